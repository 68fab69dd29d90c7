"""Sums by particle mesh, against exact ones and the laws that any sum must keep."""

import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from layouts import (
    LAYOUTS,
    clustered,
    diagonal,
    exact,
    forces,
    lattice,
    line,
    outlier,
    spacing,
    uniform,
)

import halfspace
from halfspace import choice, direct
from halfspace.grid import ACCURACIES, WORST, accuracy

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
UNIT = 1 / np.pi  # Young's modulus for which a force f acts by f/r


def ground(tolerance=1e-6, **more):
    return halfspace.HalfSpace(UNIT, 0.0, tolerance=tolerance, **more)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def worst(x, f, plan, targets):
    """Largest error of the depression, and root mean square of the slope's."""
    w, slope = plan.displacement(f)
    right, steep = exact(x, f, targets)
    return np.abs(w[targets] - right).max(), np.sqrt(np.mean((slope[targets] - steep) ** 2))


def check_accuracy(rng, layout, n, tolerance, sample=150):
    x = layout(rng, n)
    plan = ground(tolerance).plan(x, method="mesh")
    targets = rng.choice(len(x), min(len(x), sample), replace=False)
    # A line's contacts are a unit apart.
    s = 1.0 if layout.__name__ in ("line", "diagonal") else min(spacing(x, rng), 1.0)
    for sign in ("random", "pressing"):
        f = forces(rng, len(x), sign)
        error, _ = worst(x, f, plan, targets)
        assert error * s <= tolerance


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("n", [100, 1000])
def test_accuracy(rng, layout, tolerance, n):
    check_accuracy(rng, layout, n, tolerance)


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_accuracy_for_many(rng, tolerance):
    for layout in (uniform, clustered, line, outlier):
        check_accuracy(rng, layout, 10_000, tolerance, sample=60)


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_accuracy_for_very_many(rng, layout, tolerance):
    if layout is diagonal and tolerance < 1e-6:  # a grid as fine would be empty for the most part
        x = layout(rng, 100_000)
        with pytest.raises(MemoryError, match="GB"):
            ground(tolerance).plan(x, method="mesh")
        assert ground(tolerance).plan(x).choice.method == "direct"
    else:
        check_accuracy(rng, layout, 100_000, tolerance, sample=60)


def test_error_follows_the_settings(rng):
    """Each setting errs by what its row says, so that a tolerance costs no more than it must."""
    x = uniform(rng, 2000)
    targets = np.arange(300)
    for row in ACCURACIES[1::3]:
        plan = ground(WORST * row.error * 1.01).plan(x, method="mesh")
        assert plan.choice.grid.accuracy == row
        f = forces(rng, len(x), "random")
        w = plan.apply(f)
        error = np.sqrt(np.mean((w[targets] - exact(x, f, targets)[0]) ** 2))
        assert 0.2 * row.error < error < 1.5 * row.error


def test_slope_is_as_good(rng):
    """The slope errs by as little as the depression, per cell of the grid."""
    x = uniform(rng, 2000)
    for tolerance in TOLERANCES:
        plan = ground(tolerance).plan(x, method="mesh")
        _, error = worst(x, forces(rng, len(x), "random"), plan, np.arange(200))
        assert error * plan.choice.grid.spacing[0] < tolerance


def test_depression_with_and_without_slope_is_the_same(rng):
    x = uniform(rng, 1500)
    plan = ground(1e-4).plan(x, method="mesh")
    f = forces(rng, len(x), "random")
    w, slope = plan.displacement(f)
    assert np.array_equal(plan.apply(f), w)
    assert np.array_equal(plan.slope(f), slope)


@pytest.mark.parametrize("period", [None, (40.0, 37.0)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-8])
def test_reciprocity(rng, tolerance, period):
    x = uniform(rng, 1500)
    plan = ground(tolerance, period=period).plan(x, method="mesh")
    f, g = forces(rng, len(x), "random"), forces(rng, len(x), "pressing")
    both = np.abs(f) @ np.abs(plan.apply(np.abs(g)))
    assert abs(f @ plan.apply(g) - g @ plan.apply(f)) < 1e-14 * both


