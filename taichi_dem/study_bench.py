"""The runs of a study: a reference, and the points that are measured against it.

A machine is not equally fast at all times, and not all processes can be alive at once. So one of
them, the pacer, lives as long as the study does, and every timed run stands between two of its
runs: times are compared as multiples of the pacer's.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from taichi_dem import accuracy, study_plan
from taichi_dem import study_point as table
from taichi_dem.closed_form import flown_freely, is_over, rebound, rebound_error
from taichi_dem.record import Record, even_step
from taichi_dem.scene import Scene
from taichi_dem.settings import KNOBS, REFERENCE_STEP, STEPS, Settings, ladder
from taichi_dem.study_point import Point
from taichi_dem.study_result import Reference, Study
from taichi_dem.workers import Worker, WorkerFailed

ALIVE = 8  # processes at a time, and the pacer
MEMBERS = 5  # of an ensemble
PAIRED = 1 / 4  # of the stable step: that at which knobs other than the step are turned


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
        self.study = Study(folder, window, samples)
        self.records = folder / "records"
        self.exact = rebound(scene)
        self.references: list[Record] = []
        self.hosted = False
        self.twin_runs: list[Record] | None = None  # once the twin has got through
        self._open = ExitStack()

    def close(self) -> None:
        """End the pacer."""
        self._open.close()

    def start(self, given_step: float | None) -> None:
        """The reference, and whether the scene is chaotic; ``given_step`` (s) is the scene's."""
        self.say("the reference, and how far it can be compared …")
        self.records.mkdir()
        table.write(self.study.folder, [])
        tight = Settings.tightest(self.scene, 0.0)
        self.pacer = worker = self._worker(tight, None, self._open)
        self.stable = self._even(worker.stable)  # so that halves are halves
        self.given = Settings.of(self.scene, self._even(given_step or worker.stable))
        tight = tight.but("step", self.stable * REFERENCE_STEP)
        coarse = [self._reference(worker, member, self.stable) for member in (0, 1)]
        last = accuracy.comparable(*coarse)
        members = range(MEMBERS if last < self.study.samples else 1)
        self.references = [self._reference(worker, member, tight.step) for member in members]
        self.characterize(tight, last)

    def characterize(self, tight: Settings, last: int) -> None:
        """What ``references``, of settings ``tight``, comparable up to sample ``last``, say."""
        runs, before = self.references, self.scene.spheres.velocity
        ground = None if self.scene.substrate is None else any(run.ground.any() for run in runs)
        touched = not flown_freely(runs[0], self.scene)
        chaotic = last < self.study.samples
        self.study.reference = Reference(tight, last, chaotic, len(runs), touched, ground)
        if self.exact is not None and not is_over(runs[0], self.exact, before):
            self.exact = None

    @property
    def reference(self) -> Reference:
        """Of the study, which has been started."""
        assert self.study.reference is not None
        return self.study.reference

    def ladders(self, knobs: Sequence[str]) -> None:
        """The step and each of ``knobs`` turned alone, and the settings that the scene asks for."""
        steps = ladder("step", self.scene, self.reference.settings, self.stable)
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
        study, reference = self.study, self.reference
        points: list[Point] = []
        study.orders = study_plan.fit_orders(study, reference)
        study.sparse_order = study_plan.sparse_order(study)
        tried = study_plan.combinations(study, reference, self.twin.settings, self.stable)
        for target, settings in tried:
            if settings not in [point.settings for point in points]:
                points.append(Point(f"combined {target:g}", settings))
        self._measure(points)

    # -- measuring -------------------------------------------------------------------------------

    def _measure(self, points: Sequence[Point]) -> None:
        """All of ``points``, a few processes at a time: each is looked at, then they take turns."""
        done = self.study.planned
        self.study.planned += len(points)
        for first in range(0, len(points), ALIVE):
            batch = points[first : first + ALIVE]
            low, high = done + first + 1, done + first + len(batch)
            which = f"settings {low} to {high}" if high > low else f"setting {low}"
            labels = ", ".join(point.label for point in batch)
            self.say(f"{which} of {self.study.planned}: {labels} …")
            with ExitStack() as alive:
                pairs = [(point, self._looked_at(point, alive)) for point in batch]
                for _ in range(self.rounds):
                    self._turn(pairs)

    def _turn(self, pairs: Sequence[tuple[Point, Worker | None]]) -> None:
        """One timed run of each point, between two of the pacer."""
        before = self._pace()
        for point, worker in pairs:
            if worker is None or point.stopped:
                continue
            try:
                taken = worker.time() / self.study.window
            except WorkerFailed as error:
                point.outcome, point.times = f"failed: {error}", []
            else:
                after = self._pace()
                point.times.append(taken / math.sqrt(before * after))
                before = after
            table.write(self.study.folder, self.study.points)

    def _pace(self) -> float:
        """Wall time of a run of the pacer, per simulated second; their median is the unit of all
        times."""
        try:
            taken = self.pacer.time(self.stable)
        except WorkerFailed as error:
            raise WorkerFailed(f"the pacer, which all times are compared with: {error}") from error
        self.study.paces.append(taken / self.study.window)
        for point in self.study.points:
            point.unit = statistics.median(self.study.paces)
        return self.study.paces[-1]

    def _looked_at(self, point: Point, alive: ExitStack) -> Worker | None:
        """The process of a point, which joins those ``alive``, once its errors are known; None
        where it cannot even be started."""
        worker = None
        try:
            worker = self._worker(point.settings, point.settings.step, alive)
            point.built = worker.built
            self._look(point, worker)
        except WorkerFailed as error:
            point.outcome = f"failed: {error}"
        self.study.points.append(point)
        table.write(self.study.folder, self.study.points)
        return worker

    def _look(self, point: Point, worker: Worker) -> None:
        """Run all members of a point's ensemble, and find its errors."""
        runs = []
        for member in range(self.reference.members):
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
            point.alone = self._alone(point, runs, self.twin_runs)

    def _alone(self, point: Point, runs: list[Record], twin_runs: list[Record]) -> float:
        """The error of the one knob that is turned: against its twin, of the same step."""
        if self.study.chaotic:
            means = accuracy.ensemble_errors(runs, twin_runs)
            return accuracy.worst({name: error for name, (error, _) in means.items()})
        found = self._errors(runs, twin_runs)
        if "energy drift" in found:
            last = self.reference.last
            found["energy drift"] = accuracy.drift_between(runs[0], twin_runs[0], last)
        return accuracy.worst(found)

    def _errors(self, runs: list[Record], references: list[Record]) -> dict[str, float]:
        if self.reference.last < accuracy.FEWEST:
            return {}
        return accuracy.errors(runs[0], references[0], self.reference.last)

    def _even(self, step: float) -> float:
        """The step (s) that is really made."""
        return even_step(step, self.study.window, self.study.samples)

    def _reference(self, worker: Worker, member: int, step: float) -> Record:
        """A run that must get through."""
        path = self.records / f"reference.{member}.npz"
        answer = worker.look(path, member, step)
        if "stopped" in answer:
            raise WorkerFailed(f"the reference was stopped: {answer['stopped']}")
        self.hosted = self.hosted or answer["hosted"]
        return Record.load(path)

    def _worker(self, settings: Settings, step: float | None, alive: ExitStack) -> Worker:
        scene = self.study.folder / "scene.toml"
        worker = Worker(scene, settings, self.study.window, self.study.samples, step)
        alive.callback(worker.close)
        return worker
