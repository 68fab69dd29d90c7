"""The study of a scene, from the choice of points to the sentences."""

import csv
import dataclasses
import itertools
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from bobbing import STONE, R, bobbing
from records import made
from setups import law, scene

import taichi_dem as dem
from taichi_dem import cli, study_plan, study_report
from taichi_dem.settings import KNOBS, Settings, ladder
from taichi_dem.studies import study
from taichi_dem.study_bench import Bench
from taichi_dem.study_picture import picture, value
from taichi_dem.study_point import TABLE, Point, cheapest, pareto, write
from taichi_dem.study_result import Reference, Study
from taichi_dem.workers import WorkerFailed

ROOT = Path(__file__).parents[2]


def rows(folder):
    with (folder / TABLE).open() as file:
        return list(csv.DictReader(file))


def timed(folder):
    """Whether there is a time in the table."""
    return (folder / TABLE).exists() and any(int(row["rounds"]) for row in rows(folder))


# Points


def test_every_knob_is_turned_to_what_the_scene_accepts():
    setup = bobbing()
    tight = Settings.tightest(setup, 1e-5)
    for knob in KNOBS:
        found = ladder(knob, setup, tight, 1e-4)
        assert found
        assert all(settings.accepted(setup) and settings != tight for settings in found)
        if knob != "coupling":
            others = {settings.but(knob, getattr(tight, knob)) for settings in found}
            assert others == {tight}
    none = tight.but("coupling", "none")
    assert none.exchange is None and none.applied(setup).substrate.exchange == "none"
    assert tight.applied(setup).substrate.residual == tight.residual


def test_an_exchange_every_few_steps_is_a_setting():
    setup = bobbing()
    every = Settings.of(setup, 1e-5).but("exchange", "every 4")
    ground = every.applied(setup).substrate
    assert (ground.exchange, ground.exchange_every) == ("implicit", 4)
    assert Settings.of(every.applied(setup), 1e-5) == every
    assert Settings.tightest(every.applied(setup), 1e-5).exchange == "implicit"
    steps = (1e-5, 2e-5, 5e-6, 3e-6, 4e-5)
    kept = ["every 4", "every 2", "every 8", "every 13", "implicit"]  # 40 us, or less
    assert [every.at(step).exchange for step in steps] == kept
    assert [every.at(step).step for step in steps] == list(steps)
    assert Settings(1e-5, exchange="lagged").at(1e-6).exchange == "lagged"
    assert Settings(1e-5).at(1e-6) == Settings(1e-6)
    for coupling in ("none", "point"):
        assert every.but("coupling", coupling).accepted(every.applied(setup))


def test_without_ground_there_is_nothing_to_couple():
    setup = scene([[0, 0, 0]], R, STONE, law=law())
    tight = Settings.tightest(setup, 1e-5)
    assert [k for k in KNOBS if ladder(k, setup, tight, 1e-4)] == ["step", "precision", "skin"]
    assert tight.applied(setup) is setup


def points():
    """Made by hand: (cost, error, uncertainty)."""
    numbers = [(1.0, 5e-2, 0.0), (2.0, 2e-3, 0.0), (3.0, 8e-4, 2e-4), (4.0, 9e-4, 0.0)]
    return [
        Point("step", Settings(1e-5), "finished", {}, {"mean": (e, u)}, None, e, u, times=[c])
        for c, e, u in numbers
    ]


def made_study(folder, found=(), last=32, **rest):
    """One of which the reference is there; over 1 s."""
    told = {k: rest.pop(k) for k in ("touched", "grounded") if k in rest}
    tight = rest.pop("tight", Settings(1e-6))
    reference = Reference(tight, last, last < 32, 5 if last < 32 else 1, **told)
    return Study(folder, rest.pop("window", 1.0), 32, reference, points=list(found), **rest)


def said_of(found):
    return list(study_report.sentences(found))


def test_cheapest_is_one_that_surely_meets_the_target():
    found = points()
    assert cheapest(found, 1e-1) is found[0]
    assert cheapest(found, 1e-2) is found[1]
    assert cheapest(found, 1e-3) is found[3]  # the third may err by 1.2e-3
    assert cheapest(found, 1e-4) is None


def test_none_is_on_the_front_by_luck():
    found = points()
    assert pareto(found) == found
    found[2].means["other"] = (0.0, 1e-3)
    assert pareto(found) == [found[0], found[1], found[3]]
    assert found[2].bound == 2e-3


