"""Memory of a simulation per particle, counted in a process of its own."""

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks.report import Figure

MOST_BYTES = 1500.0  # for each particle, where there are
MANY = 1_000_000
TILE = 100_000  # spheres of the settled bed that is laid out in a row
STEPS = 3


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=1_000_000)


def run(options: argparse.Namespace) -> list[Figure]:
    """What the process holds when the scene stands, and what the simulation adds to it."""
    tile = min(TILE, options.particles)
    beds.settled(tile)
    root = Path(__file__).resolve().parents[1]
    command = [sys.executable, "-m", "benchmarks.memory", str(tile), str(options.particles // tile)]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    count = told["spheres"]
    return [
        Figure(
            f"{count} spheres, simulation",
            (told["running"] - told["scene"]) / count,
            "bytes per particle",
            at_most=MOST_BYTES if count >= MANY else None,
        ),
        Figure("contacts on the list", told["listed"] / count, "per particle"),
        Figure("process with the scene", told["scene"] / 1e6, "MB"),
        Figure("process while running", told["running"] / 1e6, "MB"),
        Figure("process at its peak", told["peak"] / 1e6, "MB"),
    ]


def measure(tile: int, copies: int) -> dict[str, int]:
    """Bytes that this process holds: with the scene, and after a few steps."""
    bed = beds.side_by_side(beds.settled(tile), copies)
    scene = beds.scene(bed)
    held = resident()
    simulation = dem.Simulation(scene, dt=beds.TIME_STEP)
    simulation.run(steps=STEPS)
    return {
        "spheres": bed.count,
        "listed": simulation._engine.contacts.count(),
        "scene": held,
        "running": resident(),
        "peak": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def resident() -> int:
    """Bytes of this process that are in memory (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]), int(sys.argv[2]))))
