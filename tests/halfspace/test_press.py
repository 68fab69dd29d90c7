"""Spheres pressed into the surface, against closed forms and against boundary elements."""

import numpy as np
import pytest

import halfspace
from halfspace import reference as ref

E, NU = 2e4, 0.45
MODULUS = E / (1 - NU**2)
R = 1e-3
GROUND = halfspace.HalfSpace(E, NU)
POINTS = halfspace.HalfSpace(E, NU, coupling="point")
ROW = [[0, 0], [3 * R, 0], [6 * R, R]]


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def square(side, spacing):
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    return spacing * cells


# Closed forms ------------------------------------------------------------------------------------


@pytest.mark.parametrize("ground", [GROUND, POINTS])
def test_one_sphere_is_hertz(ground):
    depth = 0.04 * R
    pressed = halfspace.press(ground, [[1.0, 2.0]], R, approach=depth)
    force = ref.hertz_stiffness(R, MODULUS) * depth**1.5
    assert pressed.force == pytest.approx([force], rel=1e-12)
    assert pressed.contact_radius == pytest.approx([np.sqrt(R * depth)], rel=1e-12)
    r = np.linspace(0, 5, 40) * pressed.contact_radius[0]
    points = np.stack([1.0 + r, np.full(40, 2.0)], axis=1)
    surface = ref.hertz_surface(r, pressed.contact_radius[0], R)
    assert pressed.depression(points) == pytest.approx(surface, rel=1e-9)
    inside = r < pressed.contact_radius[0]
    peak = 1.5 * force / (np.pi * R * depth)
    right = peak * np.sqrt(1 - (r[inside] / pressed.contact_radius[0]) ** 2)
    assert pressed.pressure(points)[inside] == pytest.approx(right, rel=1e-9, abs=1e-6 * peak)
    assert not pressed.pressure(points)[~inside].any()
    for load in (force, [force]):
        again = halfspace.press(ground, [[0.0, 0.0]], R, load=load)
        assert again.approach == pytest.approx([depth], rel=1e-8)


@pytest.mark.parametrize(
    ("separation", "depth", "share"),
    [(2, 0.01, 0.969), (2, 0.05, 0.934), (4, 0.01, 0.984), (4, 0.05, 0.966)],
)
def test_two_rigid_spheres_as_points(separation, depth, share):
    pressed = halfspace.press(POINTS, [[0, 0], [separation * R, 0]], R, approach=depth * R)
    alone = ref.hertz_stiffness(R, MODULUS) * (depth * R) ** 1.5
    assert pressed.force / alone == pytest.approx([share] * 2, abs=5e-4)
    closed = ref.two_spheres(depth * R, separation * R, R, MODULUS)
    assert pressed.force == pytest.approx([closed] * 2, rel=1e-7)
    assert not (pressed.contact - [[0, 0], [separation * R, 0]]).any()


def test_elastic_spheres():
    """A sphere as compliant as the ground doubles the contact's compliance, not the coupling."""
    alone = halfspace.press(
        GROUND, [[0, 0]], R, approach=0.02 * R, youngs_modulus=E, poissons_ratio=NU
    )
    half = ref.hertz_stiffness(R, MODULUS / 2) * (0.02 * R) ** 1.5
    assert alone.force == pytest.approx([half], rel=1e-12)
    assert alone.depression([[0, 0]]) == pytest.approx([0.01 * R], rel=1e-9)  # of both 0.02 R
    far = halfspace.press(
        POINTS, ROW, R, approach=0.02 * R, youngs_modulus=E, poissons_ratio=NU, residual=1e-12
    )
    law = ref.hertz_law(R, MODULUS / 2)
    state = halfspace.solve(POINTS, ROW, np.full(3, 0.02 * R), law, residual=1e-12)
    assert far.force == pytest.approx(state.force, rel=1e-11)
    stiff = halfspace.press(
        GROUND, ROW, R, approach=0.02 * R, youngs_modulus=1e9 * E, poissons_ratio=0.3
    )
    rigid = halfspace.press(GROUND, ROW, R, approach=0.02 * R)
    assert stiff.force == pytest.approx(rigid.force, rel=1e-7)