def test_sentences_name_what_meets_each_target(tmp_path):
    result = made_study(tmp_path, points(), orders={"trajectory": 1.98})
    said = said_of(result)
    assert "comparable over all 1 s" in said[0] and "1.98" in said[2]
    assert [line.partition(":")[0] for line in said[3:]] == [
        f"error {target}" for target in ("0.1", "0.01", "0.001", "0.0001")
    ]
    assert "none of the settings tried" in said[-1]
    result.sparse_order = 2.1
    assert "exchange to the next: 2.10" in said_of(result)[3]
    stopped = Point("step", Settings(1e-5), "stopped: too deep")
    said = said_of(made_study(tmp_path, [*points(), stopped], last=8))
    assert "chaotic" in said[0] and "250 ms of 1 s" in said[0] and "too deep" in said[2]


def test_errors_that_do_not_go_with_the_step_are_named(tmp_path):
    found = points()
    for point in found:
        point.errors = {"trajectory": 1e-3, "depression": 1e-3, "energy drift": 1e-15}
    said = said_of(made_study(tmp_path, found, orders={"trajectory": 1.98}))
    assert said[2] == "orders of convergence in the time step: trajectory 1.98; none of depression"
    result = made_study(tmp_path, found)
    assert said_of(result)[2].startswith("no order in the time step: nothing tells")
    result.cut_short = "interrupted"
    assert not any("order" in line for line in said_of(result))


def test_what_may_be_as_cheap_is_counted(tmp_path):
    """By its fastest round; of those that meet the error."""
    found = points()[:2]
    found[1].times = [1.5, 0.9, 1.2]
    said = said_of(made_study(tmp_path, found))
    assert "1 s per simulated second (1 other took no longer in some round); over" in said[2]
    assert "took no longer" not in said[3]
    found[1].times = [1.5, 1.1, 1.2]
    assert "took no longer" not in said_of(made_study(tmp_path, found))[2]


def test_only_measures_that_were_compared_are_named(tmp_path):
    """In a box, say, without a substrate."""
    found = points()
    found[0].errors = {"trajectory": 5e-2, "contact force": 1e-2}
    found[1].errors = {"trajectory": 2e-3}
    assert (
        "errors are those of trajectory, contact force;" in said_of(made_study(tmp_path, found))[0]
    )
    for point in found:
        point.means = {"radius of gyration": (1e-2, 1e-3)}
    said = said_of(made_study(tmp_path, found, last=8))[0]
    assert said.endswith("5 perturbed runs, with their uncertainty: radius of gyration")
    assert "errors" not in said_of(made_study(tmp_path))[0]


def test_what_an_ensemble_cannot_tell_is_not_claimed(tmp_path):
    """Whatever was found is below the uncertainty."""
    point = points()[0]
    point.error, point.uncertainty = 1e-5, 0.02
    point.means = {"mean": (1e-5, 0.02), "other": (1e-6, 0.0)}
    orders = {"trajectory": 1.98}
    said = said_of(made_study(tmp_path, [point], last=8, orders=orders))
    assert "in the first 250 ms: trajectory 1.98" in said[2]
    assert "is the cheapest" in said[3] and said[3].endswith("surely within 0.04")
    assert all("met by none" in line for line in said[4:])
    assert said[4].endswith("none below 0.04 could be told from 5 runs")


def test_where_nothing_touches_no_setting_is_advised(tmp_path):
    result = made_study(tmp_path, points(), window=3e-3, touched=False)
    (said,) = said_of(result)
    assert said.startswith("nothing touched in these 3 ms:") and "longer --duration" in said


def test_knobs_of_a_ground_that_nothing_touches_are_said_to_change_nothing(tmp_path):
    turned = Point("residual", Settings(1e-5), "finished", error=1e-3, alone=0.0, times=[1.0])
    result = made_study(tmp_path, [turned], window=3e-3, grounded=False)
    assert "touched the substrate in these 3 ms" in said_of(result)[2]
    turned.alone = 1e-5  # something touched between two samples
    assert "substrate" not in " ".join(said_of(result))
    turned.alone = 0.0
    assert "substrate" not in " ".join(said_of(made_study(tmp_path, [turned], grounded=True)))


