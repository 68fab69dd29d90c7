"""Contact laws against NumPy twins: term by term on random contacts, and over whole impacts."""

import numpy as np
import pytest
import twins
from setups import GLASS, order_of, rigid, scene

import taichi_dem as dem
from halfspace import backend, reference
from taichi_dem.contacts.contact import at_rest, meet
from taichi_dem.types import real, ti, vec3

CONTACTS = 20_000
CLOSE = 1e-12


def log_uniform(rng, low, high, n=CONTACTS):
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def unit_vectors(rng, n=CONTACTS):
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@ti.data_oriented
class Bench:
    """Laws over arrays of contacts, each contact with coefficients and a history of its own."""

    def __init__(self, normal, tangential=None, n=CONTACTS):
        backend.start()
        self.normal, self.tangential, self.n = normal, tangential, n
        self.k = ti.Struct.field(dict.fromkeys(normal.coefficient_names, real), shape=n)
        self.rubs = tangential is not None
        if self.rubs:
            self.k_t = ti.Struct.field(dict.fromkeys(tangential.coefficient_names, real), shape=n)
            self.history = ti.types.struct(**dict(tangential.history)).field(shape=n)

    def fill(self, table, **columns):
        for name, values in columns.items():
            getattr(table, name).from_numpy(np.ascontiguousarray(np.broadcast_to(values, self.n)))

    @ti.kernel
    def forces(
        self,
        normal: ti.types.ndarray(dtype=vec3, ndim=1),
        velocity: ti.types.ndarray(dtype=vec3, ndim=1),
        surface_spin: ti.types.ndarray(dtype=vec3, ndim=1),
        scalars: ti.types.ndarray(dtype=real, ndim=2),
        result: ti.types.ndarray(dtype=real, ndim=2),
        friction: ti.types.ndarray(dtype=vec3, ndim=1),
    ):
        """scalars: overlap, spin, R*, m*, time step; result: total, elastic, stiffness, damping."""
        for c in range(self.n):
            contact = meet(
                normal[c],
                scalars[c, 0],
                velocity[c],
                surface_spin[c],
                scalars[c, 1],
                scalars[c, 2],
                scalars[c, 3],
                scalars[c, 4],
            )
            push = self.normal.force(contact, self.k[c], 0)
            result[c, 0], result[c, 1] = push.total, push.elastic
            result[c, 2], result[c, 3] = push.stiffness, push.damping
            if ti.static(self.rubs):
                history = self.history[c]
                friction[c] = self.tangential.force(contact, push, self.k_t[c], history)
                self.history[c] = history

    @ti.kernel
    def energies(
        self,
        overlap: ti.types.ndarray(dtype=real, ndim=1),
        radius: ti.types.ndarray(dtype=real, ndim=1),
        result: ti.types.ndarray(dtype=real, ndim=2),
    ):
        """result: energy, elastic force."""
        for c in range(self.n):
            contact = at_rest(overlap[c], radius[c], 1.0)
            result[c, 0] = self.normal.energy(contact, self.k[c], 0)
            result[c, 1] = self.normal.force(contact, self.k[c], 0).elastic

    @ti.kernel
    def spring_energies(self, result: ti.types.ndarray(dtype=real, ndim=1)):
        for c in range(self.n):
            result[c] = self.tangential.energy(self.history[c])


@pytest.fixture(scope="module")
def contacts():
    """Random contacts over many decades of every quantity."""
    rng = np.random.default_rng(1)
    radius = log_uniform(rng, 1e-8, 10)
    return {
        "normal": unit_vectors(rng),
        "velocity": rng.normal(size=(CONTACTS, 3)) * log_uniform(rng, 1e-6, 1e2)[:, None],
        "surface_spin": rng.normal(size=(CONTACTS, 3)) * log_uniform(rng, 1e-6, 1e2)[:, None],
        "overlap": radius * log_uniform(rng, 1e-8, 0.5),
        "spin": rng.normal(size=CONTACTS) * log_uniform(rng, 1e-3, 1e3),
        "radius": radius,
        "mass": 1e4 * radius**3 * log_uniform(rng, 0.1, 10),
        "dt": log_uniform(rng, 1e-9, 1e-4),
        "modulus": log_uniform(rng, 1e3, 1e12),
        "restitution": rng.uniform(0.01, 1, CONTACTS),
        "spring": log_uniform(rng, 1, 1e8),
    }


