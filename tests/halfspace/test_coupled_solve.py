"""Contacts in equilibrium with the surface that they deform."""

import warnings

import numpy as np
import pytest

import halfspace
from halfspace import reference as ref

RADIUS, MODULUS = 1.0, 1.0
HERTZ = ref.hertz_law(RADIUS, MODULUS)
GROUND = halfspace.HalfSpace(MODULUS, 0.0, coupling="point")  # rigid spheres on it: E* = E'
pytestmark = pytest.mark.filterwarnings("ignore:coupling = ")  # points, though close together


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def array(rng, side, depth, spacing=1.0, roughness=0.0):
    """A square array with disorder, and overlaps of which some are gaps where it is rough."""
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    x = spacing * (cells + rng.uniform(-0.1, 0.1, cells.shape))
    return x, depth * (1 + roughness * rng.standard_normal(len(x)))


def relax(ground, x, overlap, law, rounds=4000):
    """The same equilibrium by under-relaxed substitution, with nothing of `solve` in it."""
    c = ground.matrix(x)
    d = np.zeros(len(overlap))
    stiffest = law(np.maximum(overlap, 0))[1].max()
    step = 1 / (1 + stiffest * np.linalg.eigvalsh(c)[-1])
    for _ in range(rounds):
        d += step * (overlap - c @ law(np.maximum(d, 0))[0] - d)
    return np.where(d > 0, law(np.maximum(d, 0))[0], 0.0)


@pytest.mark.parametrize(
    ("separation", "depth", "share"),
    [(2, 0.01, 0.969), (2, 0.05, 0.934), (4, 0.01, 0.984), (4, 0.05, 0.966)],
)
def test_two_rigid_spheres(separation, depth, share):
    x = [[0, 0], [separation * RADIUS, 0]]
    state = halfspace.solve(GROUND, x, np.full(2, depth * RADIUS), HERTZ, residual=1e-12)
    alone = HERTZ(np.array(depth * RADIUS))[0]
    assert state.force / alone == pytest.approx([share] * 2, abs=5e-4)
    closed = ref.two_spheres(depth * RADIUS, separation * RADIUS, RADIUS, MODULUS)
    assert state.force == pytest.approx([closed] * 2, rel=1e-11)


@pytest.mark.parametrize("roughness", [0.0, 0.5, 2.0])
def test_against_relaxation(rng, roughness):
    x, overlap = array(rng, 7, 0.06, roughness=roughness)
    radius = rng.uniform(0.5, 1.5, len(x))
    law = ref.hertz_law(radius, MODULUS)
    state = halfspace.solve(GROUND, x, overlap, law, residual=1e-12)
    expected = relax(GROUND, x, overlap, law)
    assert state.force == pytest.approx(expected, rel=1e-8, abs=1e-10 * expected.max())
    assert state.converged and state.residual <= 1e-12
    assert (roughness == 0) == bool((state.force > 0).all())


def test_linear_law_with_a_kink(rng):
    x, overlap = array(rng, 8, 0.1, roughness=1.0)
    stiffness = rng.uniform(0.1, 0.6, len(x))

    def law(d):
        return stiffness * d, stiffness

    state = halfspace.solve(GROUND, x, overlap, law, residual=1e-12)
    expected = relax(GROUND, x, overlap, law)
    assert state.force == pytest.approx(expected, rel=1e-8, abs=1e-10 * expected.max())


def test_what_is_returned_belongs_together(rng):
    x, overlap = array(rng, 6, 0.05, roughness=1.0)
    state = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-10)
    force, tangent = HERTZ(np.maximum(state.overlap, 0))
    assert np.array_equal(state.force, force) and np.array_equal(state.tangent, tangent)
    w, slope = GROUND.displacement(x, state.force)
    assert state.displacement == pytest.approx(w, rel=1e-12)
    assert state.slope == pytest.approx(slope, rel=1e-12, abs=1e-15)
    closed = state.force > 0
    left = state.overlap - (overlap - w)
    assert np.abs(left[closed]).max() <= 1e-10 * overlap.max()
    assert np.all((overlap - w)[~closed] <= 0)
    assert (w >= 0).all()


def test_convergence_is_quadratic(rng):
    x, overlap = array(rng, 6, 0.1)
    errors = []
    for limit in range(2, 5):
        with pytest.raises(halfspace.NotConverged) as caught:
            halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-15, max_iterations=limit)
        errors.append(caught.value.state.residual)
    order = np.log(errors[2] / errors[1]) / np.log(errors[1] / errors[0])
    assert order > 1.7


