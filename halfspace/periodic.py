"""Direct summation over a doubly periodic cell: O(n^2), exact to rounding, the reference.

The forces of a cell and all their images press on a half-space without bounds. Their mean
depression is infinite, or arbitrary, and is taken to be zero: the wave q = 0 is left out. So a
uniform load does nothing, and `C` describes what differs from it. A contact is pressed down or
lifted by its own images, `C_kk`: a square lattice of unit forces with the spacing s by
`-3.9002649200/(pi E' s)`.

The sum is Ewald's (1921), with the bump of `splitting` in the place of the Gaussian: pairs closer
than half the shorter side one by one, and a few hundred plane waves.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from . import greens
from .checks import Array
from .direct import BLOCK, KEEP
from .splitting import Split

BETA = 36.0  # exp(-36) = 2e-16


@lru_cache(maxsize=1)
def _split() -> Split:
    return Split(BETA)


class PeriodicSum:
    """The sums over one layout of contacts in a cell `period = (Lx, Ly)`, m, and all its images.

    As `direct.DirectSum`, of which this is the periodic twin.
    """

    def __init__(
        self, x: Array, modulus: float, period: tuple[float, float], radius: Array | None = None
    ) -> None:
        self.modulus, self.period = modulus, period
        self._split = _split()
        sides = np.asarray(period)
        self._cutoff = 0.5 * float(sides.min())
        highest = 1.1 * BETA / self._cutoff
        k = [np.arange(int(highest * side / (2 * np.pi)) + 1) for side in sides]
        m, j = (a.ravel() for a in np.meshgrid(np.r_[-k[0][:0:-1], k[0]], k[1], indexing="ij"))
        q = 2 * np.pi * np.stack([m, j], axis=1) / sides
        half = (j > 0) | (m > 0)  # the others are their complex conjugates
        half &= np.hypot(*q.T) <= highest
        self._q = q[half]
        x_q = self._cutoff * np.hypot(*self._q.T)
        self._symbol = 2 * self._split.spectrum(x_q) * self._cutoff / sides.prod()
        self._mean = -2 * np.pi * self._split.missing * self._cutoff / sides.prod()
        self.refresh(x, radius)

    def refresh(self, x: Array, radius: Array | None = None) -> bool:
        """The same cell with contacts that have moved, come or gone."""
        self.x, self.radius = x, radius
        self._waves = np.exp(1j * (x @ self._q.T))
        self._unresolved = (np.finfo(np.float64).eps * max(self.period)) ** 2
        self._kept: Array | None = None
        return True

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact, by the others and by all images, (n,), m."""
        if len(f) ** 2 > KEEP:
            return self.displacement(f)[0]
        if self._kept is None:
            self._kept = self.matrix()
        return self._kept @ f

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope (n, 2), the gradient of the expansion `e = -w`."""
        amplitude = self._symbol * (f @ self._waves.conj())
        terms = self._waves * amplitude
        w = terms.real.sum(axis=1) + self._mean * f.sum() - self._own * f
        slope = terms.imag @ self._q
        for rows, dx, dy, near, steep in self._near():
            w[rows] += near @ f
            slope[rows, 0] += (steep * dx) @ f
            slope[rows, 1] += (steep * dy) @ f
        return w / (np.pi * self.modulus), slope / (np.pi * self.modulus)

    def matrix(self) -> Array:
        """The dense influence matrix `C` (n, n), m/N: symmetric, own images on the diagonal."""
        c = (self._waves * self._symbol) @ self._waves.conj().T
        c = c.real + self._mean - self._own * np.eye(len(self.x))
        for rows, _, _, near, _ in self._near():
            c[rows] += near
        return (c + c.T) / (2 * np.pi * self.modulus)

    def field(self, f: Array, points: Array) -> Array:
        """Depression (m,), m, at `points` (m, 2) by all forces; infinite where one acts."""
        w = np.empty(len(points))
        amplitude = self._symbol * (f @ self._waves.conj())
        height = max(1, BLOCK // max(len(self._q), len(f), 1))
        for first in range(0, len(points), height):
            at = points[first : first + height]
            smooth = (np.exp(1j * (at @ self._q.T)) @ amplitude).real
            d = at[:, None] - self.x
            d -= np.round(d / self.period) * self.period
            r = np.hypot(d[..., 0], d[..., 1])
            net = (r == 0) @ f
            t = np.where(r == 0, np.inf, r) / self._cutoff
            near = np.where(t < 1, 1 / t - self._split.smooth(t), 0.0) / self._cutoff
            total = smooth + self._mean * f.sum() + near @ f
            w[first : first + height] = np.where(net == 0, total, np.copysign(np.inf, net))
        return w / (np.pi * self.modulus)

    @property
    def _own(self) -> float:
        return self._split.origin / self._cutoff

    def _near(self) -> Iterator[tuple[slice, Array, Array, Array, Array]]:
        """Rows of the pair table, shortest offsets, what pairs add to the waves, its steepness."""
        n, split = len(self.x), self._split
        height = max(1, BLOCK // max(n, 1))
        polynomial = np.polynomial.Polynomial(split.polynomial)
        for first in range(0, n, height):
            rows = slice(first, min(first + height, n))
            d = self.x[rows, None] - self.x
            d -= np.round(d / self.period) * self.period
            dx, dy = d[..., 0], d[..., 1]
            t2 = (dx * dx + dy * dy) / self._cutoff**2
            same = t2 * self._cutoff**2 <= self._unresolved
            inside = (t2 < 1) & ~same
            t2 = np.where(inside, t2, 1.0)
            near = np.where(inside, 1 / np.sqrt(t2) - polynomial(2 * t2 - 1), 0.0) / self._cutoff
            steep = np.where(inside, t2**-1.5 + 4 * polynomial.deriv()(2 * t2 - 1), 0.0)
            k, j = np.nonzero(same)
            k, j = k[k + rows.start != j], j[k + rows.start != j]
            near[k, j] = -self._own
            if self.radius is not None:
                a = self.radius
                mean = greens.hertz_concentric(a[k + rows.start], a[j], 1 / np.pi)
                near[k, j] += mean
            yield rows, dx, dy, near, steep / self._cutoff**3