# Ways of pressing belong together ----------------------------------------------------------------


@pytest.mark.parametrize("ground", [GROUND, POINTS])
def test_approach_and_loads_agree(ground, rng):
    x, radius = square(3, 1.9 * R), rng.uniform(0.7, 1.0, 9) * R
    by_approach = halfspace.press(ground, x, radius, approach=0.05 * R, residual=1e-11)
    force = by_approach.force
    each = halfspace.press(ground, x, radius, load=force, residual=1e-11)
    assert each.approach == pytest.approx(by_approach.approach, rel=1e-9)
    assert each.contact == pytest.approx(by_approach.contact, abs=1e-8 * R)
    together = halfspace.press(ground, x, radius, load=float(force.sum()), residual=1e-11)
    assert together.force == pytest.approx(force, rel=1e-8)
    assert together.approach == pytest.approx(by_approach.approach, rel=1e-8)
    for result in (by_approach, each, together):
        assert result.residual <= 1e-11 and result.applications >= 1


def test_spheres_that_do_not_touch():
    pressed = halfspace.press(GROUND, ROW, R, approach=[0.05 * R, -0.1 * R, 0.05 * R])
    assert pressed.force[1] == 0 and pressed.contact_radius[1] == 0
    assert pressed.depression([ROW[1]])[0] > 0
    assert not halfspace.press(GROUND, ROW, R, approach=-R).force.any()
    nothing = halfspace.press(GROUND, [], R, approach=0.1 * R)
    assert nothing.force.shape == (0,) and nothing.depression([[0.0, 0.0]]) == [0.0]
    # Without load a sphere just touches the dented surface: a little more, and it carries.
    idle = halfspace.press(GROUND, ROW, R, load=[1e-4, 0.0, 1e-4], residual=1e-12)
    for more, touches in ((1 - 1e-6, False), (1 + 1e-6, True)):
        level = idle.approach * [1, more, 1]
        assert (halfspace.press(GROUND, ROW, R, approach=level).force[1] > 0) == touches


def test_the_surface_follows_the_sphere():
    """Under the middle of each contact the surface is where the sphere's is, nearly."""
    x = square(3, 3 * R)
    pressed = halfspace.press(GROUND, x, R, approach=0.05 * R)
    c = pressed.contact - x
    sphere = 0.05 * R - (c**2).sum(axis=1) / (2 * R)
    assert pressed.depression(pressed.contact) == pytest.approx(sphere, rel=2e-3)


def test_slope_of_the_dented_surface(rng):
    """The gradient of the expansion, by differences that fall as the square of their step."""
    pressed = halfspace.press(GROUND, square(3, 3 * R), R, approach=0.05 * R)
    points = rng.uniform(-R, 7 * R, (40, 2))
    slope = pressed.surface_slope(points)

    def error(h):
        steps = h * np.eye(2)
        ahead, behind = (
            np.stack([pressed.depression(points + sign * step) for step in steps], axis=1)
            for sign in (1, -1)
        )
        return np.abs((behind - ahead) / (2 * h) - slope).max() / np.abs(slope).max()

    assert error(1e-3 * R) < 1e-3
    assert error(1e-3 * R) / error(5e-4 * R) == pytest.approx(4, abs=0.5)


def test_units(rng):
    x, radius = square(3, 2 * R), rng.uniform(0.7, 1.0, 9) * R
    here = halfspace.press(GROUND, x, radius, load=1e-3)
    soft = halfspace.HalfSpace(E * 1e-9, NU)
    there = halfspace.press(soft, 1e6 * x, 1e6 * radius, load=1e-3 * 1e-9 * 1e12)
    assert there.force == pytest.approx(here.force * 1e3, rel=1e-9)
    assert there.approach == pytest.approx(here.approach * 1e6, rel=1e-9)


# Boundary elements -------------------------------------------------------------------------------


def love(x, y, h):
    """Depression at (x, y) by a unit pressure on a square of side 2 h about 0, times pi E'
    (A. E. H. Love, 1929; K. L. Johnson, Contact Mechanics, 1985, eq. 3.25)."""

    def corner(u, v):
        return u * np.arcsinh(v / np.abs(u)) + v * np.arcsinh(u / np.abs(v))

    return corner(x + h, y + h) - corner(x + h, y - h) - corner(x - h, y + h) + corner(x - h, y - h)


