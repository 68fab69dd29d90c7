"""The hydrogel piston against LIGGGHTS: how fast, and with what force at full compression.

Both codes run the scene of ``examples/hydrogel_piston.py`` with the same time step and write the
same mean forces, by turns and on one core, without sums of what is lost.  The packing is chaotic,
so each pair of runs starts from beads displaced at random by 1 um, and means are compared.  A third
run is this code's with the step that it chooses itself, the stable one, which is the time that the
test takes whoever does not know that step from elsewhere.  With ``--multicontact`` it is
:mod:`benchmarks.hydrogel_multicontact`.
"""

import argparse
import dataclasses
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import taichi_dem as dem
from benchmarks import liggghts
from benchmarks.report import Figure
from examples import hydrogel_piston as example

OURS, LIGGGHTS, OWN_STEP = CODES = ("ours", "liggghts", "ours, own step")
CLOCKS = {
    "steps": "the steps alone",
    "core": "the same, time of the core",
    "whole": "with start-up and compilation",
}
PACKINGS, STROKES, COMPARED_STROKE = 5, 4, 3
DISPLACEMENT = 1e-6  # m
STEPS_PER_STROKE = round(example.STROKE_TIME / example.TIME_STEP)
SAMPLING = liggghts.Sampling(
    every=round(example.INTERVAL / example.TIME_STEP),
    count=round(example.WINDOW / example.TIME_STEP),
)
WARM_UP = 2  # steps
THREADS = "HALFSPACE_THREADS"
LEAST_RATIO = 3.0
MOST_FORCE, MOST_CURVE = 2.0, 3.0  # %: of the force at full compression, of full scale


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("packing", type=Path, help="LAMMPS data file of the beads")
    parser.add_argument("--reference", type=Path, help="CSV: step, force (N)")
    parser.add_argument("--packings", type=int, default=PACKINGS)
    parser.add_argument("--steps", type=int, default=STROKES * STEPS_PER_STROKE)
    parser.add_argument("--multicontact", choices=("implicit", "lagged"), help="and how")
    parser.add_argument("--quick", action="store_true", help="one packing, one stroke")


def run(options: argparse.Namespace) -> list[Figure]:
    """Every packing in turn."""
    if not liggghts.available():
        sys.exit(f"{liggghts.BINARY} is not on the path")
    if options.multicontact:
        from benchmarks import hydrogel_multicontact

        return hydrogel_multicontact.run(options)
    packings, steps = (1, STEPS_PER_STROKE) if options.quick else (options.packings, options.steps)
    beads = example.packing(options.packing)
    runs: dict[str, list[Run]] = {code: [] for code in CODES}
    with one_core():
        for seed in range(packings):
            scene = example.scene(displaced(beads, seed))
            runs[OURS].append(ours(scene, steps))
            runs[LIGGGHTS].append(theirs(scene, steps))
            runs[OWN_STEP].append(ours(scene, steps, own_step=True))
            times = ", ".join(f"{code} {runs[code][-1].seconds['steps']:.2f} s" for code in CODES)
            print(f"packing {seed}: {times}", flush=True)
    curves = {code: np.array([run.force for run in runs[code]]) for code in CODES}
    reference = example.read_reference(options.reference) if options.reference else None
    if options.output:
        write_curves(options.output, curves)
    return [*speeds(runs), *forces(curves, reference)]


@dataclasses.dataclass(frozen=True)
class Run:
    """Seconds by each of ``CLOCKS``, and the mean force (N) on the piston at each sampling."""

    seconds: dict[str, float]
    force: np.ndarray


@contextmanager
def one_core() -> Iterator[None]:
    """Keep processes started from here on one core, where the system can, and on one thread."""
    threads = os.environ.get(THREADS)
    os.environ[THREADS] = "1"
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        if cores:
            os.sched_setaffinity(0, cores)
        del os.environ[THREADS]
        if threads is not None:
            os.environ[THREADS] = threads


def displaced(beads: dem.Spheres, seed: int) -> dem.Spheres:
    """The beads, each moved by ``DISPLACEMENT`` in a direction of its own."""
    way = np.random.default_rng(seed).normal(size=(beads.count, 3))
    way *= DISPLACEMENT / np.linalg.norm(way, axis=1, keepdims=True)
    return dataclasses.replace(beads, position=beads.position + way)


def ours(scene: dem.Scene, steps: int, own_step: bool = False) -> Run:
    """This code, in a process of its own as LIGGGHTS is."""
    start = time.perf_counter()
    with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
        run = fresh.submit(simulate, scene, steps, own_step).result()
    return Run(run.seconds | {"whole": time.perf_counter() - start}, run.force)


