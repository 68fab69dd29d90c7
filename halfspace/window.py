"""The window by which a contact is spread over a grid: an exponential of a semicircle.

`exp(beta (sqrt(1 - (2 z/w)^2) - 1))` for `|z| < w/2`, z in grid cells (A. H. Barnett, J. Magland &
L. af Klinteberg, SIAM J. Sci. Comput. 41, C479, 2019). It is used as a polynomial between grid
points, fitted so that it and its derivative are continuous and end at zero: the energy of a contact
that moves over the grid is then smooth, and forces derived from it do no spurious work.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import ArrayLike

from .checks import Array

NODES = 30  # of the quadrature between two grid points


class Window:
    """width: grid points it covers per dimension; beta: of the exponential.

    polynomials (degree + 1, width), highest power first, in `v = 2 t - 1`, where t in [0, 1) is the
    offset of the first grid point covered from the window's lower end.
    """

    def __init__(self, width: int, beta: float) -> None:
        self.width, self.beta = width, beta
        floor = np.exp(-beta)

        def bell(z: Array) -> Array:
            root = np.sqrt(np.maximum(1 - (2 * z / width) ** 2, 0.0))
            return np.where(np.abs(z) < width / 2, np.exp(beta * (root - 1)) - floor, 0.0)

        def shape(z: Array) -> Array:
            return bell(z) / bell(z[..., None] + np.arange(-width, width + 1)).sum(-1)

        def piece(v: Array, start: float) -> Array:
            return shape(start + (v + 1) / 2)

        starts = np.arange(width) - width / 2
        fits = [Chebyshev.interpolate(piece, width + 1, args=(start,)) for start in starts]
        flat = Chebyshev([0.0])
        pieces = []
        neighbours = zip([flat, *fits[:-1]], fits, [*fits[1:], flat], strict=True)
        for before, fit, after in neighbours:
            to_value, to_slope = _gaps(before, fit, after)
            pieces.append((fit.convert(kind=Polynomial) + _hermite(to_value, to_slope)).coef)
        longest = max(map(len, pieces))
        padded = [np.pad(piece, (0, longest - len(piece))) for piece in pieces]
        self.polynomials: Array = np.ascontiguousarray(np.array(padded).T[::-1])

    def transform(self, k: ArrayLike) -> Array:
        """Fourier transform at the wave numbers `k`, rad per cell."""
        node, weight = np.polynomial.legendre.leggauss(NODES)
        value = np.zeros((self.width, NODES))
        for row in self.polynomials:
            value = value * node + row[:, None]
        z = (np.arange(self.width)[:, None] - self.width / 2 + (node + 1) / 2).ravel()
        k = np.asarray(k, dtype=np.float64)
        return np.cos(k[..., None] * z) @ (value * weight / 2).ravel()


def _gaps(before: Chebyshev, fit: Chebyshev, after: Chebyshev) -> tuple[list[float], list[float]]:
    """What `fit` lacks, at its two ends, to the means with its neighbours: values and slopes."""

    def gap(f: Chebyshev, neighbour: Chebyshev, end: float) -> float:
        edge = len(neighbour.coef) == 1
        return float(-f(end) if edge else (neighbour(-end) - f(end)) / 2)

    d = [f.deriv() if len(f.coef) > 1 else f for f in (before, fit, after)]
    values = [gap(fit, before, -1.0), gap(fit, after, 1.0)]
    return values, [gap(d[1], d[0], -1.0), gap(d[1], d[2], 1.0)]


def _hermite(value: list[float], slope: list[float]) -> Polynomial:
    """The cubic on [-1, 1] with given values and slopes at both ends."""
    v = Polynomial([0.0, 1.0])
    up, down = (v + 1) ** 2 / 4, (v - 1) ** 2 / 4
    return (
        value[0] * down * (v + 2)
        - value[1] * up * (v - 2)
        + slope[0] * down * (v + 1)
        + slope[1] * up * (v - 1)
    )
