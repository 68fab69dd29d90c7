"""Force vectors on the half-space: Boussinesq's and Cerruti's kernels."""

import numpy as np
import pytest
from elasticity import wave_response

import halfspace
from halfspace import tangential

E, NU = 2e4, 0.3
G = E / (2 * (1 + NU))


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def ground():
    return halfspace.VectorHalfSpace(E, NU)


def layout(rng, n=20):
    return rng.uniform(0, 0.1, (n, 2)), rng.standard_normal((n, 3))


def symbol(angle, nu):
    """The 3x3 response to a wave, times G q; `u(q) = int u exp(-i q.x)`."""
    way = np.array([np.cos(angle), np.sin(angle)])
    s = np.zeros((*angle.shape, 3, 3), complex)
    s[..., :2, :2] = np.eye(2) - nu * np.einsum("a...,b...->...ab", way, way)
    s[..., :2, 2] = 0.5j * (1 - 2 * nu) * np.moveaxis(way, 0, -1)
    s[..., 2, :2] = -s[..., :2, 2]
    s[..., 2, 2] = 1 - nu
    return s


@pytest.mark.parametrize("nu", [-0.5, 0.0, 0.3, 0.49])
def test_symbols_solve_the_equations_of_elasticity(nu):
    """A wave on a layer ten wavelengths deep; along x the third axis, y, is sheared alone.

    With u ~ sin and w ~ cos, u(q) = -i/2 u and w(q) = w/2 at +q; w and the load are downward here.
    """
    s = symbol(np.array(0.0), nu)
    u, up = wave_response(20.0, nu, "bonded", (0.0, -1.0))  # f = 1
    assert [u, -up] == pytest.approx([(s[0, 2] / -1j).real, s[2, 2].real], abs=1e-7)
    u, up = wave_response(20.0, nu, "bonded", (1.0, 0.0))  # t = 1
    assert [u, -up] == pytest.approx([s[0, 0].real, (s[2, 0] * -1j).real], abs=1e-7)
    assert s[1, 1] == 1  # antiplane shear: u = t/(G q)


@pytest.mark.parametrize("nu", [-0.5, 0.3, 0.5])
def test_kernel_against_its_symbols(nu):
    """A load spread as a Gaussian, summed in real space and in Fourier space."""
    ground = halfspace.VectorHalfSpace(E, nu)
    width, load = 1.0, np.array([0.7, -0.4, 1.3])
    angle = 2 * np.pi * np.arange(128) / 128
    node, weight = np.polynomial.legendre.leggauss(160)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    kernel = ground.field([[0.0, 0.0]], [load], way)  # at r = 1: it falls as 1/r
    s = symbol(angle, nu) @ load / ground.shear_modulus
    for point in np.array([[0.0, 0.0], [1.1, 0.3], [-0.5, 2.5]]):
        reach = 10 * width
        r = reach * (node + 1) / 2
        source = point - r[:, None, None] * way
        density = np.exp(-(source**2).sum(axis=-1) / 2 / width**2) / (2 * np.pi * width**2)
        real = np.einsum("r,ra,ai->i", weight * reach / 2, density, kernel) * 2 * np.pi / 128
        q = 9 * (node + 1) / 2
        wave = np.exp(1j * q[:, None] * (way @ point) - (q[:, None] * width) ** 2 / 2)
        fourier = (
            np.einsum("r,ra,ai->i", weight * 9 / 2, wave, s) * 2 * np.pi / 128 / (4 * np.pi**2)
        )
        assert np.abs(fourier.imag).max() < 1e-14 * np.abs(fourier).max()
        assert real == pytest.approx(fourier.real, rel=1e-9, abs=1e-12 * np.abs(real).max())


def test_normal_forces_alone_are_boussinesqs(ground, rng):
    x, f = layout(rng)
    f[:, :2] = 0
    normal = halfspace.HalfSpace(E, NU)
    w, slope = normal.displacement(x, f[:, 2])
    assert ground.displacement(x, f)[:, 2] == pytest.approx(w, rel=1e-12)
    assert ground.plan(x).slope(f) == pytest.approx(slope, rel=1e-11)
    points = rng.uniform(0.2, 0.3, (4, 2))
    assert ground.field(x, f, points)[:, 2] == pytest.approx(normal.field(x, f[:, 2], points))


def test_signs(ground):
    """A normal force draws the surface in; a tangential one moves it along, sinks it ahead."""
    u = ground.field([[0, 0]], [[0, 0, 1.0]], [[0.1, 0]])[0]
    assert u[0] == pytest.approx(-(1 - 2 * NU) / (4 * np.pi * G * 0.1)) and u[2] > 0
    u = ground.field([[0, 0]], [[1.0, 0, 0]], [[0.1, 0], [-0.1, 0], [0, 0.1]])
    assert (u[:, 0] > 0).all() and u[0, 2] > 0 > u[1, 2] and u[2, 2] == 0
    assert u[0, 0] == pytest.approx(1 / (2 * np.pi * G * 0.1))
    assert u[2, 0] == pytest.approx((1 - NU) / (2 * np.pi * G * 0.1))


