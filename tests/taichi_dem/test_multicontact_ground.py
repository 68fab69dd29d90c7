"""Multi-contact on an elastic substrate: spheres and ground that both rise, solved together."""

import numpy as np
import pytest
from multicontact_ground_twin import equilibrium
from multicontact_twin import Bodies, contacts
from setups import order_of, restart, scene, watch

import halfspace
import taichi_dem as dem
from halfspace import reference

pytestmark = pytest.mark.filterwarnings("ignore:a contact with the substrate is wider")

R = 5e-3
BEAD = dem.Material("bead", density=1000, youngs_modulus=1e5, poissons_ratio=0.3)
SOIL = dem.Material("soil", density=1000, youngs_modulus=8e4, poissons_ratio=0.45)
STILL = 1e-12  # s, a step in which nothing moves
TIGHT = 1e-13


def pile(seed=1, overlap=0.03):
    """Seven spheres on the ground and three above, pressed on each other: places and velocities."""
    rng = np.random.default_rng(seed)
    angle = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    angle = np.pi / 6 + np.arange(3) * 2 * np.pi / 3
    top = np.stack([np.cos(angle), np.sin(angle), np.sqrt(2) + 0 * angle], axis=1) / np.sqrt(3)
    place = 2 * R * (1 - overlap) * np.vstack([np.zeros(3), ring, top])
    place += 0.01 * R * rng.uniform(-1, 1, place.shape)
    place[:, 2] += 0.97 * R
    return place, 0.02 * rng.normal(size=place.shape)


def on_ground(surface=None, ground=None, place=None, soil=SOIL, normal=None, **rest):
    surface = dem.MultiContact(residual=1e-11) if surface is None else surface
    ground = {"residual": TIGHT, **(ground or {})}
    rest.setdefault("law", dem.Law(normal or dem.Hertz(1.0), surface=surface))
    place = pile()[0] if place is None else place
    return scene(place, R, BEAD, substrate=dem.Substrate(soil, **ground), **rest)


@pytest.fixture(scope="module")
def heap():
    """A pile on ground that gives by contacts of finite size, without friction or loss."""
    return dem.Simulation(on_ground(), dt=2e-5, driver="serial")


def assert_equal_to_the_twin(sim, place, finite=True, symmetric=True, close=1e-8):
    bodies = Bodies(np.full(len(place), R), BEAD.youngs_modulus, BEAD.poissons_ratio, GROUND)
    met = contacts(place, bodies, 0.01 * R)
    found = equilibrium(met, bodies, place, SOIL, finite, symmetric)
    force, effective, raised, sunk, held = found
    touches = effective > 0
    rows = {(row["i"], max(row["j"], -1)): row for row in sim.contacts()}
    expected = {frozenset(pair): k for k, pair in enumerate(zip(met.i, met.j, strict=True))}
    assert len(rows) == touches.sum()
    for pair, row in rows.items():
        k = expected[frozenset(pair)]
        assert row["normal_force"] == pytest.approx(force[k], abs=close * force.max())
        assert row["overlap"] == pytest.approx(effective[k], abs=close * effective.max())
    ground = met.j < 0
    assert np.count_nonzero(touches & ground) > 4 and np.count_nonzero(touches & ~ground) > 10
    kept = sim.substrate
    assert kept.expansion == pytest.approx(-sunk[kept.particle], abs=close * effective.max())
    stored = {"normal": 0.4 * force @ np.maximum(effective, 0), "substrate": held}
    stored["expansion"] = -0.5 * force @ raised @ force
    parts = sim.energy()
    for name, energy in stored.items():
        assert parts[name] == pytest.approx(energy, abs=10 * close * stored["normal"]), name
    assert abs(held) > 1e-3 * stored["normal"]
    assert abs(stored["expansion"]) > 1e-3 * stored["normal"]


GROUND = (((0, 0, 0), (0.0, 0.0, 1.0)),)


def test_forces_are_those_of_the_twin(heap):
    """Solved all at once from the published equations, by other means."""
    for seed in (1, 2):
        place = pile(seed)[0]
        restart(heap, place, dt=STILL)
        assert_equal_to_the_twin(heap, place)


def test_energy_is_conserved_to_the_order_of_the_scheme(heap):
    """A pile that falls apart and bounces on ground that gives, under its weight."""
    place, velocity = pile(overlap=0.02)
    largest, steps = [], 250
    for refined in range(3):
        restart(heap, place, velocity, dt=0.02 / steps)
        parts = watch(heap, steps, steps // 50, lambda sim: list(sim.energy().values()))
        names = list(heap.energy())
        largest.append(np.abs(parts[:, names.index("balance_error")]).max())
        steps *= 2
        assert refined < 2 or largest[-1] < 1e-3 * parts[:, names.index("normal")].max()
    assert np.all(order_of(largest) > 1.9)


def test_force_is_the_slope_of_the_energy(heap):
    """By central differences along random ways of all spheres."""
    place, step, rng = pile()[0], 1e-4 * R, np.random.default_rng(3)
    restart(heap, place)
    force = heap.particles.force - heap.particles.mass[:, None] * heap.scene.gravity
    for _ in range(2):
        way, held = rng.normal(size=place.shape), []
        for sign in (1, -1):
            restart(heap, place + sign * step * way)
            parts = heap.energy()
            held.append(parts["normal"] + parts["expansion"] + parts["substrate"])
        slope = (held[0] - held[1]) / (2 * step)
        assert -np.sum(force * way) == pytest.approx(slope, abs=1e-5 * np.abs(force * way).sum())


def test_spheres_that_are_pressed_only_by_the_ground_do_not_bulge(heap):
    """Without other contacts it is the coupled ground alone."""
    places = np.array([(2.4 * R * k, 0.3 * R * (k % 2)) for k in range(10)])
    height = R * (1 - 0.02 - 0.001 * np.arange(10))
    restart(heap, np.column_stack([places, height]))
    modulus = 1 / sum((1 - m.poissons_ratio**2) / m.youngs_modulus for m in (BEAD, SOIL))
    ground = halfspace.HalfSpace(SOIL.youngs_modulus, SOIL.poissons_ratio, coupling="finite")
    hertz = reference.hertz_law(R, modulus)
    exact = halfspace.solve(
        ground, places, R - height, hertz, residual=1e-13, radius=np.full(10, R), modulus=modulus
    )
    np.testing.assert_allclose(heap.substrate.force, exact.force, rtol=1e-9)
    assert heap.energy()["expansion"] == 0
