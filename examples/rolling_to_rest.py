"""Spheres of gel roll out on a plate: how far tells how much they stick (JKR, CDT-JKR).

python examples/rolling_to_rest.py -o out/rolling_to_rest

Three gels roll side by side.  The softer one has the wider contact, and comes to rest first.
"""

import argparse
import math
from pathlib import Path

import numpy as np

import taichi_dem as dem
from taichi_dem import plot, style

RADIUS, SPEED = 2e-3, 0.05  # m, m/s
MODULI = (1e4, 3e4, 1e5)  # Pa
WORK, HYSTERESIS = 5e-3, 1.0  # J/m2, -
GRAVITY, DENSITY = 9.81, 1050.0
NAME = "rolling_to_rest"


def gel(modulus: float) -> dem.Material:
    return dem.Material(f"gel {modulus * 1e-3:g} kPa", DENSITY, modulus, 0.49)


PLATE = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)


def friction(modulus: float) -> float:
    """mu_r = pi a_0 eta/(4 R*), a_0 the radius of the contact that carries nothing."""
    compliance = [(1 - m.poissons_ratio**2) / m.youngs_modulus for m in (gel(modulus), PLATE)]
    radius = (9 * math.pi * WORK * RADIUS**2 * sum(compliance) / 2) ** (1 / 3)
    return math.pi * radius * HYSTERESIS / (4 * RADIUS)


def height(modulus: float) -> float:
    """Of a centre at rest: where the JKR contact carries the weight."""
    law, load = dem.JKR(WORK, 0.3), DENSITY * 4 / 3 * math.pi * RADIUS**3 * GRAVITY
    k = law.coefficients(gel(modulus), PLATE)
    least = k["root_radius"] ** 6 * RADIUS**2  # a_m^3
    # F = 4 E*/(3 R) (s^2 - 6 s_m s) with s = a^(3/2)
    mean = 3 * math.sqrt(least)
    root = mean + math.sqrt(mean**2 + 3 * RADIUS * load / (4 * k["effective_modulus"]))
    radius = root ** (2 / 3)
    return RADIUS - (radius**2 - 4 * math.sqrt(least * radius)) / RADIUS


def scene() -> dem.Scene:
    """One sphere of each gel, rolling without slipping along x."""
    kinds = [gel(modulus) for modulus in MODULI]
    return dem.Scene(
        spheres=dem.Spheres(
            [(0.0, 4 * RADIUS * k, height(modulus)) for k, modulus in enumerate(MODULI)],
            [RADIUS] * len(kinds),
            kinds,
            [(SPEED, 0.0, 0.0)] * len(kinds),
            [(0.0, SPEED / RADIUS, 0.0)] * len(kinds),
        ),
        boundaries=[dem.Plane((0, 0, 0), (0, 0, 1), PLATE)],
        law=dem.Law(
            normal=dem.JKR(work_of_adhesion=WORK, restitution=0.3),
            tangential=dem.Mindlin(friction=0.8),
            rolling=dem.CDTJKR(adhesion_hysteresis=HYSTERESIS),
        ),
        gravity=(0.0, 0.0, -GRAVITY),
    )


class Track:
    """Rows of time (s), places (m) and speeds (m/s) along x."""

    def __init__(self, every: float) -> None:
        self.every = every
        self.rows: list[np.ndarray] = []

    def start(self, sim: dem.Simulation) -> None:
        """Nothing has to be opened."""

    def write(self, sim: dem.Simulation) -> None:
        now = sim.particles
        self.rows.append(np.array([sim.time, *now.position[:, 0], *now.velocity[:, 0]]))

    def finish(self, sim: dem.Simulation) -> None:
        """Nothing is outstanding."""


def draw(rows: np.ndarray, folder: Path) -> Path:
    """Speeds over time, and what constant deceleration makes of them."""
    time, speeds = rows[:, 0], rows[:, 1 + len(MODULI) :]
    drawing = style.figure(4.6, 3.4)
    axes = drawing.subplots()
    for k, (modulus, color) in enumerate(zip(MODULI, style.cycle(), strict=False)):
        look = style.line(color, len(time))
        axes.plot(time, speeds[:, k] * 1e3, label=gel(modulus).name, **look)
        rate = 5 / 7 * friction(modulus) * GRAVITY
        axes.plot(time, np.maximum(SPEED - rate * time, 0) * 1e3, ":", color=color, linewidth=1)
    axes.set(xlabel="time (s)", ylabel="speed (mm/s)")
    style.legend(axes)
    style.dress(axes)
    return style.save(drawing, folder / f"{NAME}.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(f"out/{NAME}"))
    longest = SPEED / (5 / 7 * friction(max(MODULI)) * GRAVITY)
    parser.add_argument("--duration", type=float, default=1.2 * longest, help="s")
    asked = parser.parse_args()

    sim, track = dem.Simulation(scene()), Track(asked.duration / 200)
    sim.run(
        duration=asked.duration,
        outputs=[
            dem.Summary(asked.output),
            dem.State(asked.output, every=asked.duration / 20),
            dem.History(asked.output, every=asked.duration / 200),
            dem.Progress(asked.duration),
            track,
        ],
    )
    rows = np.array(track.rows)
    for k, modulus in enumerate(MODULI):
        expected = SPEED**2 / (2 * 5 / 7 * friction(modulus) * GRAVITY)
        print(
            f"{gel(modulus).name}: rolled {rows[-1, 1 + k] * 1e3:.2f} mm, at rest after "
            f"{expected * 1e3:.2f} mm by (5/7) mu_r g, mu_r = {friction(modulus):.3f}"
        )
    for picture in (*plot.draw(asked.output), draw(rows, asked.output)):
        print(picture)


if __name__ == "__main__":
    main()
