"""Sums over contacts on a layer: those of the half-space, and a smooth correction for each pair.

Depressions are `w_k = [...] + sum_j D(r_kj/h) f_j / (pi E' h)`, `j = k` included: on a layer a
contact also feels, by the base, what it does itself (`halfspace.layers`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from .arrays import Array
from .direct import BLOCK, KEEP
from .layer_kernel import LayerKernel

if TYPE_CHECKING:
    from .finite import Close
    from .plan import Sum

WAVES = 20.0  # highest q h of a periodic correction: S - 1 is below 1e-15 there
MOST = 2**23  # waves that may be summed


def correction_of(
    x: Array, modulus: float, kernel: LayerKernel, period: tuple[float, float] | None
) -> Pairs:
    """What a layer adds to the sums over the contacts `x` (n, 2), m.

    modulus: `E'`, Pa; period: (Lx, Ly), m, or None.
    """
    if period is not None:
        return Waves(x, modulus, kernel, period)
    return Pairs(x, modulus, kernel)


class LayerSum:
    """The sums of a layer over one layout of contacts: those of `bare`, a half-space, corrected."""

    def __init__(self, bare: Sum, extra: Pairs) -> None:
        self._bare, self._extra = bare, extra

    @property
    def closest(self) -> float:
        """The least distance between two contacts, m."""
        return self._bare.closest

    def close(self) -> Close:
        """The pairs that the half-space's sums leave out; the correction has them all."""
        return self._bare.close()

    def refresh(self, x: Array, reach: float = 0.0) -> bool:
        """The same for contacts that have moved, come or gone."""
        self._extra.refresh(x)
        return self._bare.refresh(x, reach)

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact, (n,), m."""
        return self._bare.apply(f) + self._extra.pair(f, None)[0]

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope (n, 2), the gradient of the expansion `e = -w`."""
        w, slope = self._bare.displacement(f)
        extra, _, fall, _ = self._extra.pair_slope(f, None)
        return w + extra, slope + fall

    def pair(self, f: Array, q: Array | None) -> tuple[Array, Array]:
        """Depression by forces and moments, and its Laplacian, as `direct.DirectSum.pair`."""
        near, steep = self._bare.pair(f, q)
        more, bend = self._extra.pair(f, q)
        return near + more, steep + bend

    def pair_slope(self, f: Array, q: Array) -> tuple[Array, Array, Array, Array]:
        """What `pair` gives, and minus the gradients of both, (n, 2) each."""
        near, steep, fall, steep_fall = self._bare.pair_slope(f, q)
        more, bend, way, bend_way = self._extra.pair_slope(f, q)
        return near + more, steep + bend, fall + way, steep_fall + bend_way


