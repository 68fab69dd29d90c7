"""The bed that the benchmarks share: spheres poured into a box with rough walls, and at rest.

It is made once by this code, from a random packing that falls and is damped, and kept in a folder
for temporary files; every code that is compared starts from the same numbers.
"""

import os
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

RADIUS = 1e-3  # m, the largest
FRICTION = 0.3
RESTITUTION = 0.5
TIME_STEP = 4e-6  # s
SETTLING_STEP = 2 * TIME_STEP
GRAVITY = 9.81
POURED = 0.54  # volume fraction before the fall, far from the walls
SETTLED = 0.6  # about what it ends at: sets the box, as wide as the bed is high
ROUND = 4000  # steps of settling between two stops
MOST_ROUNDS = 40
AT_REST = 1e-5  # kinetic energy of a sphere, in lifts of the mean sphere by its radius


@dataclass(frozen=True)
class Bed:
    """Spheres at rest: position (n, 3) m and radius (n,) m, in a box ``width`` wide (m)."""

    position: np.ndarray
    radius: np.ndarray
    width: float

    @property
    def count(self) -> int:
        return len(self.radius)


def glass():
    """The material of spheres and walls."""
    import taichi_dem as dem

    return dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)


def scene(bed: Bed, restitution: float = RESTITUTION):
    """The bed as a scene: Hertz, Mindlin, four walls and a floor."""
    import taichi_dem as dem

    material = glass()
    return dem.Scene(
        spheres=dem.Spheres(bed.position, bed.radius, material),
        boundaries=[
            dem.Box((0.0, 0.0, -np.inf), (bed.width, bed.width, np.inf), material),
            dem.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), material),
        ],
        law=dem.Law(normal=dem.Hertz(restitution), tangential=dem.Mindlin(FRICTION)),
        gravity=(0.0, 0.0, -GRAVITY),
    )


def settled(count: int, smallest: float = 0.9) -> Bed:
    """``count`` spheres at rest, radii uniform from ``smallest`` to 1 times ``RADIUS``."""
    path = _folder() / f"bed_{count}_{smallest:g}.npz"
    if not path.exists():
        bed = _settle(_pour(count, smallest))
        partial = path.with_suffix(f".{os.getpid()}.npz")
        np.savez(partial, position=bed.position, radius=bed.radius, width=bed.width)
        partial.replace(path)
    with np.load(path) as stored:
        return Bed(stored["position"], stored["radius"], float(stored["width"]))


def side_by_side(bed: Bed, copies: int) -> Bed:
    """``copies`` of a bed in a row along x, each within its own width; the box is made square."""
    rows = [bed.position + (k * bed.width, 0.0, 0.0) for k in range(copies)]
    return Bed(np.concatenate(rows), np.tile(bed.radius, copies), copies * bed.width)


def _folder() -> Path:
    folder = Path(tempfile.gettempdir()) / "taichi-dem-benchmarks"
    folder.mkdir(exist_ok=True)
    return folder


def _pour(count: int, smallest: float) -> Bed:
    from taichi_dem import packing

    mean = np.mean(np.linspace(smallest, 1, 101) ** 3) * 4 / 3 * np.pi * RADIUS**3
    width = max((count * mean / SETTLED) ** (1 / 3), 4 * RADIUS)
    height = count * mean / (POURED * (1 - 2 * RADIUS / width) * width**2)
    region = ((0.0, 0.0, 0.0), (width, width, max(height, 4 * RADIUS)))
    radius = ("uniform", smallest * RADIUS, RADIUS) if smallest < 1 else RADIUS
    position, radii = packing.generate(radius, region, count=count, seed=1)
    return Bed(position, radii, width)


def _settle(bed: Bed) -> Bed:
    """Let it fall with soft collisions until nothing moves.

    Every round starts at rest and without springs of friction: what is handed over has to stand
    with nothing but its positions.
    """
    import taichi_dem as dem

    for _ in range(MOST_ROUNDS):
        with warnings.catch_warnings():  # the step is long, but accuracy is no aim
            warnings.simplefilter("ignore")
            simulation = dem.Simulation(scene(bed, restitution=0.1), dt=SETTLING_STEP)
        simulation.run(steps=ROUND)
        bed = Bed(simulation.particles.position, bed.radius, bed.width)
        if motion(simulation) < AT_REST:
            return bed
    raise RuntimeError(f"{bed.count} spheres have not come to rest in {MOST_ROUNDS} rounds")


def motion(simulation) -> float:
    """Mean kinetic energy of a sphere over the work of lifting it by its radius."""
    spheres = simulation.scene.spheres
    lift = float(np.mean(spheres.mass * spheres.radius)) * GRAVITY
    return simulation.energy()["kinetic"] / (spheres.count * lift)
