r"""Green's functions of an elastic half-space.

The half-space fills `z < 0`. A normal force `f > 0` presses it down and its surface sinks by the
depression `w`, positive downward, in metres; the expansion `e = -w` is positive upward. The only
elastic constant that matters to normal loads is the plane-strain modulus `E' = E/(1 - nu^2)`, Pa.

Symbols: `r` the distance along the surface, m; `a` the radius of a contact, m; `f` a normal force,
N. Every function below gives the depression per unit force, m/N, for broadcastable arrays.

Source: K. L. Johnson, Contact Mechanics (1985), sections 3.2 (point force), 3.4 (Hertz pressure).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array


def plane_strain_modulus(youngs_modulus: float, poissons_ratio: float) -> float:
    """`E' = E/(1 - nu^2)`, Pa."""
    return youngs_modulus / (1.0 - poissons_ratio**2)


def point(r: ArrayLike, modulus: float) -> Array:
    """Depression at distance `r > 0` from a unit point force: `1/(pi E' r)`."""
    return 1.0 / (np.pi * modulus * np.asarray(r, dtype=np.float64))


def hertz(r: ArrayLike, a: ArrayLike, modulus: float) -> Array:
    """Depression at distance `r` from a unit force spread as Hertz pressure over the radius `a`.

    `p = 3/(2 pi a^2) sqrt(1 - r^2/a^2)` gives `3 (2 a^2 - r^2)/(8 E' a^3)` inside (Johnson, 3.41a)
    and `3/(4 pi E' a^3) [(2 a^2 - r^2) asin(a/r) + a sqrt(r^2 - a^2)]` outside (3.42a). The latter
    cancels to nothing for `r >> a`; it equals `2F1(1/2, 1/2; 5/2; a^2/r^2)/(pi E' r)`, which does
    not. `a = 0` is the point force. Not both `r` and `a` may be zero.
    """
    from scipy.special import hyp2f1

    r, a = np.broadcast_arrays(np.asarray(r, dtype=np.float64), np.asarray(a, dtype=np.float64))
    outer = np.maximum(r, a)
    inside = r < a
    shape = np.empty(r.shape)
    shape[inside] = 0.375 * np.pi * (2.0 - (r[inside] / a[inside]) ** 2)
    shape[~inside] = hyp2f1(0.5, 0.5, 2.5, (a[~inside] / r[~inside]) ** 2)
    return shape / (np.pi * modulus * outer)


def hertz_fall(r: ArrayLike, a: ArrayLike, modulus: float) -> Array:
    """Minus the derivative of `hertz` by r, over r: its gradient is that times minus the offset.

    `3/(4 E' a^3)` inside, and outside, with `z = a^2/r^2`,
    `[2F1(1/2, 1/2; 5/2; z) + z/5 2F1(3/2, 3/2; 7/2; z)]/(pi E' r^3)`.
    """
    from scipy.special import hyp2f1

    r, a = np.broadcast_arrays(np.asarray(r, dtype=np.float64), np.asarray(a, dtype=np.float64))
    outer = np.maximum(r, a)
    inside = r < a
    shape = np.empty(r.shape)
    shape[inside] = 0.75 * np.pi
    z = (a[~inside] / r[~inside]) ** 2
    shape[~inside] = hyp2f1(0.5, 0.5, 2.5, z) + 0.2 * z * hyp2f1(1.5, 1.5, 3.5, z)
    return shape / (np.pi * modulus * outer**3)


def hertz_concentric(a: ArrayLike, b: ArrayLike, modulus: float) -> Array:
    """Mean depression, weighted with one Hertz pressure, under another with the same centre.

    `3 (2 - 2/5 c^2/A^2)/(8 E' A)`, `A` the larger of the radii `a` and `b` and `c` the smaller: the
    parabola `hertz` inside the larger contact, where the mean of `r^2` over the smaller one is
    `2 c^2/5`. It is symmetric in `a` and `b`, as the energy of two loads must be. Two point forces
    (`a = b = 0`) act on each other no more than a point force acts on itself: zero.
    """
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    larger, smaller = np.maximum(a, b), np.minimum(a, b)
    size = np.where(larger > 0, larger, np.inf)
    return 0.375 * (2.0 - 0.4 * (smaller / size) ** 2) / (modulus * size)
