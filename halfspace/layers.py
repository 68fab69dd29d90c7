r"""A layer of finite thickness on a rigid base.

A wave of pressure `p(q)` on the surface of a layer of thickness h depresses it by

    u(q) = 2/(E' q) S(q h) p(q),

`S = 1` being the half-space. The influence of a point force is so the half-space's and a correction
that is smooth, bounded, and never singular:

    G(r) = [1/r + D(r/h)/h] / (pi E'),    D(t) = int_0^inf (S(x) - 1) J0(x t) dx < 0.

Beyond a few thicknesses D cancels the 1/r: G dies away as `exp(-r/(l h))`, l <= 1.36, the worst
being a bonded layer at nu = 1/2, where the surface rises around a load for want of room. `D(0)/h`
acts under the force itself: a contact is stiffer on the layer than on the half-space. Contact laws
hold the half-space's own compliance, so that `D(0)/(pi E' h)` is the diagonal of the influence
matrix here. It is the leading term for contacts small against the thickness; coupling of finite
size has the next, `D + (a_j^2 + a_k^2)/(10 h^2) L` in the energy of two Hertz contacts, or of one
with itself, with the Laplacian L of D.

Sources: the symbols follow from plane strain (K. L. Johnson, Contact Mechanics, 1985, section 5.8);
the expansion in contact size from P. D. Garcia & R. Garcia, Biophys. J. 114, 2923, 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .arrays import Array

BASES = ("bonded", "frictionless")
DEEP = 100.0  # exp(-2 DEEP) is nothing
TERMS = 8  # of the series of (sinh y - y)/y^3, for y <= 1: the next is 1e-19 of the first


@dataclass(frozen=True)
class Layer:
    """What makes a layer of a half-space: `HalfSpace(..., layer=Layer(thickness))`.

    thickness: h, m, > 0; base: "bonded" to a rigid one, or "frictionless" on it (and never lifting
    off). Raises ValueError for anything else.
    """

    thickness: float
    base: str = "bonded"

    def __post_init__(self) -> None:
        thickness = checks.number("thickness", self.thickness, "a number > 0 m")
        if not thickness > 0:
            raise ValueError(f"thickness = {thickness!r}: must be a number > 0 m")
        object.__setattr__(self, "thickness", thickness)
        checks.one_of("base", self.base, BASES)

    def symbol(self, q: ArrayLike, poissons_ratio: float) -> Array:
        """`S(q h)`: depression by a wave of pressure, over the half-space's. q: rad/m, >= 0."""
        return symbol(self.thickness * np.asarray(q, dtype=np.float64), poissons_ratio, self.base)

    def uniform(self, poissons_ratio: float) -> float:
        """`h S'(0)`, m: the depression by a uniform pressure p is twice this times `p/E'`.

        `p h/E'` on a frictionless base, `p h (1 + nu)(1 - 2 nu)/(E (1 - nu))` on a bonded one.
        """
        if self.base == "frictionless":
            return 0.5 * self.thickness
        return 0.5 * self.thickness * (1 - 2 * poissons_ratio) / (1 - poissons_ratio) ** 2


def symbol(x: ArrayLike, poissons_ratio: float, base: str) -> Array:
    """`S(x)`, `x = q h >= 0`, to machine precision also as x -> 0.

    Bonded: `[(3 - 4 nu) sinh 2x - 2x] / [(3 - 4 nu) cosh 2x + 2 x^2 + 5 - 12 nu + 8 nu^2]`;
    frictionless: `(cosh 2x - 1)/(sinh 2x + 2x)`, whatever nu.
    """
    x = np.minimum(np.asarray(x, dtype=np.float64), DEEP)
    small = np.exp(-2 * x)  # all is divided by the exponential that would overflow
    fading = -np.expm1(-2 * x)
    if base == "frictionless":
        with np.errstate(invalid="ignore"):
            s = fading**2 / (fading * (1 + small) + 4 * x * small)
        return np.where(x > 0, s, 0.0)
    nu = poissons_ratio
    kappa = 3 - 4 * nu
    odd = (kappa - 1) * fading * (1 + small) + _sinh_beyond_linear(2 * x, small)
    constant = 5 - 12 * nu + 8 * nu**2
    return odd / (kappa * (1 + small**2) + (4 * x**2 + 2 * constant) * small)


def _sinh_beyond_linear(y: Array, small: Array) -> Array:
    """`2 exp(-y) (sinh y - y)`; small: `exp(-y)`."""
    near = np.minimum(y, 1.0)
    series = np.ones_like(near)
    for k in range(TERMS, 0, -1):
        series = 1 + near**2 / ((2 * k + 2) * (2 * k + 3)) * series
    return np.where(y < 1, small * near**3 / 3 * series, 1 - small**2 - 2 * y * small)
