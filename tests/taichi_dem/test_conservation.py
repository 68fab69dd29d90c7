"""Momentum, angular momentum, energy: what must be kept is kept, what is lost is on the books."""

import numpy as np
import pytest
from setups import EPS, law, order_of, restart, scene, watch

import taichi_dem as dem
from halfspace import reference
from taichi_dem import ground
from taichi_dem.exchange import Exchange
from taichi_dem.types import ti, vec3

STONE = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e5, poissons_ratio=0.45)
HARD = dem.Material("hard", density=2500, youngs_modulus=5e9, poissons_ratio=0.2)
R, G = 5e-3, 9.81


def lattice(rng, counts, spacing, jitter):
    """Places of a box of spheres, (n, 3), in units of R, each moved by up to ``jitter``."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1)
    return (
        grid.reshape(-1, 3) * spacing + rng.uniform(-jitter, jitter, (grid[..., 0].size, 3))
    ) * R


# -- momentum --------------------------------------------------------------------------------------


def test_momentum_and_angular_momentum_are_kept_to_rounding():
    """A cloud of unequal spheres that falls together, rubs, spins and flies apart."""
    rng = np.random.default_rng(1)
    place = lattice(rng, (4, 4, 4), 2.3, 0.1)
    place -= place.mean(axis=0)
    radius = rng.uniform(0.3, 1.1, len(place)) * R
    setup = scene(
        place,
        radius,
        STONE,
        velocity=-60 * place + rng.normal(size=place.shape) * 0.2,
        omega=100 * rng.normal(size=place.shape),
        law=law(0.7, 0.5),
    )
    sim = dem.Simulation(setup)

    def momenta(sim):
        now = sim.particles
        p = now.mass[:, None] * now.velocity
        inertia = 0.4 * now.mass * now.radius**2
        spin = inertia[:, None] * now.omega
        return np.concatenate([p.sum(axis=0), (np.cross(now.position, p) + spin).sum(axis=0)])

    now = sim.particles
    p = now.mass * np.linalg.norm(now.velocity, axis=1)
    scale = np.repeat([p.sum(), (p * np.linalg.norm(now.position, axis=1)).sum()], 3)
    seen = watch(sim, 800, 20, lambda sim: [*momenta(sim), len(sim.contacts())])
    assert seen[:, 6].max() > len(place) / 2
    drift = np.abs(seen[:, :6] - seen[0, :6]) / scale
    assert drift.max() < 800 * EPS  # one rounding a step, were they all of one sign
    assert np.ptp(sim.particles.omega - setup.spheres.omega) > 10  # something did rub


# -- energy without losses -------------------------------------------------------------------------


@ti.data_oriented
class WithoutLateralForce(Exchange):
    """The control: contacts press straight up, as if their neighbours' dents had no slope."""

    @ti.func
    def lateral_force(self, i):
        return vec3(0.0)


def undamped_bed():
    """Spheres that bob on a soft substrate and wander over it without touching one another; the
    scene, their velocities, the period of a sphere and the work their weight can do."""
    rng = np.random.default_rng(2)
    place = lattice(rng, (5, 5, 1), 2.6, 0.05)
    mass = HARD.density * 4 / 3 * np.pi * R**3
    modulus = reference.composite_modulus(
        SOIL.youngs_modulus, SOIL.poissons_ratio, HARD.youngs_modulus, HARD.poissons_ratio
    )
    overlap = float(reference.hertz_overlap(mass * G, R, modulus))
    period = 2 * np.pi * np.sqrt(mass / (2 * modulus * np.sqrt(R * overlap)))
    place[:, 2] = R - overlap * rng.uniform(1.5, 2.5, len(place))
    velocity = np.zeros_like(place)
    velocity[:, :2] = 0.2 * R / (5 * period) * rng.uniform(-1, 1, (len(place), 2))
    setup = scene(
        place,
        R,
        HARD,
        gravity=(0, 0, -G),
        law=law(),
        substrate=dem.Substrate(SOIL, residual=1e-9),
    )
    return setup, velocity, period, len(place) * mass * G * overlap


