"""Impacts and rolling against closed forms: Chung & Ooi's tests 1-4, restitution, slip to roll."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from setups import EPS, GLASS, law, order_of, restart, rigid, scene, state, watch

import taichi_dem as dem
from halfspace import reference

FLOOR = dem.Plane((0, 0, 0), (0, 0, 1), rigid())


def material(name, sphere):
    return dem.Material(name, sphere.density, sphere.youngs_modulus, sphere.poissons_ratio)


# -- Chung & Ooi 1 and 2: elastic normal impacts ---------------------------------------------------

# overlap (m), force (N) and duration (s) to five digits, the duration with a factor of 2.943 for
# what is 2.9433 delta/v
TABLE = {
    "glass": (274.11e-6, 10.697e3, 40.336e-6),
    "limestone": (368.30e-6, 7.1082e3, 54.196e-6),
    "aluminium": (49.717e-6, 11.370e3, 731.59e-6),
    "magnesium": (52.123e-6, 7.2327e3, 766.99e-6),
}
HALF_A_DIGIT = 5e-5


@pytest.fixture(scope="module")
def normal_impacts():
    """Pairs of glass and of limestone, and aluminium and magnesium on the floor, in one scene."""
    spheres = [reference.GLASS, reference.LIMESTONE, reference.ALUMINIUM, reference.MAGNESIUM]
    kinds = [material(name, sphere) for name, sphere in zip(TABLE, spheres, strict=True)]
    r1, r2 = reference.GLASS.radius, reference.ALUMINIUM.radius
    half = reference.TEST_1_SPEED / 2
    setup = scene(
        [(0, 0, 1), (2 * r1, 0, 1), (0, 1, 1), (2 * r1, 1, 1), (2, 0, r2), (2, 1, r2)],
        [r1] * 4 + [r2] * 2,
        [kinds[k] for k in (0, 0, 1, 1, 2, 3)],
        [(half, 0, 0), (-half, 0, 0)] * 2 + [(0, 0, -reference.TEST_2_SPEED)] * 2,
        boundaries=[FLOOR],
        law=law(),
    )
    return dem.Simulation(setup)


def closed_form(name):
    sphere = getattr(reference, name.upper())
    pair = sphere.radius == reference.GLASS.radius
    return (reference.equal_spheres_impact if pair else reference.rigid_plane_impact)(sphere)


@pytest.mark.parametrize("name", TABLE)
def test_chung_ooi_elastic_impact(normal_impacts, name):
    """Tests 1 and 2.  With n steps per impact the largest sample is low by at most
    (5/32)(2.943/n)^2, and Verlet's own error is a fraction of that."""
    expected, row, n = closed_form(name), 2 * list(TABLE).index(name), 400
    published = np.array(TABLE[name]) * (1, 1, reference.HERTZ_DURATION / 2.943)
    assert np.allclose(expected, published, rtol=HALF_A_DIGIT, atol=0)
    sphere = min(row, row // 2 + 2)
    velocity = normal_impacts.scene.spheres.velocity
    sim = restart(normal_impacts, velocity=velocity, dt=expected.duration / n)

    def look(sim):
        position, force = sim.particles.position, sim.particles.force
        if sphere < 4:
            gap = np.linalg.norm(position[sphere] - position[sphere + 1]) - 0.02
            return -gap, abs(force[sphere, 0])
        return 0.1 - position[sphere, 2], force[sphere, 2]

    overlap, force = watch(sim, n + 4, 1, look).T
    coarse = 2 * 5 / 32 * (2.943 / n) ** 2
    assert overlap.max() == pytest.approx(expected.overlap, rel=coarse)
    assert force.max() == pytest.approx(expected.force, rel=1.5 * coarse)
    last = np.flatnonzero(overlap > 0)[-1]  # the spheres part at constant speed: interpolate
    parted = last + overlap[last] / (overlap[last] - overlap[last + 1])
    assert parted * sim.dt == pytest.approx(expected.duration, rel=coarse)


# -- Chung & Ooi 3: restitution out is restitution in ----------------------------------------------

RESTITUTION = np.array([0.01, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
SPEEDS = np.array([0.01, 0.1, 1.0])  # at 5e7 Pa: overlaps of 0.2, 1 and 7 % of R*
FIRST_ORDER = 0.25  # times steps per impact: a bound on the error of restitution, see below


def restitution_scene(size, modulus):
    """Pairs of unequal spheres for every restitution and speed, a unit of length ``size``, elastic
    waves as fast as the unit of time makes them."""
    kinds = [dem.Material(f"e = {e}", 2500, modulus, 0.22) for e in RESTITUTION]
    pairs = {
        (k.name, k.name): {"normal": dem.Hertz(e)} for k, e in zip(kinds, RESTITUTION, strict=True)
    }
    which, column = (v.ravel() for v in np.indices((len(kinds), len(SPEEDS))))
    speed = SPEEDS[column] * np.sqrt(modulus / 5e7)
    first = np.stack([column, which, 0 * which], axis=1) * 0.1 * size
    radius = np.repeat([0.01 * size, 0.006 * size], len(which))
    velocity = np.zeros((2 * len(which), 3))
    velocity[: len(which), 0] = speed
    second = first + [0.016 * size * (1 + 1e-13), 0, 0]  # apart: no rounding to an overlap
    setup = scene(
        np.vstack([first, second]),
        radius,
        (kinds, np.tile(which, 2)),
        velocity,
        law=law(pairs=pairs),
    )
    return setup, RESTITUTION[which], speed


def rebound(sim, restitution, speed, steps):
    """The restitution of each pair, from impacts of ``steps`` steps at each speed in turn."""
    spheres, n = sim.scene.spheres, len(speed)
    mass = 1 / (1 / spheres.mass[0] + 1 / spheres.mass[n])
    radius = 1 / (1 / spheres.radius[0] + 1 / spheres.radius[n])
    kind = spheres.materials[0]
    modulus = reference.composite_modulus(*[kind.youngs_modulus, kind.poissons_ratio] * 2)
    out = np.empty(n)
    for v in np.unique(speed):
        duration = reference.hertz_impact(mass, radius, modulus, v).duration
        restart(sim, velocity=spheres.velocity, dt=duration / steps)
        sim.run(steps=8 * steps)
        assert not len(sim.contacts())
        now = sim.particles.velocity[:, 0]
        out[speed == v] = ((now[n:] - now[:n]) / speed)[speed == v]
    return out


@pytest.fixture(scope="module")
def rebounds():
    """Restitutions out, by unit system and steps per impact."""
    found = {}
    for size, modulus in ((1, 5e7), (1e-6, 5e7), (1e3, 1e3)):
        setup, restitution, speed = restitution_scene(size, modulus)
        sim = dem.Simulation(setup)
        for steps in (100, 400):
            found[size, steps] = rebound(sim, restitution, speed, steps)
    return restitution, found


@pytest.mark.parametrize("steps", [100, 400])
def test_restitution_out_is_restitution_in(rebounds, steps):
    """Damping sees the velocity of the half step: first order, with a bound that does not depend
    on the step."""
    restitution, found = rebounds
    assert np.abs(found[1, steps] - restitution).max() < FIRST_ORDER / steps


def test_restitution_depends_on_neither_speed_nor_units(rebounds):
    found = rebounds[1]
    for steps in (100, 400):
        alike = found[1, steps].reshape(len(RESTITUTION), len(SPEEDS))
        assert np.ptp(alike, axis=1).max() < 1e-8
        for size in (1e-6, 1e3):  # nanometres and metres: the same impact but for rounding
            assert np.abs(found[size, steps] - found[1, steps]).max() < 1e-9


# -- orders of convergence -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kinds_of_impact():
    """One sphere per combination of damping and friction, oblique on the floor; error norms at
    steps per impact of 40, 80 ... 640, on the way in, on the way out and after."""
    names = {"smooth": (1, 0), "damped": (0.8, 0), "rubbing": (1, 0.3), "both": (0.8, 0.3)}
    kinds = [dem.Material(name, 2500, 5e7, 0.22) for name in names]
    pairs = {
        (name, "rigid"): {"normal": dem.Hertz(e), "tangential": dem.Mindlin(mu)}
        for name, (e, mu) in names.items()
    }
    radius, velocity = 0.01, np.array([0.5, 0, -1.0])
    place = [(0.1 * k, 0, radius) for k in range(4)]
    setup = scene(
        place, radius, kinds, velocity, boundaries=[FLOOR], law=law(1.0, 0.0, pairs=pairs)
    )
    sim = dem.Simulation(setup)
    mass, modulus = sim.particles.mass[0], reference.composite_modulus(5e7, 0.22, 1e30, 0.3)
    impact = reference.hertz_impact(mass, radius, modulus, 1.0)
    scale = np.repeat([1 / impact.overlap, 1.0, radius], 3)
    moments, ends = (0.3, 0.8, 1.5), []
    for steps in (40, 80, 160, 320, 640):
        ends.append([])
        restart(sim, velocity=velocity, dt=impact.duration / steps)
        for moment in moments:
            sim.run(steps=round(moment * steps) - sim.steps)
            ends[-1].append(state(sim) * scale)
    apart = np.linalg.norm(np.diff(ends, axis=0), axis=-1)
    return {name: apart[:, :, k] for k, name in enumerate(names)}


def test_verlet_is_of_second_order_in_a_smooth_impact(kinds_of_impact):
    assert np.allclose(order_of(kinds_of_impact["smooth"]), 2, atol=0.1)


@pytest.mark.parametrize("name", ["damped", "rubbing", "both"])
def test_damping_and_friction_are_of_first_order(kinds_of_impact, name):
    """The dashpot sees the velocity of the half step, and sliding begins and ends within a step:
    at least first order, on average over the place in the step where that happens.  (Measured over
    a factor of 8: damped 1.1 to 1.2, rubbing 1.5 to 1.8, both 0.96 to 1.2.)"""
    errors = kinds_of_impact[name]
    assert np.all(np.log2(errors[0] / errors[-1]) / (len(errors) - 1) > 0.9)


# -- Chung & Ooi 4: oblique impact in gross sliding ------------------------------------------------

ANGLES = np.radians([45, 55, 65, 75, 85])
SPEED, MU = 3.9, 0.092


def tail_of_damping(restitution):
    """The share by which the pushing part of a damped Hertz impact exceeds the whole impulse: near
    its end the dashpot pulls, without friction.  x'' = -x^1.5 - c x^0.25 x' in the units of Hertz.
    """
    logarithm = np.log(restitution)
    c = 2 * np.sqrt(5 / 6 * 1.5) * -logarithm / np.hypot(logarithm, np.pi)

    def force(x, v):
        x = max(x, 0.0)
        return x**1.5 - c * x**0.25 * v

    def motion(_, y):
        push = force(y[0], -y[1])
        return -y[1], push, max(push, 0.0)

    def parted(_, y):
        return y[0] if y[1] > 0 else 1.0

    parted.terminal = True
    end = solve_ivp(motion, (0, 50), (1e-12, -1.0, 0.0), events=parted, rtol=1e-9, atol=1e-12)
    return end.y[2, -1] / (1 + end.y[1, -1]) - 1


@pytest.fixture(scope="module")
def oblique():
    """Alumina spheres that hit the floor at every angle, restitution 0.98 and 0.5; results after
    impacts of 200 and 400 steps."""
    restitution = np.repeat([0.98, 0.5], len(ANGLES))
    angle = np.tile(ANGLES, 2)
    kinds = [material(f"alumina {e}", reference.ALUMINA) for e in (0.98, 0.5)]
    pairs = {
        (kind.name, "rigid"): {"normal": dem.Hertz(e)}
        for kind, e in zip(kinds, (0.98, 0.5), strict=True)
    }
    radius = reference.ALUMINA.radius
    place = np.stack([0.05 * np.arange(10), np.zeros(10), np.full(10, radius)], axis=1)
    velocity = SPEED * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
    setup = scene(
        place,
        radius,
        [kinds[k // len(ANGLES)] for k in range(10)],
        velocity,
        boundaries=[FLOOR],
        law=law(1.0, MU, pairs=pairs),
    )
    sim = dem.Simulation(setup)
    slowest = SPEED * np.cos(ANGLES[-1])
    duration = reference.rigid_plane_impact(reference.ALUMINA, slowest).duration
    after = {}
    for steps in (200, 400):
        restart(sim, velocity=velocity, dt=duration / steps)
        sim.run(steps=3 * steps)
        after[steps] = state(sim)
        assert not len(sim.contacts())
    return restitution, angle, velocity, after


def test_chung_ooi_oblique_impact_in_gross_sliding(oblique):
    """e_t = 1 - mu (1 + e)/tan(theta): the tangential impulse is mu times that of the normal
    forces that push, which the tail of the damping makes larger than the whole impulse (by 4e-5 at
    the published restitution of 0.98, 3 % at 0.5)."""
    restitution, angle, velocity, after = oblique
    radius = reference.ALUMINA.radius
    tail = np.array([tail_of_damping(e) for e in restitution])
    for steps, found in after.items():
        expected = reference.oblique_impact(angle, radius, SPEED, MU, restitution)
        loss = (1 - expected.tangential_restitution) * (1 + tail)
        error = np.abs((1 - found[:, 3] / velocity[:, 0]) / loss - 1)
        assert error.max() < FIRST_ORDER / steps
        assert np.abs(found[:, 3] / velocity[:, 0] - 1 + loss).max() < 0.2 * FIRST_ORDER / steps


def test_chung_ooi_spin_after_an_oblique_impact(oblique):
    """omega = (5/2R) mu (1 + e) v cos(theta), less what the arm R - overlap/2 takes off."""
    restitution, angle, _, after = oblique
    radius = reference.ALUMINA.radius
    tail = np.array([tail_of_damping(e) for e in restitution])
    expected = reference.oblique_impact(angle, radius, SPEED, MU, restitution).spin * (1 + tail)
    deepest = [
        reference.rigid_plane_impact(reference.ALUMINA, SPEED * np.cos(a)).overlap for a in angle
    ]
    shorter = 1 - after[400][:, 7] / expected
    assert np.all(shorter < np.divide(deepest, 2 * radius) + FIRST_ORDER / 400)
    assert np.all(shorter > 0.25 * np.divide(deepest, 2 * radius) - FIRST_ORDER / 400)
    assert np.allclose(after[400][:, [6, 8]], 0, atol=1e-9 * expected.min())


# -- sliding to rolling ----------------------------------------------------------------------------

DIRECTIONS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (-0.6, -0.8, 0)], dtype=float)
V0, GRAVITY, FRICTION = 0.1, 9.81, 0.3


@pytest.fixture(scope="module", params=["plane", "substrate"])
def resting(request):
    """Spheres at rest on the ground, far apart, at the overlap that carries them; and their arm."""
    ground = {"boundaries": [dem.Plane((0, 0, 0), (0, 0, 1), GLASS)]}
    if request.param == "substrate":
        ground = {"substrate": dem.Substrate(GLASS)}
    radius, apart = 0.01, 1000.0  # the substrate couples them by 1e-7 of their overlap
    mass = GLASS.density * 4 / 3 * np.pi * radius**3
    modulus = reference.composite_modulus(*[GLASS.youngs_modulus, GLASS.poissons_ratio] * 2)
    overlap = float(reference.hertz_overlap(mass * GRAVITY, radius, modulus))
    place = [(apart * k, 0, radius - overlap) for k in range(4)]
    setup = scene(place, radius, gravity=(0, 0, -GRAVITY), law=law(0.5, FRICTION), **ground)
    return dem.Simulation(setup), radius - overlap / 2, mass


def test_sliding_turns_into_rolling(resting):
    """5/7 of the speed after 2 v0/(7 mu g), in any direction; the arm is a little shorter than the
    radius, which the closed form for an arm b allows for: m b^2/(m b^2 + 2/5 m R^2)."""
    sim, arm, _ = resting
    radius = sim.particles.radius[0]
    share = arm**2 / (arm**2 + 0.4 * radius**2)
    speed, time = reference.slip_to_roll(V0, FRICTION, GRAVITY)
    assert share * V0 == pytest.approx(speed, rel=1 - arm / radius)
    time *= (1 - share) / (2 / 7)
    restart(sim, velocity=V0 * DIRECTIONS)
    seen, slips = [], []
    for moment in (0.3, 0.8, 6.0):
        sim.run(steps=round(moment * time / sim.dt) - sim.steps)
        now = sim.particles
        along = np.sum(now.velocity * DIRECTIONS, axis=1)
        turning = np.cross(now.omega, [0, 0, arm])
        slips.append(along - np.sum(turning * DIRECTIONS, axis=1))
        seen.append((sim.time, along))
        assert np.abs(now.velocity - along[:, None] * DIRECTIONS).max() < 1e-7 * V0
    (t1, _), (t2, v2), (_, end) = seen
    assert np.allclose(v2, V0 - FRICTION * GRAVITY * t2, rtol=1e-6)  # sliding: mu g, no less
    meet = t1 + (t2 - t1) * slips[0] / (slips[0] - slips[1])
    assert np.allclose(meet, time, rtol=1e-5)
    assert np.allclose(end, share * V0, rtol=1e-7)
    assert np.abs(slips[2]).max() < 1e-7 * V0


def test_rolling_without_slipping_has_no_tangential_velocity(resting):
    """v = omega x arm in every direction and with either sign: nothing rubs, nothing changes."""
    sim, arm, mass = resting
    omega = np.cross([0, 0, 1], DIRECTIONS) * V0 / arm
    restart(sim, velocity=V0 * DIRECTIONS, omega=omega)
    sim.run(steps=500)
    rubbed = np.linalg.norm(sim.contacts()["tangential_force"], axis=1)
    assert rubbed.max() < 1e-7 * FRICTION * mass * GRAVITY
    assert np.allclose(sim.particles.velocity, V0 * DIRECTIONS, rtol=0, atol=1e-8 * V0)
    assert np.allclose(sim.particles.omega, omega, rtol=0, atol=1e-8 * V0 / arm)

    restart(sim, velocity=V0 * DIRECTIONS, omega=-omega)  # the other sign rubs at once
    sim.run(steps=20)
    against = np.sum(sim.particles.force * DIRECTIONS, axis=1)
    assert np.allclose(against, -FRICTION * mass * GRAVITY, rtol=1e-4)


def test_equal_spheres_that_mesh_do_not_rub():
    """Two spheres that turn against each other like gears meet without sliding, whatever their
    speed; turning the same way they slow each other down by equal amounts."""
    radius, spin = 0.01, np.array([0.0, 20.0, 0.0])
    place = [(0, 0, 0), (0.02, 0, 0), (0, 1, 0), (0.02, 1, 0)]
    velocity = [(0.2, 0, 0), (-0.2, 0, 0)] * 2
    sim = dem.Simulation(
        scene(place, radius, GLASS, velocity, [spin, -spin, spin, spin], law=law(0.8, 0.5))
    )
    sim.run(steps=80)
    omega = sim.particles.omega
    assert not len(sim.contacts())
    assert np.abs(omega[:2] - [spin, -spin]).max() < 100 * EPS * spin[1]
    assert omega[2, 1] == pytest.approx(omega[3, 1], rel=1e-12) and 0 < omega[2, 1] < spin[1]
