"""What sleep saves: steps of a bed at rest asleep and awake, by turns."""

import argparse
import dataclasses
import time

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks.report import Figure
from taichi_dem.pace import NEVER

LAW = dem.Law(
    dem.Hertz(0.1), dem.Mindlin(beds.FRICTION), dem.CDT(0.05, regularization="spring")
)  # damped well, to come to rest soon
LEAST_RATIO = 3.0


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=1000)
    parser.add_argument("--driver", default="serial", help="serial, team, parallel or auto")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each")
    parser.add_argument("--steps", type=int, default=1000, help="steps of a turn")
    parser.add_argument("--most", type=int, default=200_000, help="steps until all must sleep")


def run(options: argparse.Namespace) -> list[Figure]:
    """Wait until the whole bed sleeps, then take turns."""
    scene = beds.scene(beds.settled(options.particles))
    scene = dataclasses.replace(scene, law=LAW, sleep=True)
    sim = dem.Simulation(scene, driver=options.driver)
    wait(sim, options.most)
    waited, sleep = sim.steps, sim._engine.sleep
    asleep, awake = [], []
    for _ in range(options.rounds):
        asleep.append(_seconds(sim, options.steps))
        sleep.wake_all(sim.steps)
        sleep.next = NEVER
        awake.append(_seconds(sim, options.steps))
        sleep.next = 0
        wait(sim, options.most)
    what = f"{options.particles} spheres at rest"
    ratios = [slow / fast for slow, fast in zip(awake, asleep, strict=True)]
    return [
        Figure(f"{what}: steps until they sleep", waited, ""),
        Figure.median(f"{what}: a step awake", [1e6 * seconds for seconds in awake], "us"),
        Figure.median(f"{what}: a step asleep", [1e6 * seconds for seconds in asleep], "us"),
        Figure.median(f"{what}: awake over asleep", ratios, "", at_least=LEAST_RATIO),
    ]


def wait(sim: dem.Simulation, most: int) -> None:
    """Run until all sleep, within ``most`` steps."""
    last = sim.steps + most
    while not sim.asleep.all():
        if sim.steps >= last:
            raise RuntimeError(f"{(~sim.asleep).sum()} spheres are still awake")
        sim.run(steps=200)


def _seconds(sim: dem.Simulation, steps: int) -> float:
    start = time.perf_counter()
    sim.run(steps=steps)
    return (time.perf_counter() - start) / steps
