"""EEPA: continuity, energy, restitution and units."""

import numpy as np
import pytest
from eepa_cases import (
    KINDS,
    N,
    bench_of,
    cycles,
    fill,
    plastic_of,
    random_contacts,
    random_paths,
    run,
    work_of,
)
from setups import order_of


@pytest.fixture(scope="module")
def benches():
    made = {}
    for name, (n, c, options) in KINDS.items():
        made[name] = bench_of(random_contacts(np.random.default_rng(0), n, c, options)[0])
    return made


# -- continuity, energy ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [name for name in KINDS if KINDS[name][1] >= 1])
def test_force_is_continuous_over_load_unload_reload_and_pull_off(benches, kind):
    """Whatever the path, no step of the force is longer than the steepest branch allows."""
    n, c, options = KINDS[kind]
    contacts, depth = random_contacts(np.random.default_rng(6), n, c, options)
    bench = fill(benches[kind], contacts)
    steepest = n * contacts.stiffness_ratio * contacts.first * (1.3 * depth) ** (n - 1)
    paths = cycles(contacts, depth, 200)
    change = np.abs(np.diff(run(bench, contacts, paths[:-1])["elastic"], axis=0))
    # the adhesive branch falls by at most c F_min/d_min, and d_min >= d_p,max/2
    plastic = np.maximum(plastic_of(contacts, 1.3 * depth), 1e-300)
    most = contacts.stiffness_ratio * contacts.first * plastic**n / 2
    steepest = np.maximum(steepest, (c * 2**c) * most / plastic)
    moved = np.abs(np.diff(paths[:-1], axis=0))
    touched = np.arange(len(change))[:, None] > 0
    assert np.all((change <= 1.001 * steepest * moved + 1e-12 * steepest * depth) | ~touched)


@pytest.mark.parametrize("kind", KINDS)
def test_a_closed_cycle_never_gives_energy(benches, kind):
    """And neither does any part of it: what was put in less what is stored only grows, up to the
    error of the trapezoidal rule, which falls as the square of the step."""
    worst = []
    for steps in (100, 200, 400):
        contacts, depth = random_contacts(np.random.default_rng(7), *KINDS[kind], count=N)
        paths = cycles(contacts, depth, steps)[:-1]
        found = run(fill(benches[kind], contacts), contacts, paths)
        lost = work_of(found["elastic"], paths) - (found["energy"][1:] - found["energy"][0])
        scale = contacts.stiffness_ratio * contacts.first * depth ** (KINDS[kind][0] + 1)
        worst.append(-np.minimum(np.diff(lost, axis=0), 0).sum(axis=0) / scale)
        assert np.all(lost[-1] > -1e-4 * scale)
        elastic = contacts.stiffness_ratio == 1
        assert np.all(np.abs(lost[-1][elastic]) < 1e-3 * scale[elastic])
    worst = np.max(worst, axis=1)
    assert worst[0] < 5e-3 and worst[1] < 0.4 * worst[0] and worst[2] < 0.4 * worst[1]


@pytest.mark.parametrize("kind", ["linear", "Hertzian", "any exponents"])
def test_force_is_the_slope_of_the_energy_and_stiffness_that_of_the_force(benches, kind):
    """On the reversible branch, k_2, and with F_0; central differences, second order."""
    contacts, depth = random_contacts(np.random.default_rng(8), *KINDS[kind])
    bench, plastic = fill(benches[kind], contacts), plastic_of(contacts, depth)
    place = 0.4 * plastic + 0.6 * depth
    force = run(bench, contacts, np.stack([depth, place]))
    slopes, bends = [], []
    for share in (0.2, 0.1, 0.05):
        step = share * (depth - place)
        up, down = (run(bench, contacts, np.stack([depth, place + s * step])) for s in (1, -1))
        moved = np.maximum(2 * step, 1e-300)
        scale = contacts.stiffness_ratio * contacts.first * depth ** KINDS[kind][0]
        slope = (up["energy"][1] - down["energy"][1]) / moved - force["elastic"][1]
        bend = (up["elastic"][1] - down["elastic"][1]) / moved - force["stiffness"][1]
        soft = contacts.stiffness_ratio < 50
        slopes.append((np.abs(slope) / scale)[soft].max())
        bends.append((np.abs(bend) / force["stiffness"][1])[soft].max())
    if KINDS[kind][0] == 1:
        assert max(slopes) < 1e-9 and max(bends) < 1e-9
    else:
        assert np.allclose(order_of(slopes), 2, atol=0.1)
        assert np.allclose(order_of(bends), 2, atol=0.1)


