"""What a user asks of a simulation, looked at before anything is computed."""

import math

import numpy as np

from taichi_dem.guards import FARTHEST_STEP
from taichi_dem.pace import WAYS
from taichi_dem.spheres import Spheres
from taichi_dem.validation import InputError, Problem, Range, number_problem, unknown

DRIVERS = ("auto", *WAYS)

_STEP = Range("s", "time step", above=0)
_SKIN = Range("m", "how far beyond touching contacts are listed", above=0)
_DEEPEST = Range("-", "share of the smaller radius", above=0, at_most=1)
_DURATION = Range("s", "simulated time", at_least=0)


def refuse_options(dt: float | None, driver: str, max_overlap: float, skin: float | None) -> None:
    """Raise ``InputError`` with all that is wrong with the arguments of a ``Simulation``."""
    problems = [number_problem("max_overlap", max_overlap, _DEEPEST)]
    if driver not in DRIVERS:
        problems.append(unknown("driver", driver, driver, DRIVERS, "driver"))
    if dt is not None:
        problems.append(number_problem("dt", dt, _STEP))
    if skin is not None:
        problems.append(number_problem("skin", skin, _SKIN))
    if found := [problem for problem in problems if problem]:
        raise InputError(found)


def refuse_step(dt: float | None, spheres: Spheres) -> None:
    """Raise ``InputError`` for a step that is none, or in which a sphere would go too far at first;
    None is right."""
    if dt is None:
        return
    if problem := number_problem("dt", dt, _STEP):
        raise InputError([problem])
    speed = np.linalg.norm(spheres.velocity, axis=1)
    row = int((speed / spheres.radius).argmax())
    if (limit := FARTHEST_STEP * spheres.radius[row]) <= speed[row] * dt:
        rule = (
            f"must be < {limit / speed[row]:.3g} s: sphere {row} at {speed[row]:.3g} m/s would "
            f"move more than {FARTHEST_STEP:g} of its radius in a step, through others perhaps"
        )
        raise InputError([Problem("dt", dt, rule)])


def steps_asked(duration: float | None, steps: int | None, dt: float) -> int:
    """How many steps of ``dt`` (s) a run of ``duration`` (s) or of ``steps`` has; raises
    ``InputError`` unless just one of them is given, and right."""
    if (duration is None) == (steps is None):
        raise InputError([Problem("duration", None, "give either duration (s) or steps")])
    if steps is not None:
        if isinstance(steps, bool) or not isinstance(steps, (int, np.integer)) or steps < 0:
            raise InputError([Problem("steps", steps, "must be a whole number >= 0")])
        return int(steps)
    if problem := number_problem("duration", duration, _DURATION):
        raise InputError([problem])
    assert duration is not None
    return math.ceil(duration / dt * (1 - 1e-12))
