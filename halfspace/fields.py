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
NEGLIGIBLE = 1e-12  # of a contact's own depression, what an image adds to its far field
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
    height = max(1, BLOCK // (max(len(x), 1) if waves is None else 8 * max(len(x), waves.count)))
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
        amplitude = sums.amplitude(f, f * a * a / 10)
        self.count = len(amplitude)
        # On a lattice of wavenumbers, so that a wave is the product of one along x and one along y.
        unit = 2 * np.pi / np.asarray(sums.period)
        number = np.rint(sums.q / unit).astype(int)
        low = number.min(axis=0)
        self._q = [unit[k] * np.arange(low[k], number[:, k].max() + 1) for k in (0, 1)]
        self._amplitude = np.zeros([len(q) for q in self._q], complex)
        self._amplitude[tuple((number - low).T)] = amplitude
        self._terms = _terms(float(a.max(initial=0.0)) / (0.5 * min(sums.period)))
        # What is further than the images taken one by one: nearly as a continuum.
        rest = _lattice_rest(sums.period) * MULTIPOLES[2] * (f * a**4).sum()
        self._constant = sums.mean * f.sum() + rest

    def _pairs(self, d: Array, slopes: bool) -> tuple[Pairs, Array, Array]:
        """Less the smooth part within the cutoff; beyond it, less force and moment: 1/r^2 there."""
        everything = np.broadcast_to(True, d.shape[:2])
        pairs = Pairs(d, self._sums.cutoff, self._sums.split, everything, slopes)
        r = np.hypot(d[..., 0], d[..., 1])
        outside = np.where(r < self._sums.cutoff, 0.0, 1 / np.maximum(r, self._sums.cutoff))
        return pairs, 0.1 * self._a**2, outside

    def depression(self, points: Array, d: Array) -> Array:
        pairs, size, inverse = self._pairs(d, slopes=False)
        near = pairs.value - inverse + size * (pairs.laplacian - inverse**3)
        if self._terms:
            sums = np.zeros((self._terms, *near.shape))  # of 1/r^(2n + 1), n = 2, 3, ...
            for _, inverse in self._images(d):
                power = inverse * inverse * np.sqrt(inverse)
                for total in sums[:-1]:
                    total += power
                    power *= inverse
                sums[-1] += power
            for n, total in enumerate(sums, start=2):
                near += MULTIPOLES[n] * self._a ** (2 * n) * total
        across, along = self._phases(points)
        waves = ((across @ self._amplitude) * along).sum(axis=1)
        result: Array = waves.real + self._constant + near @ self._f
        return result

    def slope(self, points: Array, d: Array) -> Array:
        pairs, size, inverse = self._pairs(d, slopes=True)
        fall = pairs.fall - inverse**3 + size * (pairs.laplacian_fall - 3 * inverse**5)
        across, along = self._phases(points)
        waves = (across @ self._amplitude) * along
        sideways = (across @ (self._q[0][:, None] * self._amplitude)) * along
        result: Array = np.stack([sideways.imag.sum(axis=1), waves.imag @ self._q[1]], axis=1)
        near = fall[..., None] * d
        for image, inverse in self._images(d) if self._terms else ():
            power = inverse**3 * np.sqrt(inverse)
            steep = np.zeros_like(power)
            for n in range(2, 2 + self._terms):
                steep += (2 * n + 1) * MULTIPOLES[n] * self._a ** (2 * n) * power
                power *= inverse
            near += steep[..., None] * (d + image)
        for axis in (0, 1):
            result[:, axis] += near[..., axis] @ self._f
        return result

    def _phases(self, points: Array) -> tuple[Array, Array]:
        x, y = (np.exp(1j * points[:, k, None] * self._q[k]) for k in (0, 1))
        return x, y

    def _images(self, d: Array) -> Iterator[tuple[Array, Array]]:
        """Offsets (2,) of the other images taken one by one, and 1/r^2 to them."""
        span = np.arange(-IMAGES, IMAGES + 1)
        x, y = ([(d[..., k] + i * self._sums.period[k]) ** 2 for i in span] for k in (0, 1))
        for i, j in np.ndindex(len(span), len(span)):
            if span[i] or span[j]:
                yield np.array([span[i], span[j]]) * self._sums.period, 1 / (x[i] + y[j])


def _terms(size: float) -> int:
    """How many multipoles, from the fourth moment on, count at a distance of 1/``size`` contact
    radii, against the depression at the centre of a contact."""
    falling = [c * size ** (2 * n + 1) for n, c in enumerate(MULTIPOLES)]
    return sum(term > NEGLIGIBLE for term in falling[2:])


@lru_cache(maxsize=8)
def _lattice_rest(period: tuple[float, float]) -> float:
    """Sum of 1/r^5 over the images beyond those taken one by one."""
    far = 40
    i, j = np.meshgrid(*(np.arange(-far, far + 1),) * 2, indexing="ij")
    beyond = np.maximum(abs(i), abs(j)) > IMAGES
    return float((np.hypot(i[beyond] * period[0], j[beyond] * period[1]) ** -5.0).sum())
