"""Tensors in, tensors out, with the same numbers as from NumPy's arrays."""

import warnings

import numpy as np
import pytest

import halfspace
from halfspace import arrays
from halfspace import reference as ref

torch = pytest.importorskip("torch", reason="PyTorch is not installed (the extra `torch`)")

PERIOD = (40.0, 37.0)
LAYER = halfspace.Layer(3.0)


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def layout(rng, n=900):
    return 40.0 * rng.random((n, 2)), rng.uniform(0.5, 1.5, n), rng.uniform(0.05, 0.2, n)


def tensors(*values):
    return tuple(torch.as_tensor(value) for value in values)


def same(ours, right, rel=1e-12):
    """Tensors, and to rounding what NumPy gives."""
    ours, right = (v if isinstance(v, tuple) else (v,) for v in (ours, right))
    for tensor, array in zip(ours, right, strict=True):
        assert isinstance(tensor, torch.Tensor) and isinstance(array, np.ndarray)
        assert tensor.dtype == torch.float64 and tensor.shape == array.shape
        assert tensor.numpy() == pytest.approx(array, rel=rel, abs=rel * np.abs(array).max())


@pytest.mark.parametrize(
    ("method", "kind"),
    [
        ("direct", {}),
        ("direct", {"period": PERIOD}),
        ("direct", {"layer": LAYER}),
        ("mesh", {}),
        ("mesh", {"period": PERIOD, "layer": LAYER}),
    ],
)
def test_sums(rng, method, kind):
    ground = halfspace.HalfSpace(1.0, 0.3, tolerance=1e-2, **kind)
    x, f, a = layout(rng, 900 if method == "mesh" else 150)
    plans = [ground.plan(y, method=method) for y in (x, torch.as_tensor(x))]
    for shift in (0.0, 0.3):
        for plan, moved in zip(plans, (x + shift, torch.as_tensor(x + shift)), strict=True):
            plan.refresh(moved)
        load = tensors(f, a)
        for name in ("apply", "slope", "displacement"):
            right, ours = (getattr(plan, name) for plan in plans)
            same(ours(load[0]), right(f))
            same(ours(*load), right(f, a))
        same(plans[1].tangent(*load)(load[0]), plans[0].tangent(f, a)(f))
    assert str(ground.explain(torch.as_tensor(x))) == str(ground.explain(x))


def test_a_plan_may_change_its_kind(rng):
    x, f, _ = layout(rng)
    ground = halfspace.HalfSpace(1.0, 0.3, tolerance=1e-2)
    right = ground.plan(x, method="mesh").apply(f)
    plan = ground.plan(torch.as_tensor(x), method="mesh")
    same(plan.apply(f), right)  # as the contacts are, not as the forces
    plan.refresh(x)
    assert np.array_equal(plan.apply(torch.as_tensor(f)), right)


@pytest.mark.parametrize("coupling", ["finite", "point"])
@pytest.mark.parametrize("spacing", [0.35, 1.0])
def test_solve(rng, coupling, spacing):
    cells = np.stack(np.meshgrid(np.arange(6), np.arange(6)), -1).reshape(-1, 2)
    x = spacing * (cells + rng.uniform(-0.1, 0.1, cells.shape))
    overlap = 0.05 * (1 + 0.5 * rng.standard_normal(36))
    ground, law = halfspace.HalfSpace(1.0, 0.0, coupling=coupling), ref.hertz_law(1.0, 1.0)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "coupling = ")
        right = halfspace.solve(ground, x, overlap, law, residual=1e-11)
        ours = halfspace.solve(ground, *tensors(x, overlap), law, residual=1e-11)
        again = halfspace.solve(
            ground, *tensors(x, overlap), law, start=ours.overlap, shift=ours.shift
        )
    assert (ours.iterations, ours.applications) == (right.iterations, right.applications)
    assert again.iterations == 0 and ours.softening == right.softening
    for name in ("force", "overlap", "displacement", "slope", "tangent", "shift", "contact_radius"):
        same(getattr(ours, name), getattr(right, name), rel=1e-8)