def run(bench, c):
    scalars = np.stack([c[name] for name in ("overlap", "spin", "radius", "mass", "dt")], axis=1)
    result, friction = np.empty((bench.n, 4)), np.empty((bench.n, 3))
    bench.forces(c["normal"], c["velocity"], c["surface_spin"], scalars, result, friction)
    return result.T, friction


def coefficients(law, c):
    """The damping coefficients as the law itself computes them from each restitution."""
    kinds = [law(e) for e in c["restitution"]]
    return np.array([kind.coefficients(GLASS, GLASS)["damping"] for kind in kinds])


def normal_velocity(c):
    return np.sum(c["velocity"] * c["normal"], axis=1)


def assert_close(found, expected, scale=None):
    """Equal to ``CLOSE`` of ``scale``, the sum of the sizes of the terms that make the value."""
    scale = np.abs(expected) if scale is None else scale
    assert np.all(np.abs(found - expected) <= CLOSE * scale)


@pytest.fixture(scope="module")
def hertz_bench(contacts):
    bench = Bench(dem.Hertz, dem.Mindlin)
    damping = coefficients(dem.Hertz, contacts)
    bench.fill(bench.k, effective_modulus=contacts["modulus"], damping=damping)
    return bench


@pytest.fixture(scope="module")
def hooke_bench(contacts):
    bench = Bench(dem.Hooke)
    damping = coefficients(lambda e: dem.Hooke(1.0, e), contacts)
    bench.fill(bench.k, stiffness=contacts["spring"], damping=damping)
    return bench


def twin_of_hertz(c):
    speed = normal_velocity(c)
    names = ("modulus", "restitution", "radius", "mass")
    return twins.hertz(c["overlap"], speed, *(c[name] for name in names))


def assert_normal_forces(found, expected, c):
    drag = np.abs(expected.damping) * np.linalg.norm(c["velocity"], axis=1)
    assert_close(found[0], expected.total, expected.elastic + drag)
    for value, twin in zip(found[1:], expected[1:], strict=True):
        assert_close(value, twin)


def test_hertz_equals_its_twin(hertz_bench, contacts):
    assert_normal_forces(run(hertz_bench, contacts)[0], twin_of_hertz(contacts), contacts)


def test_hooke_equals_its_twin(hooke_bench, contacts):
    c = contacts
    twin = twins.hooke(c["overlap"], normal_velocity(c), c["spring"], c["restitution"], c["mass"])
    assert_normal_forces(run(hooke_bench, c)[0], twin, c)


