"""What a study found, in words and as a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_dem import style
from taichi_dem.settings import KNOBS, Settings
from taichi_dem.study_point import TARGETS, Point, cheapest, pareto, write
from taichi_dem.wording import quantity
from taichi_dem.writing import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDS, PICTURE = "study.txt", "study.png"
FLOOR = 1e-16  # where an error of zero is drawn


def report(study: Any, say: Callable[[str], None]) -> None:
    """Write the table again in one piece, ``study.txt`` and, with matplotlib, ``study.png``."""
    write(study.folder, study.points)
    lines = list(sentences(study))
    write_text(study.folder / WORDS, "\n".join(lines) + "\n")
    for line in lines:
        say(line)
    measured = [point for point in study.points if point.seconds]
    if not measured:
        return
    try:
        style.save(picture(study), Path(study.folder) / PICTURE)
    except ModuleNotFoundError as error:
        say(f"no picture: it needs the {error.name} library, pip install 'taichi-dem[view]'")


def sentences(study: Any) -> Iterator[str]:
    """What was compared, the order, what stopped, and the cheapest setting for each target."""
    yield _compared(study)
    if study.orders:
        listed = ", ".join(f"{name} {order:.2f}" for name, order in study.orders.items())
        yield f"orders of convergence in the time step: {listed}"
    if study.sparse_order is not None:
        yield f"order in the time from one exchange to the next: {study.sparse_order:.2f}"
    for point in study.points:
        if not point.seconds:
            yield f"{point.knob}, {described(point.settings)}: {point.outcome}"
    for target in TARGETS:
        yield _cheapest(study, target)


def described(settings: Settings) -> str:
    """Settings in words, without those that the scene does not have."""
    parts = [f"step {quantity(settings.step, 's')}"]
    if settings.coupling is not None:
        parts.append(f"coupling {settings.coupling}")
    if settings.exchange is not None:
        parts.append(f"exchange {settings.exchange}")
        parts += [f"residual {settings.residual:g}", f"tolerance {settings.tolerance:g}"]
    parts.append(f"{settings.precision} precision")
    if settings.skin is not None:
        parts.append(f"skin {quantity(settings.skin, 'm')}")
    return ", ".join(parts)


def picture(study: Any) -> Figure:
    """Error against wall time per simulated second, one colour per knob, and the Pareto front."""
    drawing = style.figure(6.4, 4.4)
    axes = drawing.subplots()
    colors = dict(zip(KNOBS, style.cycle(), strict=False))
    measured = [point for point in study.points if point.seconds]
    for knob in dict.fromkeys(_kind(point) for point in measured):
        points = [point for point in measured if _kind(point) == knob]
        label = knob
        if knob == "step" and study.orders:
            label = f"step, order {_of_worst(study, points):.2f}"
        axes.errorbar(
            [point.cost for point in points],
            [max(point.error, FLOOR) for point in points],
            yerr=[point.uncertainty for point in points] if study.chaotic else None,
            marker="s" if knob not in KNOBS else "o",
            linestyle="-" if knob == "step" else "",
            color=colors.get(knob, style.INK if knob == "combined" else "#999999"),
            label=label,
        )
    front = pareto(measured)
    axes.plot(
        [point.cost for point in front],
        [max(point.error, FLOOR) for point in front],
        color=style.INK,
        linewidth=0.8,
        linestyle="--",
        label="Pareto front",
        zorder=0,
    )
    axes.set(xscale="log", yscale="log")
    style.label_few_decades(axes.xaxis)
    axes.set_xlabel("wall time per simulated second (s/s)")
    axes.set_ylabel("worst error of the ensemble's means" if study.chaotic else "worst error")
    style.legend(axes)
    style.dress(axes)
    return drawing


def _of_worst(study: Any, points: list[Point]) -> float:
    """The order of the measure that is worst at the largest step."""
    errors = {name: points[0].errors.get(name, 0.0) for name in study.orders}
    return study.orders[max(errors, key=lambda name: errors[name])]


def _kind(point: Point) -> str:
    return point.knob.partition(" 1e")[0].partition(" 0.")[0]


def _compared(study: Any) -> str:
    whole = quantity(study.window, "s")
    if not study.chaotic:
        return (
            f"trajectories stay comparable over all {whole}: errors are those of trajectories, "
            "contact forces, energy, depression and pistons, the worst of them counts"
        )
    samples = study.last / study.samples * study.window
    return (
        f"chaotic: trajectories stay comparable over {quantity(samples, 's')} of {whole}; errors "
        "are those of means over an ensemble of perturbed runs, with their uncertainty"
    )


def _cheapest(study: Any, target: float) -> str:
    point = cheapest(study.points, target)
    if point is not None:
        return (
            f"error {target:g}: {described(point.settings)} is the cheapest, "
            f"{quantity(point.cost, 's')} per simulated second; its error is {point.error:.2g}"
        )
    if not study.points:
        return f"error {target:g}: nothing was measured"
    least = min((p.error + 2 * p.uncertainty for p in study.points), default=np.inf)
    doubt = max((p.uncertainty for p in study.points if p.seconds), default=0.0)
    why = f"; the ensemble tells no more than {doubt:.2g}" if doubt > target / 2 else ""
    return f"error {target:g}: met by none of the settings tried; the least is {least:.2g}{why}"
