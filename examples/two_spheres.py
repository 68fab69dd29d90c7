"""Two spheres pressed side by side into a soft ground: how much less each carries than one alone.

python examples/two_spheres.py -o out/two_spheres

Against the closed form for contacts that act on each other as points, the root of
F = 4/3 E* sqrt(R) (delta - F/(pi E* s))^(3/2), at every distance s.
"""

import argparse
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import halfspace
from halfspace import reference

YOUNGS_MODULUS, POISSONS_RATIO = 20e3, 0.49  # of the ground, Pa; the spheres are rigid
RADIUS = 1e-3  # m
DEPTHS = (0.01, 0.03, 0.1)  # approach, in radii


def ground(coupling: str) -> halfspace.HalfSpace:
    """The ground; coupling: "finite" or "point"."""
    return halfspace.HalfSpace(YOUNGS_MODULUS, POISSONS_RATIO, coupling=coupling)


def pressed(coupling: str, distance: float, depth: float) -> halfspace.Pressed:
    """Two spheres, m apart, pressed by `depth`, m."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "coupling = ")  # points that are too close: to be seen
        x = [[-distance / 2, 0.0], [distance / 2, 0.0]]
        return halfspace.press(ground(coupling), x, RADIUS, approach=depth)


def draw(folder: Path, points: int) -> Path:
    """The force over that of one alone, what the closed form misses, and the dents."""
    figure = Figure(figsize=(11.5, 3.6), layout="constrained")
    seen, shares, misses = figure.subplots(1, 3)
    pressed("finite", 2.5 * RADIUS, DEPTHS[-1] * RADIUS).draw(seen)
    seen.set_title(f"approach {DEPTHS[-1]:g} R, from above")
    modulus = ground("finite").modulus
    for share, color in zip(DEPTHS, ("#56B4E9", "#0072B2", "#003366"), strict=True):
        depth = share * RADIUS
        alone = float(reference.hertz_stiffness(RADIUS, modulus) * depth**1.5)
        nearest = 2.4 * np.sqrt(share)  # contact radii, in radii of the spheres
        distance = np.geomspace(max(nearest, 0.5), 12, points) * RADIUS
        closed = np.array([reference.two_spheres(depth, s, RADIUS, modulus) for s in distance])
        force = {
            coupling: np.array([pressed(coupling, s, depth).force[0] for s in distance])
            for coupling in ("finite", "point")
        }
        look = {"color": color, "linewidth": 1.4}
        name = f"approach {share:g} R"
        shares.plot(distance / RADIUS, force["finite"] / alone, label=name, **look)
        shares.plot(distance / RADIUS, closed / alone, "k:", linewidth=1)
        misses.loglog(distance / RADIUS, 1 - force["finite"] / closed, label=name, **look)
        error = np.abs(force["point"] / closed - 1).max()
        print(f"{name}: as points, {error:.1e} from the closed form at most")
    shares.plot([], [], "k:", linewidth=1, label="points, closed form")
    shares.axvline(2, color="#bbbbbb", linewidth=0.7)  # nearer, spheres would cut each other
    shares.set(xscale="log", xlabel="distance / R", ylabel="force over that of one alone")
    misses.set(xlabel="distance / R", ylabel="what sizes take from the force of points")
    for axes in (shares, misses):
        axes.set_xticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(folder / "two_spheres.png", dpi=110)
    return folder / "two_spheres.png"


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute, tell and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/two_spheres"))
    parser.add_argument("--points", type=int, default=40, help="of each curve")
    asked = parser.parse_args(arguments)
    asked.output.mkdir(parents=True, exist_ok=True)
    print(draw(asked.output, asked.points))


if __name__ == "__main__":
    main()