@pytest.mark.parametrize("load", ["growing", "falling", "first touch"])
def test_mindlin_equals_its_twin(hertz_bench, contacts, load):
    """Stored forces up to 60 degrees out of the present tangent plane; some contacts stick, some
    slide, some have no friction at all."""
    c, rng = contacts, np.random.default_rng(2)
    push = twin_of_hertz(c)
    ratio, friction = rng.uniform(0.5, 2, CONTACTS), rng.choice([0, 0.1, 0.5, 10], CONTACTS)
    damping = rng.choice([0, 0.3, 1], CONTACTS)
    stiffness, limit = ratio * push.stiffness, friction * np.maximum(push.total, 0)
    before = stiffness * log_uniform(rng, *{"growing": (0.1, 1)}.get(load, (1, 10)))
    along = np.cross(unit_vectors(rng), c["normal"])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    along += c["normal"] * rng.uniform(-1.7, 1.7, (CONTACTS, 1))
    stored = along * (limit * rng.uniform(0, 2, CONTACTS))[:, None]
    if load == "first touch":
        stored, before = np.zeros((CONTACTS, 3)), np.zeros(CONTACTS)
    hertz_bench.fill(hertz_bench.k_t, stiffness_ratio=ratio, friction=friction, damping=damping)
    hertz_bench.history.tangential_force.from_numpy(stored)
    hertz_bench.history.tangential_stiffness.from_numpy(before)
    found = run(hertz_bench, c)[1]

    slip = c["velocity"] - normal_velocity(c)[:, None] * c["normal"]
    slip = slip - np.cross(c["surface_spin"], c["normal"])
    dashpot = damping * push.damping
    twin = twins.mindlin(
        stored, before, c["normal"], c["spin"], slip, c["dt"], stiffness, limit, dashpot
    )
    speed = np.linalg.norm(c["velocity"], axis=1) + np.linalg.norm(c["surface_spin"], axis=1)
    terms = np.linalg.norm(stored, axis=1) + (stiffness * c["dt"] + dashpot) * speed
    drag = friction * push.damping * speed  # the limit is a difference too
    scale = (2 * (terms + drag))[:, None]
    assert_close(found, twin.total, scale)
    assert_close(hertz_bench.history.tangential_force.to_numpy(), twin.spring, scale)
    assert_close(hertz_bench.history.tangential_stiffness.to_numpy(), stiffness)
    sliding = np.linalg.norm(twin.total, axis=1) > limit * (1 - 1e-9)
    assert 0.1 < sliding.mean() < 0.95


@pytest.mark.parametrize("name", ["hertz", "hooke"])
def test_normal_force_is_the_derivative_of_the_energy(name, contacts, request):
    """F = dU/d(overlap): the central difference comes nearer by the square of its width."""
    bench, c, found = request.getfixturevalue(f"{name}_bench"), contacts, np.empty((CONTACTS, 2))

    def energy(overlap):
        bench.energies(overlap, c["radius"], found)
        return found[:, 0].copy()

    energy(c["overlap"])
    force, shares, errors = found[:, 1].copy(), np.array([0.2, 0.1, 0.05]), []
    for share in shares:
        step = share * c["overlap"]
        slope = (energy(c["overlap"] + step) - energy(c["overlap"] - step)) / (2 * step)
        errors.append(np.abs(slope / force - 1).max())
    if name == "hooke":  # the energy is a parabola: the difference is exact
        assert max(errors) < 1e-13
    else:  # h^2 F''/(6 F), with F'' = (3/4) F/d^2
        assert np.allclose(errors, shares**2 / 8, rtol=0.01)
        assert np.allclose(order_of(errors), 2, atol=0.01)


def stick(bench, c, slip, dt):
    """One sticking step of ``slip`` (n, 3) in the plane of constant load; returns the friction."""
    still = dict(c, velocity=slip, dt=dt)
    still["surface_spin"] = np.zeros((CONTACTS, 3))
    return run(bench, still)[1]


def test_friction_stores_the_work_done_on_it(hertz_bench, contacts):
    """At constant load, without sliding, the spring's energy grows by the mean force times the
    slip: to rounding, since the spring is linear."""
    c, bench, rng = contacts, hertz_bench, np.random.default_rng(3)
    bench.fill(bench.k_t, stiffness_ratio=0.8, friction=1e9, damping=0.0)
    bench.history.fill(0)
    c = dict(c, spin=np.zeros(CONTACTS))
    speed = (c["overlap"] / c["dt"])[:, None]
    slips = [np.cross(unit_vectors(rng), c["normal"]) * speed for _ in range(5)]
    forces, energies, energy = [np.zeros((CONTACTS, 3))], [np.zeros(CONTACTS)], np.empty(CONTACTS)
    for slip in slips:
        forces.append(stick(bench, c, slip, c["dt"]))
        bench.spring_energies(energy)
        energies.append(energy.copy())
    for k, slip in enumerate(slips):
        mean = 0.5 * (forces[k] + forces[k + 1])
        work = -np.sum(mean * slip, axis=1) * c["dt"]
        assert_close(energies[k + 1] - energies[k], work, energies[k] + energies[k + 1])