def energy_deviations(kind, steps_per_period, monkeypatch):
    """Over five periods, relative to what the weight can do: the largest, and that at the end."""
    monkeypatch.setattr(ground, "Exchange", kind)
    setup, velocity, period, available = undamped_bed()
    sim, found = dem.Simulation(setup), []
    for n in steps_per_period:
        restart(sim, velocity=velocity, dt=period / n)
        error = watch(sim, 5 * n, n // 25, lambda sim: sim.energy()["balance_error"]) / available
        assert len(sim.substrate.force) == setup.spheres.count
        found.append((np.abs(error).max(), error[-1]))
    return np.array(found)


def test_half_the_step_quarters_the_energy_deviation(monkeypatch):
    """Velocity Verlet on the potential of the coupled system: second order (at 50 steps a period
    1.4e-3 of the available energy)."""
    largest = energy_deviations(Exchange, (50, 100, 200), monkeypatch)[:, 0]
    assert np.allclose(order_of(largest), 2, atol=0.02)
    assert largest[0] < 2.5e-3


def test_without_the_lateral_force_no_step_is_small_enough(monkeypatch):
    """The control: what is missing is work, and does not go away with the step."""
    _, (_, coarse), (_, fine) = energy_deviations(WithoutLateralForce, (50, 200, 400), monkeypatch)
    assert abs(fine) > 1e-4 and fine == pytest.approx(coarse, rel=0.3)


# -- energy with losses, and work from outside -----------------------------------------------------


@pytest.fixture(scope="module")
def losing_bed():
    """A bed with damping and friction in a box on a soft substrate: energies every millisecond of
    60, at three steps; and the simulation."""
    rng = np.random.default_rng(3)
    place = lattice(rng, (3, 3, 3), 2.3, 0.1) + np.array([1.5, 1.5, 1.2]) * R
    velocity = 0.1 * rng.normal(size=place.shape)
    omega = 30 * rng.normal(size=place.shape)
    side = 7.6 * R
    setup = scene(
        place,
        R * rng.uniform(0.8, 1, len(place)),
        STONE,
        velocity,
        omega,
        gravity=(0, 0, -G),
        law=law(0.6, 0.4),
        substrate=dem.Substrate(dem.Material("firm soil", 1000, 2e6, 0.45), residual=1e-9),
        boundaries=[dem.Box((0, 0, -np.inf), (side, side, np.inf), STONE)],
    )
    sim, seen = dem.Simulation(setup), {}
    for steps in (1500, 3000, 6000):
        restart(sim, velocity=velocity, omega=omega, dt=0.06 / steps)
        seen[steps] = watch(
            sim,
            steps,
            steps // 60,
            lambda sim: [sim.energy()[k] for k in ("balance_error", "dissipated", "kinetic")],
        )
    return sim, seen


def test_balance_error_converges_with_damping_and_friction(losing_bed):
    """By trapezoidal books: between first and second order where contacts open and close."""
    _, seen = losing_bed
    largest = [np.abs(found[:, 0]).max() for found in seen.values()]
    assert np.all(order_of(largest) > 1)
    lost = seen[1500][-1, 1]
    assert lost > 0.8 * seen[1500][0, 2]
    assert largest[0] < 5e-4 * lost


def test_dissipation_is_never_negative(losing_bed):
    _, seen = losing_bed
    for found in seen.values():
        assert found[0, 1] == 0
        assert np.diff(found[:, 1]).min() >= 0


@pytest.fixture(scope="module", params=["elastic", "rubbing"])
def pressed(request):
    """Spheres between a conveyor, a piston at constant speed, one with a program, one under load:
    the simulation after 40 ms at three steps, what was recorded on the way, and the load."""
    rng = np.random.default_rng(4)
    place = lattice(rng, (3, 3, 3), 2.1, 0.05) + np.array([1.2, 1.2, 1.1]) * R
    side, load, velocity = 6.6 * R, 0.5, 0.02 * rng.normal(size=place.shape)
    setup = scene(
        place,
        R * rng.uniform(0.9, 1, len(place)),
        STONE,
        gravity=(0, 0, -G),
        law=law() if request.param == "elastic" else law(0.6, 0.4),
        boundaries=[
            dem.Box((-np.inf, 0, -np.inf), (np.inf, side, np.inf), STONE),
            dem.Plane((0, 0, 0), (0, 0, 1), STONE, velocity=(0.03, 0.04, 0)),
            dem.Piston((0, 0, 0), (1, 0, 0), STONE, velocity=0.1),
            dem.Piston(
                (side, 0, 0),
                (-1, 0, 0),
                STONE,
                program=[(0.01, 0.001), (0.02, 0.001), (0.03, 0.0)],
            ),
            dem.Piston((0, 0, side), (0, 0, -1), STONE, load=load, mass=0.01),
        ],
    )
    sim, seen = dem.Simulation(setup), {}
    stroke = None
    for steps in (1000, 2000, 4000):
        restart(sim, velocity=velocity, dt=0.04 / steps)
        start = sim.boundaries[4].position[2]
        seen[steps] = watch(
            sim,
            steps,
            5,
            lambda sim: [
                sim.energy()["balance_error"],
                sim.energy()["external_work"],
                *(wall.force @ wall.velocity for wall in sim.boundaries[1:4]),
            ],
        )
        stroke = start - sim.boundaries[4].position[2]
    return sim, seen, load * stroke


def test_work_of_pistons_closes_the_balance(pressed):
    _, seen, _ = pressed
    largest = [np.abs(found[:, 0]).max() for found in seen.values()]
    assert np.allclose(order_of(largest), 2, atol=0.15)
    assert largest[0] < 5e-4 * seen[1000][-1, 1]


def test_external_work_is_force_times_travel(pressed):
    """The work on the books against the read-outs, summed by the trapezoidal rule over every fifth
    step; under load it is load times stroke."""
    sim, seen, load_work = pressed
    found = seen[4000]
    power = -found[:, 2:].sum(axis=1)
    work = np.sum((power[1:] + power[:-1]) / 2) * 5 * sim.dt
    assert found[-1, 1] == pytest.approx(work + load_work, rel=2e-3)


# -- forces ----------------------------------------------------------------------------------------


def assert_forces_add_up(sim):
    """The force and torque on every sphere are those of its contacts and its weight; what the
    spheres get from outside, the outside gets from them.  A dent's slope pushes along a normal that
    goes through the sphere's centre: without torque."""
    now, records, ground = sim.particles, sim.contacts(), sim.substrate
    i, j, second = records["i"], records["j"], records["j"] >= 0
    force = now.mass[:, None] * np.array(sim.scene.gravity)
    torque = np.zeros_like(force)
    np.add.at(force, i, records["force"])
    np.add.at(force, j[second], -records["force"][second])
    rubbing = records["force"].copy()
    if ground is not None:
        rubbing[j == -1, :2] += ground.force[:, None] * ground.slope
    across = np.cross(records["normal"], rubbing)
    np.add.at(torque, i, -(now.radius[i] - records["overlap"] / 2)[:, None] * across)
    arm = now.radius[j[second]] - records["overlap"][second] / 2
    np.add.at(torque, j[second], -arm[:, None] * across[second])
    size = np.abs(records["force"]).sum()
    assert np.abs(now.force - force).max() < 10 * EPS * size
    assert np.abs(now.torque - torque).max() < 10 * EPS * size * now.radius.max()

    outside = -records["force"][j == -1].sum(axis=0)
    outside = outside + sum(wall.force for wall in sim.boundaries)
    on_spheres = (now.force - now.mass[:, None] * np.array(sim.scene.gravity)).sum(axis=0)
    assert np.abs(outside + on_spheres).max() < 50 * EPS * size


def test_action_is_reaction_between_spheres_and_pistons(pressed):
    assert_forces_add_up(pressed[0])


def test_a_bed_at_rest_weighs_what_it_weighs(losing_bed):
    """Substrate and walls together carry the weight; through the ground the spheres pull on each
    other, and on nothing else."""
    sim, _ = losing_bed
    restart(sim, dt=6e-5)
    sim.run(steps=30000)
    weight = sim.particles.mass.sum() * G
    assert sim.energy()["kinetic"] < 1e-5 * weight * R  # some still roll
    ground = sim.substrate
    carried = sim.contacts()["force"][sim.contacts()["j"] == -1].sum(axis=0)
    up = carried[2] - sim.boundaries[0].force[2]
    assert up == pytest.approx(weight, rel=1e-4)
    assert ground.force.sum() == pytest.approx(carried[2], rel=1e-4)
    sideways = (ground.force[:, None] * ground.slope).sum(axis=0)
    assert np.abs(sideways).max() < 1e-12 * weight
    moment = ground.force[:, None] * np.stack([ground.slope[:, 1], -ground.slope[:, 0]], axis=1)
    turning = np.sum(ground.position * moment)
    assert abs(turning) < 1e-12 * weight * R
    assert_forces_add_up(sim)
