"""The surface anywhere: depression and pressure, free and periodic, and the picture of it."""

import subprocess
import sys

import numpy as np
import pytest

import halfspace

MODULUS = 1.0
PERIOD = (1.0, 1.3)
FREE = halfspace.HalfSpace(MODULUS, 0.0)
CELL = halfspace.HalfSpace(MODULUS, 0.0, period=PERIOD)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def waves(x, f, a, points, highest=250):
    """The field of Hertz pressures in a periodic cell, wave by wave: `2 p(q)/(E' q)`."""
    m = np.arange(-highest, highest + 1)
    q = 2 * np.pi * np.stack(np.meshgrid(m, m), axis=-1).reshape(-1, 2) / PERIOD
    q = q[(q != 0).any(axis=1)]
    length = np.hypot(*q.T)
    z = length[:, None] * a
    shape = 3 * (np.sin(z) - z * np.cos(z)) / z**3
    pressure = (np.exp(-1j * q @ x.T) * shape) @ f / np.prod(PERIOD)
    return (np.exp(1j * points @ q.T) @ (2 * pressure / (MODULUS * length))).real


def test_periodic_hertz_pressures(rng):
    """To the waves left out, which fall as the fourth power of their number."""
    x, f = rng.uniform(0, 1, (4, 2)) * PERIOD, rng.uniform(0.5, 1, 4)
    a = np.array([0.25, 0.1, 0.05, 0.2])
    points = np.r_[x[:2], x[1] + [[0.12, 0.0], [0.05, 0.02]], rng.uniform(-1, 2, (6, 2))]
    right = waves(x, f, a, points)
    assert CELL.field(x, f, points, a) == pytest.approx(right, abs=3e-5 * np.abs(right).max())


def test_periodic_fields_without_size_are_those_of_points(rng):
    x, f, points = rng.uniform(0, 1, (5, 2)), rng.uniform(0.5, 1, 5), rng.uniform(0, 1, (7, 2))
    assert CELL.field(x, f, points, np.zeros(5)) == pytest.approx(CELL.field(x, f, points))
    small = CELL.field(x, f, points, np.full(5, 1e-6))
    assert small == pytest.approx(CELL.field(x, f, points), rel=1e-6)
    assert np.isposinf(CELL.field(x, f, x)).all()
    assert np.isfinite(CELL.field(x, f, x, np.full(5, 1e-3))).all()


def test_periodic_fields_repeat_and_join(rng):
    x, f, a = rng.uniform(0, 1, (4, 2)), rng.uniform(0.5, 1, 4), rng.uniform(0, 0.2, 4)
    points = rng.uniform(0, 1, (9, 2))
    w = CELL.field(x, f, points, a)
    assert CELL.field(x, f, points + [3 * PERIOD[0], -PERIOD[1]], a) == pytest.approx(w, rel=1e-9)
    # Where the nearest image changes nothing jumps.
    sides = x[0] + 0.5 * np.array(PERIOD) * [[1 - 1e-9, 0.3], [1 + 1e-9, 0.3]]
    left, right = CELL.field(x[:1], f[:1], sides, np.array([0.25]))
    assert left == pytest.approx(right, abs=1e-6)


def test_contacts_too_wide_for_the_cell():
    for ask in (
        lambda: CELL.field([[0, 0]], [1.0], [[0.1, 0]], [0.3]),
        lambda: CELL.displacement([[0, 0], [0.1, 0]], [1.0, 1.0], [0.3, 0.3]),
    ):
        with pytest.raises(ValueError, match="must be at most a quarter of the period's shorter"):
            ask()


@pytest.mark.parametrize("ground", [FREE, CELL])
def test_mean_under_a_contact_is_what_it_feels(ground, rng):
    """The depression by the others, in the mean over a contact's own pressure, to higher order."""
    x = np.array([[0.3, 0.3], [0.7, 0.35], [0.5, 0.9]])
    f, a = np.array([1.0, 0.7, 1.2]), np.array([0.05, 0.08, 0.06])
    node, weight = np.polynomial.legendre.leggauss(20)
    r, angle = np.sqrt((node + 1) / 2), np.arange(12) * np.pi / 6
    pressure = 1.5 * np.sqrt(1 - r * r) * weight / 2
    disc = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], axis=-1)
    for k in range(3):
        others = f * (np.arange(3) != k)
        points = (x[k] + a[k] * disc).reshape(-1, 2)
        mean = pressure @ ground.field(x, others, points, a).reshape(20, 12).mean(axis=1)
        # Besides, w knows what growing costs: a^2/6 of the Laplacian, of which the mean is a^2/10.
        fixed = np.where(np.arange(3) == k, np.sqrt(0.6), 1.0) * a
        w = ground.displacement(x, others, fixed)[0][k]
        assert w == pytest.approx(mean, rel=2e-3)


