"""What a sphere, a boundary or the substrate is made of."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

from taichi_dem.validation import Problem, parameter, validate


@dataclasses.dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material; materials are told apart by ``name``."""

    name: str
    density: float = parameter("kg/m3", "density", above=0.0)
    youngs_modulus: float = parameter("Pa", "Young's modulus", above=0.0)
    poissons_ratio: float = parameter("-", "Poisson's ratio", above=-1.0, at_most=0.5)

    def __post_init__(self) -> None:
        good = isinstance(self.name, str) and self.name and self.name.isprintable()
        problem = None if good else Problem("name", self.name, "must be a name, not empty")
        validate(self, problem, name=f"materials.{self.name}" if good else "material")

    @property
    def shear_wave_speed(self) -> float:
        """sqrt(G/density), m/s."""
        shear_modulus = self.youngs_modulus / (2 * (1 + self.poissons_ratio))
        return math.sqrt(shear_modulus / self.density)


def material_problem(value: Any, path: str = "material") -> Problem | None:
    """What is wrong with ``value`` as a material, or ``None``."""
    return None if isinstance(value, Material) else Problem(path, value, "must be a Material")


def distinct(materials: Iterable[Material]) -> tuple[Material, ...]:
    """The different ones, in order of appearance."""
    return tuple(dict.fromkeys(materials))