def test_action_equals_reaction(rng):
    """No contact moves the others' centre, though none of them is where the grid has points."""
    x = uniform(rng, 1500)
    for tolerance in (1e-2, 1e-6):
        f = forces(rng, len(x), "pressing")
        slope = ground(tolerance).plan(x, method="mesh").slope(f)
        total = np.abs(f[:, None] * slope).sum()
        assert np.abs(f @ slope).max() < tolerance * total


@pytest.mark.parametrize("period", [None, (25.0, 25.0)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_slope_is_the_derivative_of_the_energy(rng, tolerance, period):
    """Of the energy as summed, whatever its error: differences fall as the square of the step."""
    x, f = uniform(rng, 600), forces(rng, 600, "pressing")
    plan = ground(tolerance, period=period).plan(x, method="mesh")
    grid = plan.choice.grid
    direction = rng.standard_normal(x.shape)
    inner = np.abs(x - 12.5).max(axis=1) < 11  # the others stay, and the grid with them
    direction[~inner] = 0
    work = -np.sum(f[:, None] * plan.slope(f) * direction)

    def difference(step):
        energy = []
        for sign in (1, -1):
            plan.refresh(x + sign * step * direction)
            energy.append(0.5 * f @ plan.apply(f))
        assert plan.choice.grid is grid
        return (energy[0] - energy[1]) / (2 * step)

    steps = 1e-4 * 0.5 ** np.arange(4)
    errors = np.abs([difference(h) - work for h in steps])
    assert errors[-1] < 1e-6 * abs(work)
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2, abs=0.3)


def test_energy_is_smooth_across_cells(rng):
    """The work done on a contact that crosses the grid is the change of energy."""
    x, f = lattice(rng, 400), np.ones(400)
    plan = ground(1e-2).plan(x, method="mesh")
    path = np.linspace(0, 2.5, 501)
    energy, pull = [], []
    for s in path:
        x[210] = [10.3 + s, 10.42 + 0.06 * s]
        plan.refresh(x)
        w, slope = plan.displacement(f)
        energy.append(0.5 * f @ w)
        pull.append(-f[210] * slope[210] @ [1.0, 0.06])
    energy, pull = np.array(energy), np.array(pull)
    work = np.concatenate([[0], np.cumsum((pull[1:] + pull[:-1]) / 2 * np.diff(path))])
    assert np.abs(energy - energy[0] - work).max() < 1e-4 * np.ptp(energy)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_shifted_by_part_of_a_cell(rng, tolerance):
    x, f = uniform(rng, 1500), forces(rng, 1500, "pressing")
    plan = ground(tolerance).plan(x, method="mesh")
    cell = plan.choice.grid.spacing[0]
    w = plan.apply(f)
    changes = []
    for part in (0.25, 0.5, 1.0):
        plan.refresh(x + part * cell * np.array([1.0, 0.7]))
        changes.append(np.abs(plan.apply(f) - w).max())
    assert 0 < max(changes) < 2 * tolerance
    plan.refresh(x + cell)
    assert np.abs(plan.apply(f) - w).max() < 1e-12 * np.abs(w).max()  # a whole cell


@pytest.mark.parametrize("side", [1.0, 7.3])
def test_lattice_constant(side):
    """A square lattice of unit forces, mean depression zero."""
    expected = -3.9002649200 / side
    one = ground(period=(side, side))
    assert one.displacement([[0.3, 0.1]], [1.0])[0][0] == pytest.approx(expected, rel=1e-11)
    x = side * np.stack(np.meshgrid(np.arange(30), np.arange(24)), -1).reshape(-1, 2)
    many = ground(1e-10, period=(30 * side, 24 * side)).plan(x, method="mesh")
    assert many.apply(np.ones(len(x))) * side == pytest.approx(-3.9002649200, abs=1e-10)


def ewald(x, f, period, width):
    """The periodic sum by Ewald's Gaussians, with nothing of `halfspace` in it."""
    from scipy.special import erfc

    sides = np.asarray(period)
    w = np.full(len(x), -2 * np.sqrt(np.pi) * width * f.sum() / sides.prod())
    w -= 2 / (np.sqrt(np.pi) * width) * f
    cells = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), -1).reshape(-1, 2)
    for cell in cells:
        r = np.linalg.norm(x[:, None] - x + cell * sides, axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            w += np.where(r > 0, erfc(r / width) / r, 0.0) @ f
    for k in np.stack(np.meshgrid(np.arange(-14, 15), np.arange(-14, 15)), -1).reshape(-1, 2):
        q = 2 * np.pi * k / sides
        size = np.hypot(*q)
        if size > 0:
            wave = np.exp(1j * x @ q)
            share = 2 * np.pi / sides.prod() / size * erfc(size * width / 2)
            w += share * (wave * (f @ wave.conj())).real
    return w


def test_periodic_against_gaussian_ewald(rng):
    period = (3.0, 2.0)
    x, f = rng.random((40, 2)) * period, rng.standard_normal(40)
    plan = ground(period=period).plan(x, method="direct")
    right = ewald(x, f, period, 0.6)
    assert ewald(x, f, period, 0.7) == pytest.approx(right, abs=1e-11)
    assert plan.apply(f) == pytest.approx(right, abs=1e-10)
    assert plan.displacement(f)[0] == pytest.approx(right, abs=1e-10)
    h = 1e-5
    slope = plan.slope(f)
    for axis in (0, 1):
        moved = [x.copy(), x.copy()]
        moved[0][3, axis] += h
        moved[1][3, axis] -= h
        ahead, behind = (ground(period=period).displacement(y, f)[0][3] for y in moved)
        assert -(ahead - behind) / (2 * h) == pytest.approx(slope[3, axis], rel=1e-5)


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("period", [(31.0, 40.0), (100.0, 12.0)])
def test_periodic_accuracy(rng, tolerance, period):
    x = (rng.random((1200, 2)) * 3 - 1) * period  # in any cell
    mesh = ground(tolerance, period=period).plan(x, method="mesh")
    reference = ground(period=period).plan(x, method="direct")
    for sign in ("random", "pressing"):
        f = forces(rng, len(x), sign)
        w, slope = mesh.displacement(f)
        right, steep = reference.displacement(f)
        assert np.abs(w - right).max() < tolerance
        assert np.sqrt(np.mean((slope - steep) ** 2)) < 10 * tolerance
        assert np.abs(mesh.apply(f) - w).max() == 0


def test_free_half_space_is_the_limit_of_a_large_cell(rng):
    x, f = uniform(rng, 60), forces(rng, 60, "random")
    f -= f.mean()
    alone = ground().plan(x).apply(f)
    near = [ground(period=(s, s)).displacement(x, f)[0] for s in (200.0, 400.0)]
    errors = [np.abs(w - w.mean() - alone + alone.mean()).max() for w in near]
    assert errors[1] < 0.15 * errors[0]  # as 1/s^3


def test_patches_of_pressure_get_worse_with_refinement(rng):
    """The scheme not to use: bilinear deposit, influence of rectangles, less its own diagonal."""
    n = 400
    x, f = lattice(rng, n) + rng.uniform(-0.2, 0.2, (n, 2)) + 1, forces(rng, n, "pressing")
    right = exact(x, f, np.arange(n))[0]
    patches = [
        np.abs(patched(x, f, h) - right).max() / np.abs(right).max() for h in (1, 1 / 2, 1 / 9)
    ]
    assert patches[0] < patches[1] < patches[2]
    mesh = np.abs(ground(1e-4).plan(x, method="mesh").apply(f) - right).max() / np.abs(right).max()
    assert mesh < 1e-2 * patches[0]


def patched(x, f, h):
    """f/r as by squares of side h (A. E. H. Love, Phil. Trans. R. Soc. A 228, 377, 1929)."""
    from scipy.signal import fftconvolve

    count = int(np.ceil(x.max() / h)) + 2
    edge = (np.arange(-count, count + 2) - 0.5) * h
    a, b = edge[:, None], edge
    corner = a * np.arcsinh(b / np.abs(a)) + b * np.arcsinh(a / np.abs(b))
    patch = np.diff(np.diff(corner, axis=0), axis=1) / h**2
    place = x / h
    low = place.astype(int)
    part = place - low
    corners = [
        ((low + np.array([i, j])).T, np.prod(np.where((i, j), part, 1 - part), axis=1))
        for i in (0, 1)
        for j in (0, 1)
    ]
    density = np.zeros((count + 1, count + 1))
    for (row, column), share in corners:
        np.add.at(density, (row, column), share * f)
    potential = fftconvolve(density, patch)
    potential = potential[count : 2 * count + 1, count : 2 * count + 1]
    w = sum(share * potential[row, column] for (row, column), share in corners)
    return w - patch[count, count] * f


@pytest.mark.parametrize("period", [None, (40.0, 40.0)])
def test_renewed_plan(rng, period):
    """Moved a little, some gone, some come: as good as a new plan, on the same grid."""
    x = uniform(rng, 1500)
    plan = ground(1e-6, period=period).plan(x, method="mesh")
    grid = plan.choice.grid
    for _ in range(4):
        keep = rng.random(len(x)) > 0.05
        come = 1 + (np.sqrt(1500) - 2) * rng.random((rng.integers(0, 120), 2))
        x = np.concatenate([x[keep] + 0.02 * rng.standard_normal((keep.sum(), 2)), come])
        plan.refresh(x)
        assert plan.choice.grid is grid
        f = forces(rng, len(x), "random")
        right = ground(period=period).plan(x, method="direct").displacement(f)
        assert np.abs(plan.displacement(f)[0] - right[0]).max() < 1e-6
    plan.refresh(3 * x)  # far off the grid, or many times around the cell
    right = ground(period=period).plan(3 * x, method="direct").apply(f)
    assert np.abs(plan.apply(f) - right).max() < 1e-6
    plan.refresh(x[:30])
    assert len(plan.apply(f[:30])) == 30


def test_contacts_that_crowd_get_a_new_grid(rng):
    x = uniform(rng, 3000)
    plan = ground(1e-4).plan(x)
    before = plan.choice.grid
    close = 27 + (x - 27) * 0.05
    plan.refresh(close)
    assert plan.choice.grid.spacing[0] < 0.5 * before.spacing[0]


@pytest.mark.parametrize("period", [None, (40.0, 40.0)])
def test_coincident_contacts(rng, period):
    """Left out of each other's sums, as in the direct sum."""
    x, f = uniform(rng, 1500), forces(rng, 1500, "pressing")
    x[7], x[8], x[1400] = x[3], x[3], x[600]
    mesh, sums = (ground(1e-8, period=period).plan(x, method=m) for m in ("mesh", "direct"))
    w, slope = mesh.displacement(f)
    right, steep = sums.displacement(f)
    assert w == pytest.approx(right, abs=1e-7)
    assert slope == pytest.approx(steep, abs=1e-6 * np.abs(steep).max())
    assert mesh.apply(f) == pytest.approx(right, abs=1e-7)


def test_all_in_one_place():
    x = np.full((5, 2), 0.3)
    for period in (None, (1.0, 1.0)):
        sums = [ground(1e-6, period=period).plan(x, method=m) for m in ("mesh", "direct")]
        w = [s.apply(np.ones(5)) for s in sums]
        assert w[0] == pytest.approx(w[1], abs=1e-5)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_very_few_on_a_mesh(rng, n):
    x, f = uniform(rng, n), np.ones(n)
    w, slope = ground(1e-8).plan(x, method="mesh").displacement(f)
    right, steep = ground().plan(x, method="direct").displacement(f)
    scale = max(np.abs(right).max(), 1.0)
    assert w == pytest.approx(right, abs=1e-7 * scale)
    assert slope == pytest.approx(steep, abs=1e-6 * max(np.abs(steep).max(), 1.0))


def test_no_length_is_built_in(rng):
    """The same in nanometres and kilometres."""
    x, f = uniform(rng, 1200), forces(rng, 1200, "random")
    w = ground(1e-6).plan(x, method="mesh").apply(f)
    for unit in (2.0**-40, 2.0**30):
        again = ground(1e-6).plan(unit * x, method="mesh").apply(f)
        assert again * unit == pytest.approx(w, abs=1e-12 * np.abs(w).max())


def test_few_contacts_are_summed_directly_without_the_compiler(rng):
    use = (
        "import sys, numpy as np, halfspace; g = halfspace.HalfSpace(1.0, 0.3, period={}); "
        "x = np.random.default_rng(1).random((300, 2)); "
        "g.displacement(x, np.ones(300)); print(g.explain(x)); "
        "assert not {{'taichi', 'quadrants'}} & set(sys.modules)"
    )
    for period in ("None", "(1.0, 1.0)"):
        out = run(use.format(period))
        assert b"300 contacts" in out and b"direct sum, because" in out


def run(code, **environment):
    root = str(Path(halfspace.__file__).parents[1])
    env = {**os.environ, "PYTHONPATH": root, **environment}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=True, env=env
    ).stdout


