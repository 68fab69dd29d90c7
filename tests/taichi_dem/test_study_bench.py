"""How the points of a study are measured, without a simulation."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from bobbing import STONE, R, bobbing
from made_studies import points, rows
from records import made
from setups import law, scene

from taichi_dem.settings import Settings
from taichi_dem.study_bench import Bench
from taichi_dem.study_point import Point
from taichi_dem.study_result import Reference
from taichi_dem.workers import WorkerFailed


def test_what_a_reference_tells_of_the_scene(tmp_path):
    """Two spheres that would meet after the end; then a sphere on the ground."""
    toward = scene([[0, 0, 0], [3 * R, 0, 0]], R, STONE, [[0.1, 0, 0], [0, 0, 0]], law=law())
    bench = Bench(toward, tmp_path, 1.0, 8, 1, print)
    assert bench.exact is not None
    away = toward.spheres.velocity * np.linspace(0, 0.01, 9)[:, None, None]
    free = dataclasses.replace(
        made(),
        time=np.linspace(0, 0.01, 9),
        position=toward.spheres.position + away,
        velocity=toward.spheres.velocity,
        contact=np.empty((0, 4)),
        force=np.empty((0, 3)),
    )
    bench.references = [free]
    bench.characterize(Settings(1e-6), 8)
    found = bench.reference
    assert not found.touched and not found.chaotic and found.grounded is None
    assert bench.exact is None
    bobs = Bench(bobbing(), tmp_path, 1.0, 8, 1, print)
    bobs.references = [made(n=bobbing().spheres.count) for _ in range(5)]
    bobs.characterize(Settings(1e-6), 3)
    found = bobs.reference
    assert found.touched and found.grounded and bobs.study.chaotic and found.members == 5


class Toy:
    """A worker whose runs take ``seconds``, as many times longer as the machine is slower then."""

    slowness = itertools.repeat(1.0)
    built = 1.0

    def __init__(self, seconds):
        self.seconds = seconds

    def time(self, step=None):
        return self.seconds * next(self.slowness)

    def close(self):
        pass


def toy_bench(folder, monkeypatch, slowness, rounds=3):
    """A bench that only takes times, of settings that take as long as their step says."""
    bench = Bench(bobbing(), folder, 1.0, 8, rounds, lambda said: None)
    bench.pacer, bench.stable = Toy(2.0), 1e-5
    monkeypatch.setattr(Toy, "slowness", slowness)
    monkeypatch.setattr(bench, "_worker", lambda settings, *_: Toy(settings.step))
    monkeypatch.setattr(bench, "_look", lambda point, _: setattr(point, "outcome", "finished"))
    return bench


def test_times_of_a_machine_that_gets_slower_can_be_compared(tmp_path, monkeypatch):
    """Ten of the same settings among others, in three batches, while it slows down tenfold."""
    slowness = (1.02**k for k in itertools.count())
    bench = toy_bench(tmp_path, monkeypatch, slowness)
    found = [Point("step", Settings(step)) for step in (3.0, 5.0) * 10]
    bench._measure(found)
    assert max(bench.study.paces) > 10 * min(bench.study.paces)
    for point in found:
        assert point.times == pytest.approx([point.settings.step / 2] * 3)
        assert point.cost == pytest.approx(point.times[0] * np.median(bench.study.paces))
    costs = [float(row["seconds_per_simulated_second"]) for row in rows(tmp_path)]
    assert costs == pytest.approx([point.cost for point in found])


def test_a_time_stands_against_the_pacer_just_before_and_after(tmp_path, monkeypatch):
    """Not against one that was before the settings were looked at."""
    bench = toy_bench(tmp_path, monkeypatch, iter([1, 3, 4]), rounds=1)
    bench._measure([point := Point("step", Settings(6.0))])
    assert bench.study.paces == [2.0, 8.0] and point.times == [18.0 / 4.0]


def test_what_fails_in_the_middle_has_no_time(tmp_path, monkeypatch):
    bench = toy_bench(tmp_path, monkeypatch, itertools.repeat(1.0))
    fails = iter([1.0, WorkerFailed("no memory")])

    def time(step=None):
        if isinstance(answer := next(fails), Exception):
            raise answer
        return answer

    toys = {1.0: Toy(1.0), 2.0: Toy(2.0)}
    monkeypatch.setattr(toys[1.0], "time", time, raising=False)
    monkeypatch.setattr(bench, "_worker", lambda settings, *_: toys[settings.step])
    lost, kept = (Point("step", Settings(step)) for step in toys)
    bench._measure([lost, kept])
    assert lost.outcome == "failed: no memory" and not lost.timed and len(kept.times) == 3
    assert [row["outcome"] for row in rows(tmp_path)] == [lost.outcome, "finished"]


def test_without_its_pacer_a_study_ends(tmp_path, monkeypatch):
    """With what is in the table."""

    def slowness():
        yield from [1.0, 1.0, 1.0, 1.0]
        raise WorkerFailed("no memory")

    bench = toy_bench(tmp_path, monkeypatch, slowness())
    with pytest.raises(WorkerFailed, match=r"the pacer, .*: no memory"):
        bench._measure([Point("step", Settings(step)) for step in (1.0, 2.0)])
    assert [point.times for point in bench.study.points] == [[0.5], []]
    assert [float(row["error"]) for row in rows(tmp_path)] == [math.inf] * 2


def test_progress_has_counts(tmp_path, monkeypatch):
    said = []
    bench = Bench(bobbing(), tmp_path, 1.0, 8, 1, said.append)
    monkeypatch.setattr(bench, "_looked_at", lambda point, alive: None)
    monkeypatch.setattr(bench, "_turn", lambda pairs: None)
    bench._measure([Point("coupling", Settings(1e-5, coupling="none")) for _ in range(10)])
    bench._measure(points()[:1])
    assert said[0].startswith("settings 1 to 8 of 10: coupling none, ")
    assert said[1].startswith("settings 9 to 10 of 10: ")
    assert said[2] == "setting 11 of 11: step 1e-05 …"


def test_without_its_twin_a_knob_has_no_error_of_its_own(tmp_path):
    """Where the step at which knobs are turned did not get through."""
    bench = Bench(bobbing(), tmp_path, 1.0, 8, 1, print)
    bench.study.reference = Reference(Settings(1e-6), 8)
    twin, turned = (Point(knob, Settings.of(bobbing(), 1e-5)) for knob in ("step", "residual"))
    tight = dataclasses.replace(made(), turnover=1.01 * made().turnover)
    bench.twin, bench.references = twin, [tight]
    bench._judge(turned, [made()])
    assert turned.alone is None and math.isfinite(turned.error)
    bench._judge(twin, [made()])
    bench._judge(turned, [made()])
    assert turned.alone == 0