def test_cost(rng):
    x, overlap = array(rng, 40, 0.04, roughness=0.3)
    cold = halfspace.solve(GROUND, x, overlap, HERTZ)
    assert cold.applications <= 25
    again = halfspace.solve(GROUND, x, overlap, HERTZ, start=cold.overlap)
    assert again.iterations == 0 and again.applications == 1
    assert np.array_equal(again.force, cold.force)


@pytest.mark.parametrize("n", [0, 1])
def test_none_and_one(n):
    state = halfspace.solve(GROUND, np.zeros((n, 2)), np.full(n, 0.1), HERTZ)
    assert np.array_equal(state.force, HERTZ(np.full(n, 0.1))[0])
    assert state.displacement.shape == (n,) and state.slope.shape == (n, 2)
    assert not state.displacement.any() and not state.slope.any() and state.converged


def test_nothing_touches(rng):
    x, _ = array(rng, 3, 0.1)
    gaps = -rng.uniform(0, 1, 9)
    gaps[0] = 0.0
    for start in (None, np.ones(9)):
        state = halfspace.solve(GROUND, x, gaps, HERTZ, start=start)
        assert not state.force.any() and state.applications == 0
        assert np.array_equal(state.overlap, gaps)


@pytest.mark.parametrize("start", [-1.0, 0.0, 1e-9, 1e-3, 10.0, 1e3])
def test_contacts_all_lost_or_all_made_at_the_start(rng, start):
    x, overlap = array(rng, 6, 0.05, roughness=1.0)
    expected = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-12)
    guess = start * rng.uniform(0.5, 1.5, len(x))
    state = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-12, start=guess)
    assert state.force == pytest.approx(expected.force, rel=1e-8, abs=1e-12)


def test_pressed_under_by_a_neighbour():
    """A sphere that only just touches loses touch in the dent of the other, and stays out."""
    x = [[0, 0], [0.5, 0], [400.0, 0]]
    state = halfspace.solve(GROUND, x, [0.05, 1e-4, 0.01], HERTZ, residual=1e-10)
    assert state.force[1] == 0 and state.overlap[1] < 0
    assert state.force[[0, 2]] == pytest.approx(HERTZ(np.array([0.05, 0.01]))[0], rel=1e-2)


def test_a_gap_of_any_size_costs_no_precision(rng):
    x, overlap = array(rng, 4, 0.05)
    near = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-12)
    overlap = np.append(overlap, -1e12)
    x = np.append(x, [[1.5, 1.5]], axis=0)
    start = np.full(len(x), 0.05)
    state = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-12, start=start)
    assert state.force[:-1] == pytest.approx(near.force, rel=1e-11)
    assert state.force[-1] == 0


def test_far_and_coincident(rng):
    x, overlap = array(rng, 4, 0.05)
    x[0], x[5] = [1e6, -1e6], x[10]
    state = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-12)
    assert state.force[0] == pytest.approx(HERTZ(overlap[0])[0], rel=1e-4)
    assert state.force == pytest.approx(relax(GROUND, x, overlap, HERTZ), rel=1e-8)


@pytest.mark.parametrize("seed", range(40))
def test_contacts_closer_than_their_size(seed):
    """Spheres that cannot be, of sizes, stiffnesses and overlaps across decades: there are many
    equilibria then, and one of them is found."""
    rng = np.random.default_rng(seed)
    n = 40
    x = rng.uniform(0, 6, (n, 2)) * 10 ** rng.uniform(-3, 3, (n, 1))
    overlap = 10 ** rng.uniform(-8, -1, n) * rng.choice([-1, 1], n)
    law = ref.hertz_law(10 ** rng.uniform(-3, 1, n), 10 ** rng.uniform(-3, 3, n))
    state = halfspace.solve(GROUND, x, overlap, law)
    reached = overlap - GROUND.matrix(x) @ law(state.overlap)[0]
    missing = np.maximum(reached, 0) - np.maximum(state.overlap, 0)
    assert np.abs(missing).max() <= 1.01e-6 * overlap.max()


@pytest.mark.parametrize("seed", range(10))
def test_nearly_coincident_contacts_are_solved_or_refused(seed):
    rng = np.random.default_rng(seed)
    x, overlap = rng.uniform(0, 6, (30, 2)), rng.uniform(0, 0.09, 60)
    x = np.r_[x, x + 10 ** rng.uniform(-14, -1, (30, 1))]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "coupling = ")  # points indeed
        try:
            state = halfspace.solve(GROUND, x, overlap, HERTZ)
        except halfspace.NotConverged as refusal:
            assert "closer together than their size" in str(refusal)
            state = refusal.state
    assert np.isfinite(state.force).all() and np.isfinite(state.slope).all()


