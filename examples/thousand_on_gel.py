"""A thousand beads pressed together into a soft gel: each lies in the dents of all the others.

python examples/thousand_on_gel.py -o out/thousand_on_gel

A round patch of beads under one flat plate.  If they did not feel each other all would carry the
same.  In truth the middle sinks as a whole and the rim carries most: seen from afar the patch is a
rigid punch, whose pressure P/(2 pi b sqrt(b^2 - r^2)) is known.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import halfspace
from halfspace import reference

GEL = halfspace.HalfSpace(youngs_modulus=5e3, poissons_ratio=0.49)
RADIUS, SPACING = 1e-3, 2.2e-3  # of the beads, rigid beside the gel; m
LOAD_OF_ONE = 0.1e-3  # N, on the mean


def patch(count: int) -> np.ndarray:
    """`count` places, (count, 2) m, on a triangular lattice in a circle, none quite regular."""
    rng = np.random.default_rng(4)
    reach = int(np.sqrt(count)) + 2
    i, j = (v.ravel() for v in np.meshgrid(*(np.arange(-reach, reach + 1),) * 2))
    x = SPACING * np.stack([i + 0.5 * j, np.sqrt(0.75) * j], axis=1)
    x += 0.05 * SPACING * rng.uniform(-1, 1, x.shape)
    return x[np.argsort(np.hypot(*x.T))[:count]]


def punch(r: np.ndarray, count: int, rim: float) -> np.ndarray:
    """Force, N, on beads at the distances r, m, if the patch were a rigid punch of radius rim."""
    area = np.pi * rim**2 / count
    return count * LOAD_OF_ONE * area / (2 * np.pi * rim * np.sqrt(rim**2 - r**2))


def draw(pressed: halfspace.Pressed, folder: Path, points: int) -> Path:
    """The dents from above; forces against the distance from the middle."""
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    seen, forces = figure.subplots(1, 2)
    pressed.draw(seen, points=points)
    count, r = len(pressed.x), np.hypot(*pressed.x.T)
    rim = SPACING * np.sqrt(np.sqrt(0.75) * count / np.pi)  # of the same area
    forces.plot(r * 1e3, pressed.force * 1e3, ".", color="#0072B2", markersize=3, label="beads")
    forces.axhline(LOAD_OF_ONE * 1e3, color="#D55E00", label="if they did not feel each other")
    inner = np.linspace(0, 0.99 * rim, 200)
    forces.plot(inner * 1e3, punch(inner, count, rim) * 1e3, "k:", label="rigid punch of that size")
    forces.set(
        xlabel="distance from the middle (mm)", ylabel="force on a bead (mN)", ylim=(0, None)
    )
    forces.legend(frameon=False, fontsize=8)
    figure.savefig(folder / "thousand_on_gel.png", dpi=110)
    return folder / "thousand_on_gel.png"


def main(arguments: Sequence[str] | None = None) -> None:
    """Press, write ``thousand_on_gel.csv`` and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/thousand_on_gel"))
    parser.add_argument("-n", "--count", type=int, default=1000, help="of the beads")
    parser.add_argument("--points", type=int, default=300, help="of the map, along a side")
    asked = parser.parse_args(arguments)
    asked.output.mkdir(parents=True, exist_ok=True)

    x = patch(asked.count)
    print(GEL.explain(x))
    pressed = halfspace.press(GEL, x, RADIUS, load=asked.count * LOAD_OF_ONE, residual=1e-6)
    alone = float(reference.hertz_overlap(LOAD_OF_ONE, RADIUS, GEL.modulus))
    print(
        f"they sink by {pressed.approach[0] * 1e6:.0f} µm, {pressed.approach[0] / alone:.1f} times "
        f"as far as one would alone; {pressed.applications} applications"
    )
    with (asked.output / "thousand_on_gel.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["x_m", "y_m", "force_N", "contact_radius_m"])
        table.writerows(np.c_[pressed.x, pressed.force, pressed.contact_radius].tolist())
    print(draw(pressed, asked.output, asked.points))


if __name__ == "__main__":
    main()
