"""What a study found, in words."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from taichi_dem import style
from taichi_dem.orders import NOISE
from taichi_dem.settings import KNOBS, Settings
from taichi_dem.study_picture import picture
from taichi_dem.study_point import TARGETS, Point, cheapest, write
from taichi_dem.study_result import Reference, Study
from taichi_dem.wording import count, quantity
from taichi_dem.writing import write_text

WORDS, PICTURE = "study.txt", "study.png"
GROUND = ("tolerance", "residual", "coupling", "exchange")  # knobs of the substrate


def report(study: Study, say: Callable[[str], None]) -> None:
    """Write the table again in one piece, ``study.txt`` and, with matplotlib, ``study.png``."""
    write(study.folder, study.points)
    lines = list(sentences(study))
    write_text(study.folder / WORDS, "\n".join(lines) + "\n")
    for line in lines:
        say(line)
    if not any(point.timed for point in study.points):
        return
    try:
        style.save(picture(study), Path(study.folder) / PICTURE)
    except ModuleNotFoundError as error:
        say(f"no picture: it needs the {error.name} library, pip install 'taichi-dem[view]'")


def sentences(study: Study) -> Iterator[str]:
    """What was compared, the order, what stopped, and the cheapest setting for each target; of
    what was not measured, nothing."""
    reference = study.reference
    if study.cut_short:
        yield _cut_short(study)
    if reference is not None:
        yield from _found(study, reference) if reference.touched else [_untouched(study)]


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


def _cut_short(study: Study) -> str:
    if study.reference is None:
        return f"{study.cut_short} before there was a reference: nothing was compared"
    done = f"{study.cut_short} after {len(study.points)} of {count(study.planned, 'setting')}"
    untimed = sum(not (point.timed or point.stopped) for point in study.points)
    return f"{done}, {untimed} of them not timed yet" if untimed else done


def _untouched(study: Study) -> str:
    return (
        f"nothing touched in these {quantity(study.window, 's')}: only free flight was compared, "
        "which no knob changes; choose a longer --duration or a later state"
    )


def _found(study: Study, reference: Reference) -> Iterator[str]:
    yield _compared(study, reference)
    yield _turned(study, reference.settings)
    if reference.grounded is False and not any(map(_moved_ground, study.points)):
        yield (
            f"nothing touched the substrate in these {quantity(study.window, 's')}: "
            f"{', '.join(GROUND)} change nothing here"
        )
    yield from _orders(study, reference)
    if study.sparse_order is not None:
        yield f"order in the time from one exchange to the next: {study.sparse_order:.2f}"
    for point in study.points:
        if point.stopped:
            yield f"{point.knob}, {_advised(study, reference, point)}: {point.outcome}"
    if study.paces:
        yield _timed(study)
    if any(point.timed for point in study.points):
        for target in TARGETS:
            yield _cheapest(study, reference, target)
    elif not study.cut_short:
        yield "no setting got through: nothing was measured"


def _compared(study: Study, reference: Reference) -> str:
    whole = quantity(study.window, "s")
    found = [point.means if reference.chaotic else point.errors for point in study.points]
    names = ", ".join(dict.fromkeys(name for each in found for name in each))
    if not reference.chaotic:
        errors = f": errors are those of {names}; the worst of them counts" if names else ""
        return f"trajectories stay comparable over all {whole}{errors}"
    errors = (
        f"; errors are those of means over an ensemble of {reference.members} perturbed runs, "
        "with their uncertainty"
    )
    comparable = f"trajectories stay comparable over {_comparable(study, reference)} of {whole}"
    return f"chaotic: {comparable}" + (f"{errors}: {names}" if names else "")


def _comparable(study: Study, reference: Reference) -> str:
    """For how long trajectories are."""
    between = study.window / study.samples
    if reference.last == 0:
        return f"less than {quantity(between, 's')}"
    return quantity(reference.last * between, "s")


def _turned(study: Study, tight: Settings) -> str:
    said = f"turned: {', '.join(study.turned)}"
    rest = described(tight, [knob for knob in KNOBS if knob not in study.turned])
    return f"{said}; all else at its tightest ({rest})" if rest else said


def _orders(study: Study, reference: Reference) -> Iterator[str]:
    """Those that were fitted, and which errors have none."""
    steps = [point.errors for point in study.points if point.knob == "step"]
    found = dict.fromkeys(name for each in steps for name, error in each.items() if error > NOISE)
    listed = ", ".join(f"{name} {order:.2f}" for name, order in study.orders.items())
    stray = ", ".join(name for name in found if name not in study.orders)
    first = f", in the first {_comparable(study, reference)}" if reference.chaotic else ""
    if listed:
        none = f"; none of {stray}" if stray else ""
        yield f"orders of convergence in the time step{first}: {listed}{none}"
    elif stray and not study.cut_short:
        yield f"no order in the time step{first}: nothing tells how exact the reference is"


def _timed(study: Study) -> str:
    rounds = max(len(point.times) for point in study.points)
    usual = statistics.median(study.paces)
    least, most = (bound(study.paces) / usual for bound in (min, max))
    return (
        f"wall times: medians of {count(rounds, 'round')}, each set against a run of one and the "
        f"same setting just before and after, which took {least:.2g} to {most:.2g} times its median"
    )


def _moved_ground(point: Point) -> bool:
    """Whether it turned what the substrate is solved with, and that changed something."""
    return point.knob in GROUND and point.alone is not None and point.alone > NOISE


def _advised(study: Study, reference: Reference, point: Point) -> str:
    """The settings of ``point`` that were turned or are not the tightest."""
    loose = [k for k in KNOBS if getattr(point.settings, k) != getattr(reference.settings, k)]
    return described(point.settings, {*study.turned, *loose})


def _cheapest(study: Study, reference: Reference, target: float) -> str:
    point = cheapest(study.points, target)
    so_far, over = " so far" if study.cut_short else "", f"over {quantity(study.window, 's')}"
    if point is not None:
        found = f"its error is {point.error:.2g}"
        if reference.chaotic:
            found = f"its errors are surely within {point.bound:.2g}"
        return (
            f"error {target:g}: {_advised(study, reference, point)} is the cheapest{so_far}, "
            f"{quantity(point.cost, 's')} per simulated second{_rivals(study, point, target)}; "
            f"{over} {found}"
        )
    measured = [point for point in study.points if point.timed]
    least = min(point.bound for point in measured)
    if not reference.chaotic:
        why = f"{over} the least is {least:.2g}"
    else:
        why = f"{over} all of them are surely within {least:.2g} at best"
        blind = min(max(2 * doubt for _, doubt in p.means.values()) for p in measured)
        if blind > target:
            why += f", and none below {blind:.2g} could be told from {reference.members} runs"
    return f"error {target:g}: met by none of the settings tried{so_far}; {why}"


def _rivals(study: Study, cheapest: Point, target: float) -> str:
    """How many more may be as cheap: those with a round that was faster than one of its."""
    meeting = [point for point in study.points if point.meets(target) and point is not cheapest]
    rivals = sum(point.least <= cheapest.most for point in meeting)
    return f" ({count(rivals, 'other')} as cheap within the scatter of rounds)" if rivals else ""
