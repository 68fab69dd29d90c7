"""Records of runs, made by hand."""

import numpy as np

from taichi_dem.record import Record


def made(samples=8, n=3, seed=1):
    """A record with all there can be in it."""
    rng = np.random.default_rng(seed)
    rows = samples + 1
    return Record(
        time=np.linspace(0, 1, rows),
        position=rng.normal(size=(rows, n, 3)),
        velocity=rng.normal(size=(n, 3)),
        balance=1e-3 * rng.normal(size=rows),
        turnover=np.linspace(1, 2, rows),
        contact=np.array([[k, 0, 1, -1] for k in range(rows)]),
        force=rng.normal(size=(rows, 3)),
        push=rng.normal(size=(rows, 1, 3)),
        ground=np.ones(rows),
        depression=rng.uniform(1, 2, 9),
    )
