"""Contacts of finite size on a surface that they tilt: one energy, and all that follows from it."""

import warnings

import numpy as np
import pytest

import halfspace
from halfspace import finite
from halfspace import reference as ref

RADIUS, MODULUS = 1.0, 1.0
GROUND = halfspace.HalfSpace(MODULUS, 0.0)  # rigid spheres on it: E* = E'
PERIOD = (4.2, 4.6)


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def array(rng, side, depth, spacing=1.0, roughness=0.0):
    """A square array with disorder, and overlaps of which some are gaps where it is rough."""
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    x = spacing * (cells + rng.uniform(-0.1, 0.1, cells.shape))
    return x, depth * (1 + roughness * rng.standard_normal(len(x)))


def hertz_radius(f, radius=RADIUS):
    return ref.hertz_contact_radius(f, radius, MODULUS)


def coupling_energy(x, f, a):
    """`1/2 sum f_j f_k/(pi E' r) [1 + (a_j^2 + a_k^2)/(10 r^2)]` as it is written."""
    r = np.linalg.norm(x[:, None] - x, axis=2)
    np.fill_diagonal(r, np.inf)
    s = a[:, None] ** 2 + a**2
    return 0.5 * f @ ((1 + s / (10 * r**2)) / (np.pi * MODULUS * r)) @ f


def order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def some(rng, apart=True):
    """Eight contacts, all apart, or so that some overlap and two coincide."""
    x = array(rng, 3, 0.1)[0][:8] * (1.0 if apart else 0.35)
    if not apart:
        x[7] = x[2]
    return x, rng.uniform(0.02, 0.08, 8)


def ground_of(period):
    return halfspace.HalfSpace(MODULUS, 0.0, period=period)


# The energy and its derivatives ------------------------------------------------------------------


