"""The number types of every kernel."""

from halfspace.backend import PRECISION, real, ti

vec2 = ti.types.vector(2, real)
vec3 = ti.types.vector(3, real)

__all__ = ["PRECISION", "real", "ti", "vec2", "vec3"]
