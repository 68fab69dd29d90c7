"""Displacement and slope of the half-space under given forces."""

import math
import warnings

import layouts
import numpy as np
import pytest

import halfspace
from halfspace import direct

E, NU = 2e4, 0.3
MODULUS = E / (1 - NU**2)


@pytest.fixture
def ground():
    return halfspace.HalfSpace(E, NU)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def layout(rng, n=50):
    return rng.uniform(0, 0.1, (n, 2)), rng.uniform(0, 2.0, n)


def test_two_contacts(ground):
    w, slope = ground.displacement([[0, 0], [3e-3, 4e-3]], [2.0, 5.0])
    r = 5e-3
    assert w == pytest.approx([5 / (np.pi * MODULUS * r), 2 / (np.pi * MODULUS * r)], rel=1e-14)
    # The surface rises away from the other load.
    uphill = np.array([0.6, 0.8]) / (np.pi * MODULUS * r**2)
    assert slope == pytest.approx(np.array([-5.0 * uphill, 2.0 * uphill]), rel=1e-14)


def test_reciprocity(ground, rng):
    x, f = layout(rng)
    g = rng.standard_normal(len(f))
    cf, cg = ground.displacement(x, f)[0], ground.displacement(x, g)[0]
    assert f @ cg == pytest.approx(g @ cf, rel=1e-13)
    c = ground.matrix(x)
    assert np.array_equal(c, c.T)
    assert not c.diagonal().any()
    assert c @ f == pytest.approx(cf, rel=1e-13)


@pytest.mark.parametrize("arrangement", [layouts.uniform, layouts.clustered, layouts.outlier])
@pytest.mark.parametrize("sign", ["random", "pressing"])
@pytest.mark.parametrize("n", [100, 3000])
def test_direct_sums_are_exact_to_rounding(rng, arrangement, sign, n):
    """Against terms in extended precision that are added up without loss."""
    x, f = arrangement(rng, n), layouts.forces(rng, n, sign)
    w = halfspace.HalfSpace(1 / np.pi, 0.0).plan(x, method="direct").apply(f)
    for k in rng.choice(n, 20, replace=False):
        d = np.delete(x, k, axis=0).astype(np.longdouble) - x[k]
        terms = np.delete(f, k) / np.sqrt((d**2).sum(axis=1))
        # The parts that doubles hold, and what is left of each.
        high = terms.astype(np.float64)
        right = math.fsum([*high, *(terms - high).astype(np.float64)])
        assert abs(w[k] - right) < 8 * np.finfo(np.float64).eps * np.abs(high).sum()


def test_linearity(ground, rng):
    x, f = layout(rng)
    g = rng.standard_normal(len(f))
    both = ground.displacement(x, 2 * f + 3 * g)
    for ours, of_f, of_g in zip(
        both, ground.displacement(x, f), ground.displacement(x, g), strict=True
    ):
        scale = np.abs(of_f).max()
        assert ours == pytest.approx(2 * of_f + 3 * of_g, rel=1e-12, abs=1e-13 * scale)


def test_rigid_motions(ground, rng):
    x, f = layout(rng)
    w, slope = ground.displacement(x, f)
    steep = np.abs(slope).max()
    shifted = ground.displacement(x + np.array([0.7, -0.3]), f)
    assert shifted[0] == pytest.approx(w, rel=1e-10)
    assert shifted[1] == pytest.approx(slope, abs=1e-9 * steep)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    turned = ground.displacement(x @ turn.T, f)
    assert turned[0] == pytest.approx(w, rel=1e-10)
    assert turned[1] == pytest.approx(slope @ turn.T, abs=1e-9 * steep)
    order = rng.permutation(len(f))
    again = ground.displacement(x[order], f[order])
    assert again[0] == pytest.approx(w[order], rel=1e-13)
    assert again[1] == pytest.approx(slope[order], abs=1e-13 * steep)


def test_slope_is_the_derivative_of_the_expansion(ground, rng):
    """Central differences of -w, moving one contact: the error falls as the square of the step."""
    x, f = layout(rng, 12)
    _, slope = ground.displacement(x, f)

    def error(h):
        total = 0.0
        for k in range(len(f)):
            for axis in (0, 1):
                move = np.zeros_like(x)
                move[k, axis] = h
                ahead = -ground.displacement(x + move, f)[0][k]
                behind = -ground.displacement(x - move, f)[0][k]
                total = max(total, abs((ahead - behind) / (2 * h) - slope[k, axis]))
        return total

    steps = 1e-4 * 0.5 ** np.arange(4)
    order = np.polyfit(np.log(steps), np.log([error(h) for h in steps]), 1)[0]
    assert order == pytest.approx(2, abs=0.05)


