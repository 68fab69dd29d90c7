"""JKR, EEPA and the rolling laws once more, in plain NumPy, from the papers alone.

Arrays run over contacts, paths over their first axis.  JKR is written in terms of the contact
radius, where nothing has to be solved for; EEPA with the plastic overlap itself and the two radii.
"""

from typing import NamedTuple

import numpy as np
from twins import damping_ratio, dot, length


class JKR(NamedTuple):
    """Spheres with the work of adhesion W (J/m2); every method takes the contact radius a (m)."""

    work: np.ndarray
    modulus: np.ndarray
    radius: np.ndarray

    @property
    def least(self):
        """The contact radius at which d is least: 2 a/R* = sqrt(pi W/(2 E* a))."""
        return (np.pi * self.work * self.radius**2 / (8 * self.modulus)) ** (1 / 3)

    @property
    def equilibrium(self):
        """a_0 of zero force, seed 003 eq. (2)."""
        return (9 * np.pi * self.work * self.radius**2 / (2 * self.modulus)) ** (1 / 3)

    def _terms(self, a):
        return a**2 / self.radius, np.sqrt(2 * np.pi * self.work * a / self.modulus)

    def overlap(self, a):
        hertz, stretch = self._terms(a)
        return hertz - stretch

    def force(self, a):
        hertz = 4 * self.modulus * a**3 / (3 * self.radius)
        return hertz - np.sqrt(8 * np.pi * self.work * self.modulus * a**3)

    def tangent(self, a):
        """(dF/da) / (dd/da)."""
        hertz, stretch = self._terms(a)
        steeper = 4 * self.modulus * a**2 / self.radius - np.sqrt(
            18 * np.pi * self.work * self.modulus * a
        )
        return steeper / ((2 * hertz - stretch / 2) / a)

    def energy(self, a):
        """The integral of F dd from a = 0; exact, a polynomial in sqrt(a)."""
        nodes, weights = np.polynomial.legendre.leggauss(8)
        root = np.sqrt(a) * (nodes[:, None] + 1) / 2
        hertz, stretch = self._terms(root**2)
        slope = 4 * hertz / root - stretch / root  # dd / d sqrt(a)
        return np.sqrt(a) / 2 * (weights @ (self.force(root**2) * slope))


