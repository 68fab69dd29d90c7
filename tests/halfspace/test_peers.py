"""Against what others wrote: arrays of spheres by boundary elements, sums by Fourier transforms.

ContactMechanics (L. Pastewka and others): free space, Fourier transforms on a padded grid, hard
walls, constrained conjugate gradients. Tamaas (L. Frérot and others): the same in a periodic cell.
FINUFFT (A. Barnett and others): transforms of what lies anywhere. Run with `-m peers`.
"""

import numpy as np
import pytest

import halfspace
from halfspace import reference as ref

pytestmark = pytest.mark.peers


def boundary_elements(side, spacing, depth, pixels):
    """Forces (side, side) on rigid spheres, R = E' = 1, on one level; `pixels` to the radius that
    one alone would have. The spacing is a whole number of pixels, so that all meet the grid
    alike."""
    contact = pytest.importorskip("ContactMechanics")
    surface = pytest.importorskip("SurfaceTopography")
    pitch = np.sqrt(depth) / pixels
    cell = round(spacing / pitch)
    n = side * cell if side > 1 else 4 * pixels
    cell = n // side
    line = (np.arange(n) % cell - (cell - 1) / 2) * pitch
    heights = -(line[:, None] ** 2 + line**2) / 2
    topography = surface.Topography(heights, (n * pitch, n * pitch))
    substrate = contact.FreeFFTElasticHalfSpace((n, n), 1.0, (n * pitch, n * pitch))
    system = contact.Systems.NonSmoothContactSystem(substrate, topography)
    result = system.minimize_proxy(offset=depth, pentol=1e-8 * depth)
    assert result.success
    force = np.abs(np.asarray(system.force)[:n, :n])
    return force.reshape(side, cell, side, cell).sum(axis=(1, 3))


CASES = [(side, apart) for side in (2, 3, 4, 5) for apart in (2.2, 2.4, 3.3, 6.0)]
CASES += [(2, 20.0), (3, 20.0)]


