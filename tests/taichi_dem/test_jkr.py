"""JKR: against its twin in terms of the contact radius, and against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from law_paths import Paths
from law_twins import JKR
from setups import GLASS, order_of
from twins import hertz

import taichi_dem as dem
from halfspace import backend
from taichi_dem.types import real, ti

N = 20_000


def log_uniform(rng, low, high, n=N):
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


@pytest.fixture(scope="module")
def twin():
    """From soft and sticky to hard and clean: a_m/R* from 1e-7 to 0.3, R* from 10 nm to 10 m."""
    rng = np.random.default_rng(1)
    radius, modulus = log_uniform(rng, 1e-8, 10), log_uniform(rng, 1e3, 1e12)
    least = radius * log_uniform(rng, 1e-7, 0.3)
    return JKR(8 * modulus * least**3 / (np.pi * radius**2), modulus, radius)


@pytest.fixture(scope="module")
def bench(twin):
    bench = Paths(dem.JKR, N)
    root = (np.pi * twin.work / (8 * twin.modulus)) ** (1 / 6)
    bench.fill(effective_modulus=twin.modulus, damping=0.0, root_radius=root)
    return bench


def pulled(bench, twin, overlap):
    """One evaluation at ``overlap`` of contacts that were pressed before."""
    path = np.stack([twin.radius * 0.1, overlap])
    return {name: values[1] for name, values in bench.run(path, twin.radius).items()}


@pytest.mark.parametrize("beyond", [1e-12, 1e-6, 1e-2, 0.5, 1, 3, 10, 1e3, 1e8])
def test_equals_its_twin_from_pull_off_to_deep_loads(bench, twin, beyond):
    """``beyond`` is a/a_m - 1.  An overlap wrong by 1e-14 of that at pull-off (or of its own
    terms) moves the force by its slope, which is infinite at pull-off; no more is allowed."""
    a = twin.least * (1 + beyond)
    found = pulled(bench, twin, twin.overlap(a))
    on = found["touching"] == 1
    assert on.all() or beyond < 1e-6
    most, pressed = 1.5 * np.pi * twin.work * twin.radius, a**2 / twin.radius
    unsure = 1e-14 * np.maximum(pressed, 3 * twin.least**2 / twin.radius)
    slack = np.minimum(np.abs(twin.tangent(a)) * unsure, 1e-6 * most)
    terms = 4 * twin.modulus * a**3 / (3 * twin.radius) + most
    assert np.all((np.abs(found["elastic"] - twin.force(a)) <= 1e-14 * terms + slack)[on])
    if beyond >= 1e-2:
        punch, digits = 2 * twin.modulus * a, 1e-14 * (1 + beyond**-3.0)
        assert np.all(np.abs(found["stiffness"] - twin.tangent(a)) <= punch * digits)
        sized = twin.modulus * a**5 / twin.radius**2 + np.pi * twin.work * a**2
        assert np.all(np.abs(found["energy"] - twin.energy(a)) <= 1e-13 * sized)


def numbers(twin, row):
    """The coefficients of one contact."""
    root = np.sqrt(twin.least[row]) / np.cbrt(twin.radius[row])
    return {"effective_modulus": twin.modulus[row], "root_radius": root}


def test_pull_off_under_load_and_under_displacement(bench, twin):
    """The largest pull is 3/2 pi W R*, at a^3 = 9 a_m^3, and 5/9 of it at the last overlap that is
    held, -3 a_m^2/R*; a_0 of seed 003, 36^(1/3) a_m, carries nothing."""
    most = 1.5 * np.pi * twin.work * twin.radius
    found = pulled(bench, twin, twin.overlap(9 ** (1 / 3) * twin.least))
    assert np.allclose(found["elastic"], -most, rtol=1e-13)
    last = -3 * twin.least**2 / twin.radius
    found = pulled(bench, twin, last * (1 - 1e-14))
    assert np.all(found["touching"] == 1)
    assert np.allclose(found["elastic"], -5 / 9 * most, rtol=1e-5)
    assert not pulled(bench, twin, last * (1 + 1e-14))["touching"].any()
    found = pulled(bench, twin, twin.overlap(twin.equilibrium))
    assert np.all(np.abs(found["elastic"]) <= 1e-13 * most)
    for row in range(0, N, 997):
        reach = dem.JKR.reach(numbers(twin, row), twin.radius[row])
        assert np.isclose(reach, -last[row], rtol=1e-13)


def test_no_contact_is_made_by_approach(bench, twin):
    """Apart, it stays apart down to zero overlap; it is made there, and then held past it."""
    last = 3 * twin.least**2 / twin.radius
    path = np.outer([-0.99, -0.5, -1e-9, 1e-9, -1e-9, -0.5, -0.99, -1.01, -0.5, 1e-9], last)
    touching = bench.run(path, twin.radius)["touching"]
    assert np.array_equal(touching.T, np.tile([0, 0, 0, 1, 1, 1, 1, 0, 0, 1], (N, 1)))


def test_largest_pull_is_the_most_along_a_slow_pull(bench, twin):
    """Pulled in finer and finer steps that miss it by half a step at worst, the largest pull met
    falls short of 3/2 pi W R* by the square of the step."""
    most = 1.5 * np.pi * twin.work * twin.radius
    top = twin.overlap(9 ** (1 / 3) * twin.least) / (3 * twin.least**2 / twin.radius)
    short = []
    for step in (0.08, 0.04, 0.02, 0.01):
        places = top + step * (np.arange(-4, 5)[:, None] + 0.5)
        path = np.vstack([np.ones(N), places[::-1]]) * 3 * twin.least**2 / twin.radius
        least = bench.run(path, twin.radius)["total"].min(axis=0)
        short.append((1 + least / most).max())
    assert np.allclose(order_of(short), 2, atol=0.1)


def test_force_is_the_slope_of_the_energy(bench, twin):
    """On the whole stable branch; central differences, so the error falls as the square."""
    for beyond in (0.3, 1, 10):
        a, errors = twin.least * (1 + beyond), []
        centre = twin.overlap(a)
        span = (centre + 3 * twin.least**2 / twin.radius) * np.array([[0.1], [0.05], [0.025]])
        for step in span:
            up, down = (pulled(bench, twin, centre + s * step)["energy"] for s in (1, -1))
            slope = (up - down) / (2 * step)
            errors.append(np.abs(slope - twin.force(a)) / (1.5 * np.pi * twin.work * twin.radius))
        assert np.allclose(order_of(np.median(errors, axis=1)), 2, atol=0.1)
        assert np.allclose(order_of(np.max(errors, axis=1)), 2, atol=0.1)


def test_opening_and_closing_lose_energy(bench, twin):
    """A contact is made below the energy of spheres apart and opens above it."""
    last = -3 * twin.least**2 / twin.radius
    path = np.stack([1e-9 * -last, last * (1 - 1e-9)])
    made, opened = bench.run(path, twin.radius)["energy"]
    scale = 16 / 3 * twin.modulus / twin.radius**2 * twin.least**5
    # t^4 (t^6/10 - t_m^3 t^3 + 3/2 t_m^6) at t^3 = 4 t_m^3 and t_m^3
    assert np.allclose(made, -0.9 * 4 ** (4 / 3) * scale, rtol=1e-6)
    assert np.allclose(opened, 0.6 * scale, rtol=1e-6)


def test_without_adhesion_it_is_the_hertz_law():
    rng = np.random.default_rng(2)
    radius, modulus = log_uniform(rng, 1e-8, 10), log_uniform(rng, 1e3, 1e12)
    overlap, mass = radius * log_uniform(rng, 1e-9, 0.5), 1e4 * radius**3
    velocity, e = rng.normal(size=N), rng.uniform(0.01, 1, N)
    bench = Paths(dem.JKR, N)
    damping = [dem.JKR(0.0, value).coefficients(GLASS, GLASS)["damping"] for value in e]
    bench.fill(effective_modulus=modulus, damping=damping, root_radius=0.0)
    found = bench.run(overlap[None], radius, velocity[None], mass)
    expected = hertz(overlap, velocity, modulus, e, radius, mass)
    scale = expected.elastic + expected.damping * np.abs(velocity)
    assert np.all(np.abs(found["total"][0] - expected.total) <= 1e-13 * scale)
    for name in ("elastic", "stiffness", "damping"):
        assert np.allclose(found[name][0], getattr(expected, name), rtol=1e-13, atol=0)
    assert not bench.run(-overlap[None], radius)["touching"].any()


def test_step_stiffness_bounds_every_tangent(bench, twin):
    for row in range(0, N, 997):
        a = twin.least[row] * np.array([4.0, 6, 10, 100])
        one = JKR(twin.work[row], twin.modulus[row], twin.radius[row])
        bound = [dem.JKR.stiffness(numbers(twin, row), one.radius, d) for d in one.overlap(a)]
        assert np.all(one.tangent(a) <= bound) and np.allclose(bound, 2 * one.modulus * a)


def test_bad_numbers_are_refused():
    with pytest.raises(dem.InputError, match="work_of_adhesion = -1"):
        dem.JKR(-1.0, 0.5)
    with pytest.raises(dem.InputError, match="restitution = 0"):
        dem.JKR(0.05, 0)


def contact_radius(twin, overlap):
    """a by bisection of the curve d(a) on its stable branch."""
    low = twin.least
    high = 8 * low + 4 * np.sqrt(twin.radius * np.maximum(overlap, 0))
    for _ in range(80):
        middle = 0.5 * (low + high)
        below = twin.overlap(middle) < overlap
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_paths_make_hold_and_open_contacts(bench, twin, seed):
    """Wandering overlaps around zero: whether there is a contact is a matter of the path, what it
    carries of the overlap alone."""
    rng = np.random.default_rng(seed)
    paths = rng.uniform(-1.5, 1, (20, N)) * 3 * twin.least**2 / twin.radius
    found = bench.run(paths, twin.radius)
    touching = np.zeros(N, dtype=bool)
    last = -3 * twin.least**2 / twin.radius
    for overlap, seen, force in zip(paths, found["touching"], found["elastic"], strict=True):
        touching = (overlap > 0) | (touching & (overlap > last))
        assert np.array_equal(touching, seen)
        far = touching & (overlap > 0.999 * last)  # where rounding is not magnified
        expected = twin.force(contact_radius(twin, overlap))
        most = 1.5 * np.pi * twin.work * twin.radius
        assert np.all(np.abs(force - expected)[far] <= 1e-11 * most[far])
        assert not force[~touching].any()


def test_units_do_not_matter(bench, twin):
    """The same contacts in other units of mass, length and time (of m, J/m2 and Pa)."""
    m, x, t = 2.0**7, 2.0**-12, 2.0**5
    overlap = twin.overlap(2 * twin.least)
    before = pulled(bench, twin, overlap)["elastic"]
    other = JKR(twin.work * m / t**2, twin.modulus * m / (x * t**2), twin.radius * x)
    root = (np.pi * other.work / (8 * other.modulus)) ** (1 / 6)
    changed = Paths(dem.JKR, N)
    changed.fill(effective_modulus=other.modulus, damping=0.0, root_radius=root)
    after = pulled(changed, other, overlap * x)["elastic"]
    most = 1.5 * np.pi * twin.work * twin.radius
    assert np.all(np.abs(after * t**2 / (m * x) - before) <= 1e-13 * most)


def test_a_sticky_sphere_is_caught_below_a_speed_and_rebounds_above():
    """e = 1: between touch and parting the energy of the contact rises by the two jumps,
    (0.9 4^(4/3) + 0.6) (16/3) E* a_m^5/R*^2, and m v^2/2 falls by as much, or has not as much."""
    rng = np.random.default_rng(7)
    radius, modulus = log_uniform(rng, 1e-6, 1, 200), log_uniform(rng, 1e4, 1e10, 200)
    least = radius * log_uniform(rng, 1e-4, 1e-2, 200)
    scale = 16 / 3 * modulus / radius**2 * least**5
    lost = (0.6 + 0.9 * 4 ** (4 / 3)) * scale
    mass = 1e4 * radius**3
    share = rng.choice([0.5, 0.9, 1.1, 2.0, 10.0], 200)
    speed = np.sqrt(2 * share * lost / mass)
    period = np.pi * np.sqrt(mass / (20 * modulus * least))
    bench = Paths(dem.JKR, 200)
    root = np.sqrt(least) / np.cbrt(radius)
    bench.fill(effective_modulus=modulus, damping=0.0, root_radius=root)
    rebounds = bench.collide(radius, mass, speed, period / 400, limit=4000)
    caught = share < 1
    assert np.all(np.isnan(rebounds[caught])) and np.all(rebounds[~caught] > 0)
    expected = np.sqrt(1 - 1 / share[~caught]) * speed[~caught]
    assert np.allclose(rebounds[~caught], expected, rtol=0.03)


def test_what_an_adhesive_law_says_of_itself():
    sticky, clean = dem.JKR(0.05, 1.0), dem.JKR(0.0, 1.0)
    assert sticky.adhesive and sticky.plastic and sticky.dissipates
    assert not clean.plastic and not clean.dissipates and dem.JKR(0.0, 0.9).dissipates


def in_long_double(product, least):
    """t of t^4 - 4 q t = p by Newton's method from above, where it falls to the root."""
    p, q = product.astype(np.longdouble), least.astype(np.longdouble)
    t = np.maximum(p, 0) ** 0.25 + np.cbrt(4 * q)
    for _ in range(60):
        slope = 4 * (t**3 - q)
        t = np.where(slope > 0, t - (t**4 - 4 * q * t - p) / np.where(slope > 0, slope, 1), t)
    return t


