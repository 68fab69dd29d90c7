"""The error that ``taichi-dem run --error`` leaves, against a tight reference, over the asked one.

Four scenes that nothing in the choice was tuned on: an undamped bed that bobs on soft ground, beads
with friction and damping poured on a gel, a packing pressed by a piston, and a cloud that collides.
"""

import argparse
import math
from collections.abc import Callable

import numpy as np

import taichi_dem as dem
from benchmarks.report import Figure
from taichi_dem import accuracy
from taichi_dem.choice import choose_by
from taichi_dem.pilot import Pilot

R = 2e-3  # m
STONE = dem.Material("stone", density=2500, youngs_modulus=5e6, poissons_ratio=0.25)
GEL = dem.Material("gel", density=1050, youngs_modulus=2e5, poissons_ratio=0.48)
FINER = 16  # times, the reference's step


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--error", type=float, nargs="+", default=[1e-3])
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))


def run(options: argparse.Namespace) -> list[Figure]:
    """Every scene with every error."""
    figures = []
    for name in options.scenes:
        scene, duration = SCENES[name]()
        pilot = Pilot(scene, duration)
        for asked in options.error:
            choice = choose_by(pilot, asked)
            for line in choice.words():
                print(f"{name}, {asked:g}: {line}", flush=True)
            fine = pilot.tight.but("step", choice.settings.step / FINER)
            found = pilot.distance(choice.settings, fine)
            ratio = accuracy.worst(found) / asked
            print(f"{name}, {asked:g}: {found}", flush=True)
            least = {} if choice.limit == "the stable step" else {"at_least": 1 / 3}
            what = f"{name}, {asked:g} asked, limited by {choice.limit}: found / asked"
            figures.append(Figure(what, ratio, "", at_most=2.0))
            if least:
                figures.append(Figure(what, ratio, "", **least))
    return figures


def _lattice(counts: tuple[int, int, int], spacing: float, jitter: float, seed: int) -> np.ndarray:
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1)
    grid = grid.reshape(-1, 3) * spacing
    return (grid + np.random.default_rng(seed).uniform(-jitter, jitter, grid.shape)) * R


def bobbing() -> tuple[dem.Scene, float]:
    """Without any loss, on ground that couples all contacts."""
    place = _lattice((4, 4, 1), 2.7, 0.1, 11)
    place[:, 2] = R * (0.97 + 0.01 * np.random.default_rng(12).uniform(size=len(place)))
    return dem.Scene(
        spheres=dem.Spheres(place, np.full(len(place), R), STONE),
        substrate=dem.Substrate(GEL),
        law=dem.Law(dem.Hertz(1.0)),
    ), 0.03


def poured() -> tuple[dem.Scene, float]:
    """Two layers of beads in a box, with friction and damping."""
    place = _lattice((3, 3, 2), 2.3, 0.1, 13) + np.array([1.3, 1.3, 1.2]) * R
    side = 7.4 * R
    return dem.Scene(
        spheres=dem.Spheres(place, np.full(len(place), R), STONE),
        boundaries=[dem.Box((0, 0, -math.inf), (side, side, math.inf), STONE)],
        substrate=dem.Substrate(GEL),
        law=dem.Law(dem.Hertz(0.5), dem.Mindlin(0.4)),
    ), 0.04


def pressed() -> tuple[dem.Scene, float]:
    """A loose packing between walls and a piston."""
    place = _lattice((3, 3, 3), 2.05, 0.02, 14) + 1.1 * R
    side = 6.4 * R
    return dem.Scene(
        spheres=dem.Spheres(place, np.full(len(place), R), STONE),
        boundaries=[
            dem.Box((0, 0, 0), (side, side, math.inf), STONE),
            dem.Piston((0, 0, side), (0, 0, -1), STONE, velocity=0.1),
        ],
        law=dem.Law(dem.Hertz(0.7), dem.Mindlin(0.3)),
    ), 0.015


def cloud() -> tuple[dem.Scene, float]:
    """Spheres of two sizes that fly at each other, elastic and smooth."""
    place = _lattice((3, 3, 3), 2.4, 0.1, 15)
    place -= place.mean(axis=0)
    radius = R * np.random.default_rng(16).choice([0.7, 1.0], len(place))
    return dem.Scene(
        spheres=dem.Spheres(place, radius, STONE, velocity=-30 * place),
        law=dem.Law(dem.Hertz(0.9)),
        gravity=(0, 0, 0),
    ), 0.02


SCENES: dict[str, Callable[[], tuple[dem.Scene, float]]] = {
    "bobbing": bobbing,
    "poured": poured,
    "pressed": pressed,
    "cloud": cloud,
}
