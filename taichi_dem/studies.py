"""``taichi-dem study``: what accuracy costs in time, for one scene.

Every knob is turned alone, from loose to tight, with all others at their tightest; then, for each
of the errors 1e-1 … 1e-4, the loosest values that leave room for each other are combined. All runs
are compared with one at the tightest settings and a finer step. Every point has a process of its
own; processes are compiled and warmed up before any clock runs, and take turns.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

from taichi_dem import accuracy, orders, scene_file
from taichi_dem import study_point as table
from taichi_dem.closed_form import rebound, rebound_error
from taichi_dem.record import SAMPLES, Record
from taichi_dem.scene import Scene
from taichi_dem.settings import KNOBS, REFERENCE_STEP, STEPS, Settings, ladder
from taichi_dem.study_point import TARGETS, Point
from taichi_dem.validation import InputError, Problem, Range, number_problem, unknown
from taichi_dem.workers import Worker, WorkerFailed

ALIVE = 8  # processes at a time
MEMBERS = 5  # of an ensemble
PAIRED = 1 / 4  # of the stable step: that at which knobs other than the step are turned
ROOM = 0.2  # of a target, for each knob but the step in a combination
AIM = 0.8  # of what is left of a target, for the step


@dataclasses.dataclass
class Study:
    """What :func:`study` found. ``last``: the sample up to which trajectories are comparable;
    ``order``: the one fitted to the errors of the time step, or None."""

    folder: Path
    window: float
    samples: int
    chaotic: bool
    last: int
    points: list[Point]
    order: float | None = None


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

    Results are appended as they come; Ctrl-C writes what there is and raises
    ``KeyboardInterrupt``. Raises ``InputError`` before anything is written.
    """
    folder = Path(folder)
    scene, step, duration = _scene(scene, duration, overrides)
    _check(folder, knobs, duration, rounds, samples)
    folder.mkdir(parents=True, exist_ok=True)
    scene.to_toml(folder / "scene.toml")
    bench = _Bench(scene, folder, duration, samples, rounds, say)
    try:
        bench.start(step)
        bench.ladders(knobs or KNOBS)
        bench.combinations()
    finally:
        bench.close()
        if bench.study is not None:
            from taichi_dem.study_report import report

            report(bench.study, say)
    assert bench.study is not None
    return bench.study


def _scene(
    scene: Scene | Path | str, duration: float | None, overrides: Sequence[str]
) -> tuple[Scene, float | None, float]:
    """The scene, the step that its file asks for, and the time to cover."""
    step = None
    if not isinstance(scene, Scene):
        scene, plan = scene_file.read(scene, overrides)
        step = plan.dt
        if duration is None:
            duration = plan.duration
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
    if found := [problem for problem in problems if problem]:
        raise InputError(found)


