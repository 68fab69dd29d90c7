"""Layers of finite thickness on a rigid base, against elasticity solved anew and closed forms."""

import warnings

import numpy as np
import pytest
from elasticity import sphere_on_a_layer, wave_response
from scipy.optimize import brentq
from scipy.special import j0, j1

import halfspace
from halfspace import layer_sums
from halfspace import reference as ref
from halfspace.layer_kernel import PIECE, REACH, LayerKernel, correction
from halfspace.layer_sums import correction_of
from halfspace.layers import symbol
from halfspace.plan import WIDE

E, NU, H = 2e4, 0.3, 0.02
BASES = ("bonded", "frictionless")
POISSONS_RATIOS = (-0.9, 0.0, 0.3, 0.45, 0.5)
CASES = [("bonded", nu) for nu in POISSONS_RATIOS] + [("frictionless", 0.3)]


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def ground(base="bonded", nu=NU, thickness=H, **options):
    return halfspace.HalfSpace(E, nu, layer=halfspace.Layer(thickness, base), **options)


def layout(rng, n=30, size=0.1):
    return size * rng.random((n, 2)), 2 * rng.random(n)


# -- the symbol ----------------------------------------------------------------------------------


@pytest.mark.parametrize("x", [0.05, 0.7, 2.0, 6.0])
@pytest.mark.parametrize(("base", "nu"), [("bonded", -0.5), ("bonded", 0.3), ("frictionless", 0.2)])
def test_symbol_against_the_equations_of_elasticity(base, nu, x):
    halfspace_depression = 1 - nu
    depression = -wave_response(x, nu, base, (0.0, -1.0))[1]
    expected = depression / halfspace_depression
    assert symbol(x, nu, base) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(("base", "nu"), CASES)
def test_limits_of_the_symbol(base, nu):
    assert symbol(50.0, nu, base) == pytest.approx(1, rel=1e-14)
    assert symbol(1e300, nu, base) == 1 and symbol(0.0, nu, base) == 0
    x = 10.0 ** np.arange(-8, -2)
    first = halfspace.Layer(1.0, base).uniform(nu) * x
    if first.any():
        assert symbol(x, nu, base) == pytest.approx(first, rel=2e-5)
    else:  # incompressible and bonded: u = q^2 h^3 p/E
        modulus = 1 / (1 - nu**2)
        assert 2 / (modulus * x) * symbol(x, nu, base) == pytest.approx(x**2, rel=1e-5)


def test_the_series_near_zero_meets_the_closed_form():
    x = np.array([0.5 - 1e-9, 0.5 + 1e-9])
    below, above = symbol(x, 0.5, "bonded")
    assert above - below == pytest.approx(2e-9 * (symbol(0.51, 0.5, "bonded") - below) / 0.01, 0.1)
    exact = (np.sinh(2 * x) - 2 * x) / (np.cosh(2 * x) + 2 * x**2 + 1)
    assert [below, above] == pytest.approx(exact, rel=1e-14)


# -- the real-space kernel -----------------------------------------------------------------------


