"""What a step costs with the contacts on the substrate solved together, and without; how often it
sums over them: exactly, and by the solve's kept matrix."""

import argparse
import dataclasses
import time

import numpy as np

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks.report import Figure

EXCHANGES = ("none", "implicit")
STIRRED = 0.2  # m/s, each component of the velocities of a bed that is stirred
STIRRED_STEPS = 1000
MOST_SUMS = 6.0  # per step


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, nargs="+", default=[300, 10_000])
    parser.add_argument("-g", "--grounded", type=int, nargs="+", default=[60, 1000])
    parser.add_argument("--rounds", type=int, default=5, help="turns of each")
    parser.add_argument("--seconds", type=float, default=2.0, help="length of a turn")
    parser.add_argument("--warm-up", type=float, default=5.0, help="s, after the first steps")


def run(options: argparse.Namespace) -> list[Figure]:
    """Every size in turn; ``grounded`` is about how many of the spheres stand on the substrate."""
    sizes = zip(options.particles, options.grounded, strict=True)
    return [figure for count, grounded in sizes for figure in _size(count, grounded, options)]


def _size(count: int, grounded: int, options: argparse.Namespace) -> list[Figure]:
    bed = beds.settled_on_gel(count, grounded)
    simulations = [
        dem.Simulation(beds.scene(bed, exchange=exchange), dt=beds.TIME_STEP)
        for exchange in EXCHANGES
    ]
    steps = [
        max(int(options.seconds / _warm(simulation, options)), 2) for simulation in simulations
    ]
    coupled = simulations[EXCHANGES.index("implicit")]
    before = _sums(coupled), coupled.steps
    turns = [
        [_cost(simulation, n) for simulation, n in zip(simulations, steps, strict=True)]
        for _ in range(options.rounds)
    ]
    standing = [len(simulation.substrate.particle) for simulation in simulations]
    figures = [
        Figure.median(
            f"{count} spheres, {standing[k]} on the substrate, exchange {exchange!r}: a step",
            [1e6 * turn[k] for turn in turns],
            "us",
        )
        for k, exchange in enumerate(EXCHANGES)
    ]
    ratios = [turn[1] / turn[0] for turn in turns]
    at_rest = (_sums(coupled) - before[0]) / (coupled.steps - before[1])
    return [
        *figures,
        Figure.median(f"{count} spheres, ratio of the two", ratios, ""),
        *_per_step(f"{count} spheres at rest", at_rest),
        *_per_step(f"{count} spheres, stirred", _stirred(bed)),
    ]


def _sums(simulation: dem.Simulation) -> np.ndarray:
    """Exact ones since the start, and products of the kept matrix."""
    solver = simulation._engine.exchange.solver
    return np.array([solver.exact_sums[None], solver.products[None]])


def _stirred(bed: beds.Bed) -> np.ndarray:
    """Sums per step while all spheres move and collide."""
    scene = beds.scene(bed)
    velocity = STIRRED * np.random.default_rng(1).standard_normal(bed.position.shape)
    spheres = dataclasses.replace(scene.spheres, velocity=velocity)
    simulation = dem.Simulation(dataclasses.replace(scene, spheres=spheres), dt=beds.TIME_STEP)
    simulation.run(steps=STIRRED_STEPS)
    return _sums(simulation) / simulation.steps


def _per_step(what: str, sums: np.ndarray) -> list[Figure]:
    exact, products = sums
    return [
        Figure(f"{what}: exact sums a step", float(exact), ""),
        Figure(f"{what}: products of the kept matrix", float(products), ""),
        Figure(f"{what}: both", float(sums.sum()), "", at_most=MOST_SUMS),
    ]


def _warm(simulation, options: argparse.Namespace) -> float:
    """Seconds of a step, once everything is compiled and the ways to make steps have been tried."""
    cost, start = _cost(simulation, 50), time.perf_counter()
    while time.perf_counter() - start < options.warm_up:
        cost = _cost(simulation, 50)
    return cost


def _cost(simulation, steps: int) -> float:
    """Seconds of a step."""
    start = time.perf_counter()
    simulation.run(steps=steps)
    return (time.perf_counter() - start) / steps