class _Bench:
    """The reference, and the points that are measured against it."""

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        window: float,
        samples: int,
        rounds: int,
        say: Callable[[str], None],
    ):
        self.scene, self.folder, self.window = scene, folder, window
        self.samples, self.rounds, self.say = samples, rounds, say
        self.study: Study | None = None
        self.records = folder / "records"
        self.hosted = False
        self.exact = rebound(scene)
        self._workers: list[Worker] = []

    def close(self) -> None:
        """End all processes."""
        while self._workers:
            self._workers.pop().close()

    def start(self, given_step: float | None) -> None:
        """The reference, and whether the scene is chaotic."""
        self.records.mkdir()
        tight = Settings.tightest(self.scene, 0.0)
        worker = self._worker(tight, None)
        self.stable = worker.stable
        self.given = Settings.of(self.scene, given_step or worker.stable)
        self.tight = dataclasses.replace(tight, step=worker.stable * REFERENCE_STEP)
        self.say("the reference, and how far it can be compared …")
        coarse = [self._record(worker, member, self.stable) for member in (0, 1)]
        last = accuracy.comparable(*coarse)
        chaotic = last < self.samples
        members = range(MEMBERS if chaotic else 1)
        runs = [self._record(worker, member, self.tight.step, "reference") for member in members]
        self.close()
        self.reference = runs[0]
        self.means = [accuracy.statistics(run) for run in runs]
        self.study = Study(self.folder, self.window, self.samples, chaotic, last, [])
        table.write(self.folder, [])

    def ladders(self, knobs: Sequence[str]) -> None:
        """Each knob turned alone, and the settings that the scene asks for."""
        assert self.study is not None
        paired = self.tight.but("step", self.stable * PAIRED)
        steps = ladder("step", self.scene, self.tight, self.stable)
        found = [Point("step", settings) for settings in steps]
        for knob in knobs:
            if knob == "step" or (knob == "tolerance" and not self.hosted):
                continue
            found += [Point(knob, s) for s in ladder(knob, self.scene, paired, self.stable)]
        found.append(Point("as given", self.given))
        self.twin = found[STEPS.index(PAIRED)]
        self._measure(found)

    def combinations(self) -> None:
        """For each target the loosest values that leave room for each other."""
        assert self.study is not None
        points = self.study.points
        steps = [point for point in points if point.knob == "step"]
        fitted = orders.fit(
            [point.settings.step for point in steps],
            [point.error for point in steps],
            self.tight.step,
        )
        if fitted is None:
            return
        self.study.order, scale = fitted
        wanted = []
        for target in TARGETS:
            used = 0.0
            settings = dataclasses.replace(self.tight, skin=None)
            for knob in {point.knob: None for point in points} if points else ():
                allowed = [
                    point
                    for point in points
                    if point.knob == knob
                    and point.alone is not None
                    and point.seconds
                    and point.alone <= ROOM * target
                ]
                if allowed and knob not in ("step", "as given"):
                    best = min(allowed, key=lambda point: point.cost)
                    if best.cost < self.twin.cost:
                        value = getattr(best.settings, knob)
                        settings, used = settings.but(knob, value), used + (best.alone or 0.0)
            step = (AIM * (target - used) / scale) ** (1 / self.study.order)
            step = min(step, self.stable)
            if step >= 2 * self.tight.step:
                wanted.append(Point(f"combined {target:g}", settings.but("step", step)))
        self._measure(wanted)

    # -- measuring -------------------------------------------------------------------------------

    def _measure(self, points: Sequence[Point]) -> None:
        """All of ``points``, a few processes at a time, which take turns."""
        for first in range(0, len(points), ALIVE):
            batch = points[first : first + ALIVE]
            self.say(f"{', '.join(_label(point) for point in batch)} …")
            workers = []
            for point in batch:
                try:
                    worker = self._worker(point.settings, point.settings.step)
                    point.built = worker.built
                    workers.append(worker)
                except WorkerFailed as error:
                    point.outcome = f"failed: {error}"
                    workers.append(None)
            paths = [self.records / f"{len(self._seen) + k}.npz" for k in range(len(batch))]
            for turn in range(self.rounds):
                for point, worker, path in zip(batch, workers, paths, strict=True):
                    if worker is not None and not point.outcome.startswith(("stopped", "failed")):
                        self._turn(point, worker, path if turn == 0 else None)
            for point in batch:
                assert self.study is not None
                self.study.points.append(point)
                table.append(self.folder, point)
            self.close()

    @property
    def _seen(self) -> list[Point]:
        return self.study.points if self.study else []

    def _turn(self, point: Point, worker: Worker, save: Path | None) -> None:
        """One timed run of a point; before the first one it is looked at."""
        assert self.study is not None
        try:
            if save is not None:
                runs = []
                for member in range(MEMBERS if self.study.chaotic else 1):
                    path = save.with_suffix(f".{member}.npz")
                    answer = worker.look(path, member)
                    if "stopped" in answer:
                        point.outcome = f"stopped: {answer['stopped']}"
                        return
                    runs.append(Record.load(path))
                self._judge(point, runs)
            point.seconds.append(worker.time() / self.window)
            point.outcome = "finished"
        except WorkerFailed as error:
            point.outcome, point.seconds = f"failed: {error}", []

    def _judge(self, point: Point, runs: Sequence[Record]) -> None:
        """The errors of a point's runs."""
        assert self.study is not None
        last = self.study.last
        if last >= accuracy.FEWEST:
            point.errors = accuracy.errors(runs[0], self.reference, last)
        if self.exact is not None:
            before = self.scene.spheres.velocity
            point.errors["rebound"] = rebound_error(runs[0].velocity, self.exact, before)
        point.error = accuracy.worst(point.errors)
        if self.study.chaotic:
            point.means = accuracy.ensemble_errors(
                [accuracy.statistics(run) for run in runs], self.means
            )
            point.error, point.uncertainty = max(point.means.values(), default=(float("inf"), 0.0))
        if point is self.twin:
            self.twin_runs = list(runs)
        if point.knob in KNOBS and point.knob != "step":
            twin = self.twin_runs
            if self.study.chaotic:
                paired = accuracy.ensemble_errors(
                    [accuracy.statistics(run) for run in runs],
                    [accuracy.statistics(run) for run in twin],
                )
                point.alone = max(paired.values(), default=(float("inf"), 0.0))[0]
            else:
                found = accuracy.errors(runs[0], twin[0], last)
                own = {k: v for k, v in found.items() if k != "energy drift"}
                drift = point.errors.get("energy drift", 0.0)
                drift -= self.twin.errors.get("energy drift", 0.0)
                point.alone = accuracy.worst(own | {"energy drift": max(drift, 0.0)})

    def _record(self, worker: Worker, member: int, step: float, name: str = "coarse") -> Record:
        """A run that must get through."""
        path = self.records / f"{name}.{member}.npz"
        answer = worker.look(path, member, step)
        if "stopped" in answer:
            raise WorkerFailed(f"the reference was stopped: {answer['stopped']}")
        self.hosted = self.hosted or answer["hosted"]
        return Record.load(path)

    def _worker(self, settings: Settings, step: float | None) -> Worker:
        scene = self.folder / "scene.toml"
        worker = Worker(scene, settings, self.window, self.samples, step)
        self._workers.append(worker)
        return worker


def _label(point: Point) -> str:
    """The point in a few characters."""
    if point.knob in KNOBS:
        value = getattr(point.settings, point.knob)
        return f"{point.knob} {value:.3g}" if isinstance(value, float) else f"{point.knob} {value}"
    return point.knob
