"""The beds that the benchmarks share: spheres poured into a box with rough walls, and at rest.

A bed is made once by this code, from a random packing that falls and is damped, and kept in a
folder for temporary files; every code that is compared starts from the same numbers.
"""

import math
import os
import tempfile
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import taichi_dem as dem
from taichi_dem import packing

RADIUS = 1e-3  # m, the largest
GLASS = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
GEL = dem.Material("gel", density=1050, youngs_modulus=2e5, poissons_ratio=0.49)
FRICTION = 0.3
RESTITUTION = 0.5
TIME_STEP = 4e-6  # s
GRAVITY = 9.81  # m/s2

POURED = 0.54  # volume fraction before the fall, far from the walls
SETTLED = 0.6  # about what it ends at: sets the box, as wide as the bed is high
MONOLAYER = 0.7  # share of the ground that the spheres on it cover
SETTLING_STEP = 2 * TIME_STEP
ROUND = 4000  # steps of settling between two stops
MOST_ROUNDS = 40
REPEATS = "_repeats"  # in the name of a file
AT_REST = 1e-5  # kinetic energy of a sphere, in lifts of the mean sphere by its radius


@dataclass(frozen=True)
class Bed:
    """Spheres at rest in a box: position (n, 3) m and radius (n,) m; ``length`` and ``width`` (m)
    along x and y. ``on_gel``: the floor is an elastic half-space; ``repeats``: in place of walls
    the sides are periodic."""

    position: np.ndarray
    radius: np.ndarray
    length: float
    width: float
    on_gel: bool = False
    repeats: bool = False

    @property
    def count(self) -> int:
        return len(self.radius)


def scene(bed: Bed, restitution: float = RESTITUTION, exchange: str = "implicit") -> dem.Scene:
    """The bed as a scene: Hertz, Mindlin, four walls or none, a floor or a substrate."""
    sides = dem.Box((0.0, 0.0, -math.inf), (bed.length, bed.width, math.inf), GLASS)
    floor = dem.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), GLASS)
    return dem.Scene(
        spheres=dem.Spheres(bed.position, bed.radius, GLASS),
        boundaries=[*([] if bed.repeats else [sides]), *([] if bed.on_gel else [floor])],
        substrate=dem.Substrate(GEL, exchange=exchange) if bed.on_gel else None,
        law=dem.Law(normal=dem.Hertz(restitution), tangential=dem.Mindlin(FRICTION)),
        gravity=(0.0, 0.0, -GRAVITY),
        period=(bed.length, bed.width) if bed.repeats else None,
    )


def settled(count: int, smallest: float = 0.9, repeats: bool = False) -> Bed:
    """``count`` spheres at rest on a floor, radii uniform from ``smallest`` to 1 ``RADIUS``."""

    def make() -> Bed:
        width = (count * _mean_volume(smallest) / SETTLED) ** (1 / 3)
        return _settle(replace(_pour(count, smallest, width), repeats=repeats))

    return _cached(f"floor_{count}_{smallest:g}{REPEATS * repeats}", make)


def settled_on_gel(count: int, grounded: int, smallest: float = 0.9, repeats: bool = False) -> Bed:
    """``count`` spheres at rest on an elastic half-space, ``grounded`` or so in touch."""

    def make() -> Bed:
        width = RADIUS * math.sqrt(math.pi * grounded / MONOLAYER)
        return _settle(replace(_pour(count, smallest, width), on_gel=True, repeats=repeats))

    return _cached(f"gel_{count}_{grounded}_{smallest:g}{REPEATS * repeats}", make)


def side_by_side(bed: Bed, copies: int) -> Bed:
    """``copies`` of a bed in a row along x."""
    step = np.array([bed.length, 0.0, 0.0])
    rows = [bed.position + k * step for k in range(copies)]
    return replace(
        bed,
        position=np.concatenate(rows),
        radius=np.tile(bed.radius, copies),
        length=copies * bed.length,
    )


def motion(simulation: dem.Simulation) -> float:
    """Mean kinetic energy of a sphere over the work of lifting it by its radius."""
    spheres = simulation.scene.spheres
    lift = float(np.mean(spheres.mass * spheres.radius)) * GRAVITY
    return simulation.energy()["kinetic"] / (spheres.count * lift)


def _cached(name: str, make: Callable[[], Bed]) -> Bed:
    folder = Path(tempfile.gettempdir()) / "taichi-dem-benchmarks"
    folder.mkdir(exist_ok=True)
    recipe = (GLASS, GEL, FRICTION, GRAVITY, RADIUS, POURED, SETTLED, MONOLAYER, SETTLING_STEP)
    path = folder / f"{name}_{zlib.crc32(repr((*recipe, ROUND, AT_REST)).encode()):08x}.npz"
    if not path.exists():
        partial = path.with_suffix(f".{os.getpid()}.npz")
        np.savez(partial, **vars(make()))
        partial.replace(path)
    with np.load(path) as stored:
        return Bed(**{name: stored[name][()] for name in stored})


def _mean_volume(smallest: float) -> float:
    """Of a sphere (m3), with radii uniform from ``smallest`` to 1 ``RADIUS``."""
    mean_cube = np.mean([smallest**3, smallest**2, smallest, 1.0])
    return float(mean_cube) * 4 / 3 * math.pi * RADIUS**3


def _pour(count: int, smallest: float, width: float) -> Bed:
    width = max(width, 4 * RADIUS)
    fraction = POURED * (1 - 2 * RADIUS / width)  # fewer fit along the walls
    height = max(count * _mean_volume(smallest) / (fraction * width**2), 4 * RADIUS)
    radius = ("uniform", smallest * RADIUS, RADIUS)
    region = ((0.0, 0.0, 0.0), (width, width, height))
    position, radii = packing.generate(radius, region, count=count, seed=1)
    return Bed(position, radii, width, width)


def _settle(bed: Bed) -> Bed:
    """Let it fall with soft collisions until nothing moves.

    Every round starts at rest and without springs of friction: what is handed over has to stand
    with nothing but its positions.
    """
    for _ in range(MOST_ROUNDS):
        with warnings.catch_warnings():  # the step is long, but accuracy is no aim
            warnings.simplefilter("ignore")
            still = scene(bed, restitution=0.1, exchange="none")  # coupled would take hours
            simulation = dem.Simulation(still, dt=SETTLING_STEP)
        simulation.run(steps=ROUND)
        bed = replace(bed, position=simulation.particles.position)
        if motion(simulation) < AT_REST:
            return bed
    raise RuntimeError(f"{bed.count} spheres have not come to rest in {MOST_ROUNDS} rounds")