def test_stiffness_of_the_pull_is_its_slope(benches):
    contacts, depth = random_contacts(np.random.default_rng(8), *KINDS["Hertzian"])
    bench = fill(benches["Hertzian"], contacts)
    middle = 0.2 * plastic_of(contacts, depth)
    found = run(bench, contacts, np.stack([depth, 1.0001 * middle, middle, 0.9999 * middle]))
    on = (found["elastic"][2] < contacts.pull_off) & (found["stiffness"][2] < 0)
    slope = (found["elastic"][1] - found["elastic"][3]) / (2e-4 * np.maximum(middle, 1e-300))
    assert on.sum() > 100 and np.allclose(found["stiffness"][2][on], slope[on], rtol=1e-6)


# -- dashpot, units, numbers -----------------------------------------------------------------------


@pytest.mark.parametrize("n", [1.0, 1.5, 2.0])
def test_restitution_is_as_asked(n):
    """At any speed, of elastic spheres: the error of Verlet's half-step dashpot falls with dt."""
    rng = np.random.default_rng(10)
    contacts, depth = random_contacts(rng, n, 1.0, {}, count=200)
    contacts = contacts._replace(
        stiffness_ratio=np.ones(200), surface_energy=np.zeros(200), pull_off=np.zeros(200)
    )
    bench = bench_of(contacts)
    speed = np.sqrt(2 / (n + 1) * contacts.first * depth ** (n + 1) / contacts.mass)
    errors = []
    for steps in (200, 400, 800):
        dt = np.pi * depth / speed / steps
        out = bench.collide(contacts.radius, contacts.mass, speed, dt)
        errors.append(np.abs(out / speed - contacts.restitution).max())
    assert errors[-1] < 0.02 and np.all(np.array(errors[1:]) < 0.7 * np.array(errors[:-1]))


def test_plastic_restitution_is_as_the_areas_say():
    """e = 1, no adhesion: e_out^2 = energy given back / energy put in; d_ex = 1: 1/kappa_21."""
    contacts, depth = random_contacts(np.random.default_rng(11), 1.0, 1.0, {}, count=200)
    contacts = contacts._replace(
        restitution=np.ones(200),
        surface_energy=np.zeros(200),
        pull_off=np.zeros(200),
        stiffness_ratio=np.linspace(1, 50, 200),
    )
    given, back = contacts.loop(depth)
    assert np.allclose(back / given, 1 / contacts.stiffness_ratio, rtol=1e-12)
    speed = np.sqrt(2 * given / contacts.mass)
    errors = []
    for steps in (400, 800, 1600):
        dt = np.pi * depth / speed / steps
        out = bench_of(contacts).collide(contacts.radius, contacts.mass, speed, dt)
        errors.append(np.abs(out / speed - np.sqrt(back / given)).max())
    assert errors[-1] < 1e-3 and order_of(errors).min() > 0.9


@pytest.mark.parametrize("kind", ["linear", "Hertzian", "Hertzian, linear pull"])
def test_units_do_not_matter(benches, kind):
    """The same contacts in other units of mass, length and time (powers of two, so exact)."""
    rng = np.random.default_rng(12)
    contacts, depth = random_contacts(rng, *KINDS[kind])
    paths = random_paths(rng, depth)
    rate = np.sqrt(contacts.first * depth ** (KINDS[kind][0] - 1) / contacts.mass)
    velocities = rng.normal(size=paths.shape) * rate * depth
    m, x, t = 2.0**7, 2.0**-12, 2.0**5
    other = contacts._replace(
        modulus=contacts.modulus * m / (x * t**2),
        surface_energy=contacts.surface_energy * m / t**2,
        pull_off=contacts.pull_off * m * x / t**2,
        radius_i=contacts.radius_i * x,
        radius_j=contacts.radius_j * x,
        mass=contacts.mass * m,
    )
    before = run(fill(benches[kind], contacts), contacts, paths, velocities)["total"]
    after = run(fill(benches[kind], other), other, paths * x, velocities * x / t)["total"]
    scale = np.abs(before).max(axis=0)
    assert np.all(np.abs(after / (m * x / t**2) - before) <= 1e-11 * scale)