def test_as_written(rng):
    x, f = some(rng)
    a = hertz_radius(f)
    w, slope = GROUND.displacement(x, f, a)
    d = x[:, None] - x
    r = np.linalg.norm(d, axis=2)
    np.fill_diagonal(r, np.inf)
    factor = 1 + (a**2 / 10 + a[:, None] ** 2 / 6) / r**2
    assert w == pytest.approx((factor / (np.pi * MODULUS * r)) @ f, rel=1e-13)
    steep = 1 / r**3 + 0.3 * (a**2 + a[:, None] ** 2) / r**5
    expected = np.einsum("kj,kja,j->ka", steep, d, f) / (np.pi * MODULUS)
    assert slope == pytest.approx(expected, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("apart", [True, False])
@pytest.mark.parametrize("period", [None, PERIOD])
def test_depression_is_the_derivative_of_the_energy_by_the_force(rng, apart, period):
    """What has a symmetric derivative is one itself; `test_energy` says of what."""
    x, f = some(rng, apart)
    plan = ground_of(period).plan(x)
    tangent = plan.tangent(f, hertz_radius(f))
    jacobian = np.stack([tangent(g) for g in np.eye(8)], axis=1)
    assert jacobian == pytest.approx(jacobian.T, rel=1e-12, abs=1e-13)
    direction = f * rng.uniform(-1, 1, 8)

    def difference(h):
        w = [plan.apply(g, hertz_radius(g)) for g in (f + h * direction, f - h * direction)]
        return (w[0] - w[1]) / (2 * h)

    steps = 0.05 * 0.5 ** np.arange(4)
    errors = [np.abs(difference(h) - jacobian @ direction).max() for h in steps]
    assert order(steps, errors) == pytest.approx(2, abs=0.1)
    assert errors[-1] < 3e-3 * np.abs(jacobian @ direction).max()


def test_energy(rng):
    """What it takes to load the contacts together is the energy as written."""
    x, f = some(rng)
    node, weight = np.polynomial.legendre.leggauss(20)
    load = (node + 1) / 2
    plan = GROUND.plan(x)
    work = sum(
        c * f @ plan.apply(t * f, hertz_radius(t * f))
        for c, t in zip(weight / 2, load, strict=True)
    )
    assert work == pytest.approx(coupling_energy(x, f, hertz_radius(f)), rel=1e-6)


@pytest.mark.parametrize("period", [None, PERIOD])
def test_slope_is_the_derivative_of_the_energy_by_the_place(rng, period):
    """By integration of w over the load, at places a little apart: of second order."""
    x, f = some(rng)
    ground = ground_of(period)
    slope = ground.displacement(x, f, hertz_radius(f))[1]
    direction = rng.uniform(-1, 1, x.shape)
    node, weight = np.polynomial.legendre.leggauss(12)
    load = ((node + 1) / 2) ** 3  # in which radii and energies are smooth
    weight = 3 * ((node + 1) / 2) ** 2 * weight / 2

    def energy(y):
        plan = ground.plan(y)
        works = [f @ plan.apply(t * f, hertz_radius(t * f)) for t in load]
        return weight @ works

    rate = -np.sum(f[:, None] * slope * direction)
    steps = 2e-2 * 0.5 ** np.arange(4)
    errors = [
        abs((energy(x + h * direction) - energy(x - h * direction)) / (2 * h) - rate) for h in steps
    ]
    assert errors[-1] < 1e-3 * abs(rate)
    assert order(steps, errors) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("apart", [True, False])
def test_periodic_cells(rng, apart):
    """No place in a cell is special; a cell is two of half its size, load by load."""
    x, f = some(rng, apart)
    a = hertz_radius(f)
    w, slope = ground_of(PERIOD).displacement(x, f, a)
    for shift in ([2.0, 2.2], [-0.7, 40.0]):
        moved = ground_of(PERIOD).displacement(x + shift, f, a)
        assert moved[0] == pytest.approx(w, abs=1e-12)
        assert moved[1] == pytest.approx(slope, abs=1e-10)
    two = np.r_[x, x + [PERIOD[0], 0]], np.r_[f, f], np.r_[a, a]
    twice = ground_of((2 * PERIOD[0], PERIOD[1])).displacement(*two)
    assert twice[0] == pytest.approx(np.r_[w, w], abs=1e-12)
    assert twice[1] == pytest.approx(np.r_[slope, slope], abs=1e-10)


# Contacts that overlap ---------------------------------------------------------------------------


def hertz_pair(a, b, r):
    """Energy of two overlapping Hertz pressures of unit force, times pi E', by their spectra."""
    from scipy.special import j0

    q = (np.arange(400_000) + 0.5) * (2e-3 / min(a, b))

    def shape(z):
        return 3 * (np.sin(z) - z * np.cos(z)) / z**3

    return np.sum(shape(q * a) * shape(q * b) * j0(q * r)) * (q[1] - q[0])


@pytest.mark.parametrize("u", [0.0, 0.3, 0.7, 1.0, 1.5, 2.0])
def test_equal_contacts_that_overlap(u):
    """Against two Hertz pressures that pass through each other."""
    a = 0.3
    r = np.sqrt(u * 2) * a
    ours = finite.kernel(np.array([r * r]), np.array([2 * a * a])).value[0]
    assert ours == pytest.approx(hertz_pair(a, a, r), rel=0.035 if u else 1e-3)


def test_the_kernel_is_smooth_where_contacts_touch():
    below, above = (
        finite.kernel(np.array([finite.TOUCHING * (1 + d)]), np.array([1.0])) for d in (-1e-9, 1e-9)
    )
    for name in ("value", "by_size", "twice_by_size", "by_square"):
        assert getattr(below, name) == pytest.approx(getattr(above, name), rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("period", [None, PERIOD])
@pytest.mark.parametrize("gap", [0.0, 1e-300, 1e-160, 1e-30, 1e-12, 1e-3])
def test_coincident_contacts(period, gap):
    x = np.array([[0.1, 0.1], [0.1 + gap, 0.1], [2.0, 0.1]])
    f, a = np.array([0.01, 0.03, 0.02]), np.array([0.1, 0.1, 0.2])
    ground = ground_of(period)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        w, slope = ground.displacement(x, f, a)
        tangent = ground.plan(x, a).tangent(f)(f)
    assert np.isfinite(np.r_[w, slope.ravel(), tangent]).all()
    if period is None:
        pair = finite.kernel(np.zeros(1), np.array([0.02]))
        own = (pair.value + 2 / 3 * 0.01 * pair.by_size)[0] / (np.pi * MODULUS)
        far = ground.displacement(x[[0, 2]], f[[0, 2]], a[[0, 2]])[0][0]
        assert w[:2] == pytest.approx(far + own * f[[1, 0]], rel=2e-3)
    if gap == 0:
        assert np.array_equal(slope[0], slope[1])
        # Without sizes they do not know of each other.
        points = ground.displacement(x, f)[0]
        assert points == pytest.approx(ground.displacement(x, f, 0 * a)[0])


def test_a_large_contact_over_small_ones(rng):
    """Far wider than the distances between the others: finite, symmetric, and solved."""
    x = np.r_[[[0.0, 0.0]], rng.uniform(-0.3, 0.3, (30, 2))]
    radius = np.r_[2.0, np.full(30, 0.05)]
    overlap = np.r_[0.2, np.full(30, 0.15)]
    state = halfspace.solve(GROUND, x, overlap, ref.hertz_law(radius, MODULUS), residual=1e-9)
    assert state.converged and state.contact_radius[0] > 0.3
    assert np.isfinite(state.slope).all()


# The solve ---------------------------------------------------------------------------------------


def test_what_is_returned_belongs_together(rng):
    x, overlap = array(rng, 5, 0.05, roughness=0.5)
    law = ref.hertz_law(rng.uniform(0.5, 1.5, len(x)), MODULUS)
    state = halfspace.solve(GROUND, x, overlap, law, residual=1e-11)
    a = ref.hertz_contact_radius(state.force, law.radius, MODULUS)
    assert state.contact_radius == pytest.approx(a, rel=1e-14)
    w, slope = GROUND.displacement(x + state.shift, state.force, a)
    assert state.displacement == pytest.approx(w, rel=1e-12)
    assert state.slope == pytest.approx(slope, rel=1e-12, abs=1e-14)
    assert state.shift == pytest.approx(law.radius[:, None] * slope, abs=1e-7)
    closed = state.force > 0
    lost = (state.shift**2).sum(axis=1) / (2 * law.radius)
    left = state.overlap - (overlap - w - lost)
    assert np.abs(left[closed]).max() <= 1e-11 * overlap.max()
    assert closed.any() and not closed.all()


def test_where_spheres_touch_a_tilted_surface():
    """Two spheres lean outward, uphill, and are drawn together."""
    state = halfspace.solve(GROUND, [[0, 0], [0.8, 0]], [0.05, 0.05], ref.hertz_law(1.0, 1.0))
    assert state.shift[0, 0] < 0 < state.shift[1, 0]
    assert -state.force[0] * state.slope[0, 0] > 0 > -state.force[1] * state.slope[1, 0]


@pytest.mark.parametrize(("spacing", "depth"), [(1.0, 0.05), (0.55, 0.06), (0.3, 0.06)])
def test_force_is_minus_the_gradient_of_the_potential(rng, spacing, depth):
    """Normal f, lateral -f slope, with all that contacts do when they overlap."""
    x, overlap = array(rng, 3, depth, spacing)
    law, node = ref.hertz_law(RADIUS, MODULUS), np.polynomial.legendre.leggauss(6)

    def solved(y, d):
        return halfspace.solve(GROUND, y, d, law, residual=1e-13)

    state = solved(x, overlap)
    ours = np.c_[-state.force[:, None] * state.slope, state.force]
    direction = rng.uniform(-1, 1, (9, 3)) * [0.1, 0.1, 0.02]
    rate = np.sum(ours * direction)

    def work(h):
        """Along the straight line from -h to h, by the forces: that of a potential, all ways."""
        total = 0.0
        for z, c in zip(*node, strict=True):
            s = solved(x + h * z * direction[:, :2], overlap - h * z * direction[:, 2])
            total += c * h * np.sum(np.c_[-s.force[:, None] * s.slope, s.force] * direction)
        return total

    def energy(h):
        s = solved(x + h * direction[:, :2], overlap - h * direction[:, 2])
        f, a = s.force, s.contact_radius
        squared = (x + h * direction[:, :2] + s.shift)[:, None] - x - h * direction[:, :2] - s.shift
        squared = (squared**2).sum(axis=2)
        np.fill_diagonal(squared, np.inf)
        c = finite.kernel(squared, a[:, None] ** 2 + a**2).value / (np.pi * MODULUS)
        lost = (s.shift**2).sum(axis=1) / (2 * RADIUS)
        own = 0.6 * np.sum(f ** (5 / 3)) * float(ref.hertz_stiffness(RADIUS, MODULUS)) ** (-2 / 3)
        return f @ (overlap - h * direction[:, 2] - lost) - 0.5 * f @ c @ f - own

    steps = 0.2 * 0.5 ** np.arange(4)
    errors = [abs((energy(-h) - energy(h)) / (2 * h) - rate) for h in steps]
    assert order(steps, errors) == pytest.approx(2, abs=0.1)
    h = steps[2]
    assert work(h) == pytest.approx(energy(-h) - energy(h), rel=1e-9)
