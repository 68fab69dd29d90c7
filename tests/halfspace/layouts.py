"""Contacts and exact sums that the tests of fast summation share."""

import numpy as np


def uniform(rng, n):
    """At random on a square, one per unit of area."""
    return np.sqrt(n) * rng.random((n, 2))


def clustered(rng, n):
    """Four dense clusters, far apart."""
    centres = 3 * np.sqrt(n) * rng.random((4, 2))
    return centres[rng.integers(0, 4, n)] + 0.05 * np.sqrt(n) * rng.standard_normal((n, 2))


def line(rng, n):
    """On a straight line, one per unit of length."""
    return np.stack([n * rng.random(n), np.zeros(n)], axis=1)


def diagonal(rng, n):
    return n * rng.random((n, 1)) * [0.8, 0.6]


def outlier(rng, n):
    """One of them ten sides away from the others."""
    x = uniform(rng, n)
    x[n // 2] = [10 * np.sqrt(n), -3.0]
    return x


def lattice(rng, n):
    side = int(np.sqrt(n))
    return np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) + 0.0


LAYOUTS = (uniform, clustered, line, diagonal, outlier, lattice)


def forces(rng, n, sign):
    """Root mean square one; of either sign, or all pressing."""
    f = rng.standard_normal(n) if sign == "random" else 2 * rng.random(n)
    return f / np.sqrt(np.mean(f**2))


def exact(x, f, targets):
    """Sums of f/r at some contacts, and minus their gradient, in extended precision."""
    x, f = x.astype(np.longdouble), f.astype(np.longdouble)
    d = x[targets, None] - x
    squared = d[..., 0] ** 2 + d[..., 1] ** 2
    squared[np.arange(len(targets)), targets] = np.inf
    inverse = 1 / np.sqrt(squared)
    slope = np.einsum("kj,kja,j->ka", inverse**3, d, f)
    return (inverse @ f).astype(np.float64), slope.astype(np.float64)


def spacing(x, rng):
    """`1/s^2`, the number per area around a contact, on the mean: from the eighth neighbour."""
    some = rng.choice(len(x), min(len(x), 200), replace=False)
    d = np.linalg.norm(x[some, None] - x, axis=2)
    eighth = np.partition(d, 8, axis=1)[:, 8]
    return 1 / np.sqrt(np.mean(8 / (np.pi * eighth**2)))
