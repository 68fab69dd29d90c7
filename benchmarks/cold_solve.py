"""Very many spheres pressed into the half-space from cold: applications, time and memory."""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import halfspace
from benchmarks.report import Figure
from halfspace import reference

APPLICATIONS, GIGABYTES = 120, 8.0  # at most
SPACING, DEPTH = 2.2, 0.02  # of the spheres, over their radius


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--contacts", type=int, default=1_000_000)
    parser.add_argument("--tolerance", type=float, default=1e-6, help="of the sums")
    parser.add_argument("--residual", type=float, default=1e-6)
    parser.add_argument("--coupling", choices=("finite", "point"), default="finite")


def run(options: argparse.Namespace) -> list[Figure]:
    """A square of equal spheres, not quite regular, on one level, in a process of its own."""
    told = json.dumps({k: getattr(options, k) for k in ("contacts", "tolerance", "residual")})
    command = [sys.executable, "-m", "benchmarks.cold_solve", told, options.coupling]
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    what = f"{found['contacts']} contacts, {options.coupling}: "
    return [
        Figure(f"{what}applications", found["applications"], "", at_most=APPLICATIONS),
        Figure(f"{what}iterations of Newton", found["iterations"], ""),
        Figure(f"{what}residual", found["residual"], "", at_most=options.residual),
        Figure(f"{what}time", found["seconds"], "s"),
        Figure(f"{what}memory at its peak", found["peak"] / 1e9, "GB", at_most=GIGABYTES),
    ]


def measure(contacts: int, tolerance: float, residual: float, coupling: str) -> dict[str, float]:
    """Solves, and tells what it took."""
    rng = np.random.default_rng(6)
    side = max(round(contacts**0.5), 1)
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    x = SPACING * (cells + rng.uniform(-0.03, 0.03, cells.shape))
    threads = int(os.environ.setdefault("HALFSPACE_THREADS", "1"))
    ground = halfspace.HalfSpace(1.0, 0.0, tolerance=tolerance, coupling=coupling, workers=threads)
    law, overlap = reference.hertz_law(1.0, ground.modulus), np.full(len(x), DEPTH)
    start = time.perf_counter()
    state = halfspace.solve(ground, x, overlap, law, residual)
    return {
        "contacts": len(x),
        "applications": state.applications,
        "iterations": state.iterations,
        "residual": state.residual,
        "seconds": time.perf_counter() - start,
        "peak": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


if __name__ == "__main__":
    print(json.dumps(measure(**json.loads(sys.argv[1]), coupling=sys.argv[2])))
