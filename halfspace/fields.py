"""The surface anywhere: depression, slope and pressure, by points or by Hertz pressures.

Of a periodic half-space, force and moment by Ewald's sum (`periodic`), the nearest image by the
closed form, and what higher moments of the others add image by image.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from . import greens
from .arrays import Array
from .direct import BLOCK
from .periodic import Pairs, PeriodicSum, check_reach

# Hertz pressures from far: sum_n c_n a^(2n)/r^(2n+1), `hertz` with c_n = (1/2)_n^2/((5/2)_n n!).
MULTIPOLES = tuple(
    float(np.prod([(m + 0.5) ** 2 / ((m + 2.5) * (m + 1)) for m in range(n)])) for n in range(9)
)
IMAGES = 2  # cells on each side in which multipoles beyond the second are summed one by one


def surface(
    x: Array,
    f: Array,
    points: Array,
    modulus: float,
    radius: Array | None = None,
    period: tuple[float, float] | None = None,
    slopes: bool = False,
) -> Array:
    """Depression (m,), m, at `points` (m, 2) by all the forces, or the gradient (m, 2) of -1 times
    it.

    x (n, 2), f (n,), radius (n,): as for `HalfSpace.field`. A force without extent makes the
    depression infinite, of the sign of the force, at its own point, and no slope there.
    """
    a = np.zeros(len(x)) if radius is None else radius
    waves = None
    if period is not None:
        check_reach(2 * float(a.max(initial=0.0)), period)
        waves = _Waves(PeriodicSum(x, 1 / np.pi, period), f, a)
    result = np.empty((len(points), 2) if slopes else len(points))
    height = max(1, BLOCK // max(len(x), 1 if waves is None else waves.count, 1))
    for first in range(0, len(points), height):
        rows = slice(first, first + height)
        d = points[rows, None] - x
        if period is not None:
            d -= np.round(d / period) * period
        r = np.hypot(d[..., 0], d[..., 1])
        singular = np.maximum(r, a) == 0
        r[singular] = np.inf
        if slopes:
            fall = greens.hertz_fall(r, a, 1 / np.pi)
            result[rows] = np.stack([(fall * d[..., axis]) @ f for axis in (0, 1)], axis=1)
            if waves is not None:
                result[rows] += waves.slope(points[rows], d)
            continue
        bare = radius is None
        total = (greens.point(r, 1 / np.pi) if bare else greens.hertz(r, a, 1 / np.pi)) @ f
        if waves is not None:
            total += waves.depression(points[rows], d)
        net = singular @ f
        result[rows] = np.where(net == 0, total, np.copysign(np.inf, net))
    return result / (np.pi * modulus)


def pressure(
    x: Array, f: Array, points: Array, radius: Array, period: tuple[float, float] | None = None
) -> Array:
    """Pressure (m,), Pa, at `points` (m, 2) under Hertz contacts of radii (n,), m."""
    p = np.empty(len(points))
    height = max(1, BLOCK // max(len(x), 1))
    wide = np.where(radius > 0, radius, 1.0)
    for first in range(0, len(points), height):
        rows = slice(first, first + height)
        d = points[rows, None] - x
        if period is not None:
            d -= np.round(d / period) * period
        r = np.hypot(d[..., 0], d[..., 1])
        shape = np.sqrt(np.maximum(1 - (r / wide) ** 2, 0.0)) * (radius > 0)
        p[rows] = shape @ (1.5 * f / (np.pi * wide**2))
        net = ((r == 0) & (radius == 0)) @ f
        p[rows] = np.where(net == 0, p[rows], np.copysign(np.inf, net))
    return p


class _Waves:
    """What a periodic half-space adds to the nearest images, in units of 1/(pi E')."""

    def __init__(self, sums: PeriodicSum, f: Array, a: Array) -> None:
        self._sums, self._f, self._a = sums, f, a
        self._amplitude = sums.amplitude(f, f * a * a / 10)
        self.count = len(self._amplitude)
        # What is further than the images taken one by one: nearly as a continuum.
        rest = _lattice_rest(sums.period) * MULTIPOLES[2] * (f * a**4).sum()
        self._constant = sums.mean * f.sum() + rest

    def _pairs(self, d: Array) -> tuple[Pairs, Array, Array]:
        """Less the smooth part within the cutoff; beyond it, less force and moment: 1/r^2 there."""
        everything = np.broadcast_to(True, d.shape[:2])
        pairs = Pairs(d, self._sums.cutoff, self._sums.split, everything)
        r = np.hypot(d[..., 0], d[..., 1])
        outside = np.where(r < self._sums.cutoff, 0.0, 1 / np.maximum(r, self._sums.cutoff))
        return pairs, 0.1 * self._a**2, outside

    def depression(self, points: Array, d: Array) -> Array:
        pairs, size, inverse = self._pairs(d)
        near = pairs.value - inverse + size * (pairs.laplacian - inverse**3)
        if self._a.any():
            for image in _images(self._sums.period):
                near += _higher(np.hypot(*(d + image).T).T, self._a)
        waves = np.exp(1j * (points @ self._sums.q.T)) @ self._amplitude
        result: Array = waves.real + self._constant + near @ self._f
        return result

    def slope(self, points: Array, d: Array) -> Array:
        pairs, size, inverse = self._pairs(d)
        fall = pairs.fall - inverse**3 + size * (pairs.laplacian_fall - 3 * inverse**5)
        waves = np.exp(1j * (points @ self._sums.q.T)) * self._amplitude
        result: Array = waves.imag @ self._sums.q
        for axis in (0, 1):
            near = fall * d[..., axis]
            if self._a.any():
                for image in _images(self._sums.period):
                    away = d + image
                    steep = _higher(np.hypot(*away.T).T, self._a, fall=True)
                    near = near + steep * away[..., axis]
            result[:, axis] += near @ self._f
        return result


def _images(period: tuple[float, float]) -> Iterator[Array]:
    """Offsets of the other images taken one by one."""
    span = range(-IMAGES, IMAGES + 1)
    for i in span:
        for j in span:
            if i or j:
                yield np.array([i * period[0], j * period[1]])


def _higher(r: Array, a: Array, fall: bool = False) -> Array:
    """Depression by the moments of a Hertz pressure beyond the second, times pi E', per force, or
    `-1/r d/dr` of it."""
    ratio = (a / r) ** 2
    total = np.zeros(r.shape)
    for n in range(len(MULTIPOLES) - 1, 1, -1):
        total = total * ratio + MULTIPOLES[n] * (2 * n + 1 if fall else 1)
    return total * ratio**2 / (r**3 if fall else r)


@lru_cache(maxsize=8)
def _lattice_rest(period: tuple[float, float]) -> float:
    """Sum of 1/r^5 over the images beyond those taken one by one."""
    far = 40
    i, j = np.meshgrid(*(np.arange(-far, far + 1),) * 2, indexing="ij")
    beyond = np.maximum(abs(i), abs(j)) > IMAGES
    return float((np.hypot(i[beyond] * period[0], j[beyond] * period[1]) ** -5.0).sum())
