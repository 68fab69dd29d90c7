"""A long soak: a bed is shaken and then left alone; it must come to rest and stay there.

Friction and a spring that resists rolling and twisting hold every sphere, so that rest is exact:
what is left of the motion is rounding.  Energy must neither creep up nor go anywhere unaccounted
for, and the process must not grow.
"""

import argparse
import math

import numpy as np

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks.memory import resident
from benchmarks.report import Figure

PERIOD, SHAKES = 0.02, 5  # s; triangles
HEIGHT = 0.5  # of the radius, of each
LOOKS = 20  # at the bed while it is left alone
ROUND_OFF = 1e-20  # kinetic energy over that of a fall by the radius: (1e-10 of its speed)^2
ENERGY_SHARE = 1e-9  # of the work of shaking that may appear or vanish at rest
GROWTH = 16e6  # bytes: what an allocator may keep


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=1_000_000)


def run(options: argparse.Namespace) -> list[Figure]:
    """Shake, leave alone, and look at the second half of the rest."""
    simulation = dem.Simulation(shaken(beds.settled(options.particles)))
    simulation.run(duration=SHAKES * PERIOD)
    highest = beds.motion(simulation)
    looks = []
    for _ in range(LOOKS):
        simulation.run(steps=max(1, (options.steps - simulation.steps) // (LOOKS - len(looks))))
        parts = simulation.energy()
        looks.append((beds.motion(simulation), parts["balance_error"], _held(parts), resident()))
        print(
            f"t = {simulation.time:.4f} s, step {simulation.steps}: motion {looks[-1][0]:.3g}, "
            f"balance error {looks[-1][1]:.3g} J, {looks[-1][3] / 1e6:.0f} MB",
            flush=True,
        )
    motion, error, held, memory = np.array(looks[LOOKS // 2 - 1 :]).T
    work = abs(simulation.energy()["external_work"])
    return [
        Figure("motion at the end of the shaking", highest, ""),
        Figure("motion at the end", motion[-1], "", at_most=ROUND_OFF),
        Figure(
            "energy gained at rest", max(0.0, *(held - held[0])) / work, "", at_most=ENERGY_SHARE
        ),
        Figure("energy unaccounted for at rest", np.ptp(error) / work, "", at_most=ENERGY_SHARE),
        Figure("energy unaccounted for in all", abs(error[-1]) / work, ""),
        Figure("memory grown at rest", np.ptp(memory), "bytes", at_most=GROWTH),
    ]


def shaken(bed: beds.Bed) -> dem.Scene:
    """The bed on a floor that goes up and down a few times."""
    times = 0.5 * PERIOD * np.arange(2 * SHAKES + 1)
    heights = HEIGHT * beds.RADIUS * (np.arange(2 * SHAKES + 1) % 2)
    floor = dem.Piston(
        (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), beds.GLASS, program=list(zip(times, heights, strict=True))
    )
    sides = dem.Box((0.0, 0.0, -math.inf), (bed.length, bed.width, math.inf), beds.GLASS)
    return dem.Scene(
        spheres=dem.Spheres(bed.position, bed.radius, beds.GLASS),
        boundaries=[sides, floor],
        law=dem.Law(
            normal=dem.Hertz(beds.RESTITUTION),
            tangential=dem.Mindlin(beds.FRICTION),
            rolling=dem.CDT(0.1, torsion_torque=True, regularization="spring", rolling_damping=0.5),
        ),
        gravity=(0.0, 0.0, -beds.GRAVITY),
    )


def _held(parts: dict[str, float]) -> float:
    """What is there, J: all but what went and what was put in."""
    return sum(
        v for k, v in parts.items() if k not in ("dissipated", "external_work", "balance_error")
    )
