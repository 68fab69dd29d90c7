"""Boundaries as data: where the walls are, what they are made of and how they move."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from taichi_dem.material import Material, material_problem
from taichi_dem.validation import (
    INF,
    Problem,
    as_numbers,
    first_few,
    parameter,
    set_vectors,
    validate,
)

Vector = tuple[float, float, float]
Face = tuple[np.ndarray, np.ndarray]  # a point (3,) m; the unit normal (3,) into the domain


class Boundary:
    """A set of flat infinite rigid faces; the domain is on the side their normals point to."""

    material: Material

    @property
    def kind(self) -> str:
        """The name of the class, as scene files have it."""
        return type(self).__name__

    @property
    def moves(self) -> bool:
        """Whether it ever leaves its place, or drags along what touches it."""
        return False

    def faces(self) -> list[Face]:
        """Each face at time zero."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class Plane(Boundary):
    """A wall through ``point`` (m); ``normal`` points into the domain and may have any length.

    ``velocity`` (m/s) is constant: its normal part moves the wall, its tangential part makes the
    surface a conveyor.
    """

    point: Vector
    normal: Vector
    material: Material
    velocity: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        validate(
            self,
            *set_vectors(self, "point", "normal", "velocity"),
            _direction_problem(self.normal),
            material_problem(self.material),
        )

    @property
    def moves(self) -> bool:
        return any(self.velocity)

    def faces(self) -> list[Face]:
        return [_face(self.point, self.normal)]


@dataclasses.dataclass(frozen=True)
class Box(Boundary):
    """Fixed walls around ``low`` < x < ``high`` (m); an infinite entry means no wall there.

    The faces are ordered low x, high x, low y, high y, low z, high z, without the absent ones.
    """

    low: Vector
    high: Vector
    material: Material

    def __post_init__(self) -> None:
        problems = set_vectors(self, "low", "high", infinite=True)
        if not problems:
            if any(low >= high for low, high in zip(self.low, self.high, strict=True)):
                problems.append(Problem("low", self.low, f"must be below high = {self.high}"))
            elif not any(map(math.isfinite, self.low + self.high)):
                problems.append(Problem("low", self.low, "must leave at least one finite wall"))
        validate(self, *problems, material_problem(self.material))

    def faces(self) -> list[Face]:
        axes = np.eye(3)
        return [
            (axes[axis] * corner[axis], axes[axis] * sign)
            for axis in range(3)
            for corner, sign in ((self.low, 1.0), (self.high, -1.0))
            if math.isfinite(corner[axis])
        ]


@dataclasses.dataclass(frozen=True)
class Piston(Boundary):
    """A flat infinite plate that starts at ``point`` (m) and moves along ``normal``.

    The normal points into the domain, the way the plate pushes. Exactly one of these says how it
    moves: a constant ``velocity`` (m/s, > 0 into the domain); a ``program`` of (time, displacement)
    pairs (s, m; piecewise linear from (0, 0), held after the last); a ``load`` (N, > 0 into the
    domain) on a plate of ``mass`` (kg), which moves freely under it and the contact forces.
    """

    point: Vector
    normal: Vector
    material: Material
    velocity: float | None = parameter("m/s", "along the normal", default=None)
    program: tuple[tuple[float, float], ...] | None = None
    load: float | None = parameter("N", "along the normal", default=None)
    mass: float | None = parameter("kg", "mass of the plate", default=None, above=0.0)

    def __post_init__(self) -> None:
        problems = [
            *set_vectors(self, "point", "normal"),
            _direction_problem(self.normal),
            material_problem(self.material),
        ]
        motion = [n for n in ("velocity", "program", "load") if getattr(self, n) is not None]
        if len(motion) != 1:
            given = " and ".join(motion) or "none"
            rule = f"exactly one of velocity, program, load must be given; given: {given}"
            problems.append(Problem("velocity", None, rule))
        if self.load is not None and self.mass is None:
            problems.append(Problem("mass", None, "must be given with a load, in kg"))
        if self.load is None and self.mass is not None:
            problems.append(Problem("mass", self.mass, "has no meaning without a load"))
        if self.program is not None:
            problems += self._set_program()
        validate(self, *problems)

    def _set_program(self) -> list[Problem]:
        pairs = as_numbers(self.program)
        if pairs is None or pairs.ndim != 2 or pairs.shape[1] != 2 or not len(pairs):
            return [Problem("program", self.program, "must be (time, displacement) pairs, s and m")]
        problems = first_few("program", ~np.isfinite(pairs).all(axis=1), pairs, "must be finite")
        early = np.diff(pairs[:, 0], prepend=-INF) <= 0
        early |= pairs[:, 0] < 0
        problems += first_few("program", early, pairs, "times must be >= 0 s and increase")
        if not problems and pairs[0, 0] == 0 and pairs[0, 1] != 0:
            problems.append(Problem("program[0]", pairs[0], "must start at displacement 0 m"))
        object.__setattr__(self, "program", tuple(map(tuple, pairs.tolist())))
        return problems

    @property
    def moves(self) -> bool:
        if self.program is not None:
            return any(displacement != 0 for _, displacement in self.program)
        return self.load is not None or self.velocity != 0

    def faces(self) -> list[Face]:
        return [_face(self.point, self.normal)]


BOUNDARIES = {kind.__name__: kind for kind in (Plane, Box, Piston)}


def _face(point: Vector, normal: Vector) -> Face:
    return np.array(point), np.array(normal) / math.hypot(*normal)


def _direction_problem(normal: Vector) -> Problem | None:
    zero = as_numbers(normal)
    if zero is not None and zero.shape == (3,) and not zero.any():
        return Problem("normal", normal, "must not be the zero vector")
    return None