def boundary_elements(images, depth, cells=11):
    """Force on a rigid sphere, R = E' = 1, pressed in with mirrored images at the offsets given.

    images: (offset (2,), signs (2,)) of each, the sphere itself included; squares of constant
    pressure, `cells` to the contact radius without neighbours, none of them in tension.
    """
    a = np.sqrt(depth)
    pitch = a / cells
    line = (np.arange(-1.2 * cells, 1.2 * cells) + 0.5) * pitch
    x, y = (v.ravel() for v in np.meshgrid(line, line))
    near = np.hypot(x, y) < 1.1 * a
    x, y = x[near], y[near]
    c = np.zeros((len(x), len(x)))
    for offset, sign in images:
        to = offset[0] + sign[0] * x, offset[1] + sign[1] * y
        c += love(x[:, None] - to[0] + 1e-9 * pitch, y[:, None] - to[1] + 1e-9 * pitch, pitch / 2)
    target = depth - (x * x + y * y) / 2
    active = np.full(len(x), True)
    while True:
        p = np.zeros(len(x))
        p[active] = np.linalg.solve(c[np.ix_(active, active)], np.pi * target[active])
        if (p >= 0).all():
            break
        active &= p > 0
    return p.sum() * pitch**2


@pytest.mark.parametrize("spacing", [2.4, 3.3, 6.0])
def test_four_spheres_against_boundary_elements(spacing):
    """A square of four, each the mirror image of the others: the force, over that of one alone."""
    depth = 0.02
    s = spacing * np.sqrt(depth)
    square = [((0, 0), (1, 1)), ((s, 0), (-1, 1)), ((0, s), (1, -1)), ((s, s), (-1, -1))]
    right = boundary_elements(square, depth) / boundary_elements(square[:1], depth)
    ground = halfspace.HalfSpace(1.0, 0.0)
    x = [offset for offset, _ in square]
    alone = float(ref.hertz_stiffness(1.0, 1.0)) * depth**1.5
    share = halfspace.press(ground, x, 1.0, approach=depth).force / alone
    assert share == pytest.approx([right] * 4, rel=2e-3)


# Refusals ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, r"approach, load: neither given, must be exactly one"),
        ({"approach": 0.1, "load": 1.0}, r"approach, load: both given"),
        ({"approach": np.nan}, r"approach = nan: must be a finite length"),
        ({"approach": [0.1] * 2}, r"approach has shape \(2,\): must be \(3,\)"),
        ({"load": -1.0}, r"load = -1.0: must be a force > 0 N, or one for each sphere"),
        ({"load": [1, -1, 1]}, r"load\[1\] = -1.0: must be >= 0 N"),
        ({"load": 1.0, "radius": 0.0}, r"radius\[0\] = 0.0: must be > 0 m"),
        ({"load": 1.0, "x": []}, r"x has no rows: there must be a sphere"),
        ({"load": 1.0, "youngs_modulus": 1.0}, r"poissons_ratio = None: must be given"),
        (
            {"load": 1.0, "youngs_modulus": 0, "poissons_ratio": 0.3},
            r"youngs_modulus = 0.0: must be a number > 0 Pa",
        ),
        (
            {"load": 1.0, "youngs_modulus": 1, "poissons_ratio": 0.6},
            r"poissons_ratio = 0.6: must be a number with -1 < nu <= 0.5",
        ),
        ({"load": 1.0, "residual": 2.0}, r"residual = 2.0: must be a number between"),
    ],
)
def test_refusals(arguments, words):
    given = {"x": ROW, "radius": R, **arguments}
    with pytest.raises(ValueError, match=words):
        halfspace.press(GROUND, given.pop("x"), given.pop("radius"), **given)


def test_no_equilibrium_says_so():
    with pytest.raises(halfspace.NotConverged, match=r"reached .* after 1 iterations") as caught:
        halfspace.press(GROUND, square(4, R), R, approach=0.1 * R, max_iterations=1)
    assert not caught.value.state.converged and len(caught.value.state.force) == 16
