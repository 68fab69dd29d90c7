"""EEPA: against its twin over random load paths, and against closed forms."""

import numpy as np
import pytest
from eepa_cases import (
    KINDS,
    N,
    bench_of,
    fill,
    plastic_of,
    random_contacts,
    random_paths,
    run,
    work_of,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from setups import order_of

import taichi_dem as dem

COMMON = settings(
    deadline=None,
    derandomize=True,
    database=None,
    max_examples=3,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


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
    pull = 1.5 * np.pi * contacts.surface_energy * np.sqrt(np.maximum(square, 0))
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