def panels(function, low, high, count, nodes=20):
    """Gauss-Legendre on `count` panels."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    width = (high - low) / count
    x = (low + width * (np.arange(count)[:, None] + (node + 1) / 2)).ravel()
    return function(x) @ np.tile(weight * width / 2, count)


@pytest.mark.parametrize(("base", "nu"), CASES)
def test_correction_is_the_transform_of_the_symbol(rng, base, nu):
    t = np.r_[0, 1e-9, PIECE * np.arange(1, 4), REACH * rng.random(40), REACH, REACH + 1e-9, 60, 90]

    def transform(weight):
        return panels(lambda x: weight(x) * (symbol(x, nu, base) - 1), 0, 30, 300)

    tables = correction(nu, base)
    for table, power in ((tables.value, 0), (tables.laplacian, 2)):
        sign = 1 - power
        exact = sign * transform(lambda x, k=power: x**k * j0(t[:, None] * x))
        tolerance = (2e-13, 0, 1e-11)[power]
        assert np.abs(table.value(t) - exact).max() < tolerance
        value, steep = table.steepness(t)
        assert np.array_equal(value, table.value(t))
        exact = -sign * transform(lambda x, k=power: x ** (k + 1) * j1(t[:, None] * x))
        assert np.abs(steep - exact).max() < 200 * tolerance
        assert table.origin == pytest.approx(table.value(0.0), rel=1e-12)
    # D = D(0) + L(0) t^2/4 + ...
    rise = tables.value.value(1e-3) - tables.value.origin
    assert rise == pytest.approx(2.5e-7 * tables.laplacian.origin, rel=1e-5)


def test_known_values():
    """D(0) for a frictionless base is Lebedev & Ufliand's 1.168; bonded, nu = 1/2, the first
    coefficient of a sphere's force, 2/pi D(0) = -1.13 (Dimitriadis et al., Biophys. J. 82, 2798,
    2002, from a fit that is good to 1 %)."""
    assert correction(0.3, "frictionless").value.origin == pytest.approx(-1.168, abs=5e-4)
    assert (
        correction(0.1, "frictionless").value.origin == correction(0.4, "frictionless").value.origin
    )
    for nu in (0.0, 0.3, 0.45, 0.5):
        fit = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
        assert correction(nu, "bonded").value.origin == pytest.approx(fit, rel=0.08)


def test_influence_of_an_incompressible_layer_changes_sign_and_dies_out():
    """Volume is kept: the depression of a point force integrates to nothing; it is soon gone."""
    kernel = correction(0.5, "bonded").value
    t = np.linspace(0.01, 40, 20000)
    influence = 1 / t + kernel.value(t)
    assert influence[0] > 0 > influence[np.searchsorted(t, 3.0)]
    assert np.abs(influence[t > 30]).max() < 1e-10
    # The pole of S next to the real axis is at cos y = y, so y = 0.739.
    far = np.abs(influence[[5000, 7500]] * np.sqrt(t[[5000, 7500]]))
    rate = -np.diff(np.log(far))[0] / (t[7500] - t[5000])
    assert rate == pytest.approx(brentq(lambda y: np.cos(y) - y, 0, 1), rel=0.02)
    volume = panels(lambda t: 1 + t * kernel.value(t), 0, 45, 180)
    assert volume == pytest.approx(0, abs=1e-11)


@pytest.mark.parametrize(("base", "nu"), [("bonded", 0.3), ("frictionless", 0.5), ("bonded", 0.45)])
def test_uniform_pressure_from_the_kernel(base, nu):
    """The volume under the influence of a force: p h (1+nu)(1-2nu)/(E(1-nu)) per unit area."""
    kernel = correction(nu, base).value
    modulus = E / (1 - nu**2)
    volume = 2 * np.pi * panels(lambda t: 1 + t * kernel.value(t), 0, 45, 180)
    depression = H * volume / (np.pi * modulus)
    expected = H * (1 + nu) * (1 - 2 * nu) / (E * (1 - nu)) if base == "bonded" else H / modulus
    assert depression == pytest.approx(expected, rel=1e-10)
    assert 2 * halfspace.Layer(H, base).uniform(nu) / modulus == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("x", [0.2, 1.0, 4.0])
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_wave_of_pressure_from_the_kernel(nu, x):
    """Summing the kernel over a wave of pressure gives 2/(E' q) S(q h) p."""
    kernel = correction(nu, "bonded").value
    response = panels(lambda t: j0(x * t) * (1 + t * kernel.value(t)), 0, 45, 200)
    q = x / H
    modulus = E / (1 - nu**2)
    from_kernel = 2 * np.pi * H * response / (np.pi * modulus)
    closed = halfspace.Layer(H).symbol(q, nu) * ref.sinusoidal_depression(1.0, q, modulus)
    assert from_kernel == pytest.approx(closed, rel=1e-10)


# -- the interface -------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [None, (0.1, 0.07)])
@pytest.mark.parametrize("base", BASES)
def test_interface(rng, base, period):
    layer = ground(base, period=period)
    x, f = layout(rng)
    g = rng.standard_normal(len(f))
    c = layer.matrix(x)
    assert np.abs(c - c.T).max() < 1e-15 * np.abs(c).max()
    w, slope = layer.displacement(x, f)
    assert w == pytest.approx(c @ f, rel=1e-12, abs=1e-13 * np.abs(w).max())
    plan = layer.plan(x)
    assert plan.apply(f) == pytest.approx(w, rel=1e-12, abs=1e-13 * np.abs(w).max())
    assert np.array_equal(plan.slope(f), slope)
    assert f @ plan.apply(g) == pytest.approx(g @ plan.apply(f), rel=1e-11)
    plan.refresh(x[::-1] + 1e-3)
    assert plan.apply(f[::-1])[::-1] == pytest.approx(w, rel=1e-9, abs=1e-9 * np.abs(w).max())
    # Where a contact without load lies, the field is what it feels.
    idle = np.where(np.arange(len(f)) == 3, 0.0, f)
    assert layer.field(x, idle, x[3:4]) == pytest.approx(layer.displacement(x, idle)[0][3:4])


@pytest.mark.parametrize("period", [None, (0.1, 0.07)])
def test_slope_is_the_derivative_of_the_energy(rng, period):
    layer = ground(nu=0.5, period=period)
    x, f = layout(rng, 8)
    _, slope = layer.displacement(x, f)

    def error(step):
        worst = 0.0
        for k in range(len(f)):
            for axis in (0, 1):
                move = np.zeros_like(x)
                move[k, axis] = step
                change = f @ (layer.matrix(x + move) - layer.matrix(x - move)) @ f / (4 * step)
                worst = max(worst, abs(change + f[k] * slope[k, axis]))
        return worst

    steps = 4e-5 * 0.5 ** np.arange(3)
    order = np.polyfit(np.log(steps), np.log([error(s) for s in steps]), 1)[0]
    assert order == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("base", BASES)
def test_a_deep_layer_is_the_half_space(rng, base):
    """The difference is D(0)/(pi E' h) times the whole load: the base is felt as one."""
    x, f = layout(rng)
    bare, differences = halfspace.HalfSpace(E, NU).displacement(x, f)[0], []
    depths = 10.0 ** np.arange(1, 5)
    for h in depths:
        differences.append(ground(base, thickness=h).displacement(x, f)[0] - bare)
    modulus = E / (1 - NU**2)
    expected = correction(NU, base).value.origin * f.sum() / (np.pi * modulus * depths)
    assert np.array(differences) == pytest.approx(np.tile(expected, (30, 1)).T, rel=1e-3)
    assert np.array(differences[1:]) == pytest.approx(np.tile(expected[1:], (30, 1)).T, rel=1e-5)


def test_a_thin_layer_is_a_bed_of_springs():
    """Under a wide load of p: p h (1+nu)(1-2nu)/(E(1-nu)), and the ripple between its points, which
    are too near each other to feel the base, as on a half-space."""
    h, pressure = 1e-3, 3.0
    s = h / 2
    x = s * np.stack(np.meshgrid(np.arange(-25, 26), np.arange(-25, 26)), axis=-1).reshape(-1, 2)
    f, middle = np.full(len(x), pressure * s**2), np.array([[s / 2, s / 2]])
    ripple = halfspace.HalfSpace(E, NU, period=(s, s)).field(x[:1], f[:1], middle)[0]
    expected = pressure * h * (1 + NU) * (1 - 2 * NU) / (E * (1 - NU)) + ripple
    assert ground(thickness=h).field(x, f, middle)[0] == pytest.approx(expected, rel=1e-4)
    periodic = ground(thickness=h, period=(s, s)).field(x[:1], f[:1], middle)[0]
    assert periodic == pytest.approx(expected, rel=1e-7)


def test_periodic_cell_is_the_sum_over_its_images(rng):
    period = (0.1, 0.07)
    x, f = layout(rng, 6, 0.07)
    periodic = ground("frictionless", thickness=0.01, period=period).displacement(x, f)
    images = np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-6, 7)), -1).reshape(-1, 2) * period
    free = ground("frictionless", thickness=0.01)
    order = np.r_[np.flatnonzero(~images.any(axis=1)), np.flatnonzero(images.any(axis=1))]
    everywhere = (x + images[order, None]).reshape(-1, 2)
    plan = free.plan(everywhere, method="direct")
    w, slope = plan.displacement(np.tile(f, len(images)))
    assert periodic[0] == pytest.approx(w[:6], rel=1e-10)
    assert periodic[1] == pytest.approx(slope[:6], abs=1e-10 * np.abs(slope).max())
    points = rng.random((5, 2)) * period
    of_cell = ground("frictionless", thickness=0.01, period=period).field(x, f, points)
    assert of_cell == pytest.approx(free.field(everywhere, np.tile(f, len(images)), points), 1e-10)


