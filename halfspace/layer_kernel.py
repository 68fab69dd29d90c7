"""The correction `D(t)` that makes a layer of a half-space, tabulated once per Poisson's ratio.

`D(t) = int_0^inf (S(x) - 1) J0(x t) dx` is even, analytic within |Im t| < 2, and is `-1/t` beyond
`REACH` to machine precision. Up to there it is kept as polynomials of degree `DEGREE` on pieces of
the width `PIECE`, interpolated in Chebyshev's points; their error falls as `(32)^-DEGREE`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array
from .layers import Layer, symbol

REACH = 48.0  # the slowest of all layers has exp(-0.739 REACH) = 4e-16 left there
PIECE = 0.25
DEGREE = 9
HIGHEST = 24.0  # S - 1 falls as x^2 exp(-2 x)
PANELS, NODES = 40, 24  # of the integral: two periods of J0 to a panel at most


class Correction:
    """`D` and its derivatives for one Poisson's ratio and base.

    coefficients: (DEGREE + 1, pieces), highest power first, of polynomials in `v` on [-1, 1], the
    place `t = PIECE (i + (v + 1)/2)` within the i-th piece.
    """

    def __init__(self, poissons_ratio: float, base: str) -> None:
        from scipy.special import j0

        node, weight = np.polynomial.legendre.leggauss(NODES)
        edges = np.linspace(0.0, HIGHEST, PANELS + 1)[:-1, None]
        x = (edges + (node + 1) / 2 * HIGHEST / PANELS).ravel()
        strength = (symbol(x, poissons_ratio, base) - 1) * np.tile(weight, PANELS)
        strength *= HIGHEST / PANELS / 2

        # Points of the second kind: neighbouring pieces meet.
        v = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
        pieces = int(REACH / PIECE)
        t = PIECE * (np.arange(pieces) + (v[:, None] + 1) / 2)
        values = np.empty_like(t)
        for row, times in enumerate(t):
            values[row] = j0(times[:, None] * x) @ strength
        self.coefficients: Array = np.linalg.solve(np.vander(v), values)
        self.origin = float(strength.sum())
        self.curvature = -0.25 * float(strength @ x**2)

    def value(self, t: ArrayLike) -> Array:
        """`D(t)`, t >= 0; `origin` is `D(0)`, `curvature` is D2 of `D = D(0) + D2 t^2 + ...`."""
        return self._evaluate(t, 0)[0]

    def steepness(self, t: ArrayLike) -> tuple[Array, Array]:
        """`D(t)` and `D'(t)`."""
        value, first = self._evaluate(t, 1)
        return value, first

    def spread(self, t: ArrayLike, square: ArrayLike) -> Array:
        """`D(t) + square/10 (D'' + D'/t)`: its mean under a Hertz pressure of radius sqrt(square).

        The mean of a smooth function over a load is the function and a quarter of the load's mean
        square distance, `2/5 a^2`, times its Laplacian, to the fourth power of the radius.
        """
        t = np.asarray(t, dtype=np.float64)
        value, first, second = self._evaluate(t, 2)
        with np.errstate(invalid="ignore", divide="ignore"):
            over = np.where(t > 1e-3, first / t, second)
        return value + np.asarray(square) / 10 * (second + over)

    def _evaluate(self, t: ArrayLike, derivatives: int) -> list[Array]:
        t = np.asarray(t, dtype=np.float64)
        near = np.minimum(t, REACH) / PIECE
        piece = np.minimum(near.astype(np.intp), self.coefficients.shape[1] - 1)
        v = 2 * (near - piece) - 1
        result = []
        with np.errstate(divide="ignore"):
            inverse = 1 / np.maximum(t, REACH)
        for order in range(derivatives + 1):
            table = _derivative(self.coefficients, order)
            sum_ = np.take(table[0], piece)
            for row in table[1:]:
                sum_ = sum_ * v + np.take(row, piece)
            far = -inverse * ((1, -inverse, 2 * inverse**2)[order])
            result.append(np.where(t < REACH, sum_ * (2 / PIECE) ** order, far))
        return result


def _derivative(coefficients: Array, order: int) -> Array:
    for _ in range(order):
        powers = np.arange(len(coefficients) - 1, 0, -1)
        coefficients = coefficients[:-1] * powers[:, None]
    return coefficients


class LayerKernel:
    """What a layer adds to the half-space's 1/r, in the same units: a force f acts by f times it.

    smooth(r): `D(r/h)/h`, 1/m, at distances r, m; spectrum(q): its Fourier transform over the
    plane, m, at q, rad/m, >= 0; at q = 0 with that of 1/r, which a periodic half-space leaves out.
    """

    def __init__(self, layer: Layer, poissons_ratio: float) -> None:
        self.layer, self.poissons_ratio = layer, poissons_ratio
        self.thickness = layer.thickness

    @property
    def table(self) -> Correction:
        return correction(self.poissons_ratio, self.layer.base)

    def smooth(self, r: ArrayLike) -> Array:
        t = np.asarray(r, dtype=np.float64) / self.thickness
        return self.table.value(t) / self.thickness

    def spectrum(self, q: ArrayLike) -> Array:
        q = np.asarray(q, dtype=np.float64)
        symbol = self.layer.symbol(q, self.poissons_ratio) - 1
        mean = self.layer.uniform(self.poissons_ratio)
        return 2 * np.pi * np.where(q > 0, symbol / np.where(q > 0, q, 1.0), mean)


@lru_cache(maxsize=16)
def correction(poissons_ratio: float, base: str) -> Correction:
    """The table, made on first use (a few tenths of a second) and kept."""
    return Correction(poissons_ratio, base)
