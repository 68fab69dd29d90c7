"""The hydrogel piston with multi-contact: its curve against LIGGGHTS', and how fast.

Each packing of beads displaced by 1 um goes through the strokes; the mean curve is compared with
the reference.  LIGGGHTS would take ten minutes for each, so the two codes race over a short way
before full compression, from the state that ours has reached there.
"""

import argparse
import dataclasses
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import taichi_dem as dem
from benchmarks import hydrogel, liggghts
from benchmarks.report import Figure
from examples import hydrogel_piston as example

RACE_FROM, RACE = 28000, 600  # steps, of a stroke of 30000
RACES, WARM_UP = 5, 100  # (the list is made anew meanwhile, which compiles, too)
LEAST_RATIO = 20.0
MOST_CURVE = 4.0  # % of full scale
REFERENCE_CURVE = 2


def run(options: argparse.Namespace) -> list[Figure]:
    """The curve of every packing, and the race."""
    surface = dem.MultiContact(exchange=options.multicontact)
    packings, steps = options.packings, options.steps
    if options.quick:
        packings, steps = 1, hydrogel.STEPS_PER_STROKE
    beads = example.packing(options.packing)
    with hydrogel.one_core():
        curves = []
        for seed in range(packings):
            run = hydrogel.ours(example.scene(hydrogel.displaced(beads, seed), surface), steps)
            curves.append(run.force)
            print(f"packing {seed}: {run.seconds['steps']:.1f} s", flush=True)
        figures = race(example.scene(beads, surface))
    mean = np.mean(curves, axis=0)
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        table = np.column_stack((hydrogel.SAMPLING.every * np.arange(1, len(mean) + 1), *curves))
        np.savetxt(options.output / f"hydrogel_{options.multicontact}.csv", table, "%.10g", ",")
    if options.reference:
        given = example.read_reference(options.reference, REFERENCE_CURVE)[: len(mean), 1]
        figures += compare(mean, given, packings)
    return figures


def compare(mean: np.ndarray, given: np.ndarray, packings: int) -> list[Figure]:
    """The mean curve against the reference."""
    row = min(len(mean), hydrogel.COMPARED_STROKE * hydrogel.STEPS_PER_STROKE // 500) - 1
    largest = 100 * float(np.abs(mean - given).max() / given.max())
    return [
        Figure(f"ours, mean of {packings}, at full compression", float(mean[row]), "N"),
        Figure("reference, there", float(given[row]), "N"),
        Figure("curves, difference", largest, "% of full scale", at_most=MOST_CURVE),
    ]


def race(scene: dem.Scene) -> list[Figure]:
    """Both codes over the same steps, by turns."""
    seconds: dict[str, list[float]] = {"ours": [], "liggghts": []}
    with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
        late = fresh.submit(advanced, scene).result()
        for _ in range(RACES):
            seconds["ours"].append(fresh.submit(timed, late).result())
            seconds["liggghts"].append(timed_liggghts(late))
    each = {code: [1e3 * s / RACE for s in values] for code, values in seconds.items()}
    ratios = [b / a for a, b in zip(*seconds.values(), strict=True)]
    return [
        *(
            Figure.median(f"{code}, a step near full compression", each[code], "ms")
            for code in each
        ),
        Figure.median("liggghts / ours", ratios, "", at_least=LEAST_RATIO),
    ]


def advanced(scene: dem.Scene) -> dem.Scene:
    """The scene after most of a stroke, its piston on the way at constant speed."""
    simulation = dem.Simulation(scene, dt=example.TIME_STEP, max_overlap=example.DEEPEST)
    simulation.run(steps=RACE_FROM)
    now, piston = simulation.particles, simulation.boundaries[example.PISTON]
    moving = dem.Piston(
        tuple(piston.position), (0.0, 0.0, -1.0), example.WALL, velocity=-float(piston.velocity[2])
    )
    spheres = dataclasses.replace(
        scene.spheres, position=now.position, velocity=now.velocity, omega=now.omega
    )
    return dataclasses.replace(scene, spheres=spheres, boundaries=(scene.boundaries[0], moving))


def timed(scene: dem.Scene) -> float:
    """Seconds of our steps, after a few that compile."""
    given = {"max_overlap": example.DEEPEST, "driver": "serial", "energy_balance": False}
    simulation = dem.Simulation(scene, dt=example.TIME_STEP, **given)
    simulation.run(steps=WARM_UP)
    start = time.perf_counter()
    simulation.run(steps=RACE)
    return time.perf_counter() - start


def timed_liggghts(scene: dem.Scene) -> float:
    """Seconds of LIGGGHTS' steps."""
    with tempfile.TemporaryDirectory() as name:
        script = liggghts.write(Path(name), scene, dt=example.TIME_STEP, steps=RACE)
        return liggghts.run(script).loop
