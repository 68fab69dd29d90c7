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
from .checks import Array
from .direct import BLOCK
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
        for rows, d, inverse in _blocks(points, x, 0.0):
            u[rows] = self._influence(d, inverse, f)
            at_load = (inverse == 0) @ f.any(axis=1).astype(float) > 0
            u[rows][at_load] = np.nan
        return u

    def matrix(self, x: ArrayLike) -> Array:
        """The dense influence matrix (3n, 3n), m/N, `u.ravel() = C f.ravel()`: symmetric."""
        plan = self.plan(x)
        n = len(plan.x)
        c = np.empty((n, 3, n, 3))
        for axis in range(3):
            unit = np.zeros((n, 3))
            unit[:, axis] = 1.0
            for rows, d, inverse in _blocks(plan.x, plan.x, plan.unresolved):
                c[rows, :, :, axis] = self._kernel(d, inverse, unit).swapaxes(1, 2)
        return c.reshape(3 * n, 3 * n)

    def _kernel(self, d: Array, inverse: Array, f: Array) -> Array:
        """Displacement (m, n, 3) of each point by each load."""
        nu, shear = self.poissons_ratio, self.shear_modulus
        way = d * inverse[..., None]  # unit vectors, zero for pairs left out
        ahead = (way * f[:, :2]).sum(axis=-1)
        u = np.empty((*inverse.shape, 3))
        u[..., :2] = ((1 - nu) * f[:, :2] + nu * ahead[..., None] * way) / (2 * np.pi * shear)
        u[..., :2] -= (1 - 2 * nu) / (4 * np.pi * shear) * way * f[:, 2, None]
        u[..., 2] = (1 - 2 * nu) / (4 * np.pi * shear) * ahead
        u[..., 2] += (1 - nu) / (2 * np.pi * shear) * f[:, 2]
        return u * inverse[..., None]

    def _influence(self, d: Array, inverse: Array, f: Array) -> Array:
        return self._kernel(d, inverse, f).sum(axis=1)

    def _steepness(self, d: Array, inverse: Array, f: Array) -> Array:
        """Gradient (m, 2) of the depression w."""
        nu, shear = self.poissons_ratio, self.shear_modulus
        way = d * inverse[..., None]
        ahead = (way * f[:, :2]).sum(axis=-1)
        pull = (1 - 2 * nu) / (4 * np.pi * shear) * (f[:, :2] - 2 * ahead[..., None] * way)
        push = (1 - nu) / (2 * np.pi * shear) * way * f[:, 2, None]
        gradient: Array = ((pull - push) * (inverse**2)[..., None]).sum(axis=1)
        return gradient


class VectorPlan:
    """Sums for many sets of forces on the same contacts; made by `VectorHalfSpace.plan`."""

    def __init__(self, ground: VectorHalfSpace, x: ArrayLike) -> None:
        self._ground = ground
        self.refresh(x)

    def refresh(self, x: ArrayLike) -> None:
        """The same for contacts that have moved, come or gone, (n, 2) m."""
        self.x = checks.vectors("x", x)
        extent = float(np.ptp(self.x, axis=0).max()) if len(self.x) else 0.0
        self.unresolved = np.finfo(np.float64).eps * extent

    def apply(self, f: Array) -> Array:
        """Displacement (n, 3), m, of every contact by the forces (n, 3), N, on the others."""
        u = np.empty((len(self.x), 3))
        for rows, d, inverse in _blocks(self.x, self.x, self.unresolved):
            u[rows] = self._ground._influence(d, inverse, f)
        return u

    def slope(self, f: Array) -> Array:
        """Gradient (n, 2) of the expansion `e = -w` at every contact."""
        gradient = np.empty((len(self.x), 2))
        for rows, d, inverse in _blocks(self.x, self.x, self.unresolved):
            gradient[rows] = self._ground._steepness(d, inverse, f)
        return -gradient


def _loads(f: ArrayLike, count: int) -> Array:
    array = np.asarray(f, dtype=np.float64)
    if array.size == 0 and count == 0:
        return np.empty((0, 3))
    if array.shape != (count, 3):
        raise ValueError(f"f has shape {array.shape}: must be ({count}, 3), one vector per contact")
    return checks.finite("f", array)


def _blocks(points: Array, x: Array, unresolved: float) -> Iterator[tuple[slice, Array, Array]]:
    """Rows of the pair table, the ways from loads to points, and 1/r, zero for pairs left out."""
    height = max(1, BLOCK // (4 * max(len(x), 1)))
    for first in range(0, len(points), height):
        rows = slice(first, first + height)
        d = points[rows, None] - x
        r = np.hypot(d[..., 0], d[..., 1])
        r[r <= unresolved] = np.inf
        yield rows, d, 1 / r