def test_reciprocity(ground, rng):
    x, f = layout(rng)
    g = rng.standard_normal(f.shape)
    plan = ground.plan(x)
    assert (f * plan.apply(g)).sum() == pytest.approx((g * plan.apply(f)).sum(), rel=1e-12)
    c = ground.matrix(x)
    assert np.abs(c - c.T).max() < 1e-15 * np.abs(c).max()
    assert (c @ f.ravel()).reshape(-1, 3) == pytest.approx(plan.apply(f), rel=1e-11, abs=1e-16)
    own = np.arange(len(x))
    assert not c.reshape(len(x), 3, len(x), 3)[own, :, own].any()


def test_incompressible_ground_does_not_couple(rng):
    x, f = layout(rng)
    rubber = halfspace.VectorHalfSpace(E, 0.5)
    tangential, normal = f * [1, 1, 0], f * [0, 0, 1]
    assert not rubber.displacement(x, tangential)[:, 2].any()
    assert not rubber.displacement(x, normal)[:, :2].any()


def test_rotation_and_translation(ground, rng):
    x, f = layout(rng)
    turn = np.array([[np.cos(0.7), -np.sin(0.7), 0], [np.sin(0.7), np.cos(0.7), 0], [0, 0, 1]])
    turned = ground.displacement(x @ turn[:2, :2].T + [3.0, -1.0], f @ turn.T)
    expected = ground.displacement(x, f) @ turn.T
    assert turned == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())
    mirror = np.array([-1.0, 1.0, 1.0])
    assert ground.displacement(x * mirror[:2], f * mirror) == pytest.approx(
        ground.displacement(x, f) * mirror, rel=1e-12
    )


def test_slope_is_the_derivative_of_the_expansion(ground, rng):
    x, f = layout(rng, 8)
    slope = ground.plan(x).slope(f)

    def error(step):
        worst = 0.0
        for k in range(len(x)):
            for axis in (0, 1):
                move = np.zeros_like(x)
                move[k, axis] = step
                ahead, behind = (ground.displacement(x + m, f)[k, 2] for m in (move, -move))
                worst = max(worst, abs((behind - ahead) / (2 * step) - slope[k, axis]))
        return worst

    steps = 1e-4 * 0.5 ** np.arange(4)
    order = np.polyfit(np.log(steps), np.log([error(s) for s in steps]), 1)[0]
    assert order == pytest.approx(2, abs=0.05)


def test_tangential_forces_in_the_normal_problem(ground):
    """Known tractions move the normal problem: the overlaps less what they sink the surface by."""
    x, t = np.array([[0.0, 0.0], [0.05, 0.0]]), 0.02
    pushed = np.array([[t, 0, 0], [0, 0, 0.0]])
    extra = ground.displacement(x, pushed)[:, 2]
    assert extra[1] > 0 == extra[0]
    law = halfspace.reference.hertz_law(0.02, E)
    normal = halfspace.HalfSpace(E, NU)
    plain = halfspace.solve(normal, x, np.full(2, 1e-3), law)
    ahead = halfspace.solve(normal, x, np.full(2, 1e-3) - extra, law)
    assert ahead.force[1] < plain.force[1]


def test_blocks_give_the_same_sums(ground, rng, monkeypatch):
    x, f = layout(rng)
    u, slope = ground.displacement(x, f), ground.plan(x).slope(f)
    field = ground.field(x, f, x + 1e-3)
    monkeypatch.setattr(tangential, "BLOCK", 70)
    monkeypatch.setattr(tangential, "KEEP", 0)
    close = {"rel": 1e-12, "abs": 1e-13 * np.abs(u).max()}
    assert ground.displacement(x, f) == pytest.approx(u, **close)
    assert ground.plan(x).slope(f) == pytest.approx(slope, rel=1e-12)
    assert ground.field(x, f, x + 1e-3) == pytest.approx(field, **close)


def test_coincident_none_and_far(ground, rng):
    x = np.array([[0.0, 0.0], [0.0, 0.0], [1e5, 0.0]])
    u = ground.displacement(x, rng.standard_normal((3, 3)))
    assert np.isfinite(u).all() and u[0] == pytest.approx(u[1])
    assert ground.displacement([], []).shape == (0, 3)
    assert np.isnan(ground.field(x, np.ones((3, 3)), x)).all()
    assert ground.matrix([]).shape == (0, 0)


@pytest.mark.parametrize(
    ("x", "f", "words"),
    [
        ([[0, 0]], [[1, 1]], r"f has shape \(1, 2\): must be \(1, 3\), one vector per contact"),
        ([[0, 0]], [[1, np.nan, 1]], r"f\[0, 1\] = nan: must be finite"),
        ([[0, 0, 0]], [[1, 1, 1]], r"x has shape \(1, 3\): must be \(n, 2\)"),
    ],
)
def test_refused_loads(ground, x, f, words):
    with pytest.raises(ValueError, match=words):
        ground.displacement(x, f)
    with pytest.raises(ValueError, match=r"poissons_ratio = 0.6: must be"):
        halfspace.VectorHalfSpace(E, 0.6)