@pytest.mark.parametrize(("side", "apart"), CASES)
def test_arrays(side, apart):
    """apart: spacing over the contact radius of a sphere alone at that approach; the forces, over
    that of a sphere alone. Nothing depends on the approach: the spheres are paraboloids."""
    pytest.importorskip("ContactMechanics")
    depth, pixels = 0.02, 24 if side * apart <= 30 else 16
    spacing = round(apart * pixels) / pixels * np.sqrt(depth)
    cells = np.stack(np.meshgrid(*(np.arange(side),) * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = halfspace.HalfSpace(1.0, 0.0)
    pressed = halfspace.press(ground, spacing * cells, 1.0, approach=depth)
    force = boundary_elements(side, spacing, depth, pixels)
    alone = boundary_elements(1, 0.0, depth, pixels)[0, 0]
    ours = pressed.force.reshape(side, side) / (ref.hertz_stiffness(1.0, 1.0) * depth**1.5)
    error = np.abs(ours / (force / alone) - 1).max()
    widest = spacing / pressed.contact_radius.max()
    print(f"{side}x{side} s/a {apart:g}, {widest:.2f} of the largest: {error:.2%}")
    assert error < (0.002 if apart >= 3.3 else 0.004)


def periodic_boundary_elements(side, spacing, length, load, pixels):
    """Forces (side, side) on rigid spheres, R = E' = 1, on one level in a cell of that length."""
    tamaas = pytest.importorskip("tamaas")
    pitch = spacing / pixels
    n = round(length / pitch)
    place = (np.arange(n) + 0.5) * pitch
    # To the nearest sphere, in both directions, the array in the middle of the cell.
    first = (length - (side - 1) * spacing) / 2
    nearest = np.clip(np.round((place - first) / spacing), 0, side - 1).astype(int)
    away = place - first - nearest * spacing
    heights = -(away[:, None] ** 2 + away**2) / 2
    model = tamaas.ModelFactory.createModel(tamaas.model_type.basic_2d, [length] * 2, [n] * 2)
    model.E, model.nu = 1.0, 0.0
    solver = tamaas.PolonskyKeerRey(model, heights, 1e-12)
    solver.max_iter = 3000
    assert solver.solve(load / length**2) < 1e-11
    force = np.asarray(model.traction).reshape(n, n) * pitch**2
    owner = nearest[:, None] * side + nearest
    return np.bincount(owner.ravel(), force.ravel(), side**2).reshape(side, side)


IN_A_CELL = [(side, apart) for side in (2, 3, 4, 5) for apart in (2.4, 3.3, 6.0)]


@pytest.mark.parametrize(("side", "apart"), IN_A_CELL)
def test_arrays_in_a_periodic_cell(side, apart):
    """apart: as above; under the load that the array would carry at that approach without a cell,
    which has the width of two more spheres."""
    pixels, spacing = {2.4: 60, 3.3: 80, 6.0: 100}[apart], 1.0
    length = (side + 2) * spacing
    cells = np.stack(np.meshgrid(*(np.arange(side),) * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    alone = halfspace.press(
        halfspace.HalfSpace(1.0, 0.0), cells * spacing, 1.0, approach=(spacing / apart) ** 2
    )
    load = float(alone.force.sum())
    right = periodic_boundary_elements(side, spacing, length, load, pixels)
    assert right.sum() == pytest.approx(load, rel=1e-9)
    ground = halfspace.HalfSpace(1.0, 0.0, period=(length, length))
    pressed = halfspace.press(ground, cells * spacing, 1.0, load=load)
    error = np.abs(pressed.force.reshape(side, side) / right - 1).max()
    spread = np.ptp(right) / right.mean()
    print(f"{side}x{side} s/a {apart:g}: {error:.2%}, forces differ by {spread:.1%}")
    assert error < (0.002 if apart >= 3.3 else 0.004)


def ewald(x, f, length, width):
    """Sums of f/r in a square cell, mean zero, by Gaussians: waves by FINUFFT, pairs by a tree."""
    from scipy.spatial import cKDTree
    from scipy.special import erfc

    finufft = pytest.importorskip("finufft")
    modes = 2 * int(np.ceil(12.5 / width * length / (2 * np.pi))) + 2
    u, v = (np.ascontiguousarray(2 * np.pi * axis / length - np.pi) for axis in x.T)
    k = 2 * np.pi / length * np.arange(-(modes // 2), (modes + 1) // 2)
    q = np.hypot(k[:, None], k)
    symbol = np.divide(erfc(q * width / 2), q, out=np.zeros_like(q), where=q > 0)
    strengths = finufft.nufft2d1(u, v, f.astype(complex), (modes, modes), eps=1e-13, isign=-1)
    w = finufft.nufft2d2(u, v, symbol * strengths, eps=1e-13, isign=1).real
    w *= 2 * np.pi / length**2
    w -= 2 * np.sqrt(np.pi) * width * f.sum() / length**2 + 2 / (np.sqrt(np.pi) * width) * f
    tree = cKDTree(x, boxsize=length)
    for i, j in [tree.query_pairs(6 * width, output_type="ndarray").T]:
        d = x[i] - x[j]
        d -= np.round(d / length) * length
        r = np.hypot(*d.T)
        near = erfc(r / width) / r
        w += np.bincount(i, near * f[j], len(x)) + np.bincount(j, near * f[i], len(x))
    return w


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
@pytest.mark.parametrize("n", [1000, 20_000])
def test_sums_against_finufft(n, tolerance):
    rng = np.random.default_rng(9)
    length = np.sqrt(n)
    x, f = length * rng.random((n, 2)), rng.standard_normal(n)
    f /= np.sqrt(np.mean(f**2))
    right = ewald(x, f, length, 0.8)
    assert ewald(x, f, length, 1.0) == pytest.approx(right, abs=1e-10)
    ground = halfspace.HalfSpace(1 / np.pi, 0.0, tolerance=tolerance, period=(length, length))
    w = ground.plan(x, method="mesh").apply(f)
    assert np.abs(w - right).max() < tolerance
