"""The ground of a scene: an elastic half-space, and how its contacts are solved for."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from taichi_dem.material import Material, material_problem
from taichi_dem.shapes import Face
from taichi_dem.validation import Problem, parameter, unknown, validate

COUPLINGS = ("finite", "point")
EXCHANGES = ("implicit", "lagged", "none")


@dataclasses.dataclass(frozen=True)
class Substrate:
    """The elastic half-space z < 0.

    ``exchange`` is how its contacts feel each other: solved together at each step ("implicit"), by
    the forces of the step before ("lagged"), or not at all ("none": a plane at z = 0).
    ``force_lagged``: a lagged run goes on where the exchange is found to diverge.
    """

    material: Material
    tolerance: float = parameter("-", "of the displacement", default=1e-4, above=0.0, below=1.0)
    coupling: str = "finite"
    exchange: str = "implicit"
    residual: float = parameter("-", "of the coupled solve", default=1e-6, above=0.0, below=1.0)
    layer: None = None
    relaxation: None = None
    force_lagged: bool = False

    def __post_init__(self) -> None:
        validate(
            self,
            material_problem(self.material),
            _choice_problem("coupling", self.coupling, COUPLINGS),
            _choice_problem("exchange", self.exchange, EXCHANGES),
            _not_yet("layer", self.layer, "a layer is"),
            _not_yet("relaxation", self.relaxation, "relaxation is"),
            _flag_problem("force_lagged", self.force_lagged),
            name="substrate",
        )

    def faces(self) -> list[Face]:
        """The undeformed surface, as a boundary gives its faces."""
        return [(np.zeros(3), np.array([0.0, 0.0, 1.0]))]


def _choice_problem(name: str, value: Any, known: tuple[str, ...]) -> Problem | None:
    return None if value in known else unknown(name, value, value, known, "choice")


def _flag_problem(name: str, value: Any) -> Problem | None:
    return None if isinstance(value, bool) else Problem(name, value, "must be true or false")


def _not_yet(name: str, value: Any, what: str) -> Problem | None:
    rule = f"{what} not available yet: must be None"
    return None if value is None else Problem(name, value, rule)
