"""Contact laws and velocity Verlet once more, in plain NumPy, from the papers alone.

Arrays run over contacts; vectors have shape (n, 3).  Conventions are those of the models: ``normal``
points from j to i, ``overlap`` > 0 touches, forces act on i, and a wall is a body of infinite mass
and radius.
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
        elastic - damping * normal_velocity, elastic, np.broadcast_to(stiffness, overlap.shape), damping
    )


def dot(a, b):
    return np.sum(a * b, axis=-1, keepdims=True)


def length(a):
    return np.sqrt(dot(a, a))


def mindlin(stored, stored_stiffness, normal, spin, slip, dt, stiffness, limit, dashpot):
    """Friction and what the spring remembers, both (n, 3).

    The stored force is laid into the present tangent plane and turned with the bodies about the
    normal at unchanged length; a contact that has softened gives back its share of it (Thornton
    et al. 2013); then dT = -k_t v_t dt (Mindlin 1949) and Coulomb's limit on spring and dashpot
    together.  ``slip`` (n, 3) is v_t, ``limit`` mu F_n, ``dashpot`` c_t; scalars are (n,).
    """
    spin, dt, stiffness, limit, dashpot, stored_stiffness = (
        np.broadcast_to(v, len(stored))[:, None]
        for v in (spin, dt, stiffness, limit, dashpot, stored_stiffness)
    )
    flat = stored - dot(stored, normal) * normal
    flat = flat + spin * dt * np.cross(normal, stored)
    before, after = length(stored), length(flat)
    loaded = after > 0
    direction = np.divide(flat, after, out=np.zeros_like(flat), where=loaded)
    softened = np.divide(
        stiffness, stored_stiffness, out=np.ones_like(stiffness), where=stored_stiffness > 0
    )
    spring = direction * before * np.minimum(softened, 1) - stiffness * dt * slip
    total = spring - dashpot * slip
    return _slide(spring, total, limit)
