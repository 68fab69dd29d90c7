"""Sides that repeat themselves along x and y: nearest images, in NumPy (in kernels: ``geometry``).

A scene with ``period = (Lx, Ly)`` is one cell of an endless pattern. Positions are those of one
sphere of each family of images and go on without a jump when it leaves the cell; two bodies act on
each other by the images that are nearest. A cell of four of the largest radii is the narrowest in
which no sphere can touch two images of another at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from taichi_dem.shapes import Boundary, Box
from taichi_dem.validation import Problem, as_numbers

Period = tuple[float, float]

LEAST_RADII = 4.0


def nearest_image(apart: np.ndarray, period: Period | None) -> np.ndarray:
    """The shortest of each vector (n, 3) or (n, 2), m, and its images."""
    if period is None:
        return apart
    found = apart.copy()
    found[:, :2] -= np.round(apart[:, :2] / period) * period
    return found


def wrapped(position: np.ndarray, period: Period | None) -> np.ndarray:
    """The images of points (n, 3) or (n, 2), m, with 0 <= x < Lx and 0 <= y < Ly."""
    if period is None:
        return position
    found = position.copy()
    inside = np.mod(position[:, :2], period)
    found[:, :2] = np.where(inside < period, inside, 0.0)  # -1e-30 mod L is L
    return found


def period_problem(value: Any) -> Problem | None:
    """What is wrong with a scene's period, or ``None``."""
    if value is None:
        return None
    lengths = as_numbers(value)
    if lengths is not None and lengths.shape == (2,):
        if np.isfinite(lengths).all() and (lengths > 0).all():
            return None
    return Problem("period", value, "must be two finite lengths > 0 m, [Lx, Ly], or left out")


def narrow_problem(period: Period | None, largest: float, reach: float = 0.0) -> Problem | None:
    """A cell in which spheres of up to the ``largest`` radius (m) could touch two images of one
    another; contacts are held up to ``reach`` (m) past touching."""
    least = LEAST_RADII * largest + 2 * reach
    if period is None or min(period) >= least:
        return None
    held = f" and twice the {reach:.3g} m that contacts are held past touching" if reach else ""
    rule = (
        f"must be at least {least:.6g} m, four times the largest radius{held}: else a sphere could "
        "touch two images of another"
    )
    return Problem("period", period, rule)


def wall_problems(boundaries: tuple[Boundary, ...]) -> Iterator[Problem]:
    """Walls that are not the same everywhere along x and y."""
    rule = "the sides are periodic along x and y"
    for k, wall in enumerate(boundaries):
        if isinstance(wall, Box):
            for name, open_side in (("low", "-inf"), ("high", "inf")):
                corner = getattr(wall, name)
                if np.isfinite(corner[:2]).any():
                    where = f"boundaries[{k}].{name}"
                    yield Problem(where, corner, f"must be {open_side} along x and y: {rule}")
        elif any(normal[:2].any() for _, normal in wall.faces()):
            normal = getattr(wall, "normal", None)
            yield Problem(f"boundaries[{k}].normal", normal, f"must be along z: {rule}")