def test_softening_and_saturated_laws(rng):
    x, overlap = array(rng, 6, 1.0, roughness=0.5)

    def softening(d):  # stiff, then ever weaker
        return 0.3 * d * np.exp(-d * d), 0.3 * (1 - 2 * d * d) * np.exp(-d * d)

    def saturated(d):
        return 0.1 * np.minimum(d, 0.2), 0.1 * (d < 0.2)

    for law in (softening, saturated):
        state = halfspace.solve(GROUND, x, overlap, law, residual=1e-11)
        d = state.overlap
        force = np.where(d > 0, law(np.maximum(d, 0))[0], 0)
        left = d + GROUND.matrix(x) @ force - overlap
        assert np.abs(left).max() <= 1.01e-11 * overlap.max()
    assert (softening(state.overlap)[1] < 0).any()


def test_contacts_that_adhere_pull_the_surface_up():
    """Two contacts held apart by less than their pull-off, of a linear law that pulls to -0.1."""

    def law(d):
        return 0.2 * d, np.full_like(d, 0.2)

    x, held = [[0, 0], [1, 0]], np.array([-0.05, -0.05])
    state = halfspace.solve(GROUND, x, held, law, residual=1e-12, opening=-0.1)
    # d + c k d = delta
    assert state.force == pytest.approx(0.2 * held / (1 + 0.2 / np.pi), rel=1e-11)
    assert (state.displacement < 0).all()
    # The same contacts, never made: an opening for each.
    state = halfspace.solve(GROUND, x, held, law, opening=np.zeros(2))
    assert not state.force.any()


def test_units(rng):
    x, overlap = array(rng, 5, 0.05, roughness=1.0)
    state = halfspace.solve(GROUND, x, overlap, HERTZ)
    length, stress = 1e-6, 1e9
    law = ref.hertz_law(RADIUS * length, MODULUS * stress)
    ground = halfspace.HalfSpace(MODULUS * stress, 0.0, coupling="point")
    scaled = halfspace.solve(ground, x * length, overlap * length, law)
    assert scaled.force == pytest.approx(state.force * stress * length**2, rel=1e-10)
    assert scaled.overlap == pytest.approx(state.overlap * length, rel=1e-10)
    assert scaled.slope == pytest.approx(state.slope, rel=1e-10)
    assert scaled.applications == state.applications


def test_not_converged_carries_the_nearest_state(rng):
    x, overlap = array(rng, 6, 0.1)
    with pytest.raises(halfspace.NotConverged, match=r"residual = 1e-06: reached .* after 1") as no:
        halfspace.solve(GROUND, x, overlap, HERTZ, max_iterations=1)
    state = no.value.state
    assert not state.converged and state.iterations == 1 and 1e-6 < state.residual < 1
    # It is a start like any other.
    assert halfspace.solve(GROUND, x, overlap, HERTZ, start=state.overlap).converged


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"x": [[0, 0, 0]] * 2}, r"x has shape \(2, 3\)"),
        ({"overlap": [0.1]}, r"overlap has shape \(1,\): must be \(2,\)"),
        ({"overlap": [0.1, np.nan]}, r"overlap\[1\] = nan: must be finite"),
        ({"start": [0.1] * 3}, r"start has shape \(3,\): must be \(2,\)"),
        ({"opening": [0.1] * 3}, r"opening has shape \(3,\): must be \(2,\)"),
        ({"opening": np.nan}, r"opening = nan: must be a finite overlap"),
        ({"residual": 0}, r"residual = 0: must be a number between 0 and 1"),
        ({"residual": 1.5}, r"residual = 1.5: must be a number between 0 and 1"),
        ({"max_iterations": 1.5}, r"max_iterations = 1.5: must be a whole number"),
        ({"max_iterations": -1}, r"max_iterations = -1: must be a whole number"),
        ({"law": lambda d: d}, r"law returned ndarray: must be \(force, tangent\)"),
        ({"law": lambda d: (d, 1.0)}, r"law returned a tangent of shape \(\), not \(2,\)"),
        ({"law": lambda d: (d * np.nan, d)}, r"law returned force\[0\] = nan at overlap 0.1 m"),
    ],
)
def test_refusals(arguments, words):
    given = {"x": [[0, 0], [1, 0]], "overlap": [0.1, 0.1], "law": HERTZ, **arguments}
    with pytest.raises(ValueError, match=words):
        halfspace.solve(GROUND, **given)
