"""Whole motions of spheres that meet in pairs, or a wall each, in plain NumPy: any law, Verlet.

A normal law is a function of (contact number array ``overlap``, ``normal_velocity``, ``touching``)
that keeps its own memory and gives back whether contacts are closed, and the forces.
"""

from typing import NamedTuple

import numpy as np
from law_twins import JKR, Rolling
from twins import Motion, Normal, Pair, _times, damping_ratio, dot, length, mindlin


class Sticking:
    """JKR with a dashpot, contacts held from first touch until they open."""

    def __init__(self, twin, mass, restitution):
        self.twin, self.mass, self.restitution = twin, mass, restitution
        self.closed = np.zeros(len(mass), bool)

    def __call__(self, overlap, normal_velocity):
        least, twin = self.twin.least, self.twin
        self.closed = np.where(self.closed, overlap > twin.overlap(least), overlap > 0)
        low, high = least.copy(), 2 * twin.radius
        for _ in range(200):
            middle = (low + high) / 2
            beyond = twin.overlap(middle) > overlap
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        punch = 2 * twin.modulus * high
        damping = np.sqrt(10 / 3 * punch * self.mass) * damping_ratio(self.restitution)
        elastic = twin.force(high)
        push = Normal(elastic - damping * normal_velocity, elastic, punch, damping)
        return self.closed, push


class Yielding:
    """EEPA; a contact that opens forgets."""

    def __init__(self, twin):
        self.twin = twin
        self.plastic = self.start = np.zeros(len(twin.mass))

    def __call__(self, overlap, normal_velocity):
        closed, n = overlap > 0, self.twin.overlap_exponent
        depth = np.where(closed, overlap, 1e-3 * self.twin.radius_i)
        force, plastic, start = self.twin.step(depth, self.plastic, self.start)
        self.plastic, self.start = closed * plastic, closed * start
        elastic, damping = force + self.twin.pull_off, self.twin.drag(depth)
        punch = n * self.twin.first * depth ** (n - 1)
        return closed, Normal(elastic - damping * normal_velocity, elastic, punch, damping)


class Friction(NamedTuple):
    coefficient: float
    ratio: np.ndarray  # 4 G*/E*


class Resistance(NamedTuple):
    """Rolling: mu_r, and k_r/(2 E* a) (CDT) or k_r itself."""

    coefficient: np.ndarray
    spring: bool = False
    torsion: bool = False
    stiffness: np.ndarray | None = None
    damping: float = 0.0


