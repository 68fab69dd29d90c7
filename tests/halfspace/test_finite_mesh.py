"""Contacts of finite size by the particle mesh: as the direct sum, and one energy of its own."""

import numpy as np
import pytest
from layouts import forces, uniform

import halfspace
from halfspace import reference as ref

UNIT = 1 / np.pi  # Young's modulus for which a force f acts by f/r
WIDEST = 0.2  # of the spacing: the contacts' radii under the mean force


def ground(tolerance=1e-6, **more):
    return halfspace.HalfSpace(UNIT, 0.0, tolerance=tolerance, **more)


def radii(f):
    return WIDEST * np.cbrt(np.maximum(f, 0.0))


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def lattice(rng, n):
    """Nearly square, so that no two contacts overlap; one per unit of area."""
    side = int(np.sqrt(n))
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    return cells + rng.uniform(-0.2, 0.2, (side**2, 2))


@pytest.mark.parametrize("period", [None, (32.0, 33.0)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8])
def test_as_the_direct_sum(rng, tolerance, period):
    """Moments act by the Laplacian, which a grid resolves less well: to a few tolerances."""
    x, f = lattice(rng, 1024), forces(rng, 1024, "pressing")
    mesh, sums = (ground(tolerance, period=period).plan(x, method=m) for m in ("mesh", "direct"))
    w, slope = mesh.displacement(f, radii(f))
    right, steep = sums.displacement(f, radii(f))
    assert np.abs(w - right).max() < 5 * tolerance
    assert np.sqrt(np.mean((slope - steep) ** 2)) * mesh.choice.grid.spacing[0] < 8 * tolerance
    assert np.array_equal(mesh.apply(f, radii(f)), w)
    g = rng.standard_normal(1024)
    ours, exact = (plan.tangent(f, radii(f))(g) for plan in (mesh, sums))
    assert np.abs(ours - exact).max() < 8 * tolerance


@pytest.mark.parametrize("period", [None, (40.0, 40.0)])
def test_overlapping_contacts(rng, period):
    """Random places: many overlap, some coincide."""
    x, f = uniform(rng, 1500), forces(rng, 1500, "pressing")
    x[7], x[8], x[1400] = x[3], x[3], x[600]
    mesh, sums = (ground(1e-8, period=period).plan(x, method=m) for m in ("mesh", "direct"))
    w, slope = mesh.displacement(f, radii(f))
    right, steep = sums.displacement(f, radii(f))
    assert w == pytest.approx(right, abs=1e-7)
    assert slope == pytest.approx(steep, abs=1e-6 * np.abs(steep).max())
    assert mesh._sum.closest == sums._sum.closest == 0.0


@pytest.mark.parametrize("period", [None, (32.0, 33.0)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_the_tangent_is_symmetric(rng, tolerance, period):
    x, f = uniform(rng, 1024), forces(rng, 1024, "pressing")
    tangent = ground(tolerance, period=period).plan(x, method="mesh").tangent(f, radii(f))
    g, h = rng.standard_normal((2, 1024))
    both = np.abs(g) @ np.abs(tangent(np.abs(h)))
    assert abs(g @ tangent(h) - h @ tangent(g)) < 1e-13 * both


@pytest.mark.parametrize("period", [None, (25.0, 25.0)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_slope_is_the_derivative_of_the_energy(rng, tolerance, period):
    """Of the energy as summed, whatever its error: differences fall as the square of the step, or
    sooner, where at larger ones a contact meets another cell of a coarse grid."""
    x, f = lattice(rng, 576) + 0.5, forces(rng, 576, "pressing")
    a = radii(f)
    plan = ground(tolerance, period=period).plan(x, method="mesh")
    grid = plan.choice.grid
    direction = rng.standard_normal(x.shape)
    inner = np.abs(x - 12.0).max(axis=1) < 10  # the others stay, and the grid with them
    direction[~inner] = 0
    work = -np.sum(f[:, None] * plan.slope(f, a) * direction)

    def energy():
        """`1/2 f.Gf + q.Lf`, with `w = Gf + Lq + a^2/6 Lf`."""
        near, steep = plan._sum.pair(f, f * a * a / 10)
        return 0.5 * f @ near + 0.05 * (f * a * a) @ steep

    def difference(step):
        found = []
        for sign in (1, -1):
            plan.refresh(x + sign * step * direction)
            found.append(energy())
        assert plan.choice.grid is grid
        return (found[0] - found[1]) / (2 * step)

    steps = 2e-4 * 0.5 ** np.arange(4)
    errors = np.abs([difference(h) - work for h in steps])
    assert errors[-1] < 1e-4 * abs(work)
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 1.7


def test_energy_is_smooth_across_cells_and_cutoff(rng):
    """The work done on a contact that crosses the grid is the change of energy."""
    x, f = lattice(rng, 400), np.ones(400)
    x[0] = [-0.9, -0.9]
    a = radii(f)
    plan = ground(1e-4).plan(x, method="mesh")
    path = np.linspace(0, 0.8, 161)
    energy, force = [], []
    for s in path:
        y = x.copy()
        y[190] += [s, 0.3 * s]
        plan.refresh(y)
        near, steep = plan._sum.pair(f, f * a * a / 10)
        energy.append(0.5 * f @ near + 0.05 * (f * a * a) @ steep)
        force.append(-plan.slope(f, a)[190] @ [1, 0.3])
    work = np.trapezoid(force, path) if hasattr(np, "trapezoid") else np.trapz(force, path)  # noqa: NPY201
    assert energy[-1] - energy[0] == pytest.approx(work, rel=1e-4)


def test_solved_on_the_mesh(rng):
    x = lattice(rng, 1600)
    law = ref.hertz_law(1.0, 1.0)
    states = []
    for method in ("mesh", "direct"):
        here = halfspace.HalfSpace(1.0, 0.0, tolerance=1e-8)
        plan = here.plan(x, method=method)
        states.append(halfspace.solve(here, x, np.full(1600, 0.05), law, plan=plan, residual=1e-8))
        assert plan.choice.method == method
    ours, right = states
    assert ours.force == pytest.approx(right.force, rel=1e-4, abs=1e-5 * right.force.max())
    assert ours.shift == pytest.approx(right.shift, abs=1e-4 * np.abs(right.shift).max())


def test_contacts_wider_than_the_cutoff(rng):
    """A grid that can hold them is taken, or none."""
    x, f = uniform(rng, 1500), forces(rng, 1500, "pressing")
    a = radii(f)
    a[77] = 6.0
    mesh, sums = (ground(1e-6).plan(x, method=m) for m in ("mesh", "direct"))
    before = mesh.choice.grid.cutoff
    assert mesh.apply(f, a) == pytest.approx(sums.apply(f, a), abs=1e-4)
    assert mesh.choice.grid.cutoff > 12.0 > before