@pytest.mark.parametrize("period", [None, (0.1, 0.07)])
def test_blocks_give_the_same_sums(rng, period, monkeypatch):
    x, f = layout(rng)
    layer = ground(period=period)
    w, field = layer.plan(x).apply(f), layer.field(x, f, x + 1e-3)
    monkeypatch.setattr(layer_sums, "BLOCK", 70)
    monkeypatch.setattr(layer_sums, "KEEP", 0)
    assert layer.plan(x).apply(f) == pytest.approx(w, rel=1e-12, abs=1e-13 * np.abs(w).max())
    assert layer.field(x, f, x + 1e-3) == pytest.approx(field, rel=1e-12)


def test_sums_as_a_kernel_would_do_them(rng):
    """From the table of coefficients alone, contact by contact, as `docs` describe it."""
    layer, table = ground(nu=0.45), correction(0.45, "bonded").value
    x, f = layout(rng, 6, 0.4)
    w, slope = layer.displacement(x, f)
    for k in range(6):
        depth, uphill = table.origin / H * f[k], np.zeros(2)
        for j in set(range(6)) - {k}:
            d = x[k] - x[j]
            r = float(np.hypot(*d))
            t = r / H
            value, steep = -1 / t, 1 / t**2
            if t < REACH:
                i = int(t / PIECE)
                v = 2 * (t / PIECE - i) - 1
                value = np.polyval(table.coefficients[:, i], v)
                steep = 2 / PIECE * np.polyval(np.polyder(table.coefficients[:, i]), v)
            depth += (1 / r + value / H) * f[j]
            uphill += (1 / r**3 - steep / (H**2 * r)) * d * f[j]
        assert w[k] * np.pi * layer.modulus == pytest.approx(depth, rel=1e-11)
        scale = np.abs(slope).max()
        assert slope[k] == pytest.approx(uphill / (np.pi * layer.modulus), abs=1e-11 * scale)


