"""Multi-contact: forces against a twin, closed forms, limits, what opens and what is refused."""

import numpy as np
import pytest
from multicontact_twin import (
    Bodies,
    contacts,
    equilibrium,
    forces_on_spheres,
)
from setups import restart, rigid, scene

import taichi_dem as dem

R = 5e-3
BEAD = dem.Material("bead", density=1000, youngs_modulus=1e5, poissons_ratio=0.3)
TIGHT = 1e-13


def with_surface(surface, normal=None, tangential=None):
    return dem.Law(normal or dem.Hertz(1.0), tangential, surface=surface)


def cluster(rng, overlap=0.03):
    """A hexagon of spheres around one, and three above: each pressed on its neighbours."""
    angle = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    angle = np.pi / 6 + np.arange(3) * 2 * np.pi / 3
    top = np.stack([np.cos(angle), np.sin(angle), np.sqrt(2) + 0 * angle], axis=1) / np.sqrt(3)
    place = 2 * R * (1 - overlap) * np.vstack([np.zeros(3), ring, top])
    return place + 0.01 * R * rng.normal(size=place.shape), R * rng.uniform(0.98, 1.0, len(place))


TILT = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)
PLANES = (((0, 0, -0.95 * R), (0.0, 0.0, 1.0)), ((0, 0, -0.96 * R), tuple(TILT)))


@pytest.fixture(scope="module", params=["implicit", "lagged"])
def pressed(request):
    """A cluster on two planes that make a blunt wedge, so near to each other that the distance of
    contacts is cut off; the simulation, its twin's bodies, and a step too short for any motion."""
    position, radius = cluster(np.random.default_rng(5))
    wall = rigid()
    setup = scene(
        position,
        radius,
        BEAD,
        law=with_surface(dem.MultiContact(exchange=request.param, residual=TIGHT)),
        boundaries=[dem.Plane(*plane, wall) for plane in PLANES],
    )
    bodies = Bodies(radius, BEAD.youngs_modulus, BEAD.poissons_ratio, PLANES, 1e30)
    return dem.Simulation(setup, dt=1e-12, max_overlap=1), bodies, request.param == "implicit"


def test_forces_are_those_of_the_twin(pressed):
    sim, bodies, implicit = pressed
    restart(sim)
    sim.run(steps=1 if implicit else 60)
    met = contacts(sim.scene.spheres.position, bodies, 0.01 * R)
    force, effective, _ = equilibrium(met, bodies, implicit)
    found, touches = sim.contacts(), effective > 0
    plain = equilibrium(met, bodies, implicit, rounds=0)[0]
    assert len(found) == touches.sum() > 25
    key = [(i, j) for i, j in zip(met.i[touches], met.j[touches], strict=True)]
    by_pair = {}
    for (i, j), f, d in zip(key, force[touches], effective[touches], strict=True):
        by_pair.setdefault(frozenset((i, j)), []).append((f, d))
    mine = {}
    for row in found:
        j = row["j"] if row["j"] >= 0 else -1
        mine.setdefault(frozenset((row["i"], j)), []).append((row["normal_force"], row["overlap"]))
    assert mine.keys() == by_pair.keys()
    for pair, rows in by_pair.items():
        np.testing.assert_allclose(sorted(mine[pair]), sorted(rows), rtol=1e-9)
    assert np.abs(force - plain).max() > 0.03 * force.max()
    if not implicit:
        total = forces_on_spheres(met, force, len(bodies.radius))
        np.testing.assert_allclose(sim.particles.force, total, atol=1e-9 * force.max())