class Twin:
    """Contacts of the bodies of ``pair`` under laws; ``friction`` and ``rolling`` may be None."""

    def __init__(self, pair: Pair, normal, friction=None, rolling=None):
        self.pair, self.normal, self.friction, self.rolling = pair, normal, friction, rolling
        n = len(pair.mass_i)
        wall = pair.wall
        self.radius = np.where(wall, pair.radius_i, 1 / (1 / pair.radius_i + 1 / pair.radius_j))
        turn_i, turn_j = self.turns()
        self.inertia = 1 / (turn_i + turn_j)
        self.spring, self.stiffness = np.zeros((n, 3)), np.zeros(n)
        self.rolled, self.winding = np.zeros((n, 3)), np.zeros(n)

    def turns(self):
        """1/I of i and of j."""
        pair = self.pair
        turn_i = 2.5 / pair.mass_i / pair.radius_i**2
        return turn_i, np.where(pair.wall, 0.0, 2.5 / pair.mass_j / pair.radius_j**2)

    def forces(self, motion, dt):
        """Force on i, torques on i and on j."""
        pair, wall = self.pair, self.pair.wall[:, None]
        apart = motion.x_i - motion.x_j
        distance = np.where(pair.wall, dot(apart, pair.facing)[:, 0], length(apart)[:, 0])
        normal = np.where(wall, pair.facing, _times(1 / distance, apart))
        overlap = pair.radius_i + np.where(pair.wall, 0.0, pair.radius_j) - distance
        velocity = motion.v_i - motion.v_j
        arm_i, arm_j = (r - overlap / 2 for r in (pair.radius_i, pair.radius_j))
        turning = _times(arm_i, motion.w_i) + _times(np.where(pair.wall, 0, arm_j), motion.w_j)
        w_j = np.where(wall, 0, motion.w_j)
        spin = dot(motion.w_i + w_j, normal)[:, 0] / 2
        normal_velocity = dot(velocity, normal)[:, 0]
        slip = velocity - _times(normal_velocity, normal) - np.cross(turning, normal)

        closed, push = self.normal(overlap, normal_velocity)
        force, couple = _times(push.total, normal), np.zeros_like(normal)
        if self.friction:
            stiffness = self.friction.ratio * push.stiffness
            limit = self.friction.coefficient * np.maximum(push.total, 0)
            rub = mindlin(
                *(self.spring, self.stiffness, normal, spin, slip, dt),
                *(stiffness, limit, push.damping),
            )
            self.spring, self.stiffness = _times(closed, rub.spring), closed * stiffness
            force, couple = force + rub.total, np.cross(normal, rub.total)
        torque = self.torque(closed, push, normal, spin, motion.w_i - w_j, dt)
        force, couple = _times(closed, force), _times(closed, couple)
        return force, torque - _times(arm_i, couple), -torque - _times(arm_j, couple)

    def torque(self, closed, push, normal, spin, relative, dt):
        """The rolling law's, on i."""
        if not self.rolling:
            return np.zeros_like(normal)
        law, radius = self.rolling, self.radius
        limit = law.coefficient * radius * np.maximum(push.elastic, 0)
        stiffness = law.stiffness
        if stiffness is None:
            stiffness = 9 / 4 * push.stiffness * law.coefficient**2 * radius
        dashpot = 2 * law.damping * np.sqrt(self.inertia * stiffness * radius)
        twin = Rolling(limit, stiffness, dashpot, radius, self.inertia, law.torsion)
        if not law.spring:
            step = np.full(len(radius), dt)
            if dt == 0:
                return np.zeros_like(normal)
            return _times(closed, twin.stop(relative, normal, step))
        if law.stiffness is None:  # displacement shrinks where the spring stiffens
            softer = np.minimum(self.winding / stiffness, 1)
            self.rolled = _times(np.sqrt(softer), self.rolled)
            self.winding = closed * stiffness
        along = dot(self.rolled, self.facing) if hasattr(self, "facing") else 0 * self.rolled[:, :1]
        plane = self.rolled - along * getattr(self, "facing", normal)
        turned = plane - dot(plane, normal) * normal + _times(spin * dt, np.cross(normal, plane))
        before, after = length(plane), length(turned)
        turned = turned * np.divide(before, after, out=np.zeros_like(after), where=after > 0)
        self.facing = normal
        torque, rolled = twin.spring(
            turned + along * normal, relative, normal, np.full(len(radius), dt)
        )
        self.rolled = _times(closed, rolled)
        return _times(closed, torque)

    def run(self, start: Motion, dt: float, steps: int) -> list[Motion]:
        """Velocity Verlet; forces see the velocities of the half step that leads to them."""
        pair = self.pair
        inverse_i, inverse_j = 1 / pair.mass_i, np.where(pair.wall, 0.0, 1 / pair.mass_j)
        turn_i, turn_j = self.turns()

        def kick(motion, force, torque_i, torque_j):
            return motion._replace(
                v_i=motion.v_i + _times(dt / 2 * inverse_i, force),
                v_j=motion.v_j - _times(dt / 2 * inverse_j, force),
                w_i=motion.w_i + _times(dt / 2 * turn_i, torque_i),
                w_j=motion.w_j + _times(dt / 2 * turn_j, torque_j),
            )

        acting, motion, path = self.forces(start, 0.0), start, [start]
        for _ in range(steps):
            half = kick(motion, *acting)
            moved = half._replace(x_i=half.x_i + dt * half.v_i, x_j=half.x_j + dt * half.v_j)
            acting = self.forces(moved, dt)
            motion = kick(moved, *acting)
            path.append(motion)
        return path


def sticking(work, modulus, radius, mass, restitution):
    """A normal law of ``Twin``: JKR."""
    return Sticking(JKR(np.full(len(mass), work), modulus, radius), mass, restitution)