def test_lateral_force_is_downhill_and_minus_the_gradient_of_the_coupling_energy(ground, rng):
    """-f slope = +grad E_c at constant forces: a sphere is drawn into the dents of the others."""
    x, f = layout(rng, 8)

    def energy(y):
        return 0.5 * f @ ground.matrix(y) @ f

    _, slope = ground.displacement(x, f)
    h = 1e-8
    for k in range(len(f)):
        for axis in (0, 1):
            move = np.zeros_like(x)
            move[k, axis] = h
            gradient = (energy(x + move) - energy(x - move)) / (2 * h)
            assert -f[k] * slope[k, axis] == pytest.approx(gradient, rel=1e-5, abs=1e-12)
    _, slope = ground.displacement([[0, 0], [1e-3, 0]], [1.0, 1.0])
    assert -slope[0, 0] > 0 > -slope[1, 0]  # towards each other


def test_blocks_give_the_same_sums(ground, rng, monkeypatch):
    x, f = layout(rng, 30)
    w, slope = ground.displacement(x, f)
    field = ground.field(x, f, x + 1e-3, np.full(30, 1e-3))
    monkeypatch.setattr(direct, "BLOCK", 70)
    monkeypatch.setattr(direct, "KEEP", 0)
    plan = ground.plan(x)
    assert plan.apply(f) == pytest.approx(w, rel=1e-13)
    assert plan.slope(f) == pytest.approx(slope, rel=1e-11)
    assert ground.field(x, f, x + 1e-3, np.full(30, 1e-3)) == pytest.approx(field, rel=1e-13)


@pytest.mark.parametrize("n", [0, 1])
def test_none_and_one(ground, n):
    w, slope = ground.displacement(np.ones((n, 2)), np.ones(n))
    assert w.shape == (n,) and slope.shape == (n, 2)
    assert not w.any() and not slope.any()
    assert ground.matrix(np.ones((n, 2))).shape == (n, n)
    assert ground.displacement([], [])[0].shape == (0,)
    assert not ground.field([], [], [[0.0, 0.0]]).any()
    assert ground.field([[0.0, 0.0]], [1.0], []).shape == (0,)


def test_a_million_spacings_apart(ground):
    x = np.array([[0.0, 0.0], [1e-3, 0.0], [1e3, 0.0]])
    w, slope = ground.displacement(x, [1.0, 1.0, 1.0])
    unit = 1 / (np.pi * MODULUS)
    assert w == pytest.approx(unit * np.array([1e3 + 1e-3, 1e3 + 1 / 999.999, 1e-3 + 1 / 999.999]))
    assert np.isfinite(slope).all()


def test_coincident_contacts(ground):
    x = np.array([[0.1, 0.1], [0.1, 0.1], [0.3, 0.1]])
    f = np.array([1.0, 2.0, 4.0])
    w, slope = ground.displacement(x, f)
    unit = 1 / (np.pi * MODULUS)
    # Without sizes the two are one force: each sees the third contact alone.
    assert w == pytest.approx(unit / 0.2 * np.array([4, 4, 3]))
    assert slope[:2, 0] == pytest.approx(-4 * unit / 0.2**2 * np.ones(2))
    c = ground.matrix(x)
    assert np.array_equal(c, c.T)
    everything, flat = ground.displacement(np.zeros((5, 2)), np.ones(5))
    assert not everything.any() and not flat.any()


@pytest.mark.parametrize("gap", [1e-300, 1e-160, 1e-30, 1e-17, 1e-12])
def test_nearly_coincident_contacts_are_finite(ground, gap):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        w, slope = ground.displacement([[0.0, 0.0], [gap, 0.0], [1.0, 0.0]], np.ones(3))
    assert np.isfinite(w).all() and np.isfinite(slope).all()


def test_units(rng):
    """Lengths in micrometres, moduli in nanopascals: the same numbers, scaled."""
    x, f = layout(rng)
    length, stress = 2.0**-20, 2.0**30
    w, slope = halfspace.HalfSpace(E, NU).displacement(x, f)
    small = halfspace.HalfSpace(E * stress, NU).displacement(x * length, f * stress * length**2)
    assert np.array_equal(small[0], w * length)
    assert np.array_equal(small[1], slope)


def test_field_of_points(ground, rng):
    x, f = layout(rng, 9)
    # At a contact the field is that of all the others and of the contact itself, infinite.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        at_loads = ground.field(x, f, x)
        pulled = ground.field(x, -f, x)
        idle = ground.field(x, np.where(np.arange(9) == 3, 0.0, f), x)
    assert np.isposinf(at_loads).all() and np.isneginf(pulled).all()
    assert idle[3] == pytest.approx(ground.displacement(x, f)[0][3])
    points = rng.uniform(0.2, 0.3, (5, 2))
    r = np.hypot(*(points[:, None] - x).transpose(2, 0, 1))
    assert ground.field(x, f, points) == pytest.approx((f / (np.pi * MODULUS * r)).sum(axis=1))


