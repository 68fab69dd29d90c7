"""Direct summation over all pairs of contacts: O(n^2), exact to rounding, the reference.

Coincident contacts. The point kernel is infinite at zero distance, so a pair closer than the
rounding error of the layout itself (machine precision times its extent, which no set of positions
can resolve) is left out of the sum, as a contact is left out of its own: without sizes, two forces
at one point are one force. Contacts with sizes act on each other at any distance (`finite`): pairs
within `reach` are then left out here and summed there. No absolute length enters.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .arrays import Array
from .finite import Close

# Pairs handled at a time (2 MB an array, which stays in cache) and pairs kept as a matrix (32 MB).
BLOCK = 2**18
KEEP = 2**22


class DirectSum:
    """The sums over one layout of contacts.

    x: (n, 2) positions, m; modulus: the plane-strain modulus `E'`, Pa; reach, m: pairs no further
    apart are left out.
    """

    def __init__(self, x: Array, modulus: float, reach: float = 0.0) -> None:
        self.modulus = modulus
        self.refresh(x, reach)

    def refresh(self, x: Array, reach: float = 0.0) -> bool:
        """The same for contacts that have moved, come or gone."""
        self.x = x
        extent = float(np.ptp(x, axis=0).max()) if len(x) else 0.0
        self._left_out = max(np.finfo(np.float64).eps * extent, reach) ** 2
        self._kept: list[Array] = []
        self._closest: float | None = None
        return True

    @property
    def closest(self) -> float:
        """The least distance between two contacts, m."""
        if self._closest is None and len(self.x) ** 2 <= KEEP:
            self._keep()  # which finds it on the way, unless pairs are left out
        if self._closest is None:
            n, largest, pairs = len(self.x), 0.0, 0
            for _, _, _, inverse in self._blocks():
                largest = max(largest, float(inverse.max(initial=0.0)))
                pairs += int(np.count_nonzero(inverse))
            self._closest = 1 / largest if largest > 0 else np.inf
            if pairs < n * (n - 1):  # some are left out, and closer
                d = self.close().offset
                self._closest = float(np.hypot(d[:, 0], d[:, 1]).min())
        return self._closest

    def close(self) -> Close:
        """The pairs that are left out."""
        found, offsets = [np.empty((2, 0), int)], [np.empty((0, 2))]
        for rows, dx, dy, inverse in self._blocks():
            k, j = np.nonzero(inverse == 0)
            other = k + rows.start != j
            k, j = k[other], j[other]
            found.append(np.stack([k + rows.start, j]))
            offsets.append(np.stack([dx[k, j], dy[k, j]], axis=1))
        k, j = np.concatenate(found, axis=1)
        return Close(len(self.x), k, j, np.concatenate(offsets))

    def _keep(self) -> None:
        if not self._kept:
            self._kept = [self.matrix()]

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact by the forces on the others, (n,), m."""
        return self.pair(f, None)[0]

    def pair(self, f: Array, q: Array | None) -> tuple[Array, Array]:
        """Depression by the forces `f` and the moments `q`, and the Laplacian of that by `f`.

        (n,) m and (n,) 1/m; without moments, the second is zero.
        """
        near, steep = np.zeros(len(f)), np.zeros(len(f))
        if len(f) ** 2 <= KEEP:
            self._keep()
            near = self._kept[0] @ f
            if q is not None:
                if len(self._kept) < 2:
                    # (1/(pi E' r))^3, with its unit mended
                    c = self._kept[0]
                    self._kept.append(c * c * ((np.pi * self.modulus) ** 2 * c))
                near, steep = near + self._kept[1] @ q, self._kept[1] @ f
            return near, steep
        for rows, _, _, inverse in self._blocks():
            near[rows] = inverse @ f
            if q is not None:
                inverse = inverse * inverse * inverse
                near[rows] += inverse @ q
                steep[rows] = inverse @ f
        return near / (np.pi * self.modulus), steep / (np.pi * self.modulus)

    def slope(self, f: Array, q: Array | None = None) -> tuple[Array, Array]:
        """Minus the gradients of what `pair` gives, (n, 2) each."""
        near, steep = np.zeros((len(f), 2)), np.zeros((len(f), 2))
        for rows, dx, dy, inverse in self._blocks():
            squared = inverse * inverse
            cubed = squared * inverse
            for axis, d in enumerate((dx, dy)):
                near[rows, axis] = (cubed * d) @ f
            if q is not None:
                cubed *= 3 * squared
                for axis, d in enumerate((dx, dy)):
                    d *= cubed
                    near[rows, axis] += d @ q
                    steep[rows, axis] = d @ f
        return near / (np.pi * self.modulus), steep / (np.pi * self.modulus)

    def pair_slope(self, f: Array, q: Array) -> tuple[Array, Array, Array, Array]:
        """What `pair` and `slope` give."""
        return *self.pair(f, q), *self.slope(f, q)

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope, the gradient of the expansion `e = -w`, (n, 2)."""
        return self.apply(f), self.slope(f)[0]

    def matrix(self) -> Array:
        """The dense influence matrix `C` (n, n), m/N: symmetric, zero on the diagonal."""
        n = len(self.x)
        c = np.empty((n, n))
        for rows, _, _, inverse in self._blocks():
            c[rows] = inverse
        if np.count_nonzero(c) == n * (n - 1) > 0:
            self._closest = 1 / float(c.max())
        return c / (np.pi * self.modulus)

    def _blocks(self) -> Iterator[tuple[slice, Array, Array, Array]]:
        """Rows of the pair table, offsets from the loads, and 1/r, zero for pairs left out."""
        n = len(self.x)
        height = max(1, BLOCK // max(n, 1))
        for first in range(0, n, height):
            rows = slice(first, min(first + height, n))
            dx = self.x[rows, 0, None] - self.x[:, 0]
            dy = self.x[rows, 1, None] - self.x[:, 1]
            squared = dx * dx + dy * dy
            squared[squared <= self._left_out] = np.inf
            yield rows, dx, dy, 1.0 / np.sqrt(squared)
