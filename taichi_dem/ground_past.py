"""What the substrate keeps of its contact with a particle."""

from typing import Any

from taichi_dem.extrapolation import course_members
from taichi_dem.types import real, ti, vec2, vec3

PAST = 4  # displacements kept: the next one is extrapolated from them
DRIFTS = 2

past_values = ti.types.vector(PAST, real)
past_misses = ti.types.vector(PAST - 1, real)
past_drifts = ti.types.vector(DRIFTS, real)


def ground_type(finite: bool, extrapolates: bool, spreads: bool) -> Any:
    """What the substrate keeps for a particle, whose own surface may rise, too (``spreads``)."""
    # bulge: what it has risen there by the sphere's other contacts, m
    more = {"bulge": real} if spreads else {}
    slopes = {"past_x": past_values, "past_y": past_values} if finite else {}
    return ti.types.struct(
        expansion=real,  # what the surface has risen, where the sphere touches it, by the others, m
        slope=vec2,  # the gradient of that
        force=real,  # elastic, N
        stored=real,  # in the surface, on account of this contact, J
        past=past_values,  # displacements of the last steps, latest first, m
        missed=past_misses,  # by how much lines, parabolas, cubics through them miss, m
        drift=past_drifts,  # what of their changes the solve's matrix does not explain, m
        drifts=ti.i32,  # how many of those there are
        **slopes,
        **(course_members() if extrapolates else {}),
        **more,
        age=ti.i32,  # how many of them there are
        anchor=vec3,  # x, y (m) and squared contact radius (m2) that the solve's matrix is for
        anchored=ti.i32,
        touched=ti.i32,  # what has been noticed of it since it was made: bits of ``doubts``
    )
