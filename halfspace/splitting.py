"""1/r as a smooth part, which a grid can hold, and a part of short range, which vanishes beyond rc.

    1/r = Phi(r/rc)/r + (1 - Phi(r/rc))/r,    Phi(t) = int_0^t b / int_0^1 b,

with `b(t) = I0(beta sqrt(1 - t^2)) - 1` on [-1, 1], a Kaiser-Bessel bump that ends continuously.
The spectrum of the smooth part falls by `exp(-beta)` until `q = beta/rc` and stays there: the bump
takes the place of the Gaussian of Ewald's sum (P. P. Ewald, Ann. Phys. 369, 253, 1921), whose
spectrum is twice as wide at equal accuracy.

Everything here is in units of rc: `t = r/rc`, `x = q rc`.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import ArrayLike

from .arrays import Array

NODES = 200  # of the quadratures: the integrands are entire


class Split:
    """One bump. `beta` sets how small the spectrum becomes, and how soon; where it is `smooth`,
    the bump ends without slope, and the Laplacian of the smooth part without a jump.

    The smooth part is `P(t^2)/rc` inside, with an entire function `P` that is kept as polynomial in
    `v = 2 t^2 - 1`: `polynomial` (degree + 1,), lowest power first. `P(1) = 1`.
    """

    def __init__(self, beta: float, smooth: bool = False) -> None:
        from scipy.special import i0

        self.beta = beta
        node, weight = np.polynomial.legendre.leggauss(NODES)
        node, weight = (node + 1) / 2, weight / 2

        def bump(t: Array) -> Array:
            z2 = beta**2 * np.maximum(1 - t * t, 0.0)
            return i0(np.sqrt(z2)) - 1.0 - (z2 / 4 if smooth else 0.0)

        whole = float(weight @ bump(node))

        def ratio(v: Array) -> Array:  # Phi(t)/t, the mean of the bump over [0, t]
            t = np.sqrt((v + 1) / 2)
            return bump(t[:, None] * node) @ weight / whole

        series = Chebyshev.interpolate(ratio, int(14 + 0.7 * beta), domain=[-1, 1])
        tail = np.abs(series.coef[::-1]).cumsum()[::-1]
        series = series.truncate(int((tail > max(0.1 * np.exp(-beta), 1e-15)).sum()))
        series -= series(1.0) - 1.0
        self.polynomial: Array = np.ascontiguousarray(series.convert(kind=Polynomial).coef)
        self._node, self._rest = node, weight * (1 - node * ratio(2 * node * node - 1))

    @property
    def origin(self) -> float:
        """`Phi'(0)`: the smooth part at r = 0, times rc."""
        return float(Polynomial(self.polynomial)(-1.0))

    @property
    def laplacian(self) -> Array:
        """Of the smooth part within rc, times rc^3, as polynomial in v, lowest power first."""
        p = Polynomial(self.polynomial)
        bent = 8 * p.deriv() + Polynomial([8.0, 8.0]) * p.deriv(2)
        return np.ascontiguousarray(bent.coef)

    @property
    def bend(self) -> float:
        """The smooth part's Laplacian at r = 0, times rc^3."""
        return float(8 * Polynomial(self.polynomial).deriv()(-1.0))

    def derivatives(self, t2: Array) -> tuple[Array, Array, Array, Array]:
        """Of the smooth part within rc, at `t^2`: value, Laplacian, and `1/t d/dt` of both."""
        p = Polynomial(self.polynomial)
        v = 2 * t2 - 1
        first, second, third = (p.deriv(m)(v) for m in (1, 2, 3))
        return p(v), 8 * first + 16 * t2 * second, 4 * first, 64 * (second + t2 * third)

    def values(self, t2: Array) -> tuple[Array, Array]:
        """Of the smooth part within rc, at `t^2`: value and Laplacian."""
        v = 2 * t2 - 1
        return Polynomial(self.polynomial)(v), Polynomial(self.laplacian)(v)

    @property
    def missing(self) -> float:
        """`int_0^1 (1 - Phi) dt`: -2 pi rc of it is the smooth part's mean in a periodic cell."""
        return float(self._rest.sum())

    def smooth(self, t: ArrayLike) -> Array:
        """`Phi(t)/t`, the smooth part times rc."""
        t = np.asarray(t, dtype=np.float64)
        inner = Polynomial(self.polynomial)(2 * np.minimum(t, 1.0) ** 2 - 1)
        return np.where(t < 1, inner, 1 / np.maximum(t, 1.0))

    def spectrum(self, x: ArrayLike) -> Array:
        """Fourier transform of the smooth part over the plane, over rc.

        `2 pi int_0^inf Phi(t) J0(x t) dt = 2 pi [1/x - int_0^1 (1 - Phi) J0(x t) dt]`, without the
        `1/x` at x = 0: a periodic cell has zero mean.
        """
        from scipy.special import j0

        x = np.asarray(x, dtype=np.float64)
        highest = max(float(x.max(initial=0.0)), 1.0)

        def rest(y: Array) -> Array:
            return j0(y[:, None] * self._node) @ self._rest

        degree = min(int(20 + 1.2 * highest), NODES)
        series = Chebyshev.interpolate(rest, degree, domain=[0.0, highest])
        with np.errstate(divide="ignore"):
            inverse = np.where(x > 0, 1 / x, 0.0)
        return 2 * np.pi * (inverse - series(x))
