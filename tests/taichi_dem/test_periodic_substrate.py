"""Spheres on an elastic half-space that repeats itself: each feels all images, also its own."""

import numpy as np
import pytest
from setups import law, order_of, restart, rigid, scene, state
from test_determinism import assert_same_bits, everything

import halfspace
import taichi_dem as dem
from halfspace import reference
from taichi_dem.snapshot import Snapshot

pytestmark = [
    pytest.mark.filterwarnings("ignore:a contact with the substrate is wider"),
    pytest.mark.filterwarnings("ignore:dt = "),
]

R, S, ROW = 1e-3, 2.5e-3, 3  # radius, spacing, spheres along each side
SIDES = np.array([ROW * S, ROW * S])
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e5, poissons_ratio=0.45)
STIFF = rigid()
LATTICE = np.stack(np.meshgrid(range(ROW), range(ROW)), axis=-1).reshape(-1, 2) * S


def ground(coupling, period):
    return halfspace.HalfSpace(
        SOIL.youngs_modulus, SOIL.poissons_ratio, coupling=coupling, period=tuple(period)
    )


def simulation(coupling="finite", exchange="implicit"):
    soil = dem.Substrate(SOIL, coupling=coupling, exchange=exchange, residual=1e-11)
    position = np.column_stack([LATTICE, np.full(len(LATTICE), 3 * R)])
    setup = scene(position, R, STIFF, law=law(), substrate=soil, period=tuple(SIDES))
    return dem.Simulation(setup, max_overlap=1)


@pytest.fixture(scope="module")
def sim():
    return simulation()


def jittered(seed):
    """Places near those of a lattice and overlaps, as random as spheres apart allow."""
    rng = np.random.default_rng(seed)
    places = LATTICE + rng.uniform(-0.15, 0.15, LATTICE.shape) * R
    return places, R * rng.uniform(0.02, 0.05, len(places))


def put(sim, places, overlap, **motion):
    return restart(sim, np.column_stack([places, R - overlap]), **motion)


def assert_equal_to_solve(sim, places, overlap, coupling="finite"):
    soil = ground(coupling, SIDES)
    hertz = reference.hertz_law(R, soil.modulus)
    right = halfspace.solve(soil, places, overlap, hertz, residual=1e-11)
    found = sim.substrate
    assert found.force == pytest.approx(right.force, rel=1e-8)
    assert found.expansion == pytest.approx(right.overlap - overlap, abs=1e-9 * R)
    assert found.slope == pytest.approx(right.slope, abs=1e-8)


def test_forces_are_those_of_the_coupled_solve(sim):
    """Wherever the spheres' own cells are."""
    places, overlap = jittered(1)
    cells = np.random.default_rng(2).integers(-5, 6, places.shape)
    put(sim, places + cells * SIDES, overlap)
    assert_equal_to_solve(sim, places, overlap)


def test_a_lattice_is_one_contact_and_its_images(sim):
    overlap = 0.04 * R
    put(sim, LATTICE - 0.3 * S, np.full(len(LATTICE), overlap))
    soil = ground("finite", (S, S))
    hertz = reference.hertz_law(R, soil.modulus)
    one = halfspace.solve(soil, np.zeros((1, 2)), [overlap], hertz, residual=1e-11)
    assert one.displacement[0] < -1e-3 * overlap  # images lift it: their mean is taken away
    assert sim.substrate.force == pytest.approx(np.full(len(LATTICE), one.force[0]), rel=1e-8)
    assert sim.substrate.slope == pytest.approx(0, abs=1e-9)


def bob(sim, places, overlap, steps, fraction):
    """Let spheres bob while they drift, for a ``fraction`` of a period of ``steps`` steps; returns
    the error of the energy balance, and the velocities at first."""
    soil, high = ground("finite", SIDES), 0.04 * R
    mass = STIFF.density * 4 / 3 * np.pi * R**3
    turn = 2 * np.pi * np.sqrt(mass / (2 * soil.modulus * np.sqrt(R * high)))
    velocity = np.zeros((len(places), 3))
    velocity[:, :2] = np.random.default_rng(3).normal(size=places.shape) * 0.1 * R / turn
    put(sim, places, overlap, velocity=velocity, dt=turn / steps)
    seen = []
    for _ in range(20):
        sim.run(steps=int(steps * fraction / 20))
        seen.append(sim.energy()["balance_error"])
    return np.abs(seen).max(), velocity


