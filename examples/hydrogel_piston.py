"""A flat piston presses hydrogel beads in a box, twice, as in a measured experiment.

python examples/hydrogel_piston.py particles.data --reference forces.csv -o out/hydrogel_piston

``particles.data`` is the measured packing in LAMMPS format (id type diameter density x y z);
without it the beads are packed at random.  The piston goes down by 30 mm in 0.3 s, up, down and up
again.  The mean force on it before every 5 ms is written and drawn over the force in a reference.

Source: N. Brodu, J. A. Dijksman and R. P. Behringer, Nature Communications 6 (2015) 6361.  Only
with their multi-contact effect (``--multicontact implicit``, ``lagged`` or both, to be drawn
together) are the beads as hard as the measured ones.
"""

import argparse
import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import taichi_dem as dem
from taichi_dem import plot, style
from taichi_dem.writing import replacing

BEADS, RADII = 500, (9.5e-3, 11.6e-3)  # of a random packing; m
GEL = dem.Material("hydrogel", density=11.5, youngs_modulus=23.3e3, poissons_ratio=0.5)
WALL = dem.Material("wall", density=1200, youngs_modulus=50e6, poissons_ratio=0.5)
BOX = (0.165190844117647, 0.165833589215686)  # m, inner width and depth
HIGHEST, LOWEST = 0.1676430125, 0.1375165625  # m, of the piston
STROKE = HIGHEST - LOWEST
STROKE_TIME = 0.3  # s
PROGRAM = tuple((k * STROKE_TIME, STROKE * (k % 2)) for k in range(5))  # (s, m down)
TIME_STEP = 1e-5  # s
DEEPEST = 0.7  # of a radius
INTERVAL, WINDOW = 5e-3, 1e-3  # s, between two mean forces; over which each is taken
PISTON = 1  # index of the boundary
NAME = "piston_force"


def packing(path: Path | str) -> dem.Spheres:
    """The beads of a LAMMPS data file."""
    return dem.Spheres.from_lammps_data(path, GEL)


def random_packing(count: int = BEADS) -> dem.Spheres:
    """Beads of about the measured sizes that just do not touch."""
    region = ((0.0, 0.0, 0.0), (*BOX, HIGHEST))
    return dem.Spheres.generate(GEL, radius=("uniform", *RADII), region=region, count=count, seed=1)


def scene(beads: dem.Spheres, surface: dem.MultiContact | None = None) -> dem.Scene:
    """The beads between floor, four side walls and the piston."""
    return dem.Scene(
        spheres=beads,
        boundaries=(
            dem.Box((0.0, 0.0, 0.0), (*BOX, math.inf), material=WALL),
            dem.Piston((0.0, 0.0, HIGHEST), (0.0, 0.0, -1.0), material=WALL, program=PROGRAM),
        ),
        law=dem.Law(
            normal=dem.Hertz(restitution=0.95),
            tangential=dem.Mindlin(friction=0.03),
            surface=surface,
        ),
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


def read_reference(path: Path | str, curve: int = 1) -> np.ndarray:
    """(rows, 2): step and force (N) of a curve in a table of them; the second is multi-contact."""
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, curve))


def draw(curves: dict[str, np.ndarray], reference: np.ndarray | None, folder: Path) -> Path:
    """Force against time and against the piston's way down, of each of the ``curves`` by name."""
    pale = {"color": "#bbbbbb", "linewidth": 3.5}
    lines = []
    if reference is not None:
        lines.append(("reference", reference[:, 0] * TIME_STEP, reference[:, 1], pale))
    for k, (name, curve) in enumerate(curves.items()):
        look = style.line(style.PALETTE[k], len(curve)) | {"linestyle": "--" if k else "-"}
        lines.append((name, curve[:, 1], curve[:, 3], look))
    drawing = style.figure(8.0, 3.4)
    over_time, over_way = drawing.subplots(1, 2, sharey=True)
    for name, time, force, look in lines:
        over_time.plot(time, force, label=name, **look)
        over_way.plot((HIGHEST - piston_height(time)) * 1e3, force, **look)
    over_time.set(xlabel="time (s)", ylabel="force on the piston (N)")
    over_way.set(xlabel="way down (mm)")
    style.legend(over_time)
    for axes in (over_time, over_way):
        style.dress(axes)
    return style.save(drawing, folder / f"{NAME}.png")


def press(
    beads: dem.Spheres, surface: dem.MultiContact | None, duration: float, folder: Path
) -> np.ndarray:
    """Run the program for ``duration`` (s), writing into ``folder``; returns the curve."""
    # Beads that bulge overlap deeper than is accepted unasked.
    sim = dem.Simulation(scene(beads, surface), dt=TIME_STEP, max_overlap=DEEPEST)
    force = PistonForce()
    sim.run(
        duration=duration,
        outputs=[
            dem.Summary(folder),
            dem.State(folder, every=duration / 10),
            dem.History(folder, every=duration / 100),
            dem.Progress(duration),
            force,
        ],
    )
    force.save(folder)
    return force.curve()


def tell(name: str, curve: np.ndarray, reference: np.ndarray | None) -> None:
    """Print the forces at full compression."""
    for time in STROKE_TIME * np.array([1, 3]):
        for _, _, height, newton in curve[np.isclose(curve[:, 1], time)]:
            where = f"full compression at {time:g} s, {height * 1e3:.2f} mm"
            print(f"{name}, {where}: {newton:.4f} N", end="")
            if reference is not None:
                given = reference[reference[:, 0] == round(time / TIME_STEP), 1]
                print(f" (reference {given[0]:.4f} N)", end="")
            print()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the whole program, or its first ``--duration`` seconds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("packing", type=Path, nargs="?", help="LAMMPS data file of the beads")
    parser.add_argument("--reference", type=Path, help="CSV: step, force (N)")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/hydrogel_piston"))
    parser.add_argument("--spheres", type=int, default=BEADS, help="of a random packing")
    parser.add_argument("--duration", type=float, default=PROGRAM[-1][0], help="s")
    parser.add_argument(
        "--multicontact", choices=("implicit", "lagged"), nargs="+", default=[], help="and how"
    )
    asked = parser.parse_args(arguments)

    beads = packing(asked.packing) if asked.packing else random_packing(asked.spheres)
    reference, curves = None, {}
    if asked.reference:
        reference = read_reference(asked.reference, 2 if asked.multicontact else 1)
    for exchange in asked.multicontact or [None]:
        surface = dem.MultiContact(exchange=exchange) if exchange else None
        folder = asked.output / exchange if len(asked.multicontact) > 1 else asked.output
        name = f"taichi-dem, {exchange}" if exchange else "taichi-dem"
        curves[name] = press(beads, surface, asked.duration, folder)
        for picture in plot.draw(folder):
            print(picture)
    print(draw(curves, reference, asked.output))
    for name, curve in curves.items():
        tell(name, curve, reference)


if __name__ == "__main__":
    main()
