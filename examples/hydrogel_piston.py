"""A flat piston presses 514 hydrogel beads in a box, twice, as in a measured experiment.

    python examples/hydrogel_piston.py particles.data [--reference forces.csv] [--out folder]

``particles.data`` is the packing at the start in LAMMPS format (id type diameter density x y z).
The piston goes down by 30 mm in 0.3 s, up, down and up again.  The mean force on it before every
5 ms goes to ``piston_force.csv`` and, over the curve of a reference if one is given, to
``piston_force.png``; energies and contacts go to ``history.csv``.

Source: N. Brodu, J. A. Dijksman and R. P. Behringer, Nature Communications 6 (2015) 6361.  Without
their multi-contact effect, as here, the beads are softer than the measured ones.
"""

import argparse
import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import taichi_dem as dem
from taichi_dem import style
from taichi_dem.writing import replacing

GEL = dem.Material("hydrogel", density=11.5, youngs_modulus=23.3e3, poissons_ratio=0.5)
WALL = dem.Material("wall", density=1200, youngs_modulus=50e6, poissons_ratio=0.5)
BOX = (0.165190844117647, 0.165833589215686)  # m, inner width and depth
HIGHEST, LOWEST = 0.1676430125, 0.1375165625  # m, of the piston
STROKE = HIGHEST - LOWEST
STROKE_TIME = 0.3  # s
PROGRAM = tuple((k * STROKE_TIME, STROKE * (k % 2)) for k in range(5))  # (s, m down)
TIME_STEP = 1e-5  # s
INTERVAL, WINDOW = 5e-3, 1e-3  # s, between two mean forces; over which each is taken
PISTON = 1  # index of the boundary
NAME = "piston_force"


def packing(path: Path | str) -> dem.Spheres:
    """The beads of a LAMMPS data file."""
    return dem.Spheres.from_lammps_data(path, GEL)


def scene(beads: dem.Spheres) -> dem.Scene:
    """The beads between floor, four side walls and the piston."""
    return dem.Scene(
        spheres=beads,
        boundaries=(
            dem.Box((0.0, 0.0, 0.0), (*BOX, math.inf), material=WALL),
            dem.Piston((0.0, 0.0, HIGHEST), (0.0, 0.0, -1.0), material=WALL, program=PROGRAM),
        ),
        law=dem.Law(normal=dem.Hertz(restitution=0.95), tangential=dem.Mindlin(friction=0.03)),
    )


def piston_height(time: Any) -> np.ndarray:
    """Height of the piston (m) at ``time`` (s)."""
    times, travel = zip(*PROGRAM, strict=True)
    return HIGHEST - np.interp(time, times, travel)


class PistonForce:
    """Mean force of the beads on the piston, over ``WINDOW`` before each multiple of ``INTERVAL``.

    It is the work that the piston does in a window over the way that it goes, which counts every
    step and needs no sample of any.  ``rows`` holds (step, time s, piston m, force N).
    """

    every = WINDOW

    def __init__(self) -> None:
        self.rows: list[tuple[int, float, float, float]] = []
        self._work, self._windows = math.nan, round(INTERVAL / WINDOW)

    def start(self, sim: dem.Simulation) -> None:
        """Nothing has to be opened."""

    def write(self, sim: dem.Simulation) -> None:
        window = round(sim.time / WINDOW) % self._windows
        if window not in (0, self._windows - 1):
            return
        before, self._work = self._work, sim.energy()["external_work"]
        if window == 0 and sim.steps > 0:
            height = piston_height(sim.time)
            force = (self._work - before) / (piston_height(sim.time - WINDOW) - height)
            self.rows.append((sim.steps, sim.time, float(height), float(force)))

    def finish(self, sim: dem.Simulation) -> None:
        """Nothing is outstanding."""

    def curve(self) -> np.ndarray:
        """(rows, 4): step, time (s), height of the piston (m), mean force (N)."""
        return np.array(self.rows).reshape(-1, 4)

    def save(self, folder: Path) -> None:
        """Write ``piston_force.csv``."""
        with (
            replacing(folder / f"{NAME}.csv") as path,
            path.open("w", newline="", encoding="utf-8") as file,
        ):
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("step", "time_s", "piston_z_m", "force_N"))
            table.writerows(self.rows)


def read_reference(path: Path | str) -> np.ndarray:
    """(rows, 2): step and force (N) of the first curve in a table of them."""
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1))


def draw(curve: np.ndarray, reference: np.ndarray | None, folder: Path) -> Path:
    """Force against time and against the piston's way down."""
    curves = [("taichi-dem", curve[:, 1], curve[:, 3])]
    if reference is not None:
        curves.append(("LIGGGHTS", reference[:, 0] * TIME_STEP, reference[:, 1]))
    drawing = style.figure(8.0, 3.4)
    over_time, over_way = drawing.subplots(1, 2, sharey=True)
    for (label, time, force), color in zip(curves, style.PALETTE, strict=False):
        look = style.line(color, len(time)) | {"label": label}
        over_time.plot(time, force, **look)
        over_way.plot((HIGHEST - piston_height(time)) * 1e3, force, **look)
    over_time.set(xlabel="time (s)", ylabel="force on the piston (N)")
    over_way.set(xlabel="way down (mm)")
    style.legend(over_time)
    for axes in (over_time, over_way):
        style.dress(axes)
    return style.save(drawing, folder / f"{NAME}.png")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the whole program, or its first ``--duration`` seconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packing", type=Path, help="LAMMPS data file of the beads")
    parser.add_argument("--reference", type=Path, help="CSV: step, force (N)")
    parser.add_argument("--out", type=Path, default=Path("out/hydrogel_piston"))
    parser.add_argument("--duration", type=float, default=PROGRAM[-1][0], help="s")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)

    simulation = dem.Simulation(scene(packing(options.packing)), dt=TIME_STEP)
    force = PistonForce()
    outputs = (
        force,
        dem.History(options.out, every=10 * INTERVAL),
        dem.Summary(options.out),
        dem.Progress(options.duration),
    )
    try:
        simulation.run(options.duration, outputs=outputs)
    finally:
        force.save(options.out)

    curve = force.curve()
    reference = read_reference(options.reference) if options.reference else None
    print(f"{draw(curve, reference, options.out)} and {NAME}.csv are in {options.out}")
    third = np.isclose(curve[:, 1], 3 * STROKE_TIME)
    if third.any():
        print(f"full compression, third stroke: {curve[third, 3][0]:.4f} N", end="")
        if reference is not None:
            same = reference[:, 0] == round(3 * STROKE_TIME / TIME_STEP)
            print(f" (reference {reference[same, 1][0]:.4f} N)", end="")
        print()


if __name__ == "__main__":
    main()
