"""Multi-contact on an elastic half-space once more, in plain NumPy: all equations at once, by
``scipy.optimize.root`` from its own differences.

The contacts are those of :mod:`multicontact_twin`, with the ground as its plane; what that raises
is added.
"""

import numpy as np
from multicontact_twin import SWELLINGS, effective_radius, influence
from scipy.optimize import root


def stiffness(met, bodies, soil, swollen=0.0):
    """K of F = K D^1.5; ``soil`` is the material of the ground."""
    bead = (1 - bodies.nu**2) / bodies.modulus
    ground = (1 - soil.poissons_ratio**2) / soil.youngs_modulus
    other = np.where(met.j >= 0, bead, ground)
    return 4 / 3 / (bead + other) * np.sqrt(effective_radius(met, bodies, swollen))


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
    (g,) and energy held there.  Not ``symmetric``: as LIGGGHTS has it."""
    swollen, later = 0.0, np.maximum(met.i, met.j)
    for _ in range(1 if symmetric else SWELLINGS):
        of_each = influence(met, bodies, symmetric, swollen)
        hertz = stiffness(met, bodies, soil, swollen)
        found = balance(met, bodies, position, soil, finite, of_each.sum(axis=0), hertz)
        expansion = (of_each @ found[0])[later, np.arange(len(later))]
        swollen = np.where(met.j >= 0, expansion, 0.0)
    return found


def balance(met, bodies, position, soil, finite, raised, hertz):
    """:func:`equilibrium` with what is ``raised`` by a force (c, c) and ``hertz``, K (c,)."""
    ground = np.flatnonzero(met.j < 0)
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