def test_stored_friction_turns_with_the_contact(hertz_bench, contacts):
    """Spin about the normal turns the stored force by the angle, at unchanged length; the error of
    n equal turns falls as 1/n^2."""
    c, bench, rng = contacts, hertz_bench, np.random.default_rng(4)
    bench.fill(bench.k_t, stiffness_ratio=0.8, friction=1e9, damping=0.0)
    push = twin_of_hertz(c)
    start = np.cross(unit_vectors(rng), c["normal"]) * push.elastic[:, None]
    angle, still, errors = 0.5, np.zeros((CONTACTS, 3)), []
    exact = np.cos(angle) * start + np.sin(angle) * np.cross(c["normal"], start)
    size = np.linalg.norm(start, axis=1)
    for turns in (1, 2, 4, 8):
        bench.history.tangential_force.from_numpy(start)
        bench.history.tangential_stiffness.from_numpy(0.8 * push.stiffness)
        for _ in range(turns):
            stored = stick(bench, dict(c, spin=angle / turns / c["dt"]), still, c["dt"])
        assert_close(np.linalg.norm(stored, axis=1), size, size)
        errors.append((np.linalg.norm(stored - exact, axis=1) / size).max())
    assert np.allclose(order_of(errors), 2, atol=0.2)


# -- whole impacts ---------------------------------------------------------------------------------

RUBBER = dem.Material("rubber", density=1100, youngs_modulus=1e6, poissons_ratio=0.49)
RESTITUTION, FRICTION, PAIRS = 0.7, 0.4, 24


@pytest.fixture(scope="module")
def impacts():
    """Spheres of unequal size and material that hit each other or a tilted wall, spinning."""
    rng = np.random.default_rng(5)
    n = PAIRS
    facing = np.array([0.6, 0.0, 0.8])
    wall = np.arange(n) % 2 == 0
    kinds = [GLASS, RUBBER]
    kind_i, kind_j = rng.integers(0, 2, (2, n))
    radius_i, radius_j = rng.uniform(2e-3, 4e-3, (2, n))
    density = np.array([kind.density for kind in kinds])
    mass_i, mass_j = (
        density[kind] * 4 / 3 * np.pi * radius**3
        for kind, radius in ((kind_i, radius_i), (kind_j, radius_j))
    )
    # places apart along the wall; pairs float above it
    along, across = np.array([0.8, 0.0, -0.6]), np.array([0.0, 1.0, 0.0])
    place = (np.arange(n) % 5 * 0.02)[:, None] * along + (np.arange(n) // 5 * 0.02)[
        :, None
    ] * across
    normal = np.where(wall[:, None], facing, unit_vectors(rng, n))
    x_j = place + np.where(wall[:, None], 0.0, 0.02 * facing)
    gap = radius_i + np.where(wall, 0.0, radius_j)
    start = twins.Motion(
        x_i=x_j + gap[:, None] * normal * 1.0001,
        v_i=-0.5 * normal + 0.5 * rng.normal(size=(n, 3)),
        w_i=200 * rng.normal(size=(n, 3)),
        x_j=x_j,
        v_j=np.where(wall[:, None], 0.0, 0.1 * rng.normal(size=(n, 3))),
        w_j=np.where(wall[:, None], 0.0, 200 * rng.normal(size=(n, 3))),
    )
    body = [(kind.youngs_modulus, kind.poissons_ratio) for kind in (*kinds, rigid())]
    second = np.where(wall, 2, kind_j)
    moduli = [(*body[a], *body[b]) for a, b in zip(kind_i, second, strict=True)]
    law = twins.Law(
        modulus=np.array([twins.composite_modulus(*m) for m in moduli]),
        shear_modulus=np.array([twins.composite_shear_modulus(*m) for m in moduli]),
        restitution=np.full(n, RESTITUTION),
        friction=np.full(n, FRICTION),
        tangential_damping=0.5,
    )
    pair = twins.Pair(radius_i, mass_i, radius_j, mass_j, wall, facing)
    spheres = [~wall, kinds, kind_i, kind_j]
    return pair, law, start, spheres