class EEPA(NamedTuple):
    """Contacts after the Edinburgh model; (n,) arrays, ``radius_j`` infinite for a wall."""

    modulus: np.ndarray
    restitution: np.ndarray
    stiffness_ratio: np.ndarray
    surface_energy: np.ndarray
    pull_off: np.ndarray
    radius_i: np.ndarray
    radius_j: np.ndarray
    mass: np.ndarray
    overlap_exponent: float
    adhesion_exponent: float
    damping: str = "tangent"
    limit_force: bool = False

    @property
    def radius(self):
        return 1 / (1 / self.radius_i + 1 / self.radius_j)

    @property
    def first(self):
        """k_1, eq. (1)."""
        if self.overlap_exponent == 1:
            return 2 * self.modulus * self.radius
        return 4 / 3 * self.modulus * np.sqrt(self.radius)

    def chord(self, overlap):
        """Radius of the circle in which the spheres cut each other: Heron's triangle of the two
        radii and the distance; of a sphere and a plane, sqrt(2 R d - d^2)."""
        wall = np.isinf(self.radius_j)
        r_i, r_j = self.radius_i, np.where(wall, self.radius_i, self.radius_j)
        distance = r_i + r_j - overlap
        area = (r_i + r_j + distance) * overlap * (distance + r_i - r_j) * (distance + r_j - r_i)
        cap = np.maximum(overlap * (2 * r_i - overlap), 0)
        return np.where(wall, np.sqrt(cap), np.sqrt(np.maximum(area, 0)) / (2 * distance))

    def adhesion(self, overlap, plastic):
        """k_c d^c, eqs. (5) and (6); ``plastic`` is d_p,max, which sets the contact radius too."""
        n, c = self.overlap_exponent, self.adhesion_exponent
        second = self.stiffness_ratio * self.first
        pull = 1.5 * np.pi * self.surface_energy * self.chord(plastic)
        most = 0.5 * second * plastic**n
        free = (np.maximum(plastic**n - pull / second, 0)) ** (1 / n)
        at = np.where(pull > most, 0.5 * plastic, free)
        stuck = plastic > 0
        return np.where(stuck, np.minimum(pull, most) * (overlap / np.where(stuck, at, 1)) ** c, 0)

    def step(self, overlap, plastic, start):
        """F_el of eq. (7), the new d_p,max, and where the k_2 line through the force starts.

        A contact that has slid down the adhesive branch has ``start`` < ``plastic``; off the branch
        again, its d_p,max is where the line starts, if with it the line is above the branch.
        """
        n = self.overlap_exponent
        first, second = self.first, self.stiffness_ratio * self.first
        least = (1 - first / second) ** (1 / n) * overlap
        loads = least >= start
        plastic, start = np.maximum(plastic, least), np.maximum(start, least)
        line, branch = second * (overlap**n - start**n), -self.adhesion(overlap, plastic)
        slides = line < branch
        down = (overlap**n - branch / second) ** (1 / n)
        force = np.where(loads, first * overlap**n, np.where(slides, branch, line))
        fits = line >= -self.adhesion(overlap, start)
        if self.adhesion_exponent >= n:
            fits = np.full_like(fits, True)
        reloads = (start < plastic) & (line > branch) & fits
        return force, np.where(reloads, start, plastic), np.where(slides, down, start)

    def drag(self, overlap):
        """gamma_n, eq. (8)."""
        ratio, n = damping_ratio(self.restitution), self.overlap_exponent
        if self.damping == "constant":
            return 2 * ratio * np.sqrt(self.mass * self.first)
        return ratio * np.sqrt(2 * (n + 1) * self.first * self.mass * overlap ** (n - 1))

    def path(self, overlaps, velocities):
        """F_el and F_n along paths (steps, n) of overlap and v_n, from first touch; a contact that
        opens forgets."""
        plastic, start = np.zeros(overlaps.shape[1]), np.zeros(overlaps.shape[1])
        elastic, total = np.zeros_like(overlaps), np.zeros_like(overlaps)
        for k, (overlap, velocity) in enumerate(zip(overlaps, velocities, strict=True)):
            touching = overlap > 0
            depth = np.where(touching, overlap, self.radius_i)
            force, plastic, start = self.step(depth, plastic, start)
            plastic, start = touching * plastic, touching * start
            whole = force + self.pull_off - self.drag(depth) * velocity
            if self.limit_force:
                whole = np.maximum(whole, 0)
            elastic[k], total[k] = touching * force, touching * whole
        return elastic, total

    def loop(self, deepest):
        """Work put in, and work given back, of one load to ``deepest`` and unload, no adhesion."""
        n, kappa = self.overlap_exponent, self.stiffness_ratio
        given = self.first * deepest ** (n + 1) / (n + 1)
        plastic = (1 - 1 / kappa) ** (1 / n) * deepest
        back = (deepest ** (n + 1) - plastic ** (n + 1)) / (n + 1)
        back = kappa * self.first * (back - plastic**n * (deepest - plastic))
        return given, back


class Rolling(NamedTuple):
    """A torque against rolling up to ``limit`` (N m); stiffness (N), dashpot (N m s), (n,)."""

    limit: np.ndarray
    stiffness: np.ndarray
    dashpot: np.ndarray
    radius: np.ndarray
    inertia: np.ndarray
    torsion: bool

    def opposed(self, spin, normal):
        return spin if self.torsion else spin - dot(spin, normal) * normal

    def stop(self, spin, normal, dt):
        """Eqs. (8)-(10), no longer than what stops the bodies within dt."""
        spin = self.opposed(spin, normal)
        speed = length(spin)
        size = np.minimum(self.limit[:, None], self.inertia[:, None] * speed / dt[:, None])
        return -size * np.divide(spin, speed, out=np.zeros_like(spin), where=speed > 0)

    def spring(self, stored, spin, normal, dt):
        """The torque, and the new rolling displacement from one, (n, 3), that lies in the present
        tangent plane (or, with torsion, anywhere)."""
        spin = self.opposed(spin, normal)
        moved = stored + (self.radius * dt)[:, None] * spin
        torque = -self.stiffness[:, None] * moved - self.dashpot[:, None] * spin
        size, slack = length(torque), self.limit[:, None]
        over = size > slack
        torque = np.where(over, torque * slack / np.where(over, size, 1), torque)
        most = slack / self.stiffness[:, None]
        far = over & (length(moved) > most)
        return torque, np.where(far, moved * most / np.where(far, length(moved), 1), moved)
