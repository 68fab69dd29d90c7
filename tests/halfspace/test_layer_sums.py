"""Sums over contacts on a layer: direct, periodic, and by particle mesh."""

import numpy as np
import pytest

import halfspace
from halfspace import layer_sums
from halfspace.layer_kernel import PIECE, REACH, LayerKernel, correction
from halfspace.layer_sums import correction_of

E, NU, H = 2e4, 0.3, 0.02
BASES = ("bonded", "frictionless")


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def ground(base="bonded", nu=NU, thickness=H, **options):
    return halfspace.HalfSpace(E, nu, layer=halfspace.Layer(thickness, base), **options)


def layout(rng, n=30, size=0.1):
    return size * rng.random((n, 2)), 2 * rng.random(n)


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


def test_units(rng):
    x, f = layout(rng)
    length, stress = 2.0**-20, 2.0**30
    w, slope = ground().displacement(x, f)
    small = halfspace.HalfSpace(E * stress, NU, layer=halfspace.Layer(H * length))
    scaled = small.displacement(x * length, f * stress * length**2)
    assert scaled[0] == pytest.approx(w * length, rel=1e-13)
    assert scaled[1] == pytest.approx(slope, rel=1e-12)


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


# -- fast sums ------------------------------------------------------------------------------------


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
