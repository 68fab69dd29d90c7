"""What a layer adds to the half-space's 1/r, tabulated once per Poisson's ratio.

`D(t) = int_0^inf (S(x) - 1) J0(x t) dx`, and its Laplacian in the plane, which contacts of some
size need, `L(t) = -int_0^inf (S(x) - 1) x^2 J0(x t) dx`. Both are even, analytic within |Im t| < 2,
and beyond `REACH` they are `-1/t` and `-1/t^3` to machine precision, so that nothing is left of the
half-space there. Up to there they are kept as polynomials of degree `DEGREE` on pieces of the width
`PIECE`, interpolated in Chebyshev's points: 32 times better with each degree.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import Array
from .layers import Layer, symbol

Pieces = NDArray[np.intp]

REACH = 48.0  # the slowest of all layers has exp(-0.739 REACH) = 4e-16 left there
PIECE = 0.25
DEGREE = 9
HIGHEST = 24.0  # S - 1 falls as x^2 exp(-2 x)
PANELS, NODES = 40, 24  # of the integrals: five periods of J0 to a panel at most


class Table:
    """One of the two functions.

    coefficients: (DEGREE + 1, pieces), highest power first, of polynomials in `v` on [-1, 1], the
    place `t = PIECE (i + (v + 1)/2)` within the i-th piece; power: of 1/t that it ends in; origin:
    its value at t = 0.
    """

    def __init__(self, x: Array, strength: Array, power: int) -> None:
        from scipy.special import j0

        # Points of the second kind: neighbouring pieces meet.
        v = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
        t = PIECE * (np.arange(int(REACH / PIECE)) + (v[:, None] + 1) / 2)
        values = np.stack([j0(row[:, None] * x) @ strength for row in t])
        self.coefficients: Array = np.linalg.solve(np.vander(v), values)
        powers = np.arange(DEGREE, 0, -1)
        self._derivative = self.coefficients[:-1] * (2 / PIECE * powers[:, None])
        self.power, self.origin = power, float(strength.sum())

    def value(self, t: ArrayLike) -> Array:
        """At t >= 0."""
        t, piece, v, inverse = self._place(t)
        return np.where(
            t < REACH, _polynomials(self.coefficients, piece, v), -(inverse**self.power)
        )

    def steepness(self, t: ArrayLike) -> tuple[Array, Array]:
        """The value and its derivative."""
        t, piece, v, inverse = self._place(t)
        value = _polynomials(self.coefficients, piece, v)
        steep = _polynomials(self._derivative, piece, v)
        far = inverse**self.power
        return (
            np.where(t < REACH, value, -far),
            np.where(t < REACH, steep, self.power * far * inverse),
        )

    def _place(self, t: ArrayLike) -> tuple[Array, Pieces, Array, Array]:
        t = np.asarray(t, dtype=np.float64)
        near = np.minimum(t, REACH) / PIECE
        piece = np.minimum(near.astype(np.intp), self.coefficients.shape[1] - 1)
        return t, piece, 2 * (near - piece) - 1, 1 / np.maximum(t, REACH)


def _polynomials(coefficients: Array, piece: Pieces, v: Array) -> Array:
    sum_ = np.take(coefficients[0], piece)
    for row in coefficients[1:]:
        sum_ = sum_ * v + np.take(row, piece)
    return sum_


@dataclass(frozen=True)
class Correction:
    """D and L of one Poisson's ratio and base."""

    value: Table
    laplacian: Table


@lru_cache(maxsize=16)
def correction(poissons_ratio: float, base: str) -> Correction:
    """The tables, made on first use, in about 0.1 s, and kept."""
    node, weight = np.polynomial.legendre.leggauss(NODES)
    edges = np.linspace(0.0, HIGHEST, PANELS + 1)[:-1, None]
    x = (edges + (node + 1) / 2 * HIGHEST / PANELS).ravel()
    strength = (symbol(x, poissons_ratio, base) - 1) * np.tile(weight, PANELS)
    strength *= HIGHEST / PANELS / 2
    return Correction(Table(x, strength, 1), Table(x, -strength * x * x, 3))


class LayerKernel:
    """What a layer adds to 1/r, in the same units: a force f acts by f times it.

    smooth(r): `D(r/h)/h`, 1/m, at distances r, m; spectrum(q): its Fourier transform over the
    plane, m, at q, rad/m, >= 0; at q = 0 with that of 1/r, which a periodic half-space leaves out.
    """

    def __init__(self, layer: Layer, poissons_ratio: float) -> None:
        self.layer, self.poissons_ratio = layer, poissons_ratio
        self.thickness = layer.thickness

    @property
    def tables(self) -> Correction:
        return correction(self.poissons_ratio, self.layer.base)

    def smooth(self, r: ArrayLike) -> Array:
        t = np.asarray(r, dtype=np.float64) / self.thickness
        return self.tables.value.value(t) / self.thickness

    def spectrum(self, q: ArrayLike) -> Array:
        q = np.asarray(q, dtype=np.float64)
        symbol = self.layer.symbol(q, self.poissons_ratio) - 1
        mean = self.layer.uniform(self.poissons_ratio)
        return 2 * np.pi * np.where(q > 0, symbol / np.where(q > 0, q, 1.0), mean)
