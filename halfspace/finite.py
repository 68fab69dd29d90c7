r"""Contacts of finite size: what Hertz pressures, instead of point forces, do to each other.

Two Hertz pressures of radii `a_j`, `a_k` at a distance r have, to second order in a/r, the energy

    f_j f_k/(pi E') K,    K = 1/r [1 + s/(10 r^2)],    s = a_j^2 + a_k^2,

because a pressure of second moment `int p t^2 dA = 2/5 f a^2` acts on what is smooth as
`f (1 + a^2/10 laplacian)` at its centre, and the Laplacian of 1/r in the plane is 1/r^3. So a
contact is a force `f` and a moment `q = f a^2/10`. As Hertz radii grow by `a ~ f^(1/3)`,
`dq/df = a^2/6` and `d2q/df2 = a^2/(9 f)`, and the depression, which is the derivative of the energy
by the force, is

    w_k = sum_j f_j/(pi E' r) [1 + (a_j^2/10 + a_k^2/6)/r^2].

Contacts that overlap. The series is meant for contacts apart. Where `u = r^2/s < 2` (two equal
contacts that would overlap) K goes on as `k(u)/sqrt(s)` with a cubic `k` that has value, slope and
curvature in common with the series at u = 2, and at u = 0 the energy of two equal Hertz pressures
with one centre, `k = 3/5 sqrt(2) pi`. So the energy is finite at any distance, flat where centres
coincide, symmetric in both contacts and twice continuously differentiable, and displacements and
slopes are its derivatives there too. Two contacts without size at one point do not act on each
other.

Every way of summing sums 1/r and its Laplacian, and so gives displacement, slope and the second
derivative of one energy. A mesh resolves the Laplacian less well than 1/r: with contacts of radius
0.2 s it errs by up to 1.5 tolerances down to 1e-6, 4 at 1e-8 and 7 at 1e-10, of which the part by
the sizes goes as (a/s)^2; one application takes twice the time.

What is of first order at the centre of a tilted surface, the shift of the contact, is in `solve`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from . import greens
from .arrays import Array

TOUCHING = 2.0  # u at which two equal contacts touch, and the series ends
REACH = 2.0  # of contact radii: no two contacts further apart overlap in that sense
SPARE = 1.25  # by which the distance is set larger than needed: radii grow while one solves


def _inner() -> Polynomial:
    """`k(u)` for u < TOUCHING."""
    t = TOUCHING
    value = t**-0.5 + 0.1 * t**-1.5
    slope = -0.5 * t**-1.5 - 0.15 * t**-2.5
    bend = 0.75 * t**-2.5 + 0.375 * t**-3.5
    start = np.sqrt(2.0) * np.pi * float(greens.hertz_concentric(1.0, 1.0, 1.0))
    cubic = (start - (value - slope * t + 0.5 * bend * t**2)) / -(t**3)
    v = Polynomial([-t, 1.0])
    return value + slope * v + 0.5 * bend * v**2 + cubic * v**3


INNER = _inner()


@dataclass(frozen=True)
class Kernel:
    """K, its first two derivatives by `s`, and that by `r^2`."""

    value: Array
    by_size: Array
    twice_by_size: Array
    by_square: Array


def kernel(squared: Array, size: Array) -> Kernel:
    """K for pairs at the squared distances `squared`, m^2, with `s = size`, m^2."""
    apart = squared >= TOUCHING * size
    r2 = np.where(apart & (squared > 0), squared, np.inf)
    r = np.sqrt(r2)
    s = np.where(apart, 1.0, size)
    root = np.sqrt(s)
    u = np.where(apart, 0.0, squared) / s
    k, k1, k2 = INNER(u), INNER.deriv(1)(u), INNER.deriv(2)(u)
    h = 0.5 * k + u * k1
    cubed = 1 / (r * r2)
    return Kernel(
        np.where(apart, 1 / r + 0.1 * size * cubed, k / root),
        np.where(apart, 0.1 * cubed, -h / (root * s)),
        np.where(apart, 0.0, (1.5 * h + u * (1.5 * k1 + u * k2)) / (root * s * s)),
        np.where(apart, -0.5 * cubed - 0.15 * size * cubed / r2, k1 / (root * s)),
    )


@dataclass(frozen=True)
class Close:
    """Pairs that are left out of the sums, because they may overlap: here they act one by one.

    k, j (m,): all ordered pairs; offset (m, 2): from j to k, m, the shortest in a periodic cell.
    Everything is in units of 1/(pi E').
    """

    count: int
    k: Array
    j: Array
    offset: Array

    def _kernel(self, a: Array) -> Kernel:
        squared = (self.offset**2).sum(axis=1)
        return kernel(squared, a[self.k] ** 2 + a[self.j] ** 2)

    def _sum(self, values: Array) -> Array:
        result: Array = np.bincount(self.k, values, self.count).astype(np.float64)
        return result

    def potential(self, f: Array, a: Array) -> Array:
        return self._sum(f[self.j] * self._kernel(a).value)

    def depression(self, f: Array, a: Array) -> Array:
        pair = self._kernel(a)
        return self._sum(f[self.j] * (pair.value + 2 / 3 * a[self.k] ** 2 * pair.by_size))

    def slope(self, f: Array, a: Array) -> Array:
        steep = -2 * f[self.j] * self._kernel(a).by_square
        return np.stack([self._sum(steep * self.offset[:, axis]) for axis in (0, 1)], axis=1)

    def tangent(self, f: Array, a: Array) -> Callable[[Array], Array]:
        """`df -> dw` at the forces `f`."""
        k, j, pair = self.k, self.j, self._kernel(a)
        s_k, s_j = a[k] ** 2, a[j] ** 2
        across = pair.value + 2 / 3 * (s_k + s_j) * pair.by_size
        across = across + 4 / 9 * s_k * s_j * pair.twice_by_size
        pressing = np.where(f > 0, f, np.inf)
        along = s_k * (10 / 9 * pair.by_size + 4 / 9 * s_k * pair.twice_by_size)
        own = self._sum(f[j] * along / pressing[k])
        return lambda g: self._sum(across * g[j]) + own * g