@pytest.mark.parametrize("thickness", [1e-12, 1e-7, 1e5, 1e12])
def test_layers_of_any_thickness(rng, thickness):
    x, f = layout(rng, 400)
    layer = ground(thickness=thickness)
    w, slope = layer.displacement(x, f)
    assert np.isfinite(w).all() and np.isfinite(slope).all()
    own = correction(NU, "bonded").value.origin / (np.pi * layer.modulus * thickness)
    if thickness < 1:  # none reaches another
        assert w == pytest.approx(own * f, rel=1e-6)
    else:
        deep = halfspace.HalfSpace(E, NU).plan(x, method="direct").displacement(f)
        assert w == pytest.approx(deep[0] + own * f.sum(), rel=1e-4)
    if thickness == 1e-12:
        with pytest.raises(MemoryError, match=r"a layer of 1e-12 m is too thin for that"):
            ground(thickness=thickness, period=(1.0, 1.0)).displacement(x, f)


def test_coincident_contacts_and_far_ones():
    layer = ground()
    x = np.array([[0.1, 0.1], [0.1, 0.1], [1e4, 0.1]])
    w, slope = layer.displacement(x, [1.0, 2.0, 4.0])
    own = correction(NU, "bonded").value.origin / (np.pi * layer.modulus * H)
    assert w == pytest.approx([3 * own, 3 * own, 4 * own], rel=1e-12)
    assert slope == pytest.approx(np.zeros((3, 2)), abs=1e-16)
    assert layer.displacement([], [])[0].shape == (0,)