def test_the_contact_radius_is_right_to_rounding_on_the_whole_branch():
    """In p/t_m^4 from pull-off to far above, on both sides of 1, where another guess takes over.
    Below, an error of 1e-14 t_m^4 in p is allowed: from t_m, and what cancels in p + 3 t_m^4."""
    rng = np.random.default_rng(4)
    near = np.exp(rng.uniform(np.log(1e-12), 0, N // 4))
    ratio = np.concatenate([near - 3, rng.uniform(-3, 2, N // 4), log_uniform(rng, 0.1, 1e60)])
    root = log_uniform(rng, 1e-12, 1e3, len(ratio))  # t_m
    product, least = ratio * root**4, root**3
    backend.start()

    @ti.kernel
    def run(
        p: ti.types.ndarray(dtype=real, ndim=1),
        q: ti.types.ndarray(dtype=real, ndim=1),
        t: ti.types.ndarray(dtype=real, ndim=1),
    ):
        for i in range(p.shape[0]):
            t[i] = dem.JKR.root(p[i], q[i])

    found = np.empty_like(product)
    run(product, least, found)
    expected = in_long_double(product, least)
    rounding = 2 * np.finfo(float).eps * expected
    lost = np.where(ratio < 1, 1e-14 * root**4 / (4 * (expected**3 - least)), 0)
    assert np.all(np.abs(found - expected) <= rounding + lost)