def test_bits_do_not_depend_on_threads():
    code = (
        "import sys, numpy as np, halfspace\n"
        "rng = np.random.default_rng(2)\n"
        "x, f = 50 * rng.random((3000, 2)), rng.random(3000)\n"
        "for period in (None, (50.0, 45.0)):\n"
        "    g = halfspace.HalfSpace(1.0, 0.3, period=period, workers={})\n"
        "    plan = g.plan(x, method='mesh')\n"
        "    for part in (plan.apply(f), *plan.displacement(f)):\n"
        "        sys.stdout.buffer.write(part.tobytes())\n"
    )
    one = run(code.format(1), HALFSPACE_THREADS="1")
    two = run(code.format(2), HALFSPACE_THREADS="2")
    three = run(code.format("None"), HALFSPACE_THREADS="3")
    assert len(one) == 2 * 8 * 3000 * 4
    assert one == two == three


@pytest.mark.slow
def test_bits_of_a_coupled_solve_do_not_depend_on_threads():
    """With so many contacts that products of vectors would be shared among threads."""
    code = (
        "import sys, numpy as np, halfspace\n"
        "rng = np.random.default_rng(2)\n"
        "x = 0.2 * np.indices((105, 105)).reshape(2, -1).T + rng.uniform(-0.01, 0.01, (11025, 2))\n"
        "law = halfspace.reference.hertz_law(1.0, 1.0)\n"
        "ground = halfspace.HalfSpace(1.0, 0.0)\n"
        "found = halfspace.solve(ground, x, rng.uniform(0, 1e-3, 11025), law)\n"
        "sys.stdout.buffer.write(found.force.tobytes())\n"
    )
    one, two = (run(code, HALFSPACE_THREADS=n, OPENBLAS_NUM_THREADS=n) for n in "12")
    assert len(one) == 8 * 11025
    assert one == two