def test_advice_lists_what_was_turned_and_over_which_time_it_holds(tmp_path):
    tight = Settings.tightest(bobbing(), 1e-5)
    given = Settings.of(bobbing(), 1e-5)
    cheap, exact = (
        Point("", settings, "finished", error=error, times=[error])
        for settings, error in ((tight, 1e-4), (given, 1e-2))
    )
    turned = ("step", "coupling")
    result = made_study(tmp_path, [cheap, exact], window=1e-3, tight=tight, turned=turned)
    said = said_of(result)
    assert said[1].startswith("turned: step, coupling; all else at its tightest (exchange impl")
    assert "step 10 µs, coupling finite is the cheapest" in said[-1]
    assert said[-1].endswith("over 1 ms its error is 0.0001")
    exact.times = [1e-5]  # the settings of the scene are looser in what was not turned
    said = said_of(result)
    assert f"residual {given.residual:g}" in said[-3] and "precision" not in said[-3]


def test_a_study_that_was_cut_short_says_so_and_nothing_that_was_not_measured(tmp_path):
    result = Study(tmp_path, 1.0, 32, cut_short="interrupted")
    assert said_of(result) == ["interrupted before there was a reference: nothing was compared"]
    result = made_study(tmp_path, planned=22, turned=("step",), cut_short="interrupted")
    said = said_of(result)
    assert said[0] == "interrupted after 0 of 22 settings"
    assert said[1] == "trajectories stay comparable over all 1 s" and len(said) == 3
    result.points = [*points(), Point("step", Settings(1e-5), "finished", error=1e-5)]
    said = said_of(result)
    assert said[0] == "interrupted after 5 of 22 settings, 1 of them not timed yet"
    assert "is the cheapest so far" in said[-2] and "settings tried so far" in said[-1]
    assert said[-1].endswith("the least is 0.0009")


def test_a_broken_study_is_reported_as_one(tmp_path, monkeypatch):
    """Ctrl-C while the reference is computed; then with the first settings."""
    said = []

    def interrupted(*_):
        raise KeyboardInterrupt

    def compared(bench, _):
        bench.study.reference, bench.study.planned = Reference(Settings(1e-6), 32), 8

    for start in (interrupted, compared):
        monkeypatch.setattr(Bench, "start", start)
        monkeypatch.setattr(Bench, "ladders", interrupted)
        folder = tmp_path / start.__name__
        with pytest.raises(KeyboardInterrupt):
            study(bobbing(), folder, duration=1.0, say=said.append)
        assert (folder / "study.txt").read_text().startswith("interrupted")
    assert said[0].startswith("interrupted before") and said[1].endswith("after 0 of 8 settings")


def test_nothing_is_turned_where_nothing_touches(tmp_path, monkeypatch):
    def start(bench, _):
        bench.study.reference = Reference(Settings(1e-6), 32, touched=False)

    said = []
    monkeypatch.setattr(Bench, "start", start)
    assert not study(bobbing(), tmp_path / "out", duration=3e-3, say=said.append).points
    assert len(said) == 1 and said[0].startswith("nothing touched in these 3 ms")


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


def test_the_picture_says_which_settings_are_on_the_front(tmp_path):
    """Each by its knob's value; no text on another."""
    found = points()
    others = (("exchange", "every 4"), ("precision", "single"), ("residual", 1e-2))
    for number, (knob, turned) in enumerate(others):
        settings = dataclasses.replace(Settings(1e-5), **{knob: turned})
        cost, error = 3.9 + number / 100, 8e-4 * 0.9**number
        found.append(Point(knob, settings, "finished", error=error, times=[cost]))
    found += [Point("combined 0.01", Settings(1e-5), "finished", error=0.1, times=[0.5])]
    found += [Point("as given", Settings(1e-5), "finished", error=1e-4, times=[6.0])]
    drawing = picture(made_study(tmp_path, found))
    (axes,) = drawing.axes
    written = [text for text in axes.texts if text.get_text()]
    assert {text.get_text() for text in written} == {value(p) for p in pareto(found)}
    assert {"10 µs", "every 4", "single", "residual 0.01", "for 0.01", "as given"} >= {
        text.get_text() for text in written
    }
    boxes = [text.get_window_extent() for text in written]
    for one, other in itertools.combinations(boxes, 2):
        assert not one.overlaps(other)
    assert all(axes.get_window_extent().contains(*corner) for b in boxes for corner in b.corners())


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


