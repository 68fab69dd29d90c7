"""The equations of plane elasticity, solved anew for waves of load on a layer."""

import numpy as np

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