def test_choice(rng):
    few, many = (ground().explain(uniform(rng, n)) for n in (100, 20_000))
    assert (few.method, many.method) == ("direct", "mesh")
    assert many.memory < choice.MEMORY
    text = str(many)
    for words in (
        "20000 contacts with sizes",
        "mesh sum, because",
        "grid",
        "considered: direct sum",
    ):
        assert words in text
    points = ground(coupling="point").explain(uniform(rng, 20_000))
    assert "sizes" not in str(points)
    assert many.time > 1.5 * points.time and many.memory > 1.5 * points.memory
    far = outlier(rng, 20_000)
    far[10_000] = 1e7
    fallen = ground().explain(far)
    assert fallen.method == "direct" and "cannot tell those close together apart" in str(fallen)
    assert fallen.memory < 2**28
    with pytest.raises(MemoryError, match="the mesh takes"):
        ground().plan(far, method="mesh")
    assert ground(1e-12).explain(uniform(rng, 5000)).method == "direct"
    with pytest.raises(ValueError, match=r"tolerance = 1e-12: the particle mesh reaches"):
        ground(1e-12).plan(uniform(rng, 5000), method="mesh")
    with pytest.raises(ValueError, match="method = 'fast': must be None or 'direct' or 'mesh'"):
        ground().plan([[0, 0]], method="fast")


def test_a_looser_tolerance_is_cheaper():
    settings = [accuracy(t) for t in TOLERANCES]
    assert all(a.width < b.width for a, b in pairwise(settings))


def test_solve_takes_a_plan_along(rng):
    x = uniform(rng, 1500)
    law = halfspace.reference.hertz_law(1.0, 1.0)
    here = halfspace.HalfSpace(1.0, 0.0, tolerance=1e-8, coupling="point")
    plan = here.plan(x, method="mesh")
    for move in (0.0, 0.05):
        state = halfspace.solve(here, x + move, np.full(1500, 0.02), law, plan=plan)
        alone = halfspace.solve(here, x + move, np.full(1500, 0.02), law)
        assert state.force == pytest.approx(alone.force, rel=1e-4, abs=1e-6 * alone.force.max())
    c = direct.DirectSum(x + move, here.modulus).matrix()
    assert state.displacement == pytest.approx(c @ state.force, abs=1e-6)