# -- contacts on it ------------------------------------------------------------------------------


def test_one_sphere_feels_the_base_by_its_own_force():
    """d + D(0) F/(pi E' h) = delta, point coupling."""
    layer = ground(nu=0.5, thickness=1.0, coupling="point")
    law = ref.hertz_law(1.0, layer.modulus)
    own = layer.matrix([[0.0, 0.0]])[0, 0]
    for delta in (1e-4, 0.03):
        state = halfspace.solve(layer, [[0.0, 0.0]], [delta], law, residual=1e-13)

        def surplus(d, delta=delta):
            return d + own * law(np.array(d))[0] - delta

        expected = brentq(surplus, 0, 2 * delta, xtol=1e-16 * delta)
        assert state.overlap[0] == pytest.approx(expected, rel=1e-10)


def test_one_sphere_of_finite_contact():
    """F/F_Hertz = 1 + 1.127 c + 1.482 c^2 + 1.470 c^3 + ..., c = sqrt(R delta)/h, nu = 1/2: to this
    order P. D. Garcia & R. Garcia's 1.133, 1.497 and 1.469 (Biophys. J. 114, 2923, 2018), who take
    their integrals from a fit. The third needs the contact's size."""
    layer = ground(nu=0.5, thickness=1.0)
    law = ref.hertz_law(1.0, layer.modulus)
    chi = 0.01 * np.arange(1, 9)
    ratio = []
    for delta in chi**2:
        state = halfspace.solve(layer, [[0.0, 0.0]], [delta], law, residual=1e-14)
        ratio.append(state.force[0] / law(np.array(delta))[0])
    series = np.polynomial.Polynomial.fit(chi, ratio, 7, domain=[-1, 1]).coef
    assert series[0] == pytest.approx(1, abs=1e-8)
    tables = correction(0.5, "bonded")
    b = -4 / (3 * np.pi) * tables.value.origin
    third = 5 * b**3 - 8 / (15 * np.pi) * tables.laplacian.origin
    assert series[1:4] == pytest.approx([1.5 * b, 21 / 8 * b**2, third], rel=2e-3)
    assert series[1:4] == pytest.approx([1.133, 1.497, 1.469], rel=0.011)


@pytest.mark.parametrize("method", ["direct", "mesh"])
@pytest.mark.parametrize("period", [None, (0.3, 0.24)])
def test_finite_contacts_have_an_energy(rng, period, method):
    """w is its derivative by the force, radii following by Hertz, and f slope that by the place."""
    layer = ground(period=period, thickness=0.05, tolerance=1e-8)
    cells = np.stack(np.meshgrid(np.arange(5), np.arange(4)), -1).reshape(-1, 2)
    x, f = 0.06 * cells + 0.02 * rng.random(cells.shape), 1 + rng.random(20)
    strength, plan = 4e-3, layer.plan(x, method=method)

    def radius(f):
        return strength * np.cbrt(f)

    def displacement(x, f):
        plan.refresh(x)
        return plan.displacement(f, radius(f))

    def energy(x, f):
        """int_0^1 f.w(c f) dc: w(c f) is of c and of c^(5/3)."""
        one, half = (f @ displacement(x, c * f)[0] for c in (1.0, 0.5))
        size = (half - 0.5 * one) / (0.5 ** (5 / 3) - 0.5)
        return (one - size) / 2 + 3 / 8 * size

    w, slope = displacement(x, f)
    right, steep = layer.plan(x, method="direct").displacement(f, radius(f))
    scale = 2 / (np.pi * layer.modulus * 0.06)
    assert np.abs(w - right).max() < layer.tolerance * scale
    assert np.sqrt(np.mean((slope - steep) ** 2)) < layer.tolerance * scale / 0.01
    k = 7
    bump = np.where(np.arange(20) == k, 1e-4, 0.0)
    by_force = (energy(x, f + bump) - energy(x, f - bump)) / 2e-4
    assert by_force == pytest.approx(w[k], rel=1e-7)
    for axis in (0, 1):
        move = np.zeros_like(x)
        move[k, axis] = 1e-5
        by_place = (energy(x + move, f) - energy(x - move, f)) / 2e-5
        assert -f[k] * slope[k, axis] == pytest.approx(by_place, rel=3e-6)