def test_slope_of_the_field_is_the_slope_of_the_contacts():
    """Far from others, where a contact's own size does not count."""
    x, f, a = np.array([[0.0, 0.0], [3.0, 1.0]]), np.array([0.0, 1.0]), np.array([0.0, 0.3])
    h = 1e-4
    points = h * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    w = FREE.field(x, f, points, a)
    gradient = np.array([w[1] - w[0], w[3] - w[2]]) / (2 * h)
    assert FREE.displacement(x, f, a)[1][0] == pytest.approx(gradient, rel=1e-4)


def test_pressure(rng):
    x, f, a = np.array([[0.1, 0.2], [0.8, 1.1]]), np.array([2.0, 3.0]), np.array([0.2, 0.1])
    n = 400
    cells = (np.stack(np.meshgrid(*(np.arange(n),) * 2), axis=-1).reshape(-1, 2) + 0.5) / n
    area = np.prod(PERIOD) / n**2
    for shift in ([0.0, 0.0], [0.15, -0.3]):  # the second is cut by the cell's edges
        p = CELL.pressure(x + shift, f, a, cells * PERIOD)
        assert p.sum() * area == pytest.approx(5.0, rel=1e-3)
    assert FREE.pressure(x, f, a, x) == pytest.approx(1.5 * f / (np.pi * a**2))
    assert not FREE.pressure(x, f, a, [[5.0, 5.0]]).any()
    assert np.isposinf(FREE.pressure(x, f, 0 * a, x)).all()
    assert not FREE.pressure(x, f, 0 * a, [[5.0, 5.0]]).any()


# The picture -------------------------------------------------------------------------------------


def test_picture_shows_the_field_and_the_contacts():
    pytest.importorskip("matplotlib")
    x, f, a = np.array([[0.0, 0.0], [2e-3, 1e-3]]), np.array([1e-3, 2e-3]), np.array([1e-4, 2e-4])
    axes = halfspace.draw_dents(FREE, x, f, a, window=(-1e-3, 3e-3, -1e-3, 2e-3), points=80)
    (image,) = axes.images
    shown = np.asarray(image.get_array())
    assert shown.shape == (60, 80)
    column, row = 70, 10  # cell middles
    point = [[-1e-3 + 70.5 * 4e-3 / 80, -1e-3 + 10.5 * 3e-3 / 60]]
    expected = FREE.field(x, f, point, a)[0]
    factor = shown[row, column] / expected
    assert np.log10(factor) == pytest.approx(round(np.log10(factor)), abs=1e-9)
    (circles,) = axes.collections
    assert circles.get_offsets() == pytest.approx(1e3 * x)
    assert "mm" in axes.get_xlabel()
    assert "depression (" in axes.figure.axes[1].get_ylabel()


def test_picture_of_a_periodic_cell_repeats_contacts_at_its_edges(tmp_path):
    pytest.importorskip("matplotlib")
    axes = halfspace.draw_dents(CELL, [[0.0, 0.65]], [1.0], [0.1], points=40)
    (circles,) = axes.collections
    assert len(circles.get_offsets()) == 2  # at the left and at the right
    axes.figure.savefig(tmp_path / "dents.png")
    assert (tmp_path / "dents.png").stat().st_size > 1000


def test_picture_in_axes_of_the_users_and_of_nothing():
    figure = pytest.importorskip("matplotlib.figure").Figure()
    axes = figure.add_subplot()
    pressed = halfspace.press(FREE, [[0, 0], [1, 0]], 0.5, approach=0.01)
    assert pressed.draw(axes, points=20) is axes
    halfspace.draw_dents(FREE, [], [], [], points=10)


def test_importing_does_not_load_matplotlib():
    code = "import sys, halfspace; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
