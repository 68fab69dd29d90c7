r"""Forces along the surface as well as into it: the 3x3 kernel of Boussinesq and Cerruti.

The half-space fills `z < 0`. A load is the vector `(t_x, t_y, f)`, a displacement `(u_x, u_y, w)`:
along x and y in the sense of the axes, and the third DOWNWARD, force and depression positive into
the ground, as everywhere in `halfspace`. (In x, y, z the force on the ground is `(t_x, t_y, -f)`.)
With G the shear modulus and `d` the way from load to point, `r = |d|`,

    u = [(1 - nu) t + nu d (d.t)/r^2]/(2 pi G r) - (1 - 2 nu)/(4 pi G) d f/r^2
    w = (1 - 2 nu)/(4 pi G) d.t/r^2 + (1 - nu)/(2 pi G r) f :

a normal force draws the surface towards itself, and a tangential one raises it behind and sinks it
ahead. The whole is symmetric (load and point exchanged, `d` changes sign): `f.Cg = g.Cf`. At
nu = 1/2 normal and tangential do not know of each other. With `u(q) = int u exp(-i q.x)` and the
unit vector `n = q/|q|` the blocks are, in Fourier space, `(I - nu n n^T)/(G q)`, `(1 - nu)/(G q)`
and `+-i (1 - 2 nu)/(2 G q) n`, with `+` for u under f.

Source: K. L. Johnson, Contact Mechanics (1985), sections 3.2 and 3.6, at the surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .arrays import Array
from .direct import BLOCK, KEEP
from .ground import HalfSpace


@dataclass(frozen=True)
class VectorHalfSpace:
    """An elastic half-space loaded by force vectors at points of its surface, by direct sums.

    youngs_modulus: Pa, > 0; poissons_ratio: -1 < nu <= 1/2. Loads and displacements are (n, 3) as
    `halfspace.tangential` describes. As in `HalfSpace`, a contact does not act on itself, nor one
    closer than the positions can tell: what a contact does to itself belongs to its law. Under
    tangential forces t that are known, the normal problem is `halfspace.solve` with the overlaps
    less `displacement(x, [t, 0])[:, 2]`. Raises ValueError for arguments without sense.
    """

    youngs_modulus: float
    poissons_ratio: float

    def __post_init__(self) -> None:
        normal = HalfSpace(self.youngs_modulus, self.poissons_ratio)
        object.__setattr__(self, "youngs_modulus", normal.youngs_modulus)
        object.__setattr__(self, "poissons_ratio", normal.poissons_ratio)

    @property
    def shear_modulus(self) -> float:
        """`G = E/(2 (1 + nu))`, Pa."""
        return self.youngs_modulus / (2 * (1 + self.poissons_ratio))

    @property
    def compliances(self) -> tuple[float, float, float]:
        """`nu`, `(1 - 2 nu)/2` and `1 - nu`, over `2 pi G`, 1/Pa."""
        nu, unit = self.poissons_ratio, 1 / (2 * np.pi * self.shear_modulus)
        return unit * nu, unit * (1 - 2 * nu) / 2, unit * (1 - nu)

    def plan(self, x: ArrayLike) -> VectorPlan:
        """The sums over one layout `x` (n, 2), m: `.apply(f)`, `.slope(f)`, `.refresh(x)`."""
        return VectorPlan(self, x)

    def displacement(self, x: ArrayLike, f: ArrayLike) -> Array:
        """Displacement (n, 3), m, of the surface at the contacts by the forces on the OTHERS.

        x: (n, 2), m; f: (n, 3), N. Raises ValueError for wrong shapes and values not finite.
        """
        plan = self.plan(x)
        return plan.apply(_loads(f, len(plan.x)))

    def field(self, x: ArrayLike, f: ArrayLike, points: ArrayLike) -> Array:
        """Displacement (m, 3), m, at any `points` (m, 2) by all the forces; nan where one acts."""
        x, points = checks.vectors("x", x), checks.vectors("points", points)
        f = _loads(f, len(x))
        u = np.empty((len(points), 3))
        acting = f.any(axis=1).astype(np.float64)
        for rows, pairs in _blocks(points, x, 0.0):
            u[rows] = pairs.kernel(self).apply(f)
            u[rows][(pairs.inverse == 0) @ acting > 0] = np.nan
        return u

    def matrix(self, x: ArrayLike) -> Array:
        """The dense influence matrix (3n, 3n), m/N, `u.ravel() = C f.ravel()`: symmetric."""
        return self.plan(x).matrix()


class VectorPlan:
    """Sums for many sets of forces on the same contacts; made by `VectorHalfSpace.plan`."""

    def __init__(self, ground: VectorHalfSpace, x: ArrayLike) -> None:
        self._ground = ground
        self.refresh(x)

    def refresh(self, x: ArrayLike) -> None:
        """The same for contacts that have moved, come or gone, (n, 2) m."""
        self.x = checks.vectors("x", x)
        extent = float(np.ptp(self.x, axis=0).max()) if len(self.x) else 0.0
        self._unresolved = np.finfo(np.float64).eps * extent
        self._kept: Array | None = None

    def apply(self, f: Array) -> Array:
        """Displacement (n, 3), m, of every contact by the forces (n, 3), N, on the others."""
        if 9 * len(f) ** 2 <= KEEP:
            if self._kept is None:
                self._kept = self.matrix()
            u: Array = (self._kept @ f.ravel()).reshape(-1, 3)
            return u
        u = np.empty((len(f), 3))
        for rows, pairs in self._blocks():
            u[rows] = pairs.kernel(self._ground).apply(f)
        return u

    def slope(self, f: Array) -> Array:
        """Gradient (n, 2) of the expansion `e = -w` at every contact."""
        slope = np.empty((len(f), 2))
        for rows, pairs in self._blocks():
            slope[rows] = pairs.slope(self._ground, f)
        return slope

    def matrix(self) -> Array:
        """As `VectorHalfSpace.matrix`."""
        n = len(self.x)
        c = np.empty((n, 3, n, 3))
        for rows, pairs in self._blocks():
            c[rows] = pairs.kernel(self._ground).blocks()
        return c.reshape(3 * n, 3 * n)

    def _blocks(self) -> Iterator[tuple[slice, _Ways]]:
        return _blocks(self.x, self.x, self._unresolved)


@dataclass(frozen=True)
class _Kernel:
    """The entries of the 3x3 blocks, (m, n) each, m/N; x, y along the surface, w down."""

    xx: Array
    xy: Array
    yy: Array
    wx: Array  # w under t_x; u_x under f is minus that
    wy: Array
    ww: Array

    def apply(self, f: Array) -> Array:
        x, y, down = f.T
        return np.stack(
            [
                self.xx @ x + self.xy @ y - self.wx @ down,
                self.xy @ x + self.yy @ y - self.wy @ down,
                self.wx @ x + self.wy @ y + self.ww @ down,
            ],
            axis=1,
        )

    def blocks(self) -> Array:
        """(m, 3, n, 3)."""
        rows = (
            (self.xx, self.xy, -self.wx),
            (self.xy, self.yy, -self.wy),
            (self.wx, self.wy, self.ww),
        )
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


@dataclass(frozen=True)
class _Ways:
    """Unit vectors (m, n) from loads to points, and 1/r, zero for pairs left out."""

    x: Array
    y: Array
    inverse: Array

    def kernel(self, ground: VectorHalfSpace) -> _Kernel:
        along, across, normal = ground.compliances
        x, y, inverse = self.x, self.y, self.inverse
        return _Kernel(
            inverse * (normal + along * x * x),
            inverse * (along * x * y),
            inverse * (normal + along * y * y),
            inverse * (across * x),
            inverse * (across * y),
            inverse * normal,
        )

    def slope(self, ground: VectorHalfSpace, f: Array) -> Array:
        """Minus the gradient of w, (m, 2)."""
        _, across, normal = ground.compliances
        square = self.inverse**2
        skew, bend = 2 * self.x * self.y * square, (1 - 2 * self.x**2) * square
        x, y, down = f.T
        return np.stack(
            [
                normal * ((self.x * square) @ down) - across * (bend @ x - skew @ y),
                normal * ((self.y * square) @ down) + across * (bend @ y + skew @ x),
            ],
            axis=1,
        )


def _loads(f: ArrayLike, count: int) -> Array:
    array = np.asarray(f, dtype=np.float64)
    if array.size == 0 and count == 0:
        return np.empty((0, 3))
    if array.shape != (count, 3):
        raise ValueError(f"f has shape {array.shape}: must be ({count}, 3), one vector per contact")
    return checks.finite("f", array)


def _blocks(points: Array, x: Array, unresolved: float) -> Iterator[tuple[slice, _Ways]]:
    height = max(1, BLOCK // max(len(x), 1))
    for first in range(0, len(points), height):
        rows = slice(first, first + height)
        d = points[rows, None] - x
        r = np.hypot(d[..., 0], d[..., 1])
        r[r <= unresolved] = np.inf
        yield rows, _Ways(d[..., 0] / r, d[..., 1] / r, 1 / r)
