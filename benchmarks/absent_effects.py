"""Whether an effect that is off takes time: steps timed against a package without its code.

The bed is at rest on a hard floor, and its step so short that it stays so; its contacts rub and
roll.  What it has not (or, of these, what it is told to leave out) is off in the package as it is;
from a copy of the package its code is taken out.  A process of either makes short pieces in turn,
one thread each, timed by the processor time that they take.  The figure of an effect is the median
over the pieces of off over absent.  What it would be by chance the package shows against copies of
itself: three standard errors of such a median are let pass, or three times the copies' worst.  Both
must give the same bits.

``python -m benchmarks.absent_effects COUNT CASE``, in a folder with the package, is such a process.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks.report import Figure
from tests.taichi_dem.kernel_counts import FLAGS, ROOT, package_without

EVERYTHING = "everything"  # off at once: elastic spheres that slide
EFFECTS = (*(name for name in FLAGS if name not in ("rotation", "history")), EVERYTHING)
ROLLS = dem.CDT(0.05, regularization="spring")
TIME_STEP = 1e-3 * beds.TIME_STEP
WARM_UP = 200  # steps
OF_MEDIAN = (np.pi / 2) ** 0.5  # its standard error, over that of a mean


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=1000)
    parser.add_argument("--effects", nargs="+", choices=EFFECTS, default=list(EFFECTS))
    parser.add_argument("--copies", type=int, default=3, help="that the package is timed against")
    parser.add_argument("--rounds", type=int, default=15, help="pieces of each")
    parser.add_argument("--seconds", type=float, default=0.2, help="length of a piece")


def run(options: argparse.Namespace) -> list[Figure]:
    """The copies first, then every effect."""
    beds.settled(options.particles)  # for all processes
    chance: list[float] = []
    medians = []
    for _ in range(options.copies):
        step, ratios = against_itself_without([], "", options)
        chance += ratios
        medians.append(np.median(np.log(ratios)))
    error = OF_MEDIAN * np.std(np.log(chance)) / options.rounds**0.5
    most = float(np.exp(3 * max(error, np.abs(medians).max())))
    figures = [
        Figure.median(f"{options.particles} spheres: a step", step, "us"),
        Figure.median("the package over a copy of it", chance, ""),
    ]
    for name in options.effects:
        taken = list(FLAGS) if name == EVERYTHING else [name]
        _, ratios = against_itself_without(taken, name, options)
        figures.append(Figure.median(f"{name}: off over absent", ratios, "", at_most=most))
    return figures


def against_itself_without(
    effects: list[str], case: str, options: argparse.Namespace
) -> tuple[list[float], list[float]]:
    """For each turn, the time of a step of the package (us), and that over the one of a copy
    without the code of ``effects``."""
    with tempfile.TemporaryDirectory() as folder:
        if not package_without(Path(folder), effects) and effects:
            raise ValueError(f"no code belongs to {', '.join(effects)}")
        with Steps(ROOT, case, options) as off, Steps(Path(folder), case, options) as absent:
            if off.state != absent.state:
                raise RuntimeError(f"without the code of {', '.join(effects)} spheres move apart")
            steps = max(int(options.seconds / off.time(WARM_UP)), 1)
            absent.time(steps)
            turns = []
            for turn in range(options.rounds):
                pair = (off, absent) if turn % 2 else (absent, off)
                seconds = {one: one.time(steps) for one in pair}
                turns.append((seconds[off], seconds[absent]))
    return [1e6 * first for first, _ in turns], [first / second for first, second in turns]


class Steps:
    """A process that makes steps of a ``case`` with the package in ``folder``; ``state`` is a sum
    over the bits of all spheres after the first ``WARM_UP``."""

    def __init__(self, folder: Path, case: str, options: argparse.Namespace):
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.absent_effects", str(options.particles), case],
            cwd=folder,  # where it looks for the package first
            env={**os.environ, "PYTHONPATH": str(ROOT), "HALFSPACE_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.state = self._make(WARM_UP)["state"]

    def __enter__(self) -> "Steps":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def time(self, steps: int) -> float:
        """Seconds of a step."""
        return self._make(steps)["seconds"] / steps

    def _make(self, steps: int) -> dict[str, float]:
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None
        print(steps, file=stdin, flush=True)
        line = stdout.readline()
        if not line:
            raise RuntimeError("the process ended; what it said is above")
        return json.loads(line)


def simulation(count: int, case: str) -> dem.Simulation:
    """The bed in which the effect of that name is off; nothing besides is, of what it may have."""
    scene = beds.scene(beds.settled(count))
    law = dataclasses.replace(scene.law, rolling=ROLLS)
    if case == EVERYTHING:
        law = dem.Law(dem.Hertz(1.0))
    law = law.without(*{"friction": ["tangential"], "rolling": ["rolling"]}.get(case, []))
    return dem.Simulation(
        dataclasses.replace(scene, law=law),
        TIME_STEP,
        driver="serial",
        energy_balance=case != "dissipation",
    )


def main() -> None:
    """Make as many steps as each line of standard input says."""
    count, case = sys.argv[1:]
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to standard error
    if Path(dem.__file__).resolve().parents[1] != Path.cwd():
        raise RuntimeError(f"the package is that of {dem.__file__}")
    sim = simulation(int(count), case)
    for line in sys.stdin:
        start = time.process_time()
        sim.run(steps=int(line))
        seconds = time.process_time() - start
        now = sim.particles
        state = zlib.crc32(np.hstack([now.position, now.velocity, now.omega]).tobytes())
        print(json.dumps({"seconds": seconds, "state": state}), file=answers, flush=True)


if __name__ == "__main__":
    main()
