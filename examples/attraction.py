"""Two beads on a soft gel are moved by each other's dents: together on a deep one, apart on a thin.

python examples/attraction.py -o out/attraction

Each bead lies in the slope of the other's dent.  On a deep gel it is driven downhill, towards the
other, by nearly f^2/(pi E' s^2): two equal masses that attract as 1/s^2 fall into each other in a
time that is known in closed form.  Around a bead on a thin layer that is bonded to glass, the gel
that is displaced rises, and drives the other away.  The beads slide without friction.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import halfspace

RADIUS, MASS = 1e-3, 3.3e-5  # of steel, m and kg
WEIGHT = 9.81 * MASS  # N
DEEP = halfspace.HalfSpace(youngs_modulus=10e3, poissons_ratio=0.5)
THIN = halfspace.HalfSpace(10e3, 0.5, layer=halfspace.Layer(1.5e-3))
FAR, NEAR = 6 * RADIUS, 2 * RADIUS  # distances: at the start, and where the beads touch
STRENGTH = WEIGHT**2 / (np.pi * DEEP.modulus)  # of the attraction of points, N m^2


def pair(distance: float) -> np.ndarray:
    """Where two beads are, (2, 2) m."""
    return np.array([[-distance / 2, 0.0], [distance / 2, 0.0]])


def attraction(ground: halfspace.HalfSpace, distance: float) -> float:
    """The force, N, along the surface on each bead, towards the other."""
    pressed = halfspace.press(ground, pair(distance), RADIUS, load=[WEIGHT, WEIGHT])
    return float(-pressed.force[0] * pressed.slope[0, 0])


def motion(
    ground: halfspace.HalfSpace, distance: float, duration: float, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Times, s, and distances, m, of beads let go at rest, by velocity Verlet, until they touch."""
    dt, speed = duration / steps, 0.0
    path, pull = [distance], attraction(ground, distance)
    while len(path) <= steps and path[-1] > NEAR:
        speed -= dt * pull / MASS  # half a step of both beads
        path.append(path[-1] + dt * speed)
        pull = attraction(ground, path[-1])
        speed -= dt * pull / MASS
    return dt * np.arange(len(path)), np.array(path)


def fall(distance: np.ndarray) -> np.ndarray:
    """Time, s, at which points that fall from FAR are at a distance, m: `s'' = -2 F/m`."""
    share = np.clip(distance / FAR, 0.0, 1.0)
    unit = np.sqrt(FAR**3 * MASS / (4 * STRENGTH))
    return unit * (np.sqrt(share * (1 - share)) + np.arccos(np.sqrt(share)))


def draw(folder: Path, steps: int) -> Path:
    """The dents from above, the force against the distance, and the distance against time."""
    figure = Figure(figsize=(11.5, 3.6), layout="constrained")
    seen, forces, paths = figure.subplots(1, 3)
    halfspace.press(DEEP, pair(3 * RADIUS), RADIUS, load=[WEIGHT, WEIGHT]).draw(seen)
    seen.set_title("deep gel, from above")

    distance = np.linspace(NEAR, FAR, 60)
    forces.plot(distance * 1e3, STRENGTH / distance**2 * 1e6, "k:", label="points, closed form")
    fallen = FAR - (FAR - NEAR) * np.linspace(0, 1, 200) ** 2
    paths.plot(fall(fallen), fallen * 1e3, "k:", label="points, closed form")
    duration = 1.1 * float(fall(np.array(NEAR)))
    for name, ground, start, color in (
        ("deep gel", DEEP, FAR, "#0072B2"),
        ("thin layer on glass", THIN, 1.2 * NEAR, "#D55E00"),
    ):
        pull = [attraction(ground, s) for s in distance]
        forces.plot(distance * 1e3, np.array(pull) * 1e6, color=color, label=name)
        time, path = motion(ground, start, duration, steps)
        paths.plot(time, path * 1e3, color=color, label=name)
        print(f"{name}: from {path[0] * 1e3:.2f} to {path[-1] * 1e3:.2f} mm in {time[-1]:.2f} s")
    forces.axhline(0, color="#bbbbbb", linewidth=0.7)
    forces.set(xlabel="distance (mm)", ylabel="attraction (µN)")
    paths.set(xlabel="time (s)", ylabel="distance (mm)")
    for axes in (forces, paths):
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(folder / "attraction.png", dpi=110)
    return folder / "attraction.png"


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute, tell and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/attraction"))
    parser.add_argument("--steps", type=int, default=200, help="of the motion")
    asked = parser.parse_args(arguments)
    asked.output.mkdir(parents=True, exist_ok=True)
    for distance in (2.5 * RADIUS, 4 * RADIUS, FAR):
        share = attraction(DEEP, distance) * distance**2 / STRENGTH
        print(f"distance {distance * 1e3:.1f} mm: {share:.4f} of the attraction of two points")
    print(draw(asked.output, asked.steps))


if __name__ == "__main__":
    main()
