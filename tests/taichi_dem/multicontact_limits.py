"""Soft spheres squeezed up to where their contacts find no equilibrium any more."""

import numpy as np

import taichi_dem as dem
from tests.taichi_dem.setups import rigid, scene

R, GAMMA = 5e-3, 1.125
SOFT = dem.Material("soft", 1000, 1e5, 0.5)


def walls_closing(speed, nu=0.5, **surface):
    """A sphere that just touches six rigid planes, which close in on it."""
    bead = dem.Material("soft", 1000, 1e5, nu)
    planes = [
        dem.Plane(-R * normal, tuple(normal), rigid(), velocity=tuple(speed * normal))
        for normal in np.vstack([np.eye(3), -np.eye(3)])
    ]
    law = dem.Law(dem.Hertz(1.0), surface=dem.MultiContact(**surface))
    return scene(np.zeros((1, 3)), R, bead, law=law, boundaries=planes), bead


def six_walls(bead, depth, rounds=4000):
    """Overlap D of each contact at ``depth`` (m): the pole opposite and four at right angles."""
    nu, a = bead.poissons_ratio, R - depth / 2
    sines = np.array([1.0] + 4 * [np.sqrt(0.5)])
    shape = 2 * (1 - nu) / sines + 2 * (1 - 2 * nu) - (7 - 8 * nu) * sines
    raised = -GAMMA * (1 + nu) / (4 * np.pi * bead.youngs_modulus * a) * shape.sum()
    stiffness = 4 / 3 * bead.youngs_modulus / (1 - nu**2) * np.sqrt(R)
    most = 4 / 27 / (raised * stiffness) ** 2  # of D - raised * stiffness D^1.5
    effective = depth
    for _ in range(rounds):
        effective = depth + raised * stiffness * effective**1.5
    return (effective if depth < most else np.nan), most, stiffness


def walls_limit(bead=SOFT):
    """Depth (m) of each of six walls in a sphere beyond which no forces fit."""
    limit = 0.1 * R
    for _ in range(50):
        limit = six_walls(bead, limit, 0)[1]
    return limit


def cubic_limit(deeper):
    """Depth on each side of a contact, over R, beyond which six of them find no equilibrium; those
    of spheres lie ``deeper``, at the end of that depth rather than in the middle."""
    limit = 0.1 * R
    for _ in range(50):
        limit = six_walls(SOFT, 2 * limit if deeper else limit, 0)[1]
    return limit / R


def cubic_packing(share, restitution=1.0, velocity=0.0, **surface):
    """Eight spheres of a simple cubic packing between rigid walls that stand where others would
    touch, and the depth (m) on each side of a contact: ``share`` of that of the limit.

    The walls' limit and that of spheres in place of walls (0.092 diameters) enclose that of a
    mixture of both; of them the one on the safe side is taken.
    """
    limit = sorted([cubic_limit(True), cubic_limit(False)])
    depth = R * share * (limit[0] if share < 1 else limit[1])
    half = 2 * (R - depth)
    place = (R - depth) * np.stack(np.meshgrid(*3 * [[-1, 1]]), axis=-1).reshape(-1, 3)
    law = dem.Law(dem.Hertz(restitution), surface=dem.MultiContact(**surface))
    walls = dem.Box((-half,) * 3, (half,) * 3, rigid())
    return scene(place, R, SOFT, velocity, law=law, boundaries=[walls]), depth
