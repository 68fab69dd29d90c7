"""Contact laws and velocity Verlet once more, in plain NumPy, from the papers alone.

Arrays run over contacts; vectors have shape (n, 3).  Conventions are those of the models:
``normal`` points from j to i, ``overlap`` > 0 touches, forces act on i, and a wall is a body of
infinite mass and radius.
"""

from typing import NamedTuple

import numpy as np


def composite_modulus(e1, nu1, e2, nu2):
    """1/E* = (1 - nu_1^2)/E_1 + (1 - nu_2^2)/E_2."""
    return 1 / ((1 - nu1**2) / e1 + (1 - nu2**2) / e2)


def composite_shear_modulus(e1, nu1, e2, nu2):
    """1/G* = (2 - nu_1)/G_1 + (2 - nu_2)/G_2, G = E / 2(1 + nu)."""
    g1, g2 = e1 / (2 * (1 + nu1)), e2 / (2 * (1 + nu2))
    return 1 / ((2 - nu1) / g1 + (2 - nu2) / g2)


def damping_ratio(restitution):
    """The share of critical damping at which a half swing leaves ``restitution`` of the speed:
    e = exp(-pi beta / sqrt(1 - beta^2))."""
    swing = -np.log(restitution) / np.pi
    return swing / np.sqrt(1 + swing**2)


class Normal(NamedTuple):
    total: np.ndarray
    elastic: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


def hertz(overlap, normal_velocity, modulus, restitution, radius, mass):
    """F = 4/3 E* sqrt(R*) d^1.5 (Johnson 4.23) less 2 sqrt(5/6) beta sqrt(k m*) v_n (Tsuji)."""
    elastic = 4 / 3 * modulus * np.sqrt(radius) * overlap**1.5
    stiffness = 1.5 * elastic / overlap
    damping = np.sqrt(10 / 3 * stiffness * mass) * damping_ratio(restitution)
    return Normal(elastic - damping * normal_velocity, elastic, stiffness, damping)


def hooke(overlap, normal_velocity, stiffness, restitution, mass):
    """F = k d - 2 beta sqrt(k m*) v_n (Cundall & Strack)."""
    damping = 2 * np.sqrt(stiffness * mass) * damping_ratio(restitution)
    elastic = stiffness * overlap
    return Normal(
        elastic - damping * normal_velocity,
        elastic,
        np.broadcast_to(stiffness, overlap.shape),
        damping,
    )


def dot(a, b):
    return np.sum(a * b, axis=-1, keepdims=True)


def length(a):
    return np.sqrt(dot(a, a))


def _times(scalar, vector):
    return np.asarray(scalar)[:, None] * vector


def _capped(force, limit):
    """``force`` no longer than ``limit``, its direction kept."""
    size = length(force)[:, 0]
    share = np.divide(limit, size, out=np.ones_like(size), where=size > limit)
    return _times(share, force)


class Friction(NamedTuple):
    total: np.ndarray
    spring: np.ndarray


def mindlin(stored, stored_stiffness, normal, spin, slip, dt, stiffness, limit, dashpot):
    """The force on i, and what the spring remembers of it, both (n, 3).

    The stored force is laid into the present tangent plane and turned with the bodies about the
    normal at unchanged length; a contact that has softened gives back its share of it (Thornton
    et al. 2013); then dT = -k_t v_t dt (Mindlin 1949), and Coulomb's limit on spring and dashpot
    together: beyond it the contact slides, and the spring keeps no more than the limit.  ``slip``
    (n, 3) is v_t, ``limit`` mu F_n, ``dashpot`` c_t; scalars are (n,).
    """
    turned = stored - dot(stored, normal) * normal + _times(spin * dt, np.cross(normal, stored))
    before, after = length(stored), length(turned)
    turned = turned * np.divide(before, after, out=np.zeros_like(after), where=after > 0)
    softened = np.divide(
        stiffness, stored_stiffness, out=np.ones_like(stiffness), where=stored_stiffness > stiffness
    )
    spring = _times(softened, turned) - _times(stiffness * dt, slip)
    total = spring - _times(dashpot, slip)
    slides = length(total) > np.asarray(limit)[:, None]
    return Friction(_capped(total, limit), np.where(slides, _capped(spring, limit), spring))


