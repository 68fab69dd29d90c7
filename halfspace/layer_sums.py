"""Sums over contacts on a layer: those of the half-space, and a smooth correction for each pair.

Depressions are `w_k = [...] + sum_j D(r_kj/h) f_j / (pi E' h)`, `j = k` included: on a layer a
contact also feels, by the base, what it does itself (`halfspace.layers`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from .checks import Array
from .direct import BLOCK, KEEP
from .layer_kernel import LayerKernel

if TYPE_CHECKING:
    from .plan import Sum

WAVES = 20.0  # highest q h of a periodic correction: S - 1 is below 1e-15 there


def correction_of(
    x: Array,
    modulus: float,
    kernel: LayerKernel,
    period: tuple[float, float] | None,
    radius: Array | None = None,
) -> Pairs:
    """What a layer adds to the sums over the contacts `x` (n, 2), m.

    modulus: `E'`, Pa; period: (Lx, Ly), m, or None; radius: (n,) contact radii, m, of Hertz
    pressures, to the third order in `a/h`; for `at` alone, and not in a periodic cell.
    """
    if period is not None:
        return Waves(x, modulus, kernel, period)
    return Pairs(x, modulus, kernel, radius)


class LayerSum:
    """The sums of a layer over one layout of contacts: those of `bare`, a half-space, corrected."""

    def __init__(self, bare: Sum, extra: Pairs) -> None:
        self._bare, self._extra = bare, extra
        self._kept: Array | None = None

    def refresh(self, x: Array, radius: Array | None = None) -> bool:
        """The same for contacts that have moved, come or gone."""
        self._extra.x, self._kept = x, None
        return self._bare.refresh(x, radius)

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact, (n,), m."""
        if len(f) ** 2 > KEEP:
            return self._bare.apply(f) + self._extra.at(self._extra.x, f)
        if self._kept is None:
            self._kept = self._extra.matrix()
        return self._bare.apply(f) + self._kept @ f

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope (n, 2), the gradient of the expansion `e = -w`."""
        w, slope = self._bare.displacement(f)
        extra, steep = self._extra.displacement(f)
        return w + extra, slope + steep


class Pairs:
    """`sum_j D(r_kj/h) f_j / (pi E' h)`, pair by pair."""

    def __init__(
        self, x: Array, modulus: float, kernel: LayerKernel, radius: Array | None = None
    ) -> None:
        self.x, self._radius = x, radius
        self._h, self._table = kernel.thickness, kernel.table
        self._unit = 1 / (np.pi * modulus * self._h)

    def at(self, points: Array, f: Array) -> Array:
        """Depression (m,), m, at `points` (m, 2)."""
        w = np.empty(len(points))
        for rows, dx, dy in self._blocks(points):
            w[rows] = self._value(np.hypot(dx, dy)) @ f
        return w * self._unit

    def _value(self, r: Array) -> Array:
        if self._radius is None:
            return self._table.value(r / self._h)
        return self._table.spread(r / self._h, (self._radius / self._h) ** 2)

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression and slope of every contact."""
        w, slope = np.empty(len(f)), np.empty((len(f), 2))
        for rows, dx, dy in self._blocks(self.x):
            r = np.hypot(dx, dy)
            value, steep = self._table.steepness(r / self._h)
            r[r == 0] = np.inf
            w[rows] = value @ f
            slope[rows, 0] = (steep * dx / r) @ f
            slope[rows, 1] = (steep * dy / r) @ f
        return w * self._unit, slope * (-self._unit / self._h)

    def matrix(self) -> Array:
        """What is added to the influence matrix, (n, n), m/N: symmetric, on the diagonal too."""
        c = np.empty((len(self.x), len(self.x)))
        for rows, dx, dy in self._blocks(self.x):
            c[rows] = self._table.value(np.hypot(dx, dy) / self._h)
        return c * self._unit

    def _blocks(self, points: Array) -> Iterator[tuple[slice, Array, Array]]:
        """Rows of the pair table, offsets from the loads."""
        height = max(1, BLOCK // max(len(self.x), 1))
        for first in range(0, len(points), height):
            rows = slice(first, first + height)
            d = points[rows, None] - self.x
            yield rows, d[..., 0], d[..., 1]


class Waves(Pairs):
    """The same over all images of a periodic cell: a sum of waves.

    The wave q = 0, which a half-space leaves out, has a meaning on a layer, `Layer.uniform`.
    """

    def __init__(
        self, x: Array, modulus: float, kernel: LayerKernel, period: tuple[float, float]
    ) -> None:
        self.x = x
        counts = [int(WAVES * side / (2 * np.pi * kernel.thickness)) + 1 for side in period]
        self._q = 2 * np.pi / period[0] * np.arange(-counts[0], counts[0] + 1)
        self._p = 2 * np.pi / period[1] * np.arange(counts[1] + 1)
        symbol = kernel.spectrum(np.hypot(self._q[:, None], self._p))
        symbol[:, 1:] *= 2  # with their complex conjugates
        self._symbol = symbol / (np.pi * modulus * period[0] * period[1])

    def at(self, points: Array, f: Array) -> Array:
        across, along = self._phases(points)
        w: Array = ((across @ self._amplitudes(f)) * along).sum(axis=1).real
        return w

    def displacement(self, f: Array) -> tuple[Array, Array]:
        across, along = self._phases(self.x)
        amplitudes = self._amplitudes(f)
        terms = (across @ amplitudes) * along
        sideways = (across @ (self._q[:, None] * amplitudes)) * along
        slope = np.stack([sideways.imag.sum(axis=1), terms.imag @ self._p], axis=1)
        return terms.real.sum(axis=1), slope

    def matrix(self) -> Array:
        across, along = self._phases(self.x)
        c = np.zeros((len(self.x), len(self.x)))
        for symbol, wave in zip(self._symbol.T, along.T, strict=True):
            c += ((across * symbol) @ across.conj().T * np.outer(wave, wave.conj())).real
        return (c + c.T) / 2

    def _amplitudes(self, f: Array) -> Array:
        across, along = self._phases(self.x)
        amplitudes: Array = self._symbol * ((across.conj() * f[:, None]).T @ along.conj())
        return amplitudes

    def _phases(self, points: Array) -> tuple[Array, Array]:
        return (
            np.exp(1j * points[:, 0, None] * self._q),
            np.exp(1j * points[:, 1, None] * self._p),
        )