def test_solve_on_the_mesh(rng):
    cells = np.stack(np.meshgrid(np.arange(30), np.arange(30)), -1).reshape(-1, 2)
    x, overlap = cells + rng.uniform(-0.1, 0.1, cells.shape), np.full(900, 0.02)
    ground, law = halfspace.HalfSpace(1.0, 0.0, tolerance=1e-2), ref.hertz_law(1.0, 1.0)
    plans = ground.plan(x, method="mesh"), ground.plan(torch.as_tensor(x), method="mesh")
    right = halfspace.solve(ground, x, overlap, law, plan=plans[0])
    ours = halfspace.solve(ground, *tensors(x, overlap), law, plan=plans[1])
    assert ours.applications == right.applications
    same(ours.force, right.force, rel=1e-10)


@pytest.mark.parametrize("ask", [{"approach": 0.05}, {"load": 2.0}, {"load": "each"}])
def test_press(rng, ask):
    x = np.array([[0.0, 0.0], [1.0, 0.1], [0.2, 1.1], [3.0, 3.0]])
    ours = theirs = ask
    if "each" in ask.values():
        each = rng.uniform(0.001, 0.02, 4)
        ours, theirs = {"load": torch.as_tensor(each)}, {"load": each}
    ground = halfspace.HalfSpace(1.0, 0.3)
    pressed = halfspace.press(ground, torch.as_tensor(x), 1.0, **ours)
    right = halfspace.press(ground, x, 1.0, **theirs)
    for name in ("force", "contact_radius", "approach", "displacement", "slope", "contact"):
        same(getattr(pressed, name), getattr(right, name), rel=1e-7)
    points = rng.uniform(-1, 4, (50, 2))
    same(pressed.pressure(points), right.pressure(points), rel=1e-6)
    same(pressed.depression(points), right.depression(points), rel=1e-6)
    assert pressed.draw() is not None


@pytest.mark.parametrize("period", [None, PERIOD])
def test_fields(rng, period):
    ground = halfspace.HalfSpace(1.0, 0.3, period=period)
    x, f, a = layout(rng, 20)
    points = rng.uniform(0, 40, (30, 2))
    given, places = tensors(x, f), torch.as_tensor(points)
    for name in ("field", "field_slope"):
        ask = getattr(ground, name)
        same(ask(*given, places, torch.as_tensor(a)), ask(x, f, points, a))
    same(ground.pressure(*given, torch.as_tensor(a), places), ground.pressure(x, f, a, points))
    same(ground.matrix(given[0]), ground.matrix(x))


@pytest.mark.parametrize("n", [0, 1])
def test_none_and_one(n):
    ground = halfspace.HalfSpace(1.0, 0.3)
    x, f = torch.zeros((n, 2)), torch.ones(n)
    w, slope = ground.displacement(x, f)
    assert w.shape == (n,) and slope.shape == (n, 2)
    state = halfspace.solve(ground, x, 0.1 * f, ref.hertz_law(1.0, 1.0))
    assert state.force.shape == (n,) and state.converged


def test_whatever_is_given_in_single_precision_or_with_gradients_comes_back_double(rng):
    x, f, _ = layout(rng, 30)
    ground = halfspace.HalfSpace(1.0, 0.3)
    single = [value.to(torch.float32).requires_grad_() for value in tensors(x, f)]
    w, slope = ground.displacement(*single)
    assert w.dtype == slope.dtype == torch.float64
    assert not w.requires_grad
    strided = torch.as_tensor(np.ascontiguousarray(x.T)).T  # not contiguous
    same(ground.displacement(strided, f), ground.displacement(x, f))


@pytest.mark.parametrize(
    ("x", "f", "words"),
    [
        ([[0.0, 0.0, 0.0]], [1.0], r"x has shape \(1, 3\): must be \(n, 2\)"),
        ([[0.0, 0.0]], [1.0, 2.0], r"f has shape \(2,\): must be \(1,\)"),
        ([[0.0, float("nan")]], [1.0], r"x\[0, 1\] = nan: must be finite"),
    ],
)
def test_refusals(x, f, words):
    with pytest.raises(ValueError, match=words):
        halfspace.HalfSpace(1.0, 0.3).displacement(torch.tensor(x), torch.tensor(f))


def test_least_squares_is_numpys(rng):
    """Also where columns depend on each other."""
    a, b = rng.standard_normal((40, 3)), rng.standard_normal(40)
    a[:, 2] = a[:, 1] + 1e-11 * a[:, 0]
    right = arrays.NUMPY.least_squares(a, b, 1e-8)
    same(arrays.kind_of(torch.empty(0)).least_squares(*tensors(a, b), 1e-8), right, rel=1e-9)
