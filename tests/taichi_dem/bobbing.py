"""A smooth scene that the tests of studies and choices share."""

import numpy as np
from setups import law, scene

import taichi_dem as dem

STONE = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e5, poissons_ratio=0.45)
R = 5e-3


def bobbing(side=1):
    """Two spheres on soft ground, without losses; or so many pairs, and rows of them."""
    pair = np.array([[0, 0, 0.98], [2.3, 0, 0.985]])
    place = [pair + (4.6 * i, 2.3 * j, 0) for i in range(side) for j in range(2 * side - 1)]
    return scene(
        np.concatenate(place) * R,
        R,
        STONE,
        gravity=(0, 0, -9.81),
        law=law(),
        substrate=dem.Substrate(SOIL),
    )