def simulate(scene: dem.Scene, steps: int, own_step: bool) -> Run:
    """The steps, after a few that compile what is left to compile; with ``own_step`` as many fewer
    as that is longer."""
    given = {"dt": example.TIME_STEP, "max_overlap": example.DEEPEST, "energy_balance": False}
    simulation = dem.Simulation(scene, **given)
    if own_step:  # whole windows of the mean force
        stretch = example.WINDOW / example.TIME_STEP
        stretch /= math.ceil(example.WINDOW / simulation.stable.value)
        simulation.restart(dt=stretch * example.TIME_STEP)
        steps = round(steps / stretch)
    force = example.PistonForce()
    simulation.run(steps=WARM_UP)
    start, core = time.perf_counter(), time.process_time()
    simulation.run(steps=steps - WARM_UP, outputs=[force])
    end, core = time.perf_counter(), time.process_time() - core
    return Run({"steps": end - start, "core": core}, force.curve()[:, 3])


def theirs(scene: dem.Scene, steps: int) -> Run:
    """LIGGGHTS, from the same scene; the core's time holds its start-up, some hundredths of it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        script = liggghts.write(folder, scene, dt=example.TIME_STEP, steps=steps, sampling=SAMPLING)
        timing = liggghts.run(script)
        force = liggghts.forces(folder, example.PISTON)[:, 3]
    return Run({"steps": timing.loop, "core": timing.core, "whole": timing.wall}, force)


def speeds(runs: dict[str, list[Run]]) -> list[Figure]:
    """Seconds of each code, and the ratios packing by packing."""
    figures = []
    for clock, what in CLOCKS.items():
        seconds = {code: [run.seconds[clock] for run in runs[code]] for code in CODES}
        figures += [Figure.median(f"{code}, {what}", seconds[code], "s") for code in CODES]
        target = {"at_least": LEAST_RATIO} if clock == "steps" else {}
        for code in (OURS, OWN_STEP):
            ratios = [b / a for a, b in zip(seconds[code], seconds[LIGGGHTS], strict=True)]
            figures.append(Figure.median(f"liggghts / {code}, {what}", ratios, "", **target))
    return figures


def forces(curves: dict[str, np.ndarray], reference: np.ndarray | None) -> list[Figure]:
    """Mean forces at full compression, and how far the mean curves are apart."""
    steps = curves[OURS].shape[1] * SAMPLING.every
    step = min(COMPARED_STROKE * STEPS_PER_STROKE, steps)
    row = step // SAMPLING.every - 1
    figures = []
    for code, curve in curves.items():
        what = f"{code}, mean force at step {step}"
        figures.append(Figure(what, float(curve[:, row].mean()), "N", samples=tuple(curve[:, row])))
        if len(curve) > 1:
            error = float(curve[:, row].std(ddof=1)) / math.sqrt(len(curve))
            figures.append(Figure(f"{code}, its standard error", error, "N"))
    means = {code: curve.mean(axis=0) for code, curve in curves.items()}
    aims = {"force": MOST_FORCE, "whole": MOST_CURVE}
    for code in (OURS, OWN_STEP):
        figures += _differences(f"{code} and liggghts", means[code], means[LIGGGHTS], row, **aims)
    if reference is not None:
        given = reference[: steps // SAMPLING.every, 1]
        figures.append(Figure(f"reference, force at step {step}", float(given[row]), "N"))
        for code, mean in means.items():
            figures += _differences(f"{code} and reference", mean, given, row)
    return figures


def _differences(
    what: str,
    curve: np.ndarray,
    standard: np.ndarray,
    row: int,
    force: float | None = None,
    whole: float | None = None,
) -> list[Figure]:
    """At ``row`` and where they are farthest apart; a single chaotic run sets no aim."""
    there = 100 * abs(curve[row] / standard[row] - 1)
    largest = 100 * np.abs(curve - standard).max() / standard.max()
    return [
        Figure(f"{what}, difference there", float(there), "%", at_most=force),
        Figure(f"{what}, curves", float(largest), "% of full scale", at_most=whole),
    ]


def write_curves(folder: Path, curves: dict[str, np.ndarray]) -> None:
    """Write the mean force (N) of each code against the step."""
    folder.mkdir(parents=True, exist_ok=True)
    means = [np.mean(curves[code], axis=0) for code in CODES]
    steps = SAMPLING.every * np.arange(1, len(means[0]) + 1)
    header = ",".join(
        ("step", *(f"{code.replace(', ', '_').replace(' ', '_')}_N" for code in CODES))
    )
    table = np.column_stack((steps, *means))
    np.savetxt(folder / "hydrogel.csv", table, "%.10g", ",", header=header, comments="")
