"""The ground of a scene: half-space or layer, elastic or creeping, and how it is solved for."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from taichi_dem.material import Material, material_problem
from taichi_dem.shapes import Face
from taichi_dem.validation import Problem, parameter, unknown, validate

COUPLINGS = ("finite", "point")
EXCHANGES = ("implicit", "lagged", "none")
BASES = ("bonded", "frictionless")


@dataclasses.dataclass(frozen=True)
class Layer:
    """What makes a layer of the half-space, on a rigid ``base`` that holds it ("bonded") or lets it
    slide and never lets it lift off ("frictionless")."""

    thickness: float = parameter("m", "thickness", above=0.0)
    base: str = "bonded"

    def __post_init__(self) -> None:
        validate(self, _choice_problem("base", self.base, BASES), name="layer")


@dataclasses.dataclass(frozen=True)
class Relaxation:
    """What makes the ground creep: the standard linear solid, with the material's Young's modulus
    at once and ``relaxed_modulus`` at rest; under a constant load the depression approaches its end
    with ``retardation_time``."""

    relaxed_modulus: float = parameter("Pa", "Young's modulus at rest", above=0.0)
    retardation_time: float = parameter("s", "time of creep under a constant load", above=0.0)

    def __post_init__(self) -> None:
        validate(self, name="relaxation")


@dataclasses.dataclass(frozen=True)
class Substrate:
    """The elastic half-space z < 0, or a ``layer`` of it; with ``relaxation`` it creeps.

    ``exchange`` is how its contacts feel each other: solved together at each step ("implicit"), by
    the forces of the step before ("lagged"), or not at all ("none": a plane at z = 0). Solved
    together every ``exchange_every`` steps only, what the ground does is extrapolated in between.
    ``force_lagged``: a lagged run goes on where the exchange is found to diverge.
    """

    material: Material
    tolerance: float = parameter("-", "of the displacement", default=1e-4, above=0.0, below=1.0)
    coupling: str = "finite"
    exchange: str = "implicit"
    residual: float = parameter("-", "of the coupled solve", default=1e-6, above=0.0, below=1.0)
    layer: Layer | None = None
    relaxation: Relaxation | None = None
    force_lagged: bool = False
    exchange_every: int = 1

    def __post_init__(self) -> None:
        validate(
            self,
            material_problem(self.material),
            self._coupling_problem(),
            _choice_problem("exchange", self.exchange, EXCHANGES),
            _kind_problem("layer", self.layer, Layer),
            self._plane_problem("layer"),
            _kind_problem("relaxation", self.relaxation, Relaxation),
            self._plane_problem("relaxation"),
            *self._relaxation_problems(),
            _flag_problem("force_lagged", self.force_lagged),
            self._every_problem(),
            name="substrate",
        )

    @property
    def homogeneous(self) -> bool:
        """Whether it is an elastic half-space and nothing else, which a kernel can solve for."""
        return self.layer is None and self.relaxation is None

    def faces(self) -> list[Face]:
        """The undeformed surface, as a boundary gives its faces."""
        return [(np.zeros(3), np.array([0.0, 0.0, 1.0]))]

    def _coupling_problem(self) -> Problem | None:
        """The knob for no coupling at all is the other one."""
        if self.coupling != "none":
            return _choice_problem("coupling", self.coupling, COUPLINGS)
        rule = (
            f"must be one of {', '.join(COUPLINGS)}; for contacts that do not feel each other, "
            'exchange = "none"'
        )
        return Problem("coupling", self.coupling, rule)

    def _plane_problem(self, name: str) -> Problem | None:
        """A plane has no depth."""
        if self.exchange != "none" or getattr(self, name) is None:
            return None
        return Problem(name, None, 'must be left out with exchange = "none", a plane')

    def _every_problem(self) -> Problem | None:
        """Only what is solved for can be solved for less often."""
        name, every = "exchange_every", self.exchange_every
        if isinstance(every, bool) or not isinstance(every, int) or every < 1:
            return Problem(name, every, "must be a whole number of steps >= 1")
        if every > 1 and self.exchange != "implicit":
            return Problem(name, every, f"must be 1 with exchange = {self.exchange!r}")
        if every > 1 and self.relaxation is not None:
            rule = "must be 1 with relaxation: the ground's memory follows the force of every step"
            return Problem(name, every, rule)
        return None

    def _relaxation_problems(self) -> Iterator[Problem]:
        """What does not go together with creep."""
        if not isinstance(self.relaxation, Relaxation):
            return
        if isinstance(self.material, Material):
            most, relaxed = self.material.youngs_modulus, self.relaxation.relaxed_modulus
            if relaxed > most:
                rule = f"must be <= {most:g} Pa, the modulus of {self.material.name} at once"
                yield Problem("relaxation.relaxed_modulus", relaxed, rule)
        if self.coupling == "finite":
            rule = (
                "must be 'point' with relaxation, which has no theory for contacts of finite size"
            )
            yield Problem("coupling", self.coupling, rule)
        if self.exchange == "lagged":
            rule = "must be 'implicit' with relaxation, which is solved for as it passes"
            yield Problem("exchange", self.exchange, rule)


def _choice_problem(name: str, value: Any, known: tuple[str, ...]) -> Problem | None:
    return None if value in known else unknown(name, value, value, known, "choice")


def _kind_problem(name: str, value: Any, kind: type) -> Problem | None:
    if value is None or isinstance(value, kind):
        return None
    return Problem(name, value, f"must be a {kind.__name__} or None")


def _flag_problem(name: str, value: Any) -> Problem | None:
    return None if isinstance(value, bool) else Problem(name, value, "must be true or false")
