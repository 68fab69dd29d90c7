"""How long the half-space takes: one application of C, by mesh and directly; renewing a plan.

    python benchmarks/half_space.py [--count 1000 10000] [--tolerance 1e-4 1e-6] [--threads 1]

Contacts lie at random, one per unit of area; times are the least of several. `error` is the worst
contact's, of `f_rms/(pi E' s)`, against extended precision at some of them. Where FINUFFT is
installed, the last column is its time for the smooth part alone: one transform of type 1 and one of
type 2, of as many waves and to the same tolerance. It is no complete sum.
"""

import argparse
import os
import sys
import time
from pathlib import Path

HEADER = (
    "contacts tolerance |  apply  +slope renewal (in applications) |  direct  gain"
    " |   error | neighbours  grid | FINUFFT"
)
DIRECT_AT_MOST = 20_000  # beyond, some rows stand for all
ROWS = 200


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--tolerance", type=float, nargs="+", default=[1e-2, 1e-4, 1e-6, 1e-10])
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    for name in ("HALFSPACE_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = str(options.threads)
    sys.path.insert(0, str(Path(__file__).parents[1]))
    print(f"times in ms, {options.threads} thread(s)\n{HEADER}")
    for count in options.count:
        for tolerance in options.tolerance:
            print(line(count, tolerance, options.threads), flush=True)


def line(count: int, tolerance: float, threads: int) -> str:
    """One row of the table."""
    import numpy as np

    import halfspace

    rng = np.random.default_rng(1)
    x, f = np.sqrt(count) * rng.random((count, 2)), rng.standard_normal(count)
    ground = halfspace.HalfSpace(1 / np.pi, 0.0, tolerance=tolerance, workers=threads)
    plan = ground.plan(x, method="mesh")
    grid, pairs = plan.choice.grid, plan.choice.pairs
    moved = [x + 0.01 * rng.standard_normal(x.shape) for _ in range(2)]
    renewals = iter(moved * 1000)
    apply = least(lambda: plan.apply(f))
    both = least(lambda: plan.displacement(f))
    renewal = least(lambda: plan.refresh(next(renewals)))
    plan.refresh(x)
    direct = least(direct_sum(ground, x, f), 0.1) * max(1.0, (count / DIRECT_AT_MOST) ** 2)
    some = rng.choice(count, ROWS, replace=False)
    error = np.abs(plan.apply(f)[some] - exact(x, f, some)).max() / np.sqrt(np.mean(f**2))
    return (
        f"{count:8d} {tolerance:9.0e} | {apply:6.2f} {both:7.2f} {renewal:7.2f} "
        f"{renewal / apply:17.2f} | {direct:7.4g} {direct / apply:5.0f} | {error:7.1e} | "
        f"{pairs:10.0f} {grid.torus[0]:5d} | {finufft(x, f, grid, tolerance, threads):>7s}"
    )


def least(work, seconds: float = 0.5) -> float:
    """The shortest of several times, ms; `seconds` for all of them, or twice."""
    work()
    times, end = [], time.perf_counter() + seconds
    while len(times) < 2 or time.perf_counter() < end:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def direct_sum(ground, x, f):
    """The direct sum, of no more contacts than would take seconds."""
    few = ground.plan(x[:DIRECT_AT_MOST], method="direct")
    return lambda: few.apply(f[:DIRECT_AT_MOST])


def exact(x, f, some):
    """Sums of f/r at some contacts, in extended precision."""
    import numpy as np

    result = np.empty(len(some))
    for k, target in enumerate(some):
        d = x[target].astype(np.longdouble) - x
        squared = d[:, 0] ** 2 + d[:, 1] ** 2
        squared[target] = np.inf
        result[k] = np.sum(f / np.sqrt(squared))
    return result


def finufft(x, f, grid, tolerance: float, threads: int) -> str:
    """Time of the transforms there and back, ms."""
    try:
        import finufft as library
    except ImportError:
        return "-"
    import numpy as np

    place = 2 * np.pi * (x / (np.asarray(grid.torus) * grid.spacing))
    u, v = (np.ascontiguousarray(axis) for axis in place.T)
    there = library.Plan(1, grid.torus, eps=tolerance, isign=-1, nthreads=threads)
    back = library.Plan(2, grid.torus, eps=tolerance, isign=1, nthreads=threads)
    load = f.astype(np.complex128)
    there.setpts(u, v)
    back.setpts(u, v)
    return f"{least(lambda: back.execute(there.execute(load))):7.2f}"


if __name__ == "__main__":
    main()
