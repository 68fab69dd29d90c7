"""Direct summation over a doubly periodic cell: O(n^2), exact to rounding, the reference.

The forces of a cell and all their images press on a half-space without bounds. Their mean
depression is infinite, or arbitrary, and is taken to be zero: the wave q = 0 is left out. So a
uniform load does nothing, and `C` describes what differs from it. A contact is pressed down or
lifted by its own images, `C_kk`: a square lattice of unit forces with the spacing s by
`-3.9002649200/(pi E' s)`.

The sum is Ewald's (1921), with the bump of `splitting` in the place of the Gaussian: pairs closer
than half the shorter side one by one, and a few hundred plane waves. That of the Laplacian, 1/r^3,
which sizes of contacts need, is the Laplacian of both parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from .arrays import Array
from .direct import BLOCK, KEEP
from .finite import Close
from .splitting import Split

BETA = 36.0  # exp(-36) = 2e-16


@lru_cache(maxsize=1)
def _split() -> Split:
    return Split(BETA, smooth=True)


class PeriodicSum:
    """The sums over one layout of contacts in a cell `period = (Lx, Ly)`, m, and all its images.

    As `direct.DirectSum`, of which this is the periodic twin. Raises ValueError for a `reach` of
    more than half the shorter side.
    """

    def __init__(
        self, x: Array, modulus: float, period: tuple[float, float], reach: float = 0.0
    ) -> None:
        self.modulus, self.period = modulus, period
        self.split = _split()
        sides = np.asarray(period)
        self.cutoff = 0.5 * float(sides.min())
        highest = 1.1 * BETA / self.cutoff
        k = [np.arange(int(highest * side / (2 * np.pi)) + 1) for side in sides]
        m, j = (a.ravel() for a in np.meshgrid(np.r_[-k[0][:0:-1], k[0]], k[1], indexing="ij"))
        q = 2 * np.pi * np.stack([m, j], axis=1) / sides
        half = (j > 0) | (m > 0)  # the others are their complex conjugates
        half &= np.hypot(*q.T) <= highest
        self.q = q[half]
        x_q = self.cutoff * np.hypot(*self.q.T)
        symbol = 2 * self.split.spectrum(x_q) * self.cutoff / sides.prod()
        # Of cosines and sines, (2 waves,), in real numbers: half the work of complex ones.
        self._symbol = np.tile(symbol, 2)
        self._laplacian = np.tile(-(self.q**2).sum(axis=1) * symbol, 2)
        self.mean = -2 * np.pi * self.split.missing * self.cutoff / sides.prod()
        self.refresh(x, reach)

    def refresh(self, x: Array, reach: float = 0.0) -> bool:
        """The same cell with contacts that have moved, come or gone."""
        check_reach(reach, self.period)
        self.x = x
        phase = x @ self.q.T
        self._waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        self._left_out = max(np.finfo(np.float64).eps * max(self.period), reach) ** 2
        self._kept: list[Array] = []
        self._pairs: list[tuple[slice, Pairs]] | None = None
        self._closest: float | None = None
        return True

    @property
    def closest(self) -> float:
        """The least distance between two contacts, images included, m."""
        if self._closest is None:
            least = min(self.period) ** 2 if len(self.x) else np.inf
            for rows, d in self._offsets():
                squared = (d**2).sum(axis=2)
                own = np.arange(rows.start, rows.stop)
                squared[own - rows.start, own] = np.inf
                least = min(least, float(squared.min(initial=np.inf)))
            self._closest = float(np.sqrt(least))
        return self._closest

    def close(self) -> Close:
        """The pairs that are left out."""
        found, offsets = [np.empty((2, 0), int)], [np.empty((0, 2))]
        for rows, d in self._offsets():
            k, j = np.nonzero((d**2).sum(axis=2) <= self._left_out)
            other = k + rows.start != j
            k, j = k[other], j[other]
            found.append(np.stack([k + rows.start, j]))
            offsets.append(d[k, j])
        k, j = np.concatenate(found, axis=1)
        return Close(len(self.x), k, j, np.concatenate(offsets))

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact, by the others and by all images, (n,), m."""
        return self.pair(f, None)[0]

    def pair(self, f: Array, q: Array | None) -> tuple[Array, Array]:
        """Depression by the forces `f` and the moments `q`, and the Laplacian of that by `f`."""
        zero = np.zeros(len(f))
        if len(f) ** 2 <= KEEP:
            if not self._kept:
                self._kept = [self.matrix()]
            if q is None:
                return self._kept[0] @ f, zero
            if len(self._kept) < 2:
                self._kept.append(self.matrix(laplacian=True))
            return self._kept[0] @ f + self._kept[1] @ q, self._kept[1] @ f
        wave_f, wave_q = self._amplitudes(f, q)
        near = self._waves @ (self._symbol * wave_f + self._laplacian * wave_q)
        near += self.mean * f.sum() - self._own[0] * f
        steep = zero
        if q is not None:
            near -= self._own[1] * q
            steep = self._waves @ (self._laplacian * wave_f) - self._own[1] * f
        for rows, pairs in self._near():
            near[rows] += pairs.value @ f
            if q is not None:
                near[rows] += pairs.laplacian @ q
                steep[rows] += pairs.laplacian @ f
        return near / (np.pi * self.modulus), steep / (np.pi * self.modulus)

    def slope(self, f: Array, q: Array | None = None) -> tuple[Array, Array]:
        """Minus the gradients of what `pair` gives, (n, 2) each."""
        wave_f, wave_q = self._amplitudes(f, q)
        near = self._fall(self._symbol * wave_f + self._laplacian * wave_q)
        steep = np.zeros((len(f), 2))
        if q is not None:
            steep = self._fall(self._laplacian * wave_f)
        for rows, pairs in self._near():
            for axis in (0, 1):
                d = pairs.offset[..., axis]
                near[rows, axis] += (pairs.fall * d) @ f
                if q is not None:
                    d = pairs.laplacian_fall * d
                    near[rows, axis] += d @ q
                    steep[rows, axis] += d @ f
        return near / (np.pi * self.modulus), steep / (np.pi * self.modulus)

    def pair_slope(self, f: Array, q: Array) -> tuple[Array, Array, Array, Array]:
        """What `pair` and `slope` give."""
        return *self.pair(f, q), *self.slope(f, q)

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope (n, 2), the gradient of the expansion `e = -w`."""
        return self.apply(f), self.slope(f)[0]

    def matrix(self, laplacian: bool = False) -> Array:
        """The dense influence matrix `C` (n, n), m/N: symmetric, own images on the diagonal.

        Or that of its Laplacian, 1/(m N).
        """
        c = (self._waves * (self._laplacian if laplacian else self._symbol)) @ self._waves.T
        c -= self._own[laplacian] * np.eye(len(self.x))
        c += 0.0 if laplacian else self.mean
        for rows, pairs in self._near():
            c[rows] += pairs.laplacian if laplacian else pairs.value
        return (c + c.T) / (2 * np.pi * self.modulus)

    def amplitude(self, f: Array, q: Array) -> NDArray[np.complex128]:
        """Of the waves q (waves, 2), 1/m, that forces and moments make of the smooth part."""
        wave_f, wave_q = self._amplitudes(f, q)
        cosine, sine = np.split(self._symbol * wave_f + self._laplacian * wave_q, 2)
        return cosine - 1j * sine

    @cached_property
    def _own(self) -> tuple[float, float]:
        """The smooth part and its Laplacian at r = 0."""
        return self.split.origin / self.cutoff, self.split.bend / self.cutoff**3

    def _amplitudes(self, f: Array, q: Array | None) -> tuple[Array, Array]:
        wave_f: Array = f @ self._waves
        return wave_f, np.zeros_like(wave_f) if q is None else q @ self._waves

    def _fall(self, amplitude: Array) -> Array:
        cosine, sine = np.split(amplitude, 2)
        along = np.concatenate([-sine[:, None] * self.q, cosine[:, None] * self.q])
        return self._waves @ along

    def _offsets(self) -> Iterator[tuple[slice, Array]]:
        """Rows of the pair table, and the shortest offsets in it."""
        n = len(self.x)
        height = max(1, BLOCK // max(n, 1))
        for first in range(0, n, height):
            rows = slice(first, min(first + height, n))
            d = self.x[rows, None] - self.x
            d -= np.round(d / self.period) * self.period
            yield rows, d

    def _near(self) -> Iterable[tuple[slice, Pairs]]:
        """Rows of the pair table; they are kept where it is small."""
        if len(self.x) ** 2 > BLOCK:
            return self._found()
        if self._pairs is None:
            self._pairs = list(self._found())
        return self._pairs

    def _found(self) -> Iterator[tuple[slice, Pairs]]:
        for rows, d in self._offsets():
            left_out = (d**2).sum(axis=2) <= self._left_out
            own = np.arange(rows.start, rows.stop)
            pairs = Pairs(d, self.cutoff, self.split, left_out)
            pairs.value[own - rows.start, own] = 0.0
            pairs.laplacian[own - rows.start, own] = 0.0
            yield rows, pairs


class Pairs:
    """What pairs at the offsets d (m, n, 2) add to the waves, times pi E'; nothing beyond rc.

    `value` and its Laplacian; with `slopes`, `fall` and `laplacian_fall`: `-1/r d/dr` of both. Of
    pairs that are left out, only the smooth part is taken away.
    """

    def __init__(
        self, d: Array, cutoff: float, split: Split, left_out: Array, slopes: bool = True
    ) -> None:
        self.offset = d
        t2 = (d**2).sum(axis=2) / cutoff**2
        inside = t2 < 1
        t2 = np.where(inside, t2, 1.0)
        inverse = 1 / np.sqrt(np.where(left_out, np.inf, t2))
        if slopes:
            smooth, bend, fall, bend_fall = split.derivatives(t2)
        else:
            smooth, bend = split.values(t2)
        self.value = np.where(inside, inverse - smooth, 0.0) / cutoff
        self.laplacian = np.where(inside, inverse**3 - bend, 0.0) / cutoff**3
        if not slopes:
            return
        self.fall = np.where(inside, inverse**3 + fall, 0.0) / cutoff**3
        self.laplacian_fall = np.where(inside, 3 * inverse**5 + bend_fall, 0.0) / cutoff**5


def check_reach(reach: float, period: tuple[float, float]) -> None:
    """Refuses contacts so wide that they may overlap with more than one image of another."""
    if reach > 0.5 * min(period):
        raise ValueError(
            f"radius = {reach / 2:.3g} m: must be at most a quarter of the period's shorter side, "
            f"{min(period):.3g} m"
        )