@pytest.mark.parametrize(("base", "nu"), [("bonded", 0.0), ("bonded", 0.5), ("frictionless", 0.3)])
def test_one_sphere_against_the_integral_equation(base, nu):
    """With contacts of finite size the force errs as (a/h)^5, as points as (a/h)^3; and 1 % where
    it is said that they are too wide."""
    errors = {}
    for coupling, order in (("finite", 5), ("point", 3)):
        layer = ground(base, nu, 1.0, coupling=coupling)
        law = ref.hertz_law(1.0, layer.modulus)
        for a in (0.1, 0.2, WIDE[coupling]):
            force, approach = sphere_on_a_layer(a, nu, base)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                state = halfspace.solve(layer, [[0.0, 0.0]], [approach], law, residual=1e-13)
            errors[a] = abs(state.force[0] / (force * layer.modulus) - 1)
        assert np.log2(errors[0.2] / errors[0.1]) > order - 0.5
        assert errors[WIDE[coupling]] < 0.01
    assert sphere_on_a_layer(1e-4, nu, base)[1] == pytest.approx(1e-8, rel=1e-3)


def test_spheres_pressed_on_a_layer(rng):
    """One by the load of the integral equation; several, by approach and by load the same."""
    layer = ground(nu=0.5, thickness=1.0)
    force, approach = sphere_on_a_layer(0.2, 0.5, "bonded")
    one = halfspace.press(layer, [[0.0, 0.0]], 1.0, load=[force * layer.modulus])
    assert one.approach[0] == pytest.approx(approach, rel=3e-4)
    x = 1.2 * np.stack(np.meshgrid(np.arange(3), np.arange(3)), -1).reshape(-1, 2)
    held = halfspace.press(layer, x, 1.0, approach=0.04 + 0.01 * rng.random(9))
    laden = halfspace.press(layer, x, 1.0, load=held.force)
    assert laden.approach == pytest.approx(held.approach, rel=1e-6)
    together = halfspace.press(layer, x, 1.0, load=float(held.force.sum()))
    assert np.ptp(together.approach) == 0
    # What the surface does under one is its own dent and what the others and the base do there.
    depth = held.depression(held.contact)
    assert depth == pytest.approx(held.approach, rel=0.01)


def test_contacts_too_wide_for_a_layer_are_warned_of():
    layer = ground(thickness=1.0)
    law = ref.hertz_law(1.0, layer.modulus)
    with pytest.warns(UserWarning, match=r"contacts of radius 0.521 m are wide for a layer of 1 m"):
        halfspace.solve(layer, [[0.0, 0.0]], [0.2], law)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        halfspace.solve(layer, [[0.0, 0.0]], [0.1], law)


