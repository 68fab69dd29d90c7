"""Multi-contact on an elastic half-space once more, in plain NumPy: all equations at once, by
``scipy.optimize.root`` from its own differences.

The contacts are those of :mod:`multicontact_twin`, with the ground as its plane; what that raises
is added.
"""

import numpy as np
from multicontact_twin import influence
from scipy.optimize import root


def stiffness(met, bodies, soil):
    """K of F = K D^1.5; ``soil`` is the material of the ground."""
    bead = (1 - bodies.nu**2) / bodies.modulus
    ground = (1 - soil.poissons_ratio**2) / soil.youngs_modulus
    other = np.where(met.j >= 0, bead, ground)
    partner = np.where(met.j >= 0, bodies.radius[met.j], np.inf)
    return 4 / 3 / (bead + other) / np.sqrt(1 / bodies.radius[met.i] + 1 / partner)


def of_surface(place, force, square, soil):
    """Of contacts at ``place`` (k, 2) with squared radii ``square`` (k,): displacement (k,), slope
    of the potential (k, 2) and the energy."""
    unit = (1 - soil.poissons_ratio**2) / (np.pi * soil.youngs_modulus)
    apart = place[:, None] - place
    r = np.linalg.norm(apart, axis=2)
    np.fill_diagonal(r, np.inf)
    mine, other = square[:, None], square[None]
    sunk = unit * (1 / r + (other / 10 + mine / 6) / r**3) @ force
    fall = unit * force * (-1 / r**3 - 3 * (mine + other) / (10 * r**5))
    potential = unit * (1 / r + (mine + other) / (10 * r**3))
    return sunk, np.einsum("jk,jkx->jx", fall, apart), 0.5 * force @ potential @ force


def equilibrium(met, bodies, position, soil, finite, symmetric=True):
    """Forces (c,), effective overlaps (c,), M, and what the ground does: displacement with its tilt
    (g,) and energy held there."""
    ground = np.flatnonzero(met.j < 0)
    raised, hertz = influence(met, bodies, symmetric).sum(axis=0), stiffness(met, bodies, soil)
    spheres = met.i[ground]
    home, radius = position[spheres, :2], bodies.radius[spheres]
    softness = bodies.radius[spheres] / hertz[ground] * np.sqrt(radius)  # R / (4/3 E*)

    def all_of(unknown):
        effective = unknown[: len(met.i)] * R
        shift = unknown[len(met.i) :].reshape(-1, 2) * R
        force = hertz * np.maximum(effective, 0) ** 1.5
        square = np.cbrt(softness * force[ground]) ** 2 * finite
        place = home + shift
        sunk, fall, energy = of_surface(place, force[ground], square, soil)
        sunk = sunk + (shift**2).sum(axis=1) / (2 * radius)
        return effective, force, shift, sunk, fall, energy

    def wrong(unknown):
        effective, force, shift, sunk, fall, _ = all_of(unknown)
        reached = met.overlap + raised @ force
        reached[ground] -= sunk
        tilted = shift + finite * radius[:, None] * fall
        return np.concatenate([(effective - reached) / R, tilted.ravel() / R])

    R = bodies.radius.max()
    start = np.concatenate([met.overlap / R, np.zeros(2 * len(ground))])
    found = root(wrong, start, method="hybr", options={"xtol": 1e-14})
    assert np.abs(wrong(found.x)).max() < 1e-13
    effective, force, shift, sunk, _, energy = all_of(found.x)
    held = force[ground] @ (sunk - (shift**2).sum(axis=1) / (2 * radius)) - energy
    return force, effective, raised, sunk, held
