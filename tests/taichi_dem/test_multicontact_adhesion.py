"""Multi-contact of spheres that stick: JKR and EEPA, alone and on an elastic substrate."""

import numpy as np
import pytest
from multicontact_twin import Bodies, contacts, effective_radius, influence
from scipy.optimize import brentq
from setups import order_of, restart, scene, watch
from test_multicontact import BEAD, STILL, TIGHT, R, cluster
from test_multicontact_ground import SOIL, on_ground, pile

import taichi_dem as dem

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:a contact with the substrate is wider"),
]

WORK = 0.05  # J/m2
MODULUS = BEAD.youngs_modulus / (1 - BEAD.poissons_ratio**2) / 2
STICKY = dem.JKR(work_of_adhesion=WORK, restitution=1.0)


def law(normal=STICKY, residual=1e-11, exchange="implicit"):
    return dem.Law(normal, surface=dem.MultiContact(residual=residual, exchange=exchange))


def jkr(radius, overlap):
    """Force of a contact that is made; from the contact radius."""

    def beyond(a):
        return a * a / radius - np.sqrt(2 * np.pi * WORK * a / MODULUS) - overlap

    least = (np.pi * WORK * radius**2 / (8 * MODULUS)) ** (1 / 3)
    a = brentq(beyond, least, 10 * radius, xtol=1e-18, rtol=1e-15)
    return 4 * MODULUS * a**3 / (3 * radius) - np.sqrt(8 * np.pi * WORK * MODULUS * a**3)


def test_forces_are_those_of_the_twin():
    """Some press and some pull, and each feels the others."""
    place, radius = cluster(np.random.default_rng(5), overlap=0.01)
    bodies = Bodies(radius, BEAD.youngs_modulus, BEAD.poissons_ratio)
    met = contacts(place, bodies, 0.01 * R)
    raised, curvature = influence(met, bodies, True).sum(axis=0), effective_radius(met, bodies)
    effective = met.overlap
    for _ in range(200):
        made = zip(curvature, effective, strict=True)
        force = np.array([jkr(r, d) if d > 0 else 0.0 for r, d in made])
        effective = met.overlap + raised @ force
    sim = dem.Simulation(scene(place, radius, BEAD, law=law(residual=TIGHT)), dt=STILL)
    sim.run(steps=4)
    rows = {frozenset((row["i"], row["j"])): row["normal_force"] for row in sim.contacts()}
    assert len(rows) == np.count_nonzero(effective > 0)
    for k, pair in enumerate(zip(met.i, met.j, strict=True)):
        if effective[k] > 0:
            assert rows[frozenset(pair)] == pytest.approx(force[k], abs=1e-10 * force.max())
    assert force.min() < -0.1 * force.max()


@pytest.mark.parametrize("ground", [False, True], ids=["alone", "on the ground"])
def test_what_neither_jumps_nor_opens_loses_nothing(ground):
    """Columns that swing, held past zero overlap: the loss is an error of second order."""
    place = np.array([(0, 0, 0.995), (0, 0, 2.99), (2.2, 0, 0.99), (2.2, 0, 2.985)]) * R
    velocity = np.outer([0, -0.01, 0, -0.02], (0, 0, 1.0))
    if ground:
        setup = on_ground(place=place, law=law())
    else:
        floor = dem.Plane((0, 0, 0), (0, 0, 1), SOIL)
        setup = scene(place, R, BEAD, law=law(), boundaries=[floor])
    sim = dem.Simulation(setup, dt=1e-5, driver="serial")
    lost, steps = [], 250
    for _ in range(3):
        restart(sim, velocity=velocity, dt=0.02 / steps)
        parts = watch(sim, steps, steps // 50, lambda sim: sim.energy()["dissipated"])
        lost.append(np.abs(parts - parts[0]).max())
        steps *= 2
    assert np.all(order_of(lost) > 1.9)
    assert lost[-1] < 1e-4 * sim.energy()["kinetic"]
    assert len(sim.contacts()) == 4 and np.abs(sim.contacts()["expansion"]).max() > 0


@pytest.mark.parametrize("exchange", ["implicit", "lagged"])
@pytest.mark.parametrize(
    "normal",
    [STICKY, dem.EEPA(1.0, 3.0, surface_energy=1.0)],
    ids=["JKR", "EEPA"],
)
def test_a_pile_that_is_torn_apart_only_loses_energy(normal, exchange):
    """Contacts jump, yield and open on ground that gives; the run goes through."""
    place, velocity = pile(overlap=0.02)
    setup = on_ground(place=place, law=law(normal, exchange=exchange))
    sim = dem.Simulation(setup, dt=2e-5, driver="serial")
    restart(sim, velocity=6 * velocity)
    before = len(sim.contacts())
    parts = watch(sim, 1500, 30, lambda sim: list(sim.energy().values()))
    names = list(sim.energy())
    lost, moving = (parts[:, names.index(name)] for name in ("dissipated", "kinetic"))
    assert len(sim.contacts()) < before / 2
    if exchange == "implicit":  # the other has no energy
        assert lost[-1] > 5e-4 * moving.max()
        assert np.diff(lost).min() > -1e-6 * moving.max()
        assert np.abs(parts[:, names.index("balance_error")]).max() < 1e-3 * moving.max()