def test_whole_impacts_equal_their_twin(impacts):
    """Positions to 1e-13 of a radius after every step, through touching, sliding, sticking and
    parting."""
    pair, law, start, (free, kinds, kind_i, kind_j) = impacts
    setup = scene(
        np.vstack([start.x_i, start.x_j[free]]),
        np.concatenate([pair.radius_i, pair.radius_j[free]]),
        (kinds, np.concatenate([kind_i, kind_j[free]])),
        np.vstack([start.v_i, start.v_j[free]]),
        np.vstack([start.w_i, start.w_j[free]]),
        boundaries=[dem.Plane((0, 0, 0), pair.facing, rigid())],
        law=dem.Law(dem.Hertz(RESTITUTION), dem.Mindlin(FRICTION, law.tangential_damping)),
    )
    sim = dem.Simulation(setup)
    steps = int(1.2e-3 / sim.dt)
    speed, spin = 3.0, 600.0
    for motion in twins.trajectory(pair, law, start, sim.dt, steps):
        sim.run(steps=1)
        now = sim.particles
        for values, twin_i, twin_j, scale in (
            (now.position, motion.x_i, motion.x_j, pair.radius_i.min()),
            (now.velocity, motion.v_i, motion.v_j, speed),
            (now.omega, motion.w_i, motion.w_j, spin),
        ):
            twin = np.vstack([twin_i, twin_j[free]])
            assert np.abs(values - twin).max() < 1e-13 * scale
    hit = (motion.v_i != start.v_i).any(axis=1)
    assert hit.mean() > 0.7 and len(sim.contacts()) < 0.3 * hit.sum()


def test_cattaneo_mindlin_bounds_what_a_spring_can_do(hertz_bench, contacts):
    """At constant load our spring starts with the exact stiffness 8 G* a and ends at the exact
    limit mu P.  In between the exact contact slips from its edge inwards; the spring does not, so
    it is too stiff: it reaches the limit at 2/3 of the exact displacement, where its force is too
    large by 3^-1.5 of the limit, the most there is."""
    c, bench, friction, shares = contacts, hertz_bench, 0.3, 12
    modulus, shear_modulus = c["modulus"], 0.4 * c["modulus"]
    ratio = 4 * shear_modulus / modulus
    bench.fill(bench.k_t, stiffness_ratio=ratio, friction=friction, damping=0.0)
    bench.history.fill(0)
    a = np.sqrt(c["radius"] * c["overlap"])
    limit = friction * 4 / 3 * modulus * a**3 / c["radius"]
    full_slip = 3 * limit / (16 * a * shear_modulus)
    along = np.cross(unit_vectors(np.random.default_rng(6)), c["normal"])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    still, second = dict(c, spin=np.zeros(CONTACTS)), np.ones(CONTACTS)
    for step in range(1, shares + 1):
        slip = along * (full_slip / shares)[:, None]
        force = np.linalg.norm(stick(bench, still, slip, second), axis=1)
        displacement = step / shares * full_slip
        assert_close(force, np.minimum(8 * shear_modulus * a * displacement, limit))
        exact = limit * (1 - (1 - step / shares) ** 1.5)
        inner = reference.stick_radius(a, exact, limit / friction, friction)
        assert np.allclose(displacement, full_slip * (1 - (inner / a) ** 2), rtol=1e-12)
        excess = (force - exact) / limit
        assert np.all((excess > -1e-12) & (excess <= 3**-1.5 + 1e-12))
        if 3 * step == 2 * shares:
            assert np.allclose(excess, 3**-1.5, rtol=1e-12)
