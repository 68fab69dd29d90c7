"""What far contacts do to each other, roughly: the preconditioner of the coupled solve.

On soft ground `C K` is large, and conjugate gradients are slow, in the smooth modes alone, where
many contacts sink together.  These a coarse grid of nodes over the contacts knows as well, by
bilinear interpolation W and the influence `G` of the nodes on each other, smoothed over a quarter
of their spacing l:

    C ~ W G W^T,    G = 1/(pi E' sqrt(r^2 + (l/4)^2)).

`(K^-1 + W G W^T)^-1`, by Woodbury's identity, is K times

    1 - W (G^-1 + W^T K W)^-1 W^T K.

Sums into nodes are made in a fixed order on the CPU; on a GPU their bits, and what of them gets
into results that meet the residual, may differ from run to run. The whole is positive, as G is,
whatever the contacts are; of a square of 20 x 20 with `rho = 7` the matrix has the condition 1.5
with it, and 10 without.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from .arrays import Array, host, kind_of

SMOOTHED = 0.25  # of the spacing of nodes
EACH = 8  # contacts to a cell at least, in the mean
LEAST_SOFTNESS = 0.5  # of the ground under the contacts, from which on all this pays


class Coarse:
    """A grid of nodes over contacts at x (n, 2), m, on a half-space of modulus E', Pa."""

    def __init__(self, x: Array, modulus: float) -> None:
        self._kind = kind_of(x)
        low = [float(x[:, axis].min()) for axis in (0, 1)]
        sides = [float(x[:, axis].max()) - low[axis] for axis in (0, 1)]
        cells = _cells(len(x))
        self._apart = max(sides) > 0
        spacing = max(sides) / cells if self._apart else 1.0  # m; of no consequence then
        self._shape = tuple(max(math.ceil(side / spacing * (1 - 1e-9)), 1) + 1 for side in sides)
        self._scale = math.pi * modulus * spacing  # of G^-1
        first, past = zip(*(self._place(x[:, a], low[a], spacing, a) for a in (0, 1)), strict=True)
        self._corners = [
            ((first[0] + i) * self._shape[1] + first[1] + j, _part(past[0], i) * _part(past[1], j))
            for i in (0, 1)
            for j in (0, 1)
        ]

    def _place(self, x: Array, low: float, spacing: float, axis: int) -> tuple[Array, Array]:
        """The node before each contact, and how far past it the contact is, in spacings."""
        t = (x - low) / spacing
        node = self._kind.whole(t.clip(0, self._shape[axis] - 2))
        return node, t - node

    def preconditioner(self, stiffness: Array) -> Callable[[Array], Array] | None:
        """`r -> (1 - W (...)^-1 W^T K) r` for stiffnesses K (n,), N/m; None where it would not
        pay."""
        g, inverse = _influence(self._shape)
        nodes = len(g)
        load = host(self._gathered(stiffness, nodes))
        if not (self._apart and (g @ load).max() > LEAST_SOFTNESS * self._scale):
            return None
        between = np.zeros(nodes * nodes)
        for a, part in self._corners:
            for b, other in self._corners:
                spread = self._kind.bincount(a * nodes + b, stiffness * part * other, nodes**2)
                between += host(spread)
        whole = self._scale * inverse + between.reshape(nodes, nodes)
        solved = self._kind.array(_inverse(whole))

        def apply(r: Array) -> Array:
            u = solved @ self._gathered(stiffness * r, nodes)
            for a, part in self._corners:
                r = r - part * u[a]
            return r

        return apply

    def _gathered(self, value: Array, nodes: int) -> Array:
        """W^T of it."""
        parts = [self._kind.bincount(a, value * part, nodes) for a, part in self._corners]
        result: Array = parts[0] + parts[1] + parts[2] + parts[3]
        return result


def _part(past: Array, end: int) -> Array:
    return past if end else 1 - past


def _cells(contacts: int) -> int:
    """Along the longer side: what they cost stays below what they save."""
    most = max(7, int(contacts**0.2))
    return min(max(int(math.sqrt(contacts / EACH)), 1), most)


@lru_cache(maxsize=16)
def _influence(shape: tuple[int, int]) -> tuple[Array, Array]:
    """G of that many nodes in unit spacings on a unit modulus over pi, and its inverse."""
    at = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2)
    r2 = ((at[:, None] - at) ** 2).sum(axis=2)
    g = 1 / np.sqrt(r2 + SMOOTHED**2)
    return g, _inverse(g)


def _inverse(matrix: Array) -> Array:
    """Of a positive matrix, by sweeps: the bits of LAPACK's depend on the number of threads."""
    a = matrix.copy()
    for k in range(len(a)):
        column = a[:, k].copy()
        pivot = column[k]
        row = a[k] / pivot
        a -= column[:, None] * row
        a[k], a[:, k] = row, -column / pivot
        a[k, k] = 1 / pivot
    return a
