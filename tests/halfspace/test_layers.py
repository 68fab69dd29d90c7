"""Layers of finite thickness on a rigid base: their symbols and what a force does at a distance."""

import numpy as np
import pytest
from elasticity import wave_response
from scipy.optimize import brentq
from scipy.special import j0, j1

import halfspace
from halfspace import reference as ref
from halfspace.layer_kernel import PIECE, REACH, correction
from halfspace.layers import symbol

E, NU, H = 2e4, 0.3, 0.02
POISSONS_RATIOS = (-0.9, 0.0, 0.3, 0.45, 0.5)
CASES = [("bonded", nu) for nu in POISSONS_RATIOS] + [("frictionless", 0.3)]


@pytest.fixture
def rng():
    return np.random.default_rng(11)


# -- the symbol -----------------------------------------------------------------------------------


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


# -- the real-space kernel ------------------------------------------------------------------------


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
