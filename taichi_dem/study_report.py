"""What a study found, in words and as a picture."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from taichi_dem import style
from taichi_dem.orders import NOISE
from taichi_dem.settings import KNOBS, Settings
from taichi_dem.study_point import TARGETS, Point, cheapest, pareto, write
from taichi_dem.study_result import Study
from taichi_dem.wording import count, quantity
from taichi_dem.writing import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDS, PICTURE = "study.txt", "study.png"
FLOOR = 1e-16  # where an error of zero is drawn
GROUND = ("tolerance", "residual", "coupling", "exchange")  # knobs of the substrate


def report(study: Study, say: Callable[[str], None]) -> None:
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


def sentences(study: Study) -> Iterator[str]:
    """What was compared, the order, what stopped, and the cheapest setting for each target; of
    what was not measured, nothing."""
    if study.cut_short:
        yield _cut_short(study)
    if study.compared:
        yield from _found(study) if study.touched else [_untouched(study)]


def described(settings: Settings, knobs: Collection[str] = KNOBS) -> str:
    """Settings in words, by ``knobs``, without those that the scene does not have."""
    words = {"step": f"step {quantity(settings.step, 's')}"}
    if settings.coupling is not None:
        words["coupling"] = f"coupling {settings.coupling}"
    if settings.exchange is not None:
        words["exchange"] = f"exchange {settings.exchange}"
        words["residual"] = f"residual {settings.residual:g}"
        words["tolerance"] = f"tolerance {settings.tolerance:g}"
    words["precision"] = f"{settings.precision} precision"
    if settings.skin is not None:
        words["skin"] = f"skin {quantity(settings.skin, 'm')}"
    return ", ".join(said for knob, said in words.items() if knob in knobs)


def picture(study: Study) -> Figure:
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


def _of_worst(study: Study, points: list[Point]) -> float:
    """The order of the measure that is worst at the largest step."""
    errors = {name: points[0].errors.get(name, 0.0) for name in study.orders}
    return study.orders[max(errors, key=lambda name: errors[name])]


def _kind(point: Point) -> str:
    return point.knob.partition(" 1e")[0].partition(" 0.")[0]


def _cut_short(study: Study) -> str:
    if not study.compared:
        return f"{study.cut_short} before there was a reference: nothing was compared"
    return f"{study.cut_short} after {len(study.points)} of {count(study.planned, 'setting')}"


def _untouched(study: Study) -> str:
    return (
        f"nothing touched in these {quantity(study.window, 's')}: only free flight was compared, "
        "which no knob changes; choose a longer --duration or a later state"
    )


def _found(study: Study) -> Iterator[str]:
    yield _compared(study)
    if study.tight is not None:
        yield _turned(study, study.tight)
    if study.grounded is False and not any(map(_moved_ground, study.points)):
        yield (
            f"nothing touched the substrate in these {quantity(study.window, 's')}: "
            f"{', '.join(GROUND)} change nothing here"
        )
    if study.orders:
        listed = ", ".join(f"{name} {order:.2f}" for name, order in study.orders.items())
        yield f"orders of convergence in the time step: {listed}"
    if study.sparse_order is not None:
        yield f"order in the time from one exchange to the next: {study.sparse_order:.2f}"
    for point in study.points:
        if not point.seconds:
            yield f"{point.knob}, {_advised(study, point)}: {point.outcome}"
    if any(point.seconds for point in study.points):
        for target in TARGETS:
            yield _cheapest(study, target)
    elif not study.cut_short:
        yield "no setting got through: nothing was measured"


def _compared(study: Study) -> str:
    whole = quantity(study.window, "s")
    found = [point.means if study.chaotic else point.errors for point in study.points]
    names = ", ".join(dict.fromkeys(name for each in found for name in each))
    if not study.chaotic:
        errors = f": errors are those of {names}; the worst of them counts" if names else ""
        return f"trajectories stay comparable over all {whole}{errors}"
    samples = study.last / study.samples * study.window
    errors = (
        "; errors are those of means over an ensemble of perturbed runs, with their uncertainty"
    )
    return f"chaotic: trajectories stay comparable over {quantity(samples, 's')} of {whole}" + (
        f"{errors}: {names}" if names else ""
    )


def _turned(study: Study, tight: Settings) -> str:
    said = f"turned: {', '.join(study.turned)}"
    rest = described(tight, [knob for knob in KNOBS if knob not in study.turned])
    return f"{said}; all else at its tightest ({rest})" if rest else said


def _moved_ground(point: Point) -> bool:
    """Whether it turned what the substrate is solved with, and that changed something."""
    return point.knob in GROUND and point.alone is not None and point.alone > NOISE


def _advised(study: Study, point: Point) -> str:
    """The settings of ``point`` that were turned or are not the tightest."""
    if study.tight is None:
        return described(point.settings)
    loose = [k for k in KNOBS if getattr(point.settings, k) != getattr(study.tight, k)]
    return described(point.settings, {*study.turned, *loose})


def _cheapest(study: Study, target: float) -> str:
    point = cheapest(study.points, target)
    so_far, over = " so far" if study.cut_short else "", f"over {quantity(study.window, 's')}"
    if point is not None:
        return (
            f"error {target:g}: {_advised(study, point)} is the cheapest{so_far}, "
            f"{quantity(point.cost, 's')} per simulated second; "
            f"{over} its error is {point.error:.2g}"
        )
    least = min(p.error + 2 * p.uncertainty for p in study.points)
    doubt = max(p.uncertainty for p in study.points if p.seconds)
    why = f"; the ensemble tells no more than {doubt:.2g}" if doubt > target / 2 else ""
    return (
        f"error {target:g}: met by none of the settings tried{so_far}; {over} the least is "
        f"{least:.2g}{why}"
    )
