"""Spheres on a layer, against the integral equation of contact and expansions of others."""

import warnings

import numpy as np
import pytest
from elasticity import sphere_on_a_layer
from scipy.optimize import brentq

import halfspace
from halfspace import reference as ref
from halfspace.layer_kernel import correction
from halfspace.plan import WIDE

E, NU, H = 2e4, 0.3, 0.02
BASES = ("bonded", "frictionless")


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def ground(base="bonded", nu=NU, thickness=H, **options):
    return halfspace.HalfSpace(E, nu, layer=halfspace.Layer(thickness, base), **options)


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