class Pairs:
    """`sum_j [D f_j + L q_j/h^2] / (pi E' h)`, pair by pair, j = k included.

    A force f that presses over some area acts on what is smooth as f and its moment
    `q = int p r^2 dA/4`, N m^2, at its centre: under a Hertz pressure of radius a, `q = f a^2/10`.
    """

    def __init__(self, x: Array, modulus: float, kernel: LayerKernel) -> None:
        self._h, self._tables = kernel.thickness, kernel.tables
        self._unit = 1 / (np.pi * modulus * self._h)
        self.refresh(x)

    def refresh(self, x: Array) -> None:
        """The same for contacts that have moved, come or gone."""
        self.x = x
        self._kept: list[Array] = []

    def at(self, points: Array, f: Array, q: Array | None = None) -> Array:
        """Depression (m,), m, at `points` (m, 2)."""
        w = np.empty(len(points))
        for rows, dx, dy in self._blocks(points):
            t = np.hypot(dx, dy) / self._h
            w[rows] = self._tables.value.value(t) @ f
            if q is not None:
                w[rows] += self._tables.laplacian.value(t) @ q / self._h**2
        return w * self._unit

    def pair(self, f: Array, q: Array | None) -> tuple[Array, Array]:
        """Depression of every contact, (n,) m, and the Laplacian of that by `f`, (n,) 1/m.

        Without moments the second is zero.
        """
        if len(f) ** 2 > KEEP:
            near, steep, _, _ = self.pair_slope(f, q)
            return near, steep
        if not self._kept:
            self._kept = [self.matrix()]
        if q is None:
            return self._kept[0] @ f, np.zeros(len(f))
        if len(self._kept) < 2:
            self._kept.append(self.matrix(laplacian=True))
        return self._kept[0] @ f + self._kept[1] @ q, self._kept[1] @ f

    def pair_slope(self, f: Array, q: Array | None) -> tuple[Array, Array, Array, Array]:
        """What `pair` gives, and minus the gradients of both, (n, 2) each."""
        n = len(f)
        near, steep, fall, steep_fall = np.zeros(n), np.zeros(n), np.zeros((n, 2)), np.zeros((n, 2))
        unit, bent = self._unit, self._unit / self._h**2
        for rows, dx, dy in self._blocks(self.x):
            r = np.hypot(dx, dy)
            t = r / self._h
            r[r == 0] = np.inf
            way = dx / r, dy / r
            value, slope = self._tables.value.steepness(t)
            near[rows] = unit * (value @ f)
            for axis in (0, 1):
                fall[rows, axis] = -unit / self._h * ((slope * way[axis]) @ f)
            if q is None:
                continue
            value, slope = self._tables.laplacian.steepness(t)
            near[rows] += bent * (value @ q)
            steep[rows] = bent * (value @ f)
            for axis in (0, 1):
                down = slope * way[axis]
                fall[rows, axis] -= bent / self._h * (down @ q)
                steep_fall[rows, axis] = -bent / self._h * (down @ f)
        return near, steep, fall, steep_fall

    def matrix(self, laplacian: bool = False) -> Array:
        """What is added to the influence matrix, (n, n), m/N: symmetric, on the diagonal too.

        laplacian: or to that of moments, 1/(m N).
        """
        table, unit = self._tables.value, self._unit
        if laplacian:
            table, unit = self._tables.laplacian, self._unit / self._h**2
        c = np.empty((len(self.x), len(self.x)))
        for rows, dx, dy in self._blocks(self.x):
            c[rows] = table.value(np.hypot(dx, dy) / self._h)
        return c * unit

    def _blocks(self, points: Array) -> Iterator[tuple[slice, Array, Array]]:
        """Rows of the pair table, offsets from the loads."""
        height = max(1, BLOCK // max(len(self.x), 1))
        for first in range(0, len(points), height):
            rows = slice(first, first + height)
            d = points[rows, None] - self.x
            yield rows, d[..., 0], d[..., 1]


class Waves(Pairs):
    """The same over all images of a periodic cell: a sum of waves.

    The wave of no wavenumber, which a half-space leaves out, has a meaning on a layer,
    `Layer.uniform`. Raises MemoryError for cells a thousand times as wide as the layer is thick.
    """

    def __init__(
        self, x: Array, modulus: float, kernel: LayerKernel, period: tuple[float, float]
    ) -> None:
        counts = [int(WAVES * side / (2 * np.pi * kernel.thickness)) + 1 for side in period]
        if 2 * counts[0] * counts[1] > MOST:
            raise MemoryError(
                f"period = {period}: a layer of {kernel.thickness:.3g} m is too thin for that, it "
                f"takes {2.0 * counts[0] * counts[1]:.2g} waves, more than {MOST:.2g}"
            )
        self._q = 2 * np.pi / period[0] * np.arange(-counts[0], counts[0] + 1)
        self._p = 2 * np.pi / period[1] * np.arange(counts[1] + 1)
        wave = np.hypot(self._q[:, None], self._p)
        symbol = kernel.spectrum(wave)
        symbol[:, 1:] *= 2  # with their complex conjugates
        self._symbol = symbol / (np.pi * modulus * period[0] * period[1])
        self._bent = -(wave**2) * self._symbol
        self.refresh(x)

    def at(self, points: Array, f: Array, q: Array | None = None) -> Array:
        return self._sum(self._phases(points), self._load(f, q))[0]

    def pair_slope(self, f: Array, q: Array | None) -> tuple[Array, Array, Array, Array]:
        phases = self._phases(self.x)
        near, fall = self._sum(phases, self._load(f, q))
        if q is None:
            return near, np.zeros(len(f)), fall, np.zeros((len(f), 2))
        steep, steep_fall = self._sum(phases, self._bent * self._amplitudes(f))
        return near, steep, fall, steep_fall

    def matrix(self, laplacian: bool = False) -> Array:
        across, along = self._phases(self.x)
        c = np.zeros((len(self.x), len(self.x)))
        weights = self._bent if laplacian else self._symbol
        for weight, wave in zip(weights.T, along.T, strict=True):
            c += ((across * weight) @ across.conj().T * np.outer(wave, wave.conj())).real
        return (c + c.T) / 2

    def _load(self, f: Array, q: Array | None) -> Array:
        waves: Array = self._symbol * self._amplitudes(f)
        return waves if q is None else waves + self._bent * self._amplitudes(q)

    def _amplitudes(self, f: Array) -> Array:
        across, along = self._phases(self.x)
        amplitudes: Array = (across.conj() * f[:, None]).T @ along.conj()
        return amplitudes

    def _sum(self, phases: tuple[Array, Array], waves: Array) -> tuple[Array, Array]:
        """Waves summed, and minus the gradient of that."""
        across, along = phases
        terms = (across @ waves) * along
        sideways = (across @ (self._q[:, None] * waves)) * along
        fall = np.stack([sideways.imag.sum(axis=1), terms.imag @ self._p], axis=1)
        return terms.real.sum(axis=1), fall

    def _phases(self, points: Array) -> tuple[Array, Array]:
        return (
            np.exp(1j * points[:, 0, None] * self._q),
            np.exp(1j * points[:, 1, None] * self._p),
        )
