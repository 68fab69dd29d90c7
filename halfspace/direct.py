"""Direct summation over all pairs of contacts: O(n^2), exact to rounding, the reference.

Coincident contacts. The point kernel is infinite at zero distance, so a pair closer than the
rounding error of the layout itself (machine precision times its extent, which no set of positions
can resolve) is left out of the sum, as a contact is left out of its own: without sizes, two forces
at one point are one force. Where contact radii are given, such a pair acts instead by the mean of
one concentric Hertz pressure under the other (`greens.hertz_concentric`), which is finite and
symmetric. Its slope is zero, by symmetry. No absolute length enters.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from . import greens
from .checks import Array

# Pairs handled at a time (2 MB an array, which stays in cache) and pairs kept as a matrix (32 MB).
BLOCK = 2**18
KEEP = 2**22


class DirectSum:
    """The sums over one layout of contacts.

    x: (n, 2) positions, m; modulus: the plane-strain modulus `E'`, Pa; radius: (n,) contact radii,
    m, or None: they are used for coincident contacts alone.
    """

    def __init__(self, x: Array, modulus: float, radius: Array | None = None) -> None:
        self.modulus = modulus
        self.refresh(x, radius)

    def refresh(self, x: Array, radius: Array | None = None) -> bool:
        """The same for contacts that have moved, come or gone."""
        self.x, self.radius = x, radius
        extent = float(np.ptp(x, axis=0).max()) if len(x) else 0.0
        self._unresolved = (np.finfo(np.float64).eps * extent) ** 2
        self._kept: Array | None = None
        return True

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact by the forces on the others, (n,), m."""
        if self._kept is None and len(f) ** 2 <= KEEP:
            self._kept = self.matrix()
        if self._kept is not None:
            return self._kept @ f
        w = np.empty(len(f))
        for rows, _, _, inverse in self._blocks():
            w[rows] = self._influence(rows, inverse) @ f
        return w

    def slope(self, f: Array) -> Array:
        """Gradient of the expansion `e = -w` at every contact, (n, 2)."""
        return self.displacement(f)[1]

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope in one pass."""
        w, gradient = np.empty(len(f)), np.empty((len(f), 2))
        for rows, dx, dy, inverse in self._blocks():
            w[rows] = self._influence(rows, inverse) @ f
            cubed = inverse * inverse * inverse
            gradient[rows, 0] = (cubed * dx) @ f
            gradient[rows, 1] = (cubed * dy) @ f
        return w, gradient / (np.pi * self.modulus)

    def matrix(self) -> Array:
        """The dense influence matrix `C` (n, n), m/N: symmetric, zero on the diagonal."""
        c = np.empty((len(self.x), len(self.x)))
        for rows, _, _, inverse in self._blocks():
            c[rows] = self._influence(rows, inverse)
        return c

    def _blocks(self) -> Iterator[tuple[slice, Array, Array, Array]]:
        """Rows of the pair table, offsets from the loads, and 1/r, zero for pairs left out."""
        n = len(self.x)
        height = max(1, BLOCK // max(n, 1))
        for first in range(0, n, height):
            rows = slice(first, min(first + height, n))
            dx = self.x[rows, 0, None] - self.x[:, 0]
            dy = self.x[rows, 1, None] - self.x[:, 1]
            squared = dx * dx + dy * dy
            squared[squared <= self._unresolved] = np.inf
            yield rows, dx, dy, 1.0 / np.sqrt(squared)

    def _influence(self, rows: slice, inverse: Array) -> Array:
        c = inverse / (np.pi * self.modulus)
        if self.radius is not None:
            k, j = np.nonzero(inverse == 0)
            k, j = k[k + rows.start != j], j[k + rows.start != j]
            a = self.radius
            c[k, j] = greens.hertz_concentric(a[k + rows.start], a[j], self.modulus)
        return c


def field(x: Array, f: Array, points: Array, modulus: float, radius: Array | None = None) -> Array:
    """Depression (m,) of the surface at `points` (m, 2) by all the forces `f` (n,) at `x` (n, 2).

    With contact radii (n,) each force is a Hertz pressure. A force without extent makes the
    depression infinite, of the sign of the force, at its own point.
    """
    a = np.zeros(len(x)) if radius is None else radius
    w = np.empty(len(points))
    height = max(1, BLOCK // max(len(x), 1))
    for first in range(0, len(points), height):
        rows = slice(first, first + height)
        r = np.hypot(
            points[rows, 0, None] - x[:, 0],
            points[rows, 1, None] - x[:, 1],
        )
        singular = np.maximum(r, a) == 0
        r[singular] = np.inf
        kernel = greens.point(r, modulus) if radius is None else greens.hertz(r, a, modulus)
        net = singular @ f
        w[rows] = np.where(net == 0, kernel @ f, np.copysign(np.inf, net))
    return w