def test_field_of_hertz_pressures(ground):
    radius, a = 0.01, 1e-3
    force = 4 * MODULUS * a**3 / (3 * radius)
    r = np.linspace(0, 3e-3, 13)
    points = np.c_[r, np.zeros_like(r)] + [0.5, 0.5]
    dent = ground.field([[0.5, 0.5]], [force], points, [a])
    inside = r < a
    assert dent[inside] == pytest.approx(a**2 / radius - r[inside] ** 2 / (2 * radius), rel=1e-10)
    s = r[~inside]
    outside = (2 * a**2 - s**2) * np.arcsin(np.minimum(a / s, 1)) + a * np.sqrt(s**2 - a**2)
    assert dent[~inside] == pytest.approx(outside / (np.pi * radius), rel=1e-9)
    # Far away it is the point force; a contact without size is one.
    assert ground.field([[0, 0]], [1.0], [[1e4, 0]], [a]) == pytest.approx(
        ground.field([[0, 0]], [1.0], [[1e4, 0]]), rel=1e-13
    )
    assert ground.field([[0, 0]], [1.0], [[1.0, 0]], [0.0]) == pytest.approx(
        ground.field([[0, 0]], [1.0], [[1.0, 0]]), rel=1e-14
    )


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"youngs_modulus": 0}, ValueError, r"youngs_modulus = 0.0: must be a number > 0 Pa"),
        ({"youngs_modulus": np.inf}, ValueError, r"youngs_modulus = inf: must be"),
        ({"youngs_modulus": "soft"}, ValueError, r"youngs_modulus = 'soft': must be"),
        ({"youngs_modulus": [1.0]}, ValueError, r"youngs_modulus = \[1.0\]: must be"),
        ({"poissons_ratio": 0.51}, ValueError, r"poissons_ratio = 0.51: must be .* <= 0.5"),
        ({"poissons_ratio": -1}, ValueError, r"poissons_ratio = -1.0: must be"),
        ({"tolerance": 0}, ValueError, r"tolerance = 0.0: must be a number between 0 and 1"),
        ({"tolerance": True}, ValueError, r"tolerance = True: must be"),
        ({"coupling": "none"}, ValueError, r"coupling = 'none': must be 'finite' or 'point'"),
        ({"period": 1.0}, ValueError, r"period = 1.0: must be \(Lx, Ly\), two lengths > 0 m"),
        ({"period": (1.0, 0.0)}, ValueError, r"period = \(1.0, 0.0\): must be \(Lx, Ly\)"),
        ({"workers": 0}, ValueError, r"workers = 0: must be None or a whole number, not 0"),
        ({"layer": 0.01}, ValueError, r"layer = 0.01: must be a halfspace.Layer or None"),
    ],
)
def test_refused_half_spaces(arguments, error, words):
    with pytest.raises(error, match=words):
        halfspace.HalfSpace(**{"youngs_modulus": E, "poissons_ratio": NU, **arguments})


@pytest.mark.parametrize(
    ("x", "f", "radius", "words"),
    [
        (np.zeros((2, 3)), [1, 1], None, r"x has shape \(2, 3\): must be \(n, 2\)"),
        ([[0, 0], [np.nan, 0]], [1, 1], None, r"x\[1, 0\] = nan: must be finite"),
        ([[0, "a"]], [1], None, r"x = \[\[0, 'a'\]\]: must be an array of numbers"),
        ([[0, 0], [1, 0]], [1], None, r"f has shape \(1,\): must be \(2,\), one per contact"),
        ([[0, 0], [1, 0]], [np.inf] * 2, None, r"f\[0\] = inf: must be finite \(and 1 more\)"),
        ([[0, 0]], [1], [-1.0], r"radius\[0\] = -1.0: must be >= 0 m"),
        ([[0, 0]], [1], [1.0, 1.0], r"radius has shape \(2,\): must be \(1,\)"),
    ],
)
def test_refused_loads(ground, x, f, radius, words):
    for ask in (ground.displacement, lambda *load: ground.field(*load[:2], [[1, 1]], load[2])):
        with pytest.raises(ValueError, match=words):
            ask(x, f, radius)


def test_limits_of_poissons_ratio():
    assert halfspace.HalfSpace(1.0, 0.5).modulus == pytest.approx(4 / 3)
    assert halfspace.HalfSpace(1.0, 0.0).modulus == 1.0
