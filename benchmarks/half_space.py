"""How long sums over contacts on the half-space take: by mesh, directly, and renewing a plan.

Contacts lie at random, one per unit of area; times are the least of several, in ms, on as many
threads as HALFSPACE_THREADS says, one if it does not. `error` is the worst contact's, of
`f_rms/(pi E' s)`, against extended precision at some of them. Where FINUFFT is installed, the last
column is its time for the smooth part alone: one transform of type 1 and one of type 2, of as many
waves and to the same tolerance. It is no complete sum.
"""

import argparse
import os
import time

import numpy as np

import halfspace
from benchmarks.report import Figure

HEADER = (
    "contacts tolerance |  apply  +slope renewal (in applications) |  direct  gain"
    " |   error | neighbours  grid | FINUFFT"
)
DIRECT_AT_MOST = 20_000  # beyond, some rows stand for all
ROWS = 200
JUDGED = (100_000, 1e-6)  # contacts and tolerance of which most is asked
GAIN, RENEWAL, PEER = 100.0, 2.0, 1.0  # over a direct sum; in applications; over FINUFFT


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--tolerance", type=float, nargs="+", default=[1e-2, 1e-4, 1e-6, 1e-10])


def run(options: argparse.Namespace) -> list[Figure]:
    """A line for every number of contacts and tolerance, and then the figures."""
    threads = int(os.environ.setdefault("HALFSPACE_THREADS", "1"))
    print(f"times in ms, {threads} thread(s)\n{HEADER}")
    figures = []
    for count in options.count:
        for tolerance in options.tolerance:
            figures += _line(count, tolerance, threads)
    return figures


def _line(count: int, tolerance: float, threads: int) -> list[Figure]:
    """One row of the table, printed."""
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
    some = rng.choice(count, min(ROWS, count), replace=False)
    error = np.abs(plan.apply(f)[some] - exact(x, f, some)).max() / np.sqrt(np.mean(f**2))
    peer = finufft(x, f, grid, tolerance, threads)
    print(
        f"{count:8d} {tolerance:9.0e} | {apply:6.2f} {both:7.2f} {renewal:7.2f} "
        f"{renewal / apply:17.2f} | {direct:7.4g} {direct / apply:5.0f} | {error:7.1e} | "
        f"{pairs:10.0f} {grid.torus[0]:5d} | {peer:7.2f}",
        flush=True,
    )
    judged = (count, tolerance) == JUDGED
    what = f"{count} contacts, tolerance {tolerance:.0e}: "
    figures = [
        Figure(f"{what}an application", apply, "ms"),
        Figure(f"{what}direct over it", direct / apply, "", at_least=GAIN if judged else None),
        Figure(f"{what}renewal over it", renewal / apply, "", at_most=RENEWAL if judged else None),
        Figure(f"{what}error over tolerance", error / tolerance, "", at_most=1.0),
    ]
    if np.isfinite(peer):
        limit = PEER if judged else None
        figures.append(Figure(f"{what}it over FINUFFT", apply / peer, "", at_most=limit))
    return figures


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
    result = np.empty(len(some))
    for k, target in enumerate(some):
        d = x[target].astype(np.longdouble) - x
        squared = d[:, 0] ** 2 + d[:, 1] ** 2
        squared[target] = np.inf
        result[k] = np.sum(f / np.sqrt(squared))
    return result


def finufft(x, f, grid, tolerance: float, threads: int) -> float:
    """Time of the transforms there and back, ms; nan where it is not installed."""
    try:
        import finufft as library
    except ImportError:
        return np.nan
    place = 2 * np.pi * (x / (np.asarray(grid.torus) * grid.spacing))
    u, v = (np.ascontiguousarray(axis) for axis in place.T)
    there = library.Plan(1, grid.torus, eps=tolerance, isign=-1, nthreads=threads)
    back = library.Plan(2, grid.torus, eps=tolerance, isign=1, nthreads=threads)
    load = f.astype(np.complex128)
    there.setpts(u, v)
    back.setpts(u, v)
    return least(lambda: back.execute(there.execute(load)))
