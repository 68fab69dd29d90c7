"""Closed-form solutions of contact on the elastic half-space, and of what spheres do on it.

SI units. `modulus` is the composite modulus `E*` of the two bodies, Pa (for a rigid body on the
half-space, `E'` of the half-space); `radius` is the radius of relative curvature `R*`, m. Johnson:
K. L. Johnson, Contact Mechanics, Cambridge University Press, 1985. Chung & Ooi: Y. C. Chung and
J. Y. Ooi, Benchmark tests for verifying discrete element modelling codes at particle impact level,
Granular Matter 13, 643-656, 2011.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk, gamma

from . import greens
from .arrays import Array, kind_of

# Duration of a Hertz impact over `overlap/speed`: 2 int_0^1 dx/sqrt(1 - x^(5/2)) = 2.9432...
HERTZ_DURATION = float(0.8 * np.sqrt(np.pi) * gamma(0.4) / gamma(0.9))

# sum' 1/r over the unit square lattice, less the mean: 4 zeta(1/2) beta(1/2), beta Dirichlet's
# (J. M. Borwein et al., Lattice Sums Then and Now, 2013, section 1.3).
SQUARE_LATTICE = -3.900264920001956


def composite_modulus(e1: float, nu1: float, e2: float, nu2: float) -> float:
    """`1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2` (Johnson, section 4.2)."""
    return 1.0 / ((1.0 - nu1**2) / e1 + (1.0 - nu2**2) / e2)


# Hertz ------------------------------------------------------------------------------------------


def hertz_stiffness(radius: ArrayLike, modulus: ArrayLike) -> Array:
    """`k = 4/3 E* sqrt(R*)` of `F = k delta^(3/2)` (Johnson, section 4.2)."""
    return np.asarray(4.0 / 3.0 * np.asarray(modulus) * np.sqrt(radius))


@dataclass(frozen=True)
class HertzLaw:
    """The law `overlap -> (force, tangent)` of touching spheres, for `halfspace.solve`."""

    radius: ArrayLike
    modulus: ArrayLike

    def __call__(self, overlap: Array) -> tuple[Array, Array]:
        kind = kind_of(overlap)
        k = 4.0 / 3.0 * kind.array(self.modulus) * kind.array(self.radius) ** 0.5
        root = kind.array(overlap).clip(0.0) ** 0.5
        return k * root**3, 1.5 * k * root


def hertz_law(radius: ArrayLike, modulus: ArrayLike) -> HertzLaw:
    """The law of touching spheres, which knows their radii, for `halfspace.solve`."""
    return HertzLaw(radius, modulus)


def hertz_contact_radius(force: ArrayLike, radius: ArrayLike, modulus: ArrayLike) -> Array:
    """`a = (3 F R*/(4 E*))^(1/3)` (Johnson, 4.22)."""
    return np.cbrt(0.75 * np.asarray(force) * np.asarray(radius) / np.asarray(modulus))


def hertz_overlap(force: ArrayLike, radius: ArrayLike, modulus: ArrayLike) -> Array:
    """The approach `delta = a^2/R*` (Johnson, 4.23)."""
    return hertz_contact_radius(force, radius, modulus) ** 2 / np.asarray(radius)


def hertz_surface(r: ArrayLike, a: float, radius: float) -> Array:
    """Displacement of the two surfaces together at `r` from the centre of a Hertz contact, m.

    Inside `delta - r^2/(2R)`, outside `[(2a^2 - r^2) asin(a/r) + a sqrt(r^2 - a^2)]/(pi R)`
    (Johnson, 3.41a, 3.42a); `a^2/(2R)` at the edge. Each body's share is as its compliance's.
    """
    force_over_modulus = 4.0 * a**3 / (3.0 * radius)
    return force_over_modulus * greens.hertz(r, a, 1.0)


class Impact(NamedTuple):
    """Largest overlap, m, largest force, N, and duration, s, of an impact."""

    overlap: float
    force: float
    duration: float


def hertz_impact(mass: float, radius: float, modulus: float, speed: float) -> Impact:
    """Elastic impact at the closing `speed`, m/s; `mass` is the reduced mass `m*` (Johnson, 11.4).

    `delta = (5 m* v^2/(4 k))^(2/5)`, `F = k delta^(3/2)`, `t = HERTZ_DURATION delta/v`.
    """
    k = float(hertz_stiffness(radius, modulus))
    overlap = (1.25 * mass * speed**2 / k) ** 0.4
    return Impact(overlap, k * overlap**1.5, HERTZ_DURATION * overlap / speed)


def stick_radius(a: ArrayLike, tangential: ArrayLike, normal: ArrayLike, friction: float) -> Array:
    """`c = a (1 - T/(mu P))^(1/3)`, zero in full slip (Mindlin 1949; Johnson, section 7.2)."""
    share = 1.0 - np.abs(tangential) / (friction * np.asarray(normal))
    return np.asarray(a) * np.cbrt(np.maximum(share, 0.0))


# Other loads on the half-space ------------------------------------------------------------------


def flat_punch_force(a: ArrayLike, displacement: ArrayLike, modulus: ArrayLike) -> Array:
    """Rigid circular punch of radius `a`: `F = 2 a E* delta` (Johnson, section 3.4)."""
    return np.asarray(2.0 * np.asarray(a) * np.asarray(modulus) * np.asarray(displacement))


def uniform_disc(r: ArrayLike, a: float, pressure: float, modulus: float) -> Array:
    """Depression at `r` by a uniform pressure on a disc of radius `a` (Johnson, 3.4).

    `4 p a/(pi E*) E(r/a)` inside: `2 p a/E*` at the centre and `4 p a/(pi E*)` at the edge; outside
    `4 p r/(pi E*) [E(a/r) - (1 - a^2/r^2) K(a/r)]`; E and K complete elliptic integrals of modulus
    `r/a`, `a/r`.
    """
    r = np.asarray(r, dtype=np.float64)
    outer = np.maximum(r, a)
    m = (np.minimum(r, a) / outer) ** 2
    outside = ellipe(m) - (1.0 - m) * ellipk(np.where(r > a, m, 0.0))
    return 4.0 * pressure / (np.pi * modulus) * outer * np.where(r > a, outside, ellipe(m))


def sinusoidal_depression(pressure: ArrayLike, wavenumber: ArrayLike, modulus: float) -> Array:
    """Amplitude of the depression by a wave of pressure: `u(q) = 2 p(q)/(E* |q|)`.

    H. M. Westergaard, J. Appl. Mech. 6, 49, 1939.
    """
    return 2.0 * np.asarray(pressure) / (modulus * np.abs(wavenumber))


def wavy_full_contact_pressure(amplitude: float, wavelength: float, modulus: float) -> float:
    """Mean pressure that flattens `h cos(2 pi x/lambda)`: `pi E* h/lambda` (Johnson, 13.2)."""
    return np.pi * modulus * amplitude / wavelength


def two_spheres(overlap: float, separation: float, radius: float, modulus: float) -> float:
    """Force on each of two equal rigid spheres pressed into the half-space, point coupling, N.

    The root of `F = 4/3 E* sqrt(R) (delta - F/(pi E* s))^(3/2)`, `s` the separation.
    """
    k = float(hertz_stiffness(radius, modulus))

    def surplus(d: float) -> float:
        return d + k * d**1.5 / (np.pi * modulus * separation) - overlap

    if overlap <= 0:
        return 0.0
    return float(k * brentq(surplus, 0.0, overlap, xtol=1e-15 * overlap, rtol=1e-14) ** 1.5)


# Adhesion: K. L. Johnson, K. Kendall & A. D. Roberts, Proc. R. Soc. A 324, 301, 1971 -------------


def jkr_overlap(a: ArrayLike, radius: float, modulus: float, work: float) -> Array:
    """`delta = a^2/R* - sqrt(2 pi W a/E*)`, `work` the work of adhesion `W`, J/m^2."""
    a = np.asarray(a, dtype=np.float64)
    return a**2 / radius - np.sqrt(2.0 * np.pi * work * a / modulus)


def jkr_force(a: ArrayLike, radius: float, modulus: float, work: float) -> Array:
    """`F = 4 E* a^3/(3 R*) - sqrt(8 pi W E* a^3)`, positive in compression."""
    cubed = np.asarray(a, dtype=np.float64) ** 3
    return 4.0 * modulus * cubed / (3.0 * radius) - np.sqrt(8.0 * np.pi * work * modulus * cubed)


def jkr_pull_off_force(radius: float, work: float) -> float:
    """`3/2 pi W R*`, the largest tension, at which a contact opens under a given load."""
    return 1.5 * np.pi * work * radius


def jkr_zero_load_radius(radius: float, modulus: float, work: float) -> float:
    """Contact radius without load: `a0^3 = 9 pi W R*^2/(2 E*)`."""
    return float(np.cbrt(4.5 * np.pi * work * radius**2 / modulus))


def jkr_opening(radius: float, modulus: float, work: float) -> tuple[float, float]:
    """Overlap, m (negative), and force, N, at which a contact opens under a given displacement.

    `d delta/da = 0` at `a^3 = pi W R*^2/(8 E*)`, so `delta = -3 a^2/R*`, and the force is 5/9 of
    the pull-off force, in tension.
    """
    a = float(np.cbrt(np.pi * work * radius**2 / (8.0 * modulus)))
    return -3.0 * a**2 / radius, -5.0 / 9.0 * jkr_pull_off_force(radius, work)


# Impact and rolling -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Sphere:
    """A sphere of the benchmarks: Pa, -, kg/m^3, m."""

    youngs_modulus: float
    poissons_ratio: float
    density: float
    radius: float

    @property
    def mass(self) -> float:
        return 4.0 / 3.0 * np.pi * self.radius**3 * self.density

    @property
    def plane_strain_modulus(self) -> float:
        return greens.plane_strain_modulus(self.youngs_modulus, self.poissons_ratio)


# The spheres of Chung & Ooi's tests, and the closing speeds of tests 1 and 2, m/s.
GLASS = Sphere(48e9, 0.20, 2800.0, 0.01)
LIMESTONE = Sphere(20e9, 0.25, 2500.0, 0.01)
ALUMINIUM = Sphere(70e9, 0.30, 2699.0, 0.1)
MAGNESIUM = Sphere(40e9, 0.35, 1800.0, 0.1)
ALUMINA = Sphere(380e9, 0.23, 4000.0, 0.0025)
TEST_1_SPEED = 20.0
TEST_2_SPEED = 0.2


def equal_spheres_impact(sphere: Sphere, speed: float = TEST_1_SPEED) -> Impact:
    """Two equal spheres head on, closing at `speed` (Chung & Ooi, test 1)."""
    modulus = sphere.plane_strain_modulus / 2
    return hertz_impact(sphere.mass / 2, sphere.radius / 2, modulus, speed)


def rigid_plane_impact(sphere: Sphere, speed: float = TEST_2_SPEED) -> Impact:
    """A sphere normally on a rigid plane (Chung & Ooi, test 2)."""
    return hertz_impact(sphere.mass, sphere.radius, sphere.plane_strain_modulus, speed)


def rebound_speed(speed: ArrayLike, restitution: ArrayLike) -> Array:
    """`e v`: restitution out is restitution in, at any speed (Chung & Ooi, test 3)."""
    return np.asarray(speed) * np.asarray(restitution)


class Oblique(NamedTuple):
    """Tangential restitution, and spin after the impact, rad/s."""

    tangential_restitution: Array
    spin: Array


def oblique_impact(
    angle: ArrayLike, radius: float, speed: float, friction: float, restitution: float
) -> Oblique:
    """A sphere without spin that slides throughout its impact on a plane (Chung & Ooi, test 4).

    angle: of the velocity from the normal, rad. `e_t = 1 - mu (1 + e)/tan(theta)` and
    `omega = 5/(2R) mu (1 + e) v cos(theta)`. It holds where the surface still slides at the end,
    `tan(theta) > 7/2 mu (1 + e)`.
    """
    grip = friction * (1.0 + restitution)
    spin = 2.5 / radius * grip * speed * np.cos(angle)
    return Oblique(np.asarray(1.0 - grip / np.tan(angle)), np.asarray(spin))


def slip_to_roll(speed: float, friction: float, gravity: float) -> tuple[float, float]:
    """Speed, m/s, and time, s, at which a sphere that starts by sliding rolls without slip.

    `5 v0/7` at `2 v0/(7 mu g)`: friction `mu m g` slows the centre and spins up `2/5 m R^2`.
    """
    return 5.0 / 7.0 * speed, 2.0 * speed / (7.0 * friction * gravity)
