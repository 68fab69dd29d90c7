"""Makes the table and the picture of accuracy.md: ``python docs/plot_accuracy.py`` (minutes).

Prints the table in Markdown and writes docs/images/study.png.
"""

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

import taichi_dem as dem

HERE = Path(__file__).resolve().parent
R = 1e-3
COLUMNS = "| knob | value | error | of the knob alone | s per simulated s |\n|---|---|---|---|---|"


def scene() -> dem.Scene:
    """25 glass beads that bob on a gel, each pressed in by another depth, without losses."""
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(1)
    place = np.column_stack([2.5 * grid, np.full(25, 0.97)]) + rng.uniform(-0.02, 0.02, (25, 3))
    glass = dem.Material("glass", density=2500, youngs_modulus=5e6, poissons_ratio=0.22)
    gel = dem.Material("gel", density=1050, youngs_modulus=1e5, poissons_ratio=0.49)
    return dem.Scene(
        spheres=dem.Spheres(place * R, np.full(25, R), glass),
        substrate=dem.Substrate(gel),
        law=dem.Law(dem.Hertz(restitution=1.0)),
    )


def main() -> None:
    """Study the scene, print the table, keep the picture."""
    with tempfile.TemporaryDirectory() as folder:
        found = dem.study(
            scene(), Path(folder) / "study", duration=0.03, say=lambda line: print(line, flush=True)
        )
        shutil.copy(Path(folder) / "study" / "study.png", HERE / "images" / "study.png")
    print(COLUMNS)
    for point in found.points:
        turned = hasattr(point.settings, point.knob)
        name, value = point.knob, point.label.removeprefix(point.knob) if turned else ""
        alone = "" if point.alone is None else f"{point.alone:.1e}"
        print(f"| {name} | {value} | {point.error:.1e} | {alone} | {point.cost:.2g} |")


if __name__ == "__main__":
    sys.exit(main())
