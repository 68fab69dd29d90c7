"""EEPA: against its twin over random load paths, closed forms, restitution and symmetries."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from law_paths import Paths
from law_twins import EEPA
from setups import GLASS, order_of

import taichi_dem as dem

N, TURNS, PER_TURN = 1000, 8, 9
KINDS = {  # d_ex, c_ex, options
    "linear": (1.0, 1.0, {}),
    "Hertzian": (1.5, 1.5, {}),
    "Hertzian, linear pull": (1.5, 1.0, {}),
    "constant dashpot": (1.5, 3.0, {"damping": "constant"}),
    "any exponents": (1.3, 0.7, {}),
    "no pull at all": (1.5, 1.0, {"limit_force": True}),
}
COMMON = settings(
    deadline=None,
    derandomize=True,
    database=None,
    max_examples=3,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def log_uniform(rng, low, high, n=N):
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def random_contacts(rng, n, c, options, count=N):
    """Contacts of every size, hardness and stickiness: 3/2 pi gamma a from far below the limit on
    F_min to far above; a third elastic, a third without adhesion, a third on walls."""
    some = {"n": count}
    radius_i = log_uniform(rng, 1e-8, 10, **some)
    radius_j = np.where(
        rng.random(count) < 1 / 3, np.inf, radius_i * log_uniform(rng, 0.05, 20, **some)
    )
    depth = radius_i * np.minimum(1, radius_j / radius_i) * log_uniform(rng, 1e-6, 0.05, **some)
    ratio = np.where(rng.random(count) < 1 / 3, 1.0, log_uniform(rng, 1.01, 1e3, **some))
    sticks = (rng.random(count) < 2 / 3) * (not options.get("limit_force", False))
    one = EEPA(
        modulus=log_uniform(rng, 1e3, 1e12, **some),
        restitution=rng.uniform(0.01, 1, count),
        stiffness_ratio=ratio,
        surface_energy=np.zeros(count),
        pull_off=np.zeros(count),
        radius_i=radius_i,
        radius_j=radius_j,
        mass=1e4 * radius_i**3,
        overlap_exponent=n,
        adhesion_exponent=c,
        **options,
    )
    force = one.first * depth**n
    energy = sticks * force * log_uniform(rng, 1e-3, 1e2, **some) / one.chord(depth)
    pull_off = -1.0 * sticks * (rng.random(count) < 0.5) * force * rng.random(count)
    return one._replace(surface_energy=energy, pull_off=pull_off), depth


def bench_of(contacts):
    """The kernel for the exponents and options of ``contacts``, filled with their numbers."""
    options = {name: getattr(contacts, name) for name in dem.EEPA.options}
    law = dem.EEPA(0.5, 2.0, **options)
    return fill(Paths(law, len(contacts.modulus)), contacts)


def fill(bench, contacts):
    linear = contacts.overlap_exponent == 1
    laws = [
        dem.EEPA(e, 2.0, **{n: getattr(contacts, n) for n in dem.EEPA.options})
        for e in contacts.restitution
    ]
    bench.fill(
        modulus=contacts.modulus * (2 if linear else 4 / 3),
        stiffness_ratio=contacts.stiffness_ratio,
        damping=[law.coefficients(GLASS, GLASS)["damping"] for law in laws],
        surface_energy=contacts.surface_energy,
        pull_off=contacts.pull_off,
    )
    return bench


def run(bench, contacts, overlaps, velocities=0.0):
    reach = np.where(np.isinf(contacts.radius_j), 0, 1 / (contacts.radius_i + contacts.radius_j))
    return bench.run(overlaps, contacts.radius, velocities, contacts.mass, reach)


def random_paths(rng, depth, per_turn=PER_TURN, turns=TURNS):
    """Overlaps that wander between random turning points, also apart, over many scales."""
    ends = rng.uniform(-0.2, 1, (turns, len(depth))) * 10.0 ** -rng.choice(
        [0, 0, 0, 1, 2], (turns, len(depth))
    )
    ends = np.vstack([np.full(len(depth), -0.01), ends, np.full(len(depth), -0.01)]) * depth
    share = np.linspace(0, 1, per_turn, endpoint=False)[:, None]
    parts = [low + (high - low) * share for low, high in pairwise(ends)]
    return np.vstack([*parts, ends[-1:]])


@pytest.fixture(scope="module")
def benches():
    made = {}
    for name, (n, c, options) in KINDS.items():
        made[name] = bench_of(random_contacts(np.random.default_rng(0), n, c, options)[0])
    return made


@pytest.mark.parametrize("kind", KINDS)
@COMMON
@given(seed=st.integers(0, 2**32 - 1))
def test_equals_its_twin_along_random_paths(benches, kind, seed):
    """Elastic and total force at each of 80 overlaps, to rounding."""
    rng = np.random.default_rng(seed)
    contacts, depth = random_contacts(rng, *KINDS[kind])
    paths = random_paths(rng, depth)
    velocities = rng.normal(size=paths.shape) * np.sqrt(
        contacts.first * depth ** (KINDS[kind][0] + 1) / contacts.mass
    )
    found = run(fill(benches[kind], contacts), contacts, paths, velocities)
    elastic, total = contacts.path(paths, velocities)
    scale = contacts.stiffness_ratio * contacts.first * depth ** KINDS[kind][0]
    assert np.all(
        np.abs(found["elastic"] - contacts.pull_off * found["touching"] - elastic) < 1e-13 * scale
    )
    sized = scale + np.abs(found["damping"] * velocities)
    assert np.all(np.abs(found["total"] - total) < 1e-13 * sized)
    assert np.array_equal(found["touching"], paths > 0)


# -- closed forms ----------------------------------------------------------------------------------


def plastic_of(contacts, depth):
    """d_p,max after a load to ``depth``."""
    return (1 - 1 / contacts.stiffness_ratio) ** (1 / contacts.overlap_exponent) * depth


def cycles(contacts, depth, steps, low=None, high=None):
    """Load to ``depth``, unload to ``low``, reload to ``high``, and pull off; (4 steps + 1, n).

    Turning points apart from ``depth`` are drawn at random; overlaps lie closer near them.
    """
    rng = np.random.default_rng(9)
    low = rng.uniform(0.02, 0.95, len(depth)) if low is None else low
    high = np.maximum(low, rng.uniform(0, 1.3, len(depth))) if high is None else high
    zero, one = np.zeros(len(depth)), np.ones(len(depth))
    ends = np.stack([1e-12 * one, one, low, high, zero]) * depth
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(steps) / steps)[:, None]
    parts = [start + (end - start) * share for start, end in pairwise(ends)]
    return np.vstack([*parts, ends[-1:]])


def work_of(force, overlaps):
    """Cumulative work put in, by the trapezoidal rule."""
    return np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(overlaps, axis=0), axis=0)


@pytest.mark.parametrize("n", [1.0, 1.5])
def test_loop_without_adhesion_has_its_closed_form(n):
    """k_1 d^n up, k_2 (d^n - d_p^n) down, nothing below d_p; the area is what it dissipates."""
    contacts, depth = random_contacts(np.random.default_rng(3), n, 1.0, {})
    contacts = contacts._replace(surface_energy=np.zeros(N), pull_off=np.zeros(N))
    bench, plastic, errors = bench_of(contacts), plastic_of(contacts, depth), []
    load = contacts.first * depth**n
    for share in (0.3, 1.0):
        up = run(bench, contacts, np.outer([0.5, 1], share * depth))["elastic"][1]
        assert np.allclose(up, contacts.first * (share * depth) ** n, rtol=1e-12)
    for share in (0.2, 0.9):
        middle = plastic + share * (depth - plastic)
        down = run(bench, contacts, np.stack([depth, middle]))["elastic"][1]
        expected = contacts.stiffness_ratio * contacts.first * (middle**n - plastic**n)
        assert np.allclose(down, expected, rtol=1e-9, atol=1e-13 * load.min())
    assert not run(bench, contacts, np.stack([depth, 0.99 * plastic]))["elastic"][1].any()
    given, back = contacts.loop(depth)
    for steps in (100, 200, 400):
        up = np.linspace(1e-12, 1, steps)[:, None] * depth
        down = plastic + np.linspace(1, 0, steps)[:, None] * (depth - plastic)
        paths = np.vstack([up, down])
        area = work_of(run(bench, contacts, paths)["elastic"], paths)[-1]
        errors.append((np.abs(area - (given - back)) / given).max())
    if n == 1:  # the rule is exact
        assert max(errors) < 1e-12
    else:
        assert np.allclose(order_of(errors), 2, atol=0.2)


@pytest.mark.parametrize("wall", [False, True])
@pytest.mark.parametrize("n", [1.0, 1.5])
def test_pull_off_of_spheres_and_of_a_wall(n, wall):
    """Pulled slowly after a load, a contact carries at most 3/2 pi gamma_s a, with a the radius of
    the circle that the surfaces, overlapping by d_p,max, cut.  Where that is beyond the limit, the
    branches meet at k_2 P 2^(n-1)/(1 + 2^(n-1)), for n = c: at the limit, k_2 P/2, for n = 1."""
    contacts, depth = random_contacts(np.random.default_rng(4), n, n, {})
    side = np.where(wall, np.inf, np.where(np.isinf(contacts.radius_j), 1, contacts.radius_j))
    contacts = contacts._replace(radius_j=side, pull_off=np.zeros(N))
    if not wall:
        contacts = contacts._replace(radius_j=contacts.radius_i * 0.7)
    plastic = plastic_of(contacts, depth)
    square = 2 * contacts.radius_i * plastic - plastic**2
    if not wall:  # half the chord where two circles at that distance cut
        distance = contacts.radius_i + contacts.radius_j - plastic
        x = (distance**2 + contacts.radius_i**2 - contacts.radius_j**2) / (2 * distance)
        square = contacts.radius_i**2 - x**2
    pull = 1.5 * np.pi * contacts.surface_energy * np.sqrt(square)
    second = contacts.stiffness_ratio * contacts.first
    limit = second * plastic**n / 2
    meets = second * plastic**n * 2 ** (n - 1) / (1 + 2 ** (n - 1))
    steps = 1000
    paths = np.linspace(1, 0.01, steps)[:, None] * depth
    found = -run(bench_of(contacts), contacts, paths)["elastic"].min(axis=0)
    slope = n * second * depth**n / steps  # what a step can miss
    usual = (contacts.stiffness_ratio > 1.1) & (contacts.stiffness_ratio < 20)
    for case, most in ((usual & (pull < limit), pull), (usual & (pull > limit), meets)):
        assert case.sum() > 50 and np.all(found[case] <= most[case] * (1 + 1e-9))
        assert np.all(found[case] >= (most - slope)[case])


def test_constant_pull_off_force_holds_the_contact(benches):
    """F_0 acts from touch to parting, in full: pulled with less, an elastic contact stays."""
    contacts, depth = random_contacts(np.random.default_rng(5), 1.5, 1.0, {})
    pull = -contacts.first * depth**1.5
    contacts = contacts._replace(
        surface_energy=np.zeros(N), pull_off=pull, stiffness_ratio=np.ones(N)
    )
    bench = fill(benches["Hertzian, linear pull"], contacts)
    found = run(bench, contacts, np.outer([1e-9, 1, 1e-9, -1e-9], depth))["total"]
    assert np.allclose(
        found[[0, 1, 2]], [pull, 0 * pull, pull], rtol=1e-12, atol=1e-12 * -pull.min()
    )
    assert not found[3].any()


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


def test_step_stiffness_is_that_of_unloading(benches):
    contacts, depth = random_contacts(np.random.default_rng(13), *KINDS["Hertzian"])
    law = dem.EEPA(1.0, 2.0, 1.5, 1.5)
    for row in range(0, N, 97):
        k = {
            "modulus": 4 / 3 * contacts.modulus[row],
            "stiffness_ratio": contacts.stiffness_ratio[row],
        }
        bound = law.stiffness(k, contacts.radius[row], depth[row])
        slope = 1.5 * contacts.stiffness_ratio[row] * contacts.first[row] * np.sqrt(depth[row])
        assert np.isclose(bound, slope, rtol=1e-12)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"stiffness_ratio": 0.5}, "stiffness_ratio = 0.5: must be >= 1"),
        ({"overlap_exponent": 0.9}, "overlap_exponent = 0.9"),
        ({"adhesion_exponent": 0}, "adhesion_exponent = 0"),
        ({"pull_off_force": 1e-3}, "pull_off_force = 0.001: must be <= 0 N"),
        ({"damping": "log"}, "must be one of tangent, constant"),
        ({"limit_force": True, "surface_energy": 1.0}, "must be false with adhesion"),
        ({"limit_force": 1}, "must be true or false"),
    ],
)
def test_bad_numbers_are_refused(numbers, message):
    with pytest.raises(dem.InputError, match=message):
        dem.EEPA(**{"restitution": 0.5, "stiffness_ratio": 2.0} | numbers)


def test_what_the_law_says_of_itself():
    elastic, plastic = dem.EEPA(1.0, 1.0), dem.EEPA(1.0, 2.0)
    assert not (elastic.adhesive or elastic.plastic or elastic.dissipates)
    assert plastic.plastic and plastic.dissipates and dem.EEPA(0.9, 1.0).dissipates
