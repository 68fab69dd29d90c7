"""The equations of plane elasticity, solved anew for waves of load on a layer."""

import numpy as np

from halfspace.layers import symbol

NODES = 40


def wave_response(x, nu, base, load):
    """(u, w) at the surface of a layer with `q h = x`, in units of 1/(G q).

    The displacements are `u(z) sin`, along, and `w(z) cos` of the place times q, upward; `load` is
    the traction on the surface, (along, upward), in the same phases. From the equations of Lame,
    `u'' - (k+1) u - k w' = 0` and `(k+1) w'' - w + k u' = 0`, `k = 1/(1 - 2 nu)`, on Chebyshev's
    points in depth.
    """
    n = NODES
    z = np.cos(np.pi * np.arange(n + 1) / n)
    c = np.r_[2, np.ones(n - 1), 2] * (-1.0) ** np.arange(n + 1)
    d = np.outer(c, 1 / c) / (z[:, None] - z + np.eye(n + 1))
    d -= np.diag(d.sum(axis=1))
    d *= 2 / x  # heights from 0 (row 0) to -x (the last row)
    k, one, none = 1 / (1 - 2 * nu), np.eye(n + 1), np.zeros((n + 1, n + 1))
    lame = np.block([[d @ d - (k + 1) * one, -k * d], [k * d, (k + 1) * d @ d - one]])
    right = np.zeros(2 * n + 2)
    shear = np.block([d, -one])  # u' - w
    lame[0], right[0] = shear[0], load[0]
    lame[n + 1] = np.block([(k - 1) * one, (k + 1) * d])[0]
    right[n + 1] = load[1]
    lame[n] = shear[n] if base == "frictionless" else np.block([one, none])[n]
    lame[2 * n + 1] = np.block([none, one])[n]
    solution = np.linalg.solve(lame, right)
    return solution[0], solution[n + 1]


def sphere_on_a_layer(a, nu, base, radius=1.0):
    """(force/E', approach) of a rigid paraboloid of the contact radius a on a layer of unit depth.

    Sneddon's dual integral equations as one of the second kind: with the pressure's transform
    `p(q) = int_0^a phi(t) cos(q t) dt`,

        phi(t) + 2/pi int_0^a phi(s) int_0^inf (S(q) - 1) cos(q t) cos(q s) dq ds
            = E'/pi (delta - t^2/R),    phi(a) = 0,    F = 2 pi int_0^a phi dt.
    (N. N. Lebedev & Ia. S. Ufliand, PMM J. Appl. Math. Mech. 22, 442, 1958.)
    """
    node, weight = np.polynomial.legendre.leggauss(30)
    t, w = np.append(a * (node + 1) / 2, a), np.append(weight * a / 2, 0.0)
    deep, thick = np.polynomial.legendre.leggauss(200)
    q, strength = 12 * (deep + 1), 12 * thick
    waves = np.cos(t[:, None] * q)
    kernel = 2 / np.pi * (waves * (strength * (symbol(q, nu, base) - 1))) @ waves.T
    system = np.eye(len(t)) + kernel * w
    of_approach, of_shape = np.linalg.solve(system, np.stack([np.ones_like(t), -(t**2)], 1)).T
    approach = -of_shape[-1] / of_approach[-1] / radius
    phi = (approach * of_approach + of_shape / radius) / np.pi
    return 2 * np.pi * w @ phi, approach
