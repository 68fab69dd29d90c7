"""``taichi-dem study``: what accuracy costs in time, for one scene.

Every knob is turned alone, from loose to tight, with all others at their tightest; then, for each
of the errors 1e-1 … 1e-4, the loosest values that leave room for each other are combined. All runs
are compared with one at the tightest settings and a finer step. Every point has a process of its
own; processes are compiled and warmed up before any clock runs, and take turns, between two runs
of one and the same setting each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from taichi_dem import accuracy, scene_file
from taichi_dem.folder import unwritable
from taichi_dem.record import SAMPLES
from taichi_dem.scene import Scene
from taichi_dem.settings import KNOBS
from taichi_dem.study_bench import Bench
from taichi_dem.study_report import report
from taichi_dem.study_result import Study
from taichi_dem.validation import InputError, Problem, Range, number_problem, unknown


def study(
    scene: Scene | Path | str,
    folder: Path | str,
    knobs: Sequence[str] | None = None,
    duration: float | None = None,
    *,
    overrides: Sequence[str] = (),
    rounds: int = 3,
    samples: int = SAMPLES,
    say: Callable[[str], None] = print,
) -> Study:
    """Compute ``scene`` (or a scene file) over ``duration`` (s; that of the file unless given) with
    each of ``knobs`` (all unless given) turned, and write ``study.csv``, ``study.txt`` and
    ``study.png`` into ``folder``, which must be new or empty. ``rounds``: runs that each time is
    the median of; ``overrides`` as in :func:`taichi_dem.scene_file.read`; ``say`` takes lines for
    people.

    Where nothing touches in that time, nothing is turned. The table has results as they come;
    Ctrl-C writes what there is and raises ``KeyboardInterrupt``. Raises ``InputError`` before
    anything is written.
    """
    folder = Path(folder)
    scene, step, duration = _scene(scene, duration, overrides)
    _check(folder, knobs, duration, rounds, samples)
    folder.mkdir(parents=True, exist_ok=True)
    scene.to_toml(folder / "scene.toml")
    bench = Bench(scene, folder, duration, samples, rounds, say)
    try:
        bench.start(step)
        if bench.reference.touched:
            bench.ladders(knobs or KNOBS)
            bench.combinations()
    except BaseException as error:
        interrupted = isinstance(error, KeyboardInterrupt)
        bench.study.cut_short = "interrupted" if interrupted else "ended by an error"
        raise
    finally:
        bench.close()
        report(bench.study, say)
    return bench.study


def _scene(
    scene: Scene | Path | str, duration: float | None, overrides: Sequence[str]
) -> tuple[Scene, float | None, float]:
    """The scene, the step that its file asks for, and the time to cover."""
    step = None
    if not isinstance(scene, Scene):
        scene, plan = scene_file.read(scene, overrides, duration=duration)
        step, duration = plan.dt, plan.duration
        if plan.steps is not None and plan.dt is not None:
            duration = plan.steps * plan.dt
    if duration is None:
        raise InputError([Problem("duration", None, "is missing: must be given, in s")])
    return scene, step, duration


def _check(
    folder: Path, knobs: Sequence[str] | None, duration: float, rounds: int, samples: int
) -> None:
    problems = [number_problem("duration", duration, Range("s", "simulated time", above=0))]
    problems += [unknown("knobs", k, k, KNOBS, "knob") for k in knobs or () if k not in KNOBS]
    for name, value, least in (("rounds", rounds, 1), ("samples", samples, accuracy.FEWEST)):
        if not isinstance(value, int) or value < least:
            problems.append(Problem(name, value, f"must be a whole number >= {least}"))
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        problems.append(Problem("output", str(folder), "must be a new or an empty folder"))
    else:
        problems.append(unwritable(folder))
    if found := [problem for problem in problems if problem]:
        raise InputError(found)
