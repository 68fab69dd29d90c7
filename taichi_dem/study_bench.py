"""The runs of a study: a reference, and the points that are measured against it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from taichi_dem import accuracy, orders
from taichi_dem import study_point as table
from taichi_dem.closed_form import flown_freely, is_over, rebound, rebound_error
from taichi_dem.record import Record, even_step
from taichi_dem.scene import Scene
from taichi_dem.settings import KNOBS, REFERENCE_STEP, STEPS, Settings, ladder
from taichi_dem.study_point import TARGETS, Point
from taichi_dem.study_result import Study
from taichi_dem.workers import Worker, WorkerFailed

ALIVE = 8  # processes at a time
MEMBERS = 5  # of an ensemble
PAIRED = 1 / 4  # of the stable step: that at which knobs other than the step are turned
ROOM = 0.2  # of a target, for each knob but the step in a combination
AIM = 0.8  # of what is left of a target, for the step


class Bench:
    """Computes ``scene`` over ``window`` (s) again and again; ``study`` grows with every point, and
    so does the table in ``folder``."""

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        window: float,
        samples: int,
        rounds: int,
        say: Callable[[str], None],
    ):
        self.scene, self.rounds, self.say = scene, rounds, say
        self.study = Study(folder, window, samples, last=samples, compared=False)
        self.records = folder / "records"
        self.exact = rebound(scene)
        self.hosted = False
        self.twin_runs: list[Record] | None = None  # once the twin has got through
        self._workers: list[Worker] = []

    def close(self) -> None:
        """End all processes."""
        while self._workers:
            self._workers.pop().close()

    def start(self, given_step: float | None) -> None:
        """The reference, and whether the scene is chaotic; ``given_step`` (s) is the scene's."""
        self.say("the reference, and how far it can be compared …")
        self.records.mkdir()
        table.write(self.study.folder, [])
        tight = Settings.tightest(self.scene, 0.0)
        worker = self._worker(tight, None)
        self.stable = self._even(worker.stable)  # so that halves are halves
        self.given = Settings.of(self.scene, self._even(given_step or worker.stable))
        self.tight = self.study.tight = tight.but("step", self.stable * REFERENCE_STEP)
        coarse = [self._reference(worker, member, self.stable) for member in (0, 1)]
        self.study.last = accuracy.comparable(*coarse)
        self.study.chaotic = self.study.last < self.study.samples
        self.references = [
            self._reference(worker, member, self.tight.step) for member in self._members()
        ]
        self._characterize(self.references)
        self.close()

    def ladders(self, knobs: Sequence[str]) -> None:
        """The step and each of ``knobs`` turned alone, and the settings that the scene asks for."""
        steps = ladder("step", self.scene, self.tight, self.stable)
        points = [Point("step", settings) for settings in steps]
        self.twin = points[STEPS.index(PAIRED)]
        for knob in dict.fromkeys(knobs):
            if knob == "step" or (knob == "tolerance" and not self.hosted):
                continue
            turned = ladder(knob, self.scene, self.twin.settings, self.stable)
            points += [Point(knob, settings) for settings in turned]
        self.study.turned = tuple(dict.fromkeys(point.knob for point in points))
        self._measure([*points, Point("as given", self.given)])

    def combinations(self) -> None:
        """For each target the loosest values that leave room for each other."""
        fitted = self._fit_orders()
        points: list[Point] = []
        for target in TARGETS:
            settings, used = self._loosened(ROOM * target)
            step = self._step_for(AIM * (target - used), fitted)
            if step is None or self._even(step) < 2 * self.tight.step:
                continue
            settings = settings.at(self._even(step))
            if settings not in [point.settings for point in points]:
                points.append(Point(f"combined {target:g}", settings))
        self._measure(points)

    def _step_for(self, error: float, fitted: tuple[float, float] | None) -> float | None:
        """The largest step (s), up to the stable one, that errs by at most ``error``: by the order
        and constant that were ``fitted``, or of those that were tried where none were."""
        if fitted is not None:
            order, scale = fitted
            return min((error / scale) ** (1 / order), self.stable)
        tried = [point for point in self.study.points if point.knob == "step"]
        return max((p.settings.step for p in tried if p.meets(error)), default=None)

    def _characterize(self, references: Sequence[Record]) -> None:
        """What happens in the scene at all."""
        self.study.compared = True
        self.study.touched = not flown_freely(references[0], self.scene)
        if self.scene.substrate is not None:
            self.study.grounded = any(run.ground.any() for run in references)
        before = self.scene.spheres.velocity
        if self.exact is not None and not is_over(references[0], self.exact, before):
            self.exact = None

    def _fit_orders(self) -> tuple[float, float] | None:
        """Those of each measure on record; returns order and constant of the worst error."""
        points = [point for point in self.study.points if point.knob == "step"]
        steps = [point.settings.step for point in points]
        for name in points[0].errors if points else ():
            errors = [point.errors.get(name, float("inf")) for point in points]
            absolute = name in ("energy drift", "rebound")  # with no other run to compare with
            found = orders.fit(steps, errors, 0.0 if absolute else self.tight.step)
            if found is not None:
                self.study.orders[name] = found[0]
        self.study.sparse_order = self._sparse_order()
        return orders.fit(steps, [point.error for point in points], self.tight.step)

    def _sparse_order(self) -> float | None:
        """That of extrapolation, by the errors that it adds."""
        points = [p for p in self.study.points if p.knob == "exchange" and p.settings.every > 1]
        between = [point.settings.every * point.settings.step for point in points]
        found = orders.fit(between, [p.alone if p.alone else float("inf") for p in points])
        return None if found is None else found[0]

    def _loosened(self, room: float) -> tuple[Settings, float]:
        """The tightest settings with each knob at the loosest value whose own error is at most
        ``room``, at the step that they were turned at; and the sum of these errors. (Not by the
        times: these are less certain.)"""
        settings, used = self.tight.but("step", self.twin.settings.step), 0.0
        for point in self.study.points:
            own = float("inf") if point.alone is None else point.alone
            first = getattr(settings, point.knob, None) == getattr(self.tight, point.knob, None)
            if point.knob != "skin" and first and own <= room:
                settings = settings.but(point.knob, getattr(point.settings, point.knob))
                used += own
        return settings, used

    # -- measuring -------------------------------------------------------------------------------

    def _measure(self, points: Sequence[Point]) -> None:
        """All of ``points``, a few processes at a time, which take turns."""
        done = self.study.planned
        self.study.planned += len(points)
        for first in range(0, len(points), ALIVE):
            batch = points[first : first + ALIVE]
            low, high = done + first + 1, done + first + len(batch)
            which = f"settings {low} to {high}" if high > low else f"setting {low}"
            labels = ", ".join(point.label for point in batch)
            self.say(f"{which} of {self.study.planned}: {labels} …")
            pairs = [(point, self._worker_of(point)) for point in batch]
            for turn in range(self.rounds):
                for point, worker in pairs:
                    if worker is not None and (turn == 0 or point.seconds):
                        self._turn(point, worker)
            self.close()

    def _turn(self, point: Point, worker: Worker) -> None:
        """One timed run of a point; before the first one it is looked at."""
        try:
            if not point.seconds:
                self._look(point, worker)
            if not point.stopped:
                point.seconds.append(worker.time() / self.study.window)
        except WorkerFailed as error:
            point.outcome, point.seconds = f"failed: {error}", []
        if point not in self.study.points:
            self.study.points.append(point)
            table.append(self.study.folder, point)

    def _look(self, point: Point, worker: Worker) -> None:
        """Run all members of a point's ensemble, and find its errors."""
        runs = []
        for member in self._members():
            path = self.records / f"{len(self.study.points)}.{member}.npz"
            answer = worker.look(path, member)
            if "stopped" in answer:
                point.outcome = f"stopped: {answer['stopped']}"
                return
            runs.append(Record.load(path))
        point.outcome = "finished"
        self._judge(point, runs)

    def _judge(self, point: Point, runs: list[Record]) -> None:
        point.errors = self._errors(runs, self.references)
        if self.exact is not None:
            before = self.scene.spheres.velocity
            point.errors["rebound"] = rebound_error(runs[0].velocity, self.exact, before)
        point.error = accuracy.worst(point.errors)
        if self.study.chaotic:
            point.means = accuracy.ensemble_errors(runs, self.references)
            point.error, point.uncertainty = accuracy.worst_mean(point.means)
        if point is self.twin:
            self.twin_runs = runs
        elif point.knob in KNOBS[1:] and self.twin_runs is not None:
            point.alone = self._alone(runs, self.twin_runs)

    def _alone(self, runs: list[Record], twin_runs: list[Record]) -> float:
        """The error of the one knob that is turned: against its twin, of the same step."""
        if self.study.chaotic:
            means = accuracy.ensemble_errors(runs, twin_runs)
            return accuracy.worst({name: error for name, (error, _) in means.items()})
        found = self._errors(runs, twin_runs)
        if "energy drift" in found:  # which is no difference of two runs
            found["energy drift"] -= self.twin.errors["energy drift"]
        return accuracy.worst(found)

    def _errors(self, runs: list[Record], references: list[Record]) -> dict[str, float]:
        if self.study.last < accuracy.FEWEST:
            return {}
        return accuracy.errors(runs[0], references[0], self.study.last)

    def _even(self, step: float) -> float:
        """The step (s) that is really made."""
        return even_step(step, self.study.window, self.study.samples)

    def _members(self) -> range:
        return range(MEMBERS if self.study.chaotic else 1)

    def _reference(self, worker: Worker, member: int, step: float) -> Record:
        """A run that must get through."""
        path = self.records / f"reference.{member}.npz"
        answer = worker.look(path, member, step)
        if "stopped" in answer:
            raise WorkerFailed(f"the reference was stopped: {answer['stopped']}")
        self.hosted = self.hosted or answer["hosted"]
        return Record.load(path)

    def _worker_of(self, point: Point) -> Worker | None:
        """The process of a point, or None where it cannot even be started."""
        try:
            worker = self._worker(point.settings, point.settings.step)
        except WorkerFailed as error:
            point.outcome = f"failed: {error}"
            self.study.points.append(point)
            return None
        point.built = worker.built
        return worker

    def _worker(self, settings: Settings, step: float | None) -> Worker:
        scene = self.study.folder / "scene.toml"
        worker = Worker(scene, settings, self.study.window, self.study.samples, step)
        self._workers.append(worker)
        return worker
