"""Multi-contact once more, in plain NumPy: Brodu's displacements from the vectors themselves, and
equilibria by iterating them.

A contact is a row of :class:`Contacts`; one with a wall has j = -1.
"""

from typing import NamedTuple

import numpy as np

GAMMA = 1.125
SWELLINGS = 12  # rounds to a radius that agrees with its forces


class Contacts(NamedTuple):
    """i, j (c,); normal from j to i (c, 3); overlap (c,)."""

    i: np.ndarray
    j: np.ndarray
    normal: np.ndarray
    overlap: np.ndarray


class Bodies(NamedTuple):
    """Equal material: radius (n,), E (Pa), nu, and planes as rows of (point, normal)."""

    radius: np.ndarray
    modulus: float
    nu: float
    planes: tuple = ()
    wall_modulus: float = np.inf


def contacts(position, bodies, reach):
    """All pairs nearer than ``reach``."""
    rows = []
    for i in range(len(position)):
        for j in range(i):
            apart = position[i] - position[j]
            distance = np.linalg.norm(apart)
            rows.append((i, j, apart / distance, bodies.radius[[i, j]].sum() - distance))
        for point, normal in bodies.planes:
            height = (position[i] - np.array(point)) @ normal
            rows.append((i, -1, np.array(normal, float), bodies.radius[i] - height))
    near = [row for row in rows if row[3] > -reach]
    return Contacts(*(np.array(column) for column in zip(*near, strict=True)))


def published(modulus, nu, loaded, inward, other, other_inward, least=0.0):
    """What 1 N at the point ``loaded``, along ``inward``, raises at ``other``."""
    way = other - loaded
    r = max(np.linalg.norm(way), least)
    u = way / r
    bracket = (
        (inward @ u) * (other_inward @ u)
        + (3 - 4 * nu) * (inward @ other_inward)
        - (1 - 2 * nu) * ((inward + u) @ other_inward) / (1 + inward @ u)
    )
    return -GAMMA * (1 + nu) / (2 * np.pi * modulus * r) * bracket


def reciprocal(modulus, nu, a, b, n_a, n_b, least=0.0):
    """The same between two contacts at the distances a and b from the centre, both put at the one
    whose inverse is the mean of theirs, and turned apart until they are ``least`` apart."""
    a = 2 / (1 / a + 1 / b)
    half = np.arcsin(np.clip(np.linalg.norm(n_a - n_b) / 2, 0, 1))
    half = max(half, np.arcsin(least / (2 * a)))
    n_a, n_b = np.cos(half), np.sin(half)
    n_a, n_b = np.array([n_a, n_b, 0]), np.array([n_a, -n_b, 0])
    return published(modulus, nu, -a * n_a, n_a, -a * n_b, n_b, least)


def influence(met, bodies, symmetric, swollen=0.0):
    """(c, c) of each body: what a force at one contact raises at another.  ``swollen`` (c,): what
    the later of two spheres has grown by."""
    size = len(met.i)
    total = np.zeros((len(bodies.radius), size, size))
    swollen = np.broadcast_to(swollen, size)
    least = np.sqrt(effective_radius(met, bodies) * np.maximum(met.overlap, 0))
    for sphere, radius in enumerate(bodies.radius):
        own = np.flatnonzero((met.i == sphere) | (met.j == sphere))
        inward = {c: met.normal[c] * (1 if met.i[c] == sphere else -1) for c in own}
        later = {c: sphere == max(met.i[c], met.j[c]) for c in own}
        moved = {c: (1 if later[c] else -1) * (met.j[c] >= 0) * swollen[c] for c in own}
        depth = {c: radius - met.overlap[c] / 2 + moved[c] / 2 for c in own}
        for c in own:
            for k in own[own != c]:
                cut, args = max(least[c], least[k]), (bodies.modulus, bodies.nu)
                if symmetric:
                    args += (depth[k], depth[c], inward[k], inward[c])
                    total[sphere, c, k] = reciprocal(*args, cut)
                else:
                    args += (-depth[k] * inward[k], inward[k], -depth[c] * inward[c], inward[c])
                    total[sphere, c, k] = published(*args, cut)
    return total


def effective_radius(met, bodies, swollen=0.0):
    other = np.where(met.j >= 0, bodies.radius[met.j], np.inf)
    later, pair = met.i > met.j, met.j >= 0
    return 1 / (
        1 / (bodies.radius[met.i] + swollen * (pair & later)) + 1 / (other + swollen * ~later)
    )


def hertz_stiffness(met, bodies, swollen=0.0):
    """K of F = K D^1.5."""
    sphere = (1 - bodies.nu**2) / bodies.modulus
    other = np.where(met.j >= 0, sphere, (1 - bodies.nu**2) / bodies.wall_modulus)
    return 4 / 3 / (sphere + other) * np.sqrt(effective_radius(met, bodies, swollen))


def equilibrium(met, bodies, symmetric=True, rounds=400):
    """Forces (c,), effective overlaps (c,) and M.  As LIGGGHTS has it (not ``symmetric``), the
    later of two spheres has a larger radius."""
    effective, swollen = met.overlap, 0.0
    later = np.maximum(met.i, met.j)
    for _ in range(1 if symmetric or rounds == 0 else SWELLINGS):
        of_each = influence(met, bodies, symmetric, swollen)
        raised, stiffness = of_each.sum(axis=0), hertz_stiffness(met, bodies, swollen)
        for _ in range(rounds):
            force = stiffness * np.maximum(effective, 0) ** 1.5
            effective = met.overlap + raised @ force
        if not symmetric and rounds:
            expansion = (of_each @ force)[later, np.arange(len(later))]
            swollen = np.where(met.j >= 0, expansion, 0.0)
    return stiffness * np.maximum(effective, 0) ** 1.5, effective, raised


def energy(position, bodies, reach):
    """sum U(D) - F e / 2."""
    met = contacts(position, bodies, reach)
    force, effective, raised = equilibrium(met, bodies)
    stored = 0.4 * force * np.maximum(effective, 0)
    return stored.sum() - 0.5 * force @ raised @ force


def forces_on_spheres(met, force, spheres):
    total = np.zeros((spheres, 3))
    np.add.at(total, met.i, force[:, None] * met.normal)
    pair = met.j >= 0
    np.add.at(total, met.j[pair], -force[pair, None] * met.normal[pair])
    return total