def test_energy_and_momentum_are_conserved(sim):
    places, overlap = jittered(4)
    mass, errors = sim.particles.mass, []
    for steps in (40, 80, 160):
        error, velocity = bob(sim, places, overlap, steps, 0.5)
        errors.append(error)
        before, now = velocity[:, :2], sim.particles.velocity[:, :2]
        lost = mass @ now - mass @ before
        assert np.abs(lost).max() < 1e-9 * (mass @ np.abs(now)).max()
        assert np.abs(now - before).max() > 1e4 * np.abs(lost / mass.sum()).max()
    assert order_of(errors) == pytest.approx(2, abs=0.05)


def test_a_shift_changes_nothing(sim):
    places, overlap = jittered(5)
    cells = np.random.default_rng(6).integers(-5, 6, places.shape)
    ends = []
    for shift in (0.0, 0.37 * SIDES, cells * SIDES):
        bob(sim, places + shift, overlap, 40, 1)
        end = state(sim)
        end[:, :2] -= shift
        ends.append(end)
    scale = np.abs(ends[0]).max(axis=0)[:6]
    for end in ends[1:]:
        assert np.abs(end - ends[0]).max(axis=0)[:6] / scale == pytest.approx(0, abs=1e-8)


def test_all_drivers_give_the_same_bits(sim, monkeypatch):
    """And so does starting again."""
    places, overlap = jittered(7)
    seen = []
    for driver in ("serial", "parallel", "team", "serial"):
        monkeypatch.setattr(sim._engine.pace, "driver", driver)
        bob(sim, places, overlap, 40, 1)
        seen.append(everything(sim))
    for found in seen[1:]:
        assert_same_bits(found, seen[0])


def test_spheres_that_fall_meet_the_ground(sim):
    """The host is asked from the first of them near it on, and not before."""
    places, _ = jittered(8)
    velocity = np.broadcast_to([0, 0, -0.1], (len(places), 3))
    put(sim, places, -np.linspace(0.5, 1.5, len(places)) * R, velocity=velocity, dt=2e-5)
    assert not sim._engine.exchange.hosted and len(sim.substrate.force) == 0
    sim.run(duration=0.8e-3 * 10)
    assert sim._engine.exchange.hosted and 0 < len(sim.substrate.force) < len(places)
    assert (sim.substrate.force > 0).all()


def test_pictures_show_one_cell(sim):
    """All spheres and contacts in it, and of its surface the mean depression, which is zero."""
    places, overlap = jittered(9)
    put(sim, places + np.random.default_rng(10).integers(-5, 6, places.shape) * SIDES, overlap)
    shown = Snapshot.of(sim, substrate_points=61)
    for where in (shown.position[:, :2], shown.substrate_position, shown.contact_position[:, :2]):
        assert ((where >= 0) & (where < SIDES)).all()
    assert shown.contact_ends()[:, 1, :2] == pytest.approx(shown.position[:, :2])
    assert [shown.grid_x[0], shown.grid_x[-1]] == pytest.approx([0, SIDES[0]], abs=1e-12)
    assert [shown.grid_y[0], shown.grid_y[-1]] == pytest.approx([0, SIDES[1]], abs=1e-12)
    mean = shown.depression[:-1, :-1].mean()
    assert abs(mean) < 1e-3 * shown.deepest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coupling", "exchange"), [("point", "implicit"), ("finite", "lagged"), ("point", "lagged")]
)
def test_other_couplings(coupling, exchange):
    """At rest what lags behind is solved too: the state is held while its forces settle."""
    sim = simulation(coupling, exchange)
    places, overlap = jittered(1)
    put(sim, places, overlap)
    if exchange == "lagged":
        sim.run(steps=40)  # of no length to speak of
    assert_equal_to_solve(sim, places, overlap, coupling)
