"""The window by which a contact is spread over a grid: an exponential of a semicircle.

`exp(beta (sqrt(1 - (2 z/w)^2) - 1))` for `|z| < w/2`, z in grid cells (A. H. Barnett, J. Magland &
L. af Klinteberg, SIAM J. Sci. Comput. 41, C479, 2019), here with two changes. Its weights on the
points of a grid add up to one wherever the contact is, so that many forces of one sign do not add
up their errors. And between grid points it is a polynomial, fitted so that the window and its
derivative are continuous and end at zero: the energy of a contact that moves over the grid is then
smooth, and forces derived from it do no spurious work.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import ArrayLike

from .arrays import Array

NODES = 30  # of the quadrature between two grid points


class Window:
    """width: grid points it covers per dimension; beta: of the exponential.

    polynomials (width + 2, width), highest power first, in `v = 2 t - 1`, where t in [0, 1) is the
    offset of the first grid point covered from the window's lower end.
    """

    def __init__(self, width: int, beta: float) -> None:
        self.width, self.beta = width, beta

        def bell(z: Array) -> Array:
            root = np.sqrt(np.maximum(1 - (2 * z / width) ** 2, 0.0))
            return np.where(np.abs(z) < width / 2, np.exp(beta * (root - 1)) - np.exp(-beta), 0.0)

        def piece(v: Array, start: float) -> Array:
            z = start + (v + 1) / 2
            return bell(z) / bell(z[:, None] + np.arange(-width, width + 1)).sum(axis=1)

        starts = np.arange(width) - width / 2
        fits = [Chebyshev.interpolate(piece, width + 1, args=(start,)) for start in starts]
        value = _at_nodes(fits)
        value /= value.sum()
        slope = _at_nodes([fit.deriv() for fit in fits])
        pieces = [
            fit.convert(kind=Polynomial) + _hermite(fit, value[k : k + 2], slope[k : k + 2])
            for k, fit in enumerate(fits)
        ]
        # What is left of their sum has neither value nor slope at the ends: the middle takes it.
        excess = sum(pieces[1:], pieces[0]) - 1.0
        for k in {(width - 1) // 2, width // 2}:
            pieces[k] -= excess / (2 - width % 2)
        table = np.zeros((width, width + 2))
        for row, polynomial in zip(table, pieces, strict=True):
            row[: len(polynomial.coef)] = polynomial.coef
        self.polynomials: Array = np.ascontiguousarray(table.T[::-1])

    def transform(self, k: ArrayLike) -> Array:
        """Fourier transform at the wave numbers `k`, rad per cell."""
        node, weight = np.polynomial.legendre.leggauss(NODES)
        value = np.zeros((self.width, NODES))
        for row in self.polynomials:
            value = value * node + row[:, None]
        z = (np.arange(self.width)[:, None] - self.width / 2 + (node + 1) / 2).ravel()
        k = np.asarray(k, dtype=np.float64)
        return np.cos(k[..., None] * z) @ (value * weight / 2).ravel()


def _at_nodes(pieces: list[Chebyshev]) -> Array:
    """Means of the values on both sides of the points between the pieces; zero at both ends."""
    inner = [(a(1.0) + b(-1.0)) / 2 for a, b in pairwise(pieces)]
    return np.array([0.0, *inner, 0.0])


def _hermite(fit: Chebyshev, value: Array, slope: Array) -> Polynomial:
    """The cubic on [-1, 1] that a fit lacks to given values and slopes at both ends."""
    v = Polynomial([0.0, 1.0])
    up, down = (v + 1) ** 2 / 4, (v - 1) ** 2 / 4
    lack = value - fit(np.array([-1.0, 1.0]))
    steeper = slope - fit.deriv()(np.array([-1.0, 1.0]))
    return (
        lack[0] * down * (v + 2)
        - lack[1] * up * (v - 2)
        + steeper[0] * down * (v + 1)
        + steeper[1] * up * (v - 1)
    )