def test_mean_of_the_correction_under_a_hertz_pressure():
    """The field of a contact of some size, against summing the kernel over its pressure."""
    layer = ground(nu=0.4, thickness=1.0)
    kernel = correction(0.4, "bonded").value
    bare = halfspace.HalfSpace(E, 0.4)
    errors = []
    for a in (0.2, 0.1):
        for point in ([0.0, 0.0], [0.7, 0.0]):
            node, weight = np.polynomial.legendre.leggauss(20)
            slant = np.pi / 4 * (node + 1)
            rho, turn = a * np.sin(slant), 2 * np.pi * np.arange(32) / 32
            load = 1.5 * np.cos(slant) ** 2 * np.sin(slant) * weight * np.pi / 2
            distance = np.hypot(point[0] - rho[:, None] * np.cos(turn), rho[:, None] * np.sin(turn))
            exact = kernel.value(distance).mean(axis=1) @ load
            args = [[0.0, 0.0]], [1.0], [point], [a]
            extra = (layer.field(*args) - bare.field(*args))[0] * np.pi * layer.modulus
            errors.append(abs(extra - exact))
    assert np.log2(errors[0] / errors[2]) > 3.7 and np.log2(errors[1] / errors[3]) > 3.7


@pytest.mark.parametrize("period", [None, (0.1, 0.07)])
def test_moments_are_laplacians(rng, period):
    """A force of some extent is four forces around its centre, to the fourth order of their way."""
    x, f = layout(rng, 6)
    kernel = LayerKernel(halfspace.Layer(H), NU)
    errors = []
    for step in (2e-3, 1e-3):
        q = f * step**2 / 4
        around = step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1.0]])
        near, steep, fall, steep_fall = correction_of(x, 1.0, kernel, period).pair_slope(f, q)
        spread = (x[:, None] + around).reshape(-1, 2)
        four = correction_of(spread, 1.0, kernel, period)
        exact = four.at(x, np.repeat(f / 4, 4))
        one = correction_of(x, 1.0, kernel, period)
        assert one.at(x, f, q) == pytest.approx(near, rel=1e-12)
        assert one.pair(f, q)[0] == pytest.approx(near, rel=1e-11)
        assert one.pair(f, q)[1] == pytest.approx(steep, rel=1e-11)
        ring = one.at(spread, f).reshape(-1, 4).mean(axis=1)
        laplacian = 4 * (ring - one.at(x, f)) / step**2
        errors.append([np.abs(near - exact).max(), np.abs(steep - laplacian).max()])
        for index, found in enumerate((fall, steep_fall)):
            for axis in (0, 1):
                move = np.zeros_like(x)
                move[2, axis] = 1e-5
                ahead, behind = (
                    correction_of(x + m, 1.0, kernel, period).pair(f, q)[index][2]
                    for m in (move, -move)
                )
                slope = (behind - ahead) / 2e-5
                assert found[2, axis] == pytest.approx(slope, abs=1e-5 * np.abs(found).max())
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert orders == pytest.approx([4, 2], abs=0.1)


@pytest.mark.filterwarnings("ignore:coupling", "ignore:contacts of radius")
@pytest.mark.parametrize("base", BASES)
def test_spheres_in_equilibrium_on_a_layer(rng, base):
    cells = np.stack(np.meshgrid(np.arange(6), np.arange(6)), -1).reshape(-1, 2)
    x = cells + 0.2 * rng.random(cells.shape)
    overlap = 0.03 * (1 + 0.5 * rng.standard_normal(len(x)))
    layer = halfspace.HalfSpace(1.0, NU, layer=halfspace.Layer(1.0, base), coupling="point")
    law = ref.hertz_law(1.0, layer.modulus)
    state = halfspace.solve(layer, x, overlap, law, residual=1e-12)
    reached = overlap - layer.matrix(x) @ state.force
    closed = state.force > 0
    assert np.abs(state.overlap - reached)[closed].max() < 1e-12 * overlap.max()
    assert np.all(reached[~closed] <= 0)
    assert (law(np.maximum(state.overlap, 0))[0] == state.force).all()
    bare = halfspace.HalfSpace(1.0, NU, coupling="point")
    deep = halfspace.solve(bare, x, overlap, law, residual=1e-12)
    assert state.force.sum() > 1.2 * deep.force.sum()  # neighbours screen each other less


