"""What a study found as a picture: error against wall time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from taichi_dem import labels, style
from taichi_dem.settings import KNOBS
from taichi_dem.study_point import Point, pareto
from taichi_dem.study_result import Study
from taichi_dem.wording import quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLOOR = 1e-16  # where an error of zero is drawn
UNITS = {"step": "s", "skin": "m"}
GIVEN, COMBINED = "#777777", "combined"


def picture(study: Study) -> Figure:
    """Error against wall time per simulated second, one colour per knob, and the Pareto front with
    the values of its points; bars across reach from the fastest round to the slowest. Of an
    ensemble, what the error is surely within, and a bar down to the error that was found."""
    drawing = style.figure(6.4, 4.4)
    axes = drawing.subplots()
    measured = [point for point in study.points if point.timed]
    for knob in dict.fromkeys(_kind(point) for point in measured):
        points = [point for point in measured if _kind(point) == knob]
        label = knob
        if knob == "step" and study.orders and not study.chaotic:
            label = f"step, order {_of_worst(study, points):.2f}"
        axes.errorbar(
            [point.cost for point in points],
            [_height(point) for point in points],
            xerr=_around(points),
            yerr=_down(points) if study.chaotic else None,
            marker="s" if knob not in KNOBS else "o",
            markersize=5,
            elinewidth=0.7,
            linestyle="-" if knob == "step" else "",
            color=_color(knob),
            label=label,
        )
    front = pareto(measured)
    axes.plot(
        [point.cost for point in front],
        [_height(point) for point in front],
        color=style.INK,
        linewidth=0.8,
        linestyle="--",
        label="Pareto front",
        zorder=0,
    )
    axes.set(xscale="log", yscale="log")
    axes.margins(0.08)
    for axis in (axes.xaxis, axes.yaxis):
        style.label_few_decades(axis)
    axes.set_xlabel("wall time per simulated second (s/s)")
    ensemble = "error of the ensemble, with twice its uncertainty"
    axes.set_ylabel(ensemble if study.chaotic else "worst error")
    style.legend(axes)
    style.dress(axes)
    labels.beside(
        axes,
        [(p.cost, _height(p), value(p), _color(_kind(p))) for p in front],
        [(point.cost, _height(point)) for point in measured],
    )
    return drawing


def value(point: Point) -> str:
    """What a point is, in a few characters."""
    if point.knob.startswith(COMBINED):
        return f"for {point.knob.removeprefix(COMBINED).strip()}"
    turned: Any = getattr(point.settings, point.knob, point.knob)
    if point.knob in UNITS:
        return quantity(turned, UNITS[point.knob])
    return f"{point.knob} {turned:g}" if isinstance(turned, float) else str(turned)


def _height(point: Point) -> float:
    return max(point.bound, FLOOR)


def _around(points: list[Point]) -> list[list[float]]:
    """How far bars reach to the left and to the right of the points."""
    return [[p.cost - p.least for p in points], [p.most - p.cost for p in points]]


def _down(points: list[Point]) -> list[list[float]]:
    """How far bars reach down from the points, and up."""
    return [[_height(p) - max(p.error, FLOOR) for p in points], [0.0] * len(points)]


def _color(knob: str) -> str:
    if knob == COMBINED:
        return style.INK
    return dict(zip(KNOBS, style.cycle(), strict=False)).get(knob, GIVEN)


def _of_worst(study: Study, points: list[Point]) -> float:
    """The order of the measure that is worst at the largest step."""
    errors = {name: points[0].errors.get(name, 0.0) for name in study.orders}
    return study.orders[max(errors, key=lambda name: errors[name])]


def _kind(point: Point) -> str:
    return COMBINED if point.knob.startswith(COMBINED) else point.knob
