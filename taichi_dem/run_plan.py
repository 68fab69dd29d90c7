"""How long a scene is to run, and what is to be written meanwhile: ``[run]`` of a scene file."""

from __future__ import annotations

import dataclasses
from numbers import Real
from typing import Any

from taichi_dem.validation import Problem, parameter, validate

_SWITCHES = {
    "energy_balance": "whether what is lost is summed up",
    "estimate_neglected": "whether what the scene leaves out is estimated at the end",
    "effect_costs": "whether what each effect takes of a step is timed at the end",
}


@dataclasses.dataclass(frozen=True)
class Run:
    """How long to run a scene (``duration`` or ``steps``) and how often to write what."""

    duration: float | None = parameter("s", "simulated time", default=None, above=0.0)
    steps: int | None = None
    dt: float | None = parameter("s", "time step", default=None, above=0.0)
    frames: float | None = parameter("s", "time between frames", default=None, above=0.0)
    history: float | None = parameter("s", "time between lines", default=None, above=0.0)
    energy_balance: bool = True
    estimate_neglected: bool = True
    effect_costs: bool = False

    def __post_init__(self) -> None:
        problems = []
        if self.steps is not None:
            whole = isinstance(self.steps, int) and not isinstance(self.steps, bool)
            if not whole or self.steps < 1:
                problems.append(Problem("steps", self.steps, "must be a whole number >= 1"))
            if self.duration is not None:
                problems.append(Problem("steps", self.steps, "give duration or steps, not both"))
        if _numbers(self.dt, self.duration) and self.dt > self.duration:  # type: ignore[operator]
            rule = f"must be at most the duration, {self.duration:g} s, of which it is one step"
            problems.append(Problem("dt", self.dt, rule))
        for name, meaning in _SWITCHES.items():
            if not isinstance(value := getattr(self, name), bool):
                problems.append(Problem(name, value, f"must be true or false: {meaning}"))
        validate(self, *problems, name="run")


def _numbers(*values: Any) -> bool:
    return all(isinstance(value, Real) and not isinstance(value, bool) for value in values)
