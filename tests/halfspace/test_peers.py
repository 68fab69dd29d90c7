"""Arrays of spheres against boundary elements that others wrote.

ContactMechanics (L. Pastewka and others): Fourier transforms on a padded grid, hard walls,
constrained conjugate gradients. Run with `-m peers`.
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
