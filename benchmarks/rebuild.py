"""What a rebuild of the contact list costs, in steps: a bed, and two pieces of it far apart."""

import argparse
import dataclasses
import time

import numpy as np

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks.others import undisturbed
from benchmarks.report import Figure

MOST_STEPS = 4.0  # that a rebuild may cost, at
MANY = 100_000  # particles
BETWEEN_REORDERS = 8  # rebuilds: a turn holds them with their share of reordering
FAR = 1e4  # box widths between the two pieces


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5, help="turns of steps and of rebuilds")
    parser.add_argument("--patience", type=float, default=30.0, help="s to wait for a quiet turn")
    parser.add_argument("--warm-up", type=int, default=400, help="untimed steps")
    parser.add_argument("--steps", type=int, default=50, help="steps of a turn")


def run(options: argparse.Namespace) -> list[Figure]:
    """The dense bed, then the two pieces, whose grid is sparse."""
    bed = beds.settled(options.particles)
    return [*_measure("one bed", bed, options), *_measure("two far pieces", _torn(bed), options)]


def _measure(what: str, bed: beds.Bed, options: argparse.Namespace) -> list[Figure]:
    simulation = dem.Simulation(beds.scene(bed), dt=beds.TIME_STEP)
    simulation.run(steps=options.warm_up)
    skin = simulation._engine.skin  # which has become as thin as it does at rest, and is to stay
    skin._least = skin._most = skin.width
    _rebuild(simulation)
    steps, rebuilds = [], []
    for _ in range(options.rounds):
        (step, rebuild), _ = undisturbed(lambda: _turn(simulation, options.steps), options.patience)
        steps.append(1e3 * step)
        rebuilds.append(1e3 * rebuild)
    ratios = [rebuild / step for rebuild, step in zip(rebuilds, steps, strict=True)]
    target = {"at_most": MOST_STEPS} if bed.count >= MANY else {}
    grid = "dense" if simulation._engine.grid.dense else "sparse"
    what = f"{bed.count} spheres, {what} ({grid} grid)"
    return [
        Figure.median(f"{what}: a step", steps, "ms"),
        Figure.median(f"{what}: a rebuild", rebuilds, "ms"),
        Figure.median(f"{what}: a rebuild", ratios, "steps", **target),
    ]


def _turn(simulation: dem.Simulation, steps: int) -> tuple[float, float]:
    """Seconds of a step and of a rebuild."""
    start = time.perf_counter()
    simulation.run(steps=steps)
    middle = time.perf_counter()
    _rebuild(simulation)
    return (middle - start) / steps, (time.perf_counter() - middle) / BETWEEN_REORDERS


def _rebuild(simulation) -> None:
    for _ in range(BETWEEN_REORDERS):
        simulation._engine.rebuild()


def _torn(bed: beds.Bed) -> beds.Bed:
    """The bed with everything beyond its middle plane moved far along x, to the other wall."""
    beyond = bed.position[:, 0] > 0.5 * bed.width
    position = bed.position + np.outer(beyond, (FAR * bed.width, 0.0, 0.0))
    return dataclasses.replace(bed, position=position, length=(FAR + 1) * bed.width)