class Pair(NamedTuple):
    """n contacts of a sphere i with a body j each; (n,) and (n, 3) arrays.

    Where ``wall`` is True, j is a plane through x_j with the normal ``facing``, and its other
    properties do not matter.
    """

    radius_i: np.ndarray
    mass_i: np.ndarray
    radius_j: np.ndarray
    mass_j: np.ndarray
    wall: np.ndarray
    facing: np.ndarray


class Law(NamedTuple):
    """Hertz and Mindlin for each of n contacts, (n,)."""

    modulus: np.ndarray
    shear_modulus: np.ndarray
    restitution: np.ndarray
    friction: np.ndarray
    tangential_damping: float


class Motion(NamedTuple):
    """Positions, velocities and angular velocities of i and j, each (n, 3)."""

    x_i: np.ndarray
    v_i: np.ndarray
    w_i: np.ndarray
    x_j: np.ndarray
    v_j: np.ndarray
    w_j: np.ndarray


def contact_forces(pair, law, motion, spring, spring_stiffness, dt):
    """Force on i, torques on i and j, and the new memory of the contact."""
    apart = motion.x_i - motion.x_j
    distance = np.where(pair.wall, dot(apart, pair.facing)[:, 0], length(apart)[:, 0])
    normal = np.where(pair.wall[:, None], pair.facing, _times(1 / distance, apart))
    overlap = pair.radius_i + np.where(pair.wall, 0.0, pair.radius_j) - distance
    touching = overlap > 0
    depth = np.where(touching, overlap, pair.radius_i)
    arm_i, arm_j = (r - overlap / 2 for r in (pair.radius_i, pair.radius_j))
    radius = np.where(pair.wall, pair.radius_i, 1 / (1 / pair.radius_i + 1 / pair.radius_j))
    mass = np.where(pair.wall, pair.mass_i, 1 / (1 / pair.mass_i + 1 / pair.mass_j))

    # v - v_n n - (R_i w_i + R_j w_j) x n, a wall does not turn
    velocity = motion.v_i - motion.v_j
    turning = _times(arm_i, motion.w_i) + _times(np.where(pair.wall, 0, arm_j), motion.w_j)
    spin = dot(motion.w_i + np.where(pair.wall[:, None], 0, motion.w_j), normal)[:, 0] / 2
    normal_velocity = dot(velocity, normal)[:, 0]
    slip = velocity - _times(normal_velocity, normal) - np.cross(turning, normal)

    push = hertz(depth, normal_velocity, law.modulus, law.restitution, radius, mass)
    contact_radius = np.sqrt(radius * depth)
    rub = mindlin(
        spring,
        spring_stiffness,
        normal,
        spin,
        slip,
        dt,
        8 * law.shear_modulus * contact_radius,
        law.friction * np.maximum(push.total, 0),
        law.tangential_damping * push.damping,
    )
    force = _times(touching, _times(push.total, normal) + rub.total)
    couple = _times(touching, np.cross(normal, rub.total))
    memory = _times(touching, rub.spring), touching * 8 * law.shear_modulus * contact_radius
    return force, -_times(arm_i, couple), -_times(arm_j, couple), memory


def trajectory(pair, law, start, dt, steps):
    """Velocity Verlet from ``start``; the list of :class:`Motion` after each step.

    Forces see the velocities of the half step that leads to them.
    """
    inverse_i, inverse_j = 1 / pair.mass_i, np.where(pair.wall, 0.0, 1 / pair.mass_j)
    turn_i = 2.5 * inverse_i / pair.radius_i**2
    turn_j = np.where(pair.wall, 0.0, 2.5 * inverse_j / pair.radius_j**2)
    memory = np.zeros_like(start.x_i), np.zeros(len(start.x_i))

    def kick(motion, force, torque_i, torque_j):
        return motion._replace(
            v_i=motion.v_i + _times(dt / 2 * inverse_i, force),
            v_j=motion.v_j - _times(dt / 2 * inverse_j, force),
            w_i=motion.w_i + _times(dt / 2 * turn_i, torque_i),
            w_j=motion.w_j + _times(dt / 2 * turn_j, torque_j),
        )

    *acting, memory = contact_forces(pair, law, start, *memory, 0.0)
    motion, path = start, []
    for _ in range(steps):
        half = kick(motion, *acting)
        moved = half._replace(x_i=half.x_i + dt * half.v_i, x_j=half.x_j + dt * half.v_j)
        *acting, memory = contact_forces(pair, law, moved, *memory, dt)
        motion = kick(moved, *acting)
        path.append(motion)
    return path