@pytest.mark.filterwarnings("ignore:contacts of radius")
def test_a_contact_too_wide_for_its_layer_is_reported():
    """d - c d^(3/2) = delta has no root for delta > d*/3, d* = (2/(3 c))^2: it is said so."""
    layer = ground(nu=0.5, thickness=1.0, coupling="point")
    law = ref.hertz_law(1.0, layer.modulus)
    own = -layer.matrix([[0.0, 0.0]])[0, 0] * law(np.array(1.0))[0]
    turn = (2 / (3 * own)) ** 2
    largest = turn / 3
    state = halfspace.solve(layer, [[0.0, 0.0]], [0.99 * largest], law, residual=1e-10)
    nearer = brentq(lambda d: d - own * d**1.5 - 0.99 * largest, 0, turn, xtol=1e-15)
    assert state.overlap[0] == pytest.approx(nearer, rel=1e-7)
    with pytest.raises(halfspace.NotConverged) as caught:
        halfspace.solve(layer, [[0.0, 0.0]], [1.01 * largest], law)
    assert np.isfinite(caught.value.state.force).all()


def test_units(rng):
    x, f = layout(rng)
    length, stress = 2.0**-20, 2.0**30
    w, slope = ground().displacement(x, f)
    small = halfspace.HalfSpace(E * stress, NU, layer=halfspace.Layer(H * length))
    scaled = small.displacement(x * length, f * stress * length**2)
    assert scaled[0] == pytest.approx(w * length, rel=1e-13)
    assert scaled[1] == pytest.approx(slope, rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.0,), r"thickness = 0.0: must be a number > 0 m"),
        ((np.inf,), r"thickness = inf: must be a number > 0 m"),
        (("thick",), r"thickness = 'thick': must be a number > 0 m"),
        ((1.0, "glued"), r"base = 'glued': must be 'bonded' or 'frictionless'"),
    ],
)
def test_refused_layers(arguments, words):
    with pytest.raises(ValueError, match=words):
        halfspace.Layer(*arguments)


# -- fast sums -----------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [None, (20.0, 20.0)])
@pytest.mark.parametrize("thickness", [0.3, 2.0, 50.0])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-8])
def test_mesh_meets_its_tolerance(rng, tolerance, thickness, period):
    """Of f_rms/(pi E' s), at a unit spacing and for layers thinner and thicker than that."""
    x = 20 * rng.random((400, 2))
    layer = halfspace.HalfSpace(
        1 / np.pi, 0.0, tolerance, period=period, layer=halfspace.Layer(thickness)
    )
    mesh, direct = layer.plan(x, method="mesh"), layer.plan(x, method="direct")
    assert mesh.choice.grid.cutoff <= thickness
    for f in (rng.standard_normal(400), 2 * rng.random(400)):
        rms = np.sqrt(np.mean(f**2))
        w, slope = mesh.displacement(f)
        right, steep = direct.displacement(f)
        assert np.abs(w - right).max() < tolerance * rms
        spacing = mesh.choice.grid.spacing[0]
        assert np.sqrt(np.mean((slope - steep) ** 2)) * spacing < tolerance * rms
        assert np.abs(mesh.apply(f) - w).max() < 1e-13 * rms


def test_mesh_of_a_layer_is_chosen_renewed_and_explained(rng):
    x = rng.random((3000, 2))
    layer = ground(thickness=0.05)
    plan = layer.plan(x)
    assert plan.choice.method == layer.explain(x).method == "mesh"
    f = rng.random(3000)
    before = plan.apply(f)
    plan.refresh(x + 1e-3)
    scale = np.sqrt(3000.0) / (np.pi * layer.modulus)
    assert np.abs(plan.apply(f) - before).max() < 2 * layer.tolerance * scale
    assert layer.plan(x[:50]).choice.method == "direct"