def test_the_table_has_the_spread_of_the_times(tmp_path):
    timed = Point("step", Settings(1e-5), "finished", times=[1.5, 0.5, 1.0], unit=2.0)
    write(tmp_path, [timed, Point("step", Settings(1e-5), "stopped: too deep")])
    names = [f"{which}seconds_per_simulated_second" for which in ("least_", "", "largest_")]
    found = [[float(row[name]) for name in names] for row in rows(tmp_path)]
    assert found == [[1.0, 2.0, 3.0], [math.inf] * 3]


def test_the_order_of_fewer_exchanges_is_fitted(tmp_path):
    """To what they add; one that was stopped has nothing to say."""
    found = made_study(tmp_path)
    for every in (2, 4, 8):
        settings = Settings.of(bobbing(), 1e-5).but("exchange", f"every {every}")
        found.points.append(Point("exchange", settings, alone=1e-6 * every**2.2))
    found.points.append(Point("exchange", settings.but("exchange", "every 16")))
    assert study_plan.sparse_order(found) == pytest.approx(2.2, abs=0.01)


def test_the_step_of_a_combination_is_fitted_or_one_that_was_tried(tmp_path):
    """The latter where errors do not go with the step, or are below their uncertainty."""
    steps = ((1e-4, 2e-2), (5e-5, 5e-3))
    found = made_study(
        tmp_path, [Point("step", Settings(h), "finished", error=e) for h, e in steps]
    )
    assert study_plan.worst_order(found, found.reference)[0] == pytest.approx(2, abs=0.01)
    assert study_plan.step_for(found, 1e-2, (2.0, 1e8), 1e-4) == pytest.approx(1e-5)
    assert study_plan.step_for(found, 1e-2, (2.0, 1e4), 1e-4) == 1e-4
    tried = [study_plan.step_for(found, error, None, 1e-4) for error in (1e-1, 1e-2, 1e-3)]
    assert tried == [1e-4, 5e-5, None]
    found.points[1].uncertainty = 3e-3
    assert study_plan.worst_order(found, found.reference) is None


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


# The whole


@pytest.mark.slow
def test_study_of_a_smooth_scene(tmp_path):
    """Second order in the step; what matters is found."""
    said = []
    found = study(
        bobbing(),
        tmp_path / "out",
        ["coupling"],
        duration=5e-3,
        rounds=1,
        samples=8,
        say=said.append,
    )
    assert not found.chaotic
    assert found.orders["trajectory"] == pytest.approx(2, abs=0.05)
    assert found.orders["energy drift"] == pytest.approx(2, abs=0.1)
    by_knob = {p.knob: [q for q in found.points if q.knob == p.knob] for p in found.points}
    steps = [point.error for point in by_knob["step"]]
    assert np.all(np.diff(steps) < 0)
    loose = by_knob["coupling"][0]
    assert loose.error > 1e-2 and loose.alone == pytest.approx(loose.error, rel=0.1)
    for point in found.points:
        assert point.outcome == "finished" and point.cost > 0 and math.isfinite(point.error)
    assert len(rows(tmp_path / "out")) == len(found.points)
    assert said[-4].startswith("error 0.1: step")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"study.csv", "study.txt", "study.png", "scene.toml"} <= written


def test_what_is_wrong_is_said_before_anything_is_written(tmp_path, capsys):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(dem.InputError) as error:
        study(bobbing(), tmp_path / "full", ["stepp"], duration=-1.0, rounds=0)
    said = str(error.value)
    for part in ("duration = -1.0", "did you mean 'step'?", "rounds = 0", "empty folder"):
        assert part in said
    with pytest.raises(dem.InputError, match="duration"):
        study(bobbing(), tmp_path / "new")
    missing = str(tmp_path / "missing.toml")
    assert cli.main(["study", missing, "-o", str(tmp_path / "new")]) == cli.WRONG_INPUT
    assert not (tmp_path / "new").exists()
    assert "missing.toml: there is no such file" in capsys.readouterr().err


@pytest.mark.slow
def test_ctrl_c_leaves_what_there_is(tmp_path):
    bobbing().to_toml(tmp_path / "scene.toml")
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "taichi_dem", "study", str(tmp_path / "scene.toml")]
    command += ["-o", str(folder), "--duration", "2e-3", "--knobs", "step", "--rounds", "1000"]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True)
    while run.poll() is None and not timed(folder):
        time.sleep(0.1)
    run.send_signal(signal.SIGINT)
    said, _ = run.communicate()
    assert run.returncode == cli.INTERRUPTED
    assert rows(folder) and "error 0.1" in said
    assert (folder / "study.txt").read_text().startswith("interrupted after ")
