"""The spheres of a scene: arrays, checked, and the ways to get them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_dem import packing, sphere_files
from taichi_dem.material import Material, distinct
from taichi_dem.overlaps import Pairs, overlapping
from taichi_dem.periodic import Period
from taichi_dem.validation import (
    InputError,
    Problem,
    Range,
    array_problem,
    as_numbers,
    first_few,
    shape_of,
)

_POSITION = Range("m", "centre")
_RADIUS = Range("m", "radius", above=0.0)
_VELOCITY = Range("m/s", "velocity")
_OMEGA = Range("rad/s", "angular velocity")


@dataclasses.dataclass(frozen=True, eq=False)
class Spheres:
    """n spheres, SI units; the arrays are read-only copies.

    ``material`` is one for all, or one for each, or (materials, index of each into them); it is
    kept as ``materials``, the different ones in order of appearance, and ``material_index``. A
    single radius (m), velocity (m/s) or angular velocity ``omega`` (rad/s) holds for all; these
    two are zero unless given. Raises :class:`~taichi_dem.validation.InputError`.
    """

    position: np.ndarray  # (n, 3) m
    radius: np.ndarray  # (n,) m
    material: Material | Sequence[Material] | tuple[Sequence[Material], ArrayLike]
    velocity: np.ndarray = (0.0, 0.0, 0.0)  # type: ignore[assignment]  # (n, 3) m/s
    omega: np.ndarray = (0.0, 0.0, 0.0)  # type: ignore[assignment]  # (n, 3) rad/s
    materials: tuple[Material, ...] = dataclasses.field(init=False)
    material_index: np.ndarray = dataclasses.field(init=False, repr=False)  # (n,) int32

    def __post_init__(self) -> None:
        position = as_numbers(self.position)
        if position is None or position.ndim != 2 or position.shape[1] != 3 or not len(position):
            what = "numbers of shape (n, 3), n >= 1, in m"
            problems = [array_problem("position", self.position, what, 3)]
            n = _rows_meant(self.position)
        else:
            n = len(position)
            problems = self._store("position", (n, 3), _POSITION)
        if n:
            problems += [
                *self._store("radius", (n,), _RADIUS),
                *self._store("velocity", (n, 3), _VELOCITY),
                *self._store("omega", (n, 3), _OMEGA),
                *self._store_materials(n),
            ]
        if problems:
            raise InputError(problems, "spheres")

    def _store(self, name: str, shape: tuple[int, ...], allowed: Range) -> list[Problem]:
        """Keep an array, from one row per sphere or one for all; what is wrong with it."""
        given = getattr(self, name)
        values = as_numbers((0.0, 0.0, 0.0) if given is None else given)
        if values is None or values.shape not in (shape, shape[1:]):
            what = f"numbers of shape {shape}, in {allowed.unit}"
            return [array_problem(name, given, what, *shape[1:])]
        wrong: np.ndarray = np.logical_not(allowed.holds(values))
        if values.ndim < len(shape) and wrong.any():
            return [Problem(name, given, allowed.rule())]
        self._freeze(name, np.broadcast_to(values, shape).copy())
        rows = np.any(np.broadcast_to(wrong, shape).reshape(len(self.position), -1), axis=1)
        return first_few(name, np.asarray(rows), values, allowed.rule())

    def _store_materials(self, n: int) -> list[Problem]:
        given = self.material
        if isinstance(given, Problem):  # of a file that names them
            return [given]
        try:
            kinds, index = _kinds_and_index(given, n)
        except (TypeError, ValueError) as error:
            return [Problem("material", None, str(error))]
        used, first, index = np.unique(index, return_index=True, return_inverse=True)
        order = np.argsort(first)
        object.__setattr__(self, "materials", tuple(kinds[k] for k in used[order]))
        self._freeze("material_index", np.argsort(order)[index].astype(np.int32))
        one = len(self.materials) == 1
        kept = self.materials[0] if one else (self.materials, self.material_index)
        object.__setattr__(self, "material", kept)
        return []

    def _freeze(self, name: str, values: np.ndarray) -> None:
        values.setflags(write=False)
        object.__setattr__(self, name, values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Spheres):
            return NotImplemented
        arrays = ("position", "radius", "velocity", "omega", "material_index")
        return self.materials == other.materials and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in arrays
        )

    __hash__ = None  # type: ignore[assignment]

    @property
    def count(self) -> int:
        """n, the number of spheres."""
        return len(self.radius)

    def overlapping(self, period: Period | None = None) -> Pairs:
        """As :func:`taichi_dem.overlaps.overlapping`; sought once for all who ask."""
        found: dict[Any, Pairs] = self.__dict__.setdefault("_overlapping", {})
        if period not in found:
            found[period] = overlapping(self.position, self.radius, period)
        return found[period]

    @property
    def mass(self) -> np.ndarray:
        """(n,) kg."""
        density = np.array([material.density for material in self.materials])
        return density[self.material_index] * (4 / 3 * math.pi) * self.radius**3

    @classmethod
    def generate(
        cls,
        material: Material,
        *,
        radius: float | tuple[Any, ...],
        region: tuple[ArrayLike, ArrayLike],
        count: int | None = None,
        volume_fraction: float | None = None,
        seed: int = 0,
        periodic: bool = False,
        velocity: Any = (0.0, 0.0, 0.0),
        omega: Any = (0.0, 0.0, 0.0),
    ) -> Spheres:
        """Spheres at random, none overlapping another, all inside ``region``, of which the sides
        along x and y may be the period of the scene.

        See :func:`taichi_dem.packing.generate` for the arguments.
        """
        position, radii = packing.generate(radius, region, count, volume_fraction, seed, periodic)
        return cls(position, radii, material, velocity, omega)

    @classmethod
    def from_lammps_data(
        cls, path: str | Path, materials: Material | Sequence[Material] | Mapping[int, Material]
    ) -> Spheres:
        """Read a LAMMPS or LIGGGHTS data file, ``atom_style sphere``, sorted by id.

        ``materials`` is one for all atom types, or one for each, in order or by number. Their
        densities must be those of the file, to 1e-6.
        """
        return cls(**sphere_files.read_lammps_data(Path(path), materials))

    @classmethod
    def from_csv(
        cls, path: str | Path, material: Material | Sequence[Material] | None = None
    ) -> Spheres:
        """Read a table: x, y, z, radius [, vx, vy, vz] [, wx, wy, wz] [, material], SI units.

        Without a column of material names ``material`` is one for all spheres; with it, the
        materials that the names stand for.
        """
        return cls(**sphere_files.read_csv(Path(path), material))

    @classmethod
    def from_npz(
        cls, path: str | Path, material: Material | Sequence[Material] | None = None
    ) -> Spheres:
        """Read arrays named position, radius [, velocity] [, omega] [, material (names)], or the
        spheres of the ``state.npz`` that a run has left.

        ``material`` as in :meth:`from_csv`.
        """
        return cls(**sphere_files.read_npz(Path(path), material))

    def to_npz(self, path: str | Path) -> None:
        """Write a file that :meth:`from_npz` reads back exactly."""
        sphere_files.write_npz(Path(path), self)


def _rows_meant(position: Any) -> int:
    """How many spheres a list has that is no array of their centres, 0 if it does not tell."""
    rows = position if isinstance(position, (list, tuple)) else ()
    return len(rows) if any(isinstance(row, (list, tuple)) for row in rows) else 0


def _kinds_and_index(given: Any, n: int) -> tuple[tuple[Material, ...], np.ndarray]:
    """The different materials and the index of each sphere into them."""
    rule = "must be a Material, a sequence of n of them, or (materials, index of each)"
    if isinstance(given, Material):
        return (given,), np.zeros(n, dtype=np.int64)
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        raise TypeError(f"{rule}; got {type(given).__name__}")
    if len(given) == 2 and not isinstance(given[0], Material):
        listed, index = tuple(given[0]), np.asarray(given[1])
        if index.dtype.kind not in "iu" or index.shape != (n,):
            raise TypeError(f"index must be integers of shape {(n,)}{shape_of(index)}")
        if index.min() < 0 or index.max() >= len(listed):
            raise ValueError(f"index must be from 0 to {len(listed) - 1}")
    else:
        listed, index = tuple(given), np.arange(n)
        if len(listed) != n:
            raise ValueError(f"must be one material for each of {n} spheres; got {len(listed)}")
    if not all(isinstance(one, Material) for one in listed):
        raise TypeError(rule)
    kinds = distinct(listed)
    number = {kind: k for k, kind in enumerate(kinds)}
    return kinds, np.array([number[one] for one in listed])[index]
