"""Which settings are worth a try together, from what each knob did alone."""

from __future__ import annotations

from collections.abc import Iterator

from taichi_dem import orders
from taichi_dem.record import even_step
from taichi_dem.settings import Settings
from taichi_dem.study_point import TARGETS, Point
from taichi_dem.study_result import Reference, Study

ROOM = 0.2  # of a target, for each knob but the step in a combination
AIM = 0.8  # of what is left of a target, for the step
ABSOLUTE = ("energy drift", "rebound")  # errors with no other run to compare with


def combinations(
    study: Study, reference: Reference, twin: Settings, stable: float
) -> Iterator[tuple[float, Settings]]:
    """For each target the loosest settings that leave room for each other; ``twin`` are those that
    knobs were turned at, ``stable`` the stable step, s."""
    fitted = worst_order(study, reference)
    for target in TARGETS:
        settings, used = _loosened(study, reference, twin, ROOM * target)
        step = step_for(study, AIM * (target - used), fitted, stable)
        if step is None:
            continue
        step = even_step(step, study.window, study.samples)
        if step >= 2 * reference.settings.step:
            yield target, settings.at(step)


def fit_orders(study: Study, reference: Reference) -> dict[str, float]:
    """Of each measure, in the step; over the time in which trajectories are comparable."""
    points, found = _steps(study), {}
    steps = [point.settings.step for point in points]
    for name in points[0].errors if points else ():
        errors = [point.errors.get(name, float("inf")) for point in points]
        finest = 0.0 if name in ABSOLUTE else reference.settings.step
        if fitted := orders.fit(steps, errors, finest):
            found[name] = fitted[0]
    return found


def sparse_order(study: Study) -> float | None:
    """That of extrapolation between exchanges, by the errors that it adds."""
    points = [p for p in study.points if p.knob == "exchange" and p.settings.every > 1]
    between = [point.settings.every * point.settings.step for point in points]
    found = orders.fit(between, [p.alone if p.alone else float("inf") for p in points])
    return None if found is None else found[0]


def worst_order(study: Study, reference: Reference) -> tuple[float, float] | None:
    """Order and constant of the worst error in the step; of those that an ensemble resolves."""
    points = [point for point in _steps(study) if point.error > 2 * point.uncertainty]
    steps = [point.settings.step for point in points]
    return orders.fit(steps, [point.error for point in points], reference.settings.step)


def step_for(
    study: Study, error: float, fitted: tuple[float, float] | None, stable: float
) -> float | None:
    """The largest step (s), up to the ``stable`` one, that errs by at most ``error``: by the order
    and constant that were ``fitted``, or of those that were tried where none were."""
    if fitted is not None:
        order, scale = fitted
        return min((error / scale) ** (1 / order), stable)
    return max((p.settings.step for p in _steps(study) if p.meets(error)), default=None)


def _loosened(
    study: Study, reference: Reference, twin: Settings, room: float
) -> tuple[Settings, float]:
    """The tightest settings with each knob at the loosest value whose own error is at most
    ``room``, at the step that they were turned at; and the sum of these errors. (Not by the
    times: these are less certain.)"""
    tight, used = reference.settings, 0.0
    settings = tight.but("step", twin.step)
    for point in study.points:
        own = float("inf") if point.alone is None else point.alone
        first = getattr(settings, point.knob, None) == getattr(tight, point.knob, None)
        if point.knob != "skin" and first and own <= room:
            settings = settings.but(point.knob, getattr(point.settings, point.knob))
            used += own
    return settings, used


def _steps(study: Study) -> list[Point]:
    return [point for point in study.points if point.knob == "step"]
