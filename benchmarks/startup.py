"""Time from the start of the process to the end of the first step, when it has run before."""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.others import undisturbed
from benchmarks.report import Figure

MOST_SECONDS = 2.0


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=7, help="starts after the first")
    parser.add_argument("--patience", type=float, default=30.0, help="s to wait for a quiet start")


def run(options: argparse.Namespace) -> list[Figure]:
    """The first start fills the caches; the others count."""
    from benchmarks import bed as beds

    beds.settled_on_gel(options.particles, options.particles // 5)
    _start(options.particles)
    starts = [
        undisturbed(lambda: _start(options.particles), options.patience)[0]
        for _ in range(options.rounds)
    ]
    whole = [start["total"] for start in starts]
    figures = [
        Figure.median(
            f"{options.particles} spheres on a gel, to the first step",
            whole,
            "s",
            at_most=MOST_SECONDS,
        )
    ]
    return figures + [
        Figure.median(f"  {part}", [start[part] for start in starts], "s")
        for part in starts[0]
        if part != "total"
    ]


def _start(count: int) -> dict[str, float]:
    root = Path(__file__).resolve().parents[1]
    command = [sys.executable, "-m", "benchmarks.startup", str(count), repr(time.time())]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def measure(count: int, started: float) -> dict[str, float]:
    """Seconds of each part since the process was asked for, and in all."""
    marks = [("interpreter", time.time())]
    import taichi_dem as dem
    from benchmarks import bed as beds

    simulate = dem.Simulation  # imported when asked for
    marks.append(("import", time.time()))
    scene = beds.scene(beds.settled_on_gel(count, count // 5))
    marks.append(("scene", time.time()))
    simulation = simulate(scene)
    marks.append(("simulation", time.time()))
    simulation.run(steps=1)
    marks.append(("first step", time.time()))
    parts, before = {}, started
    for name, when in marks:
        parts[name], before = when - before, when
    return parts | {"total": before - started}


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]), float(sys.argv[2]))))
