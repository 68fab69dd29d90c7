"""The study of a scene, from the choice of points to the sentences."""

import csv
import dataclasses
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
from taichi_dem import cli, study_report
from taichi_dem.settings import KNOBS, Settings, ladder
from taichi_dem.studies import study
from taichi_dem.study_bench import Bench
from taichi_dem.study_point import TABLE, Point, append, cheapest, pareto
from taichi_dem.study_result import Study

ROOT = Path(__file__).parents[2]


def rows(folder):
    with (folder / TABLE).open() as file:
        return list(csv.DictReader(file))


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
        Point("step", Settings(1e-5), "finished", error=e, uncertainty=u, seconds=[c])
        for c, e, u in numbers
    ]


def test_cheapest_is_one_that_surely_meets_the_target():
    found = points()
    assert cheapest(found, 1e-1) is found[0]
    assert cheapest(found, 1e-2) is found[1]
    assert cheapest(found, 1e-3) is found[3]  # the third may err by 1.2e-3
    assert cheapest(found, 1e-4) is None
    assert pareto(found) == found[:3]


def test_sentences_name_what_meets_each_target(tmp_path):
    result = Study(tmp_path, 1.0, 32, last=32, points=points(), orders={"trajectory": 1.98})
    said = list(study_report.sentences(result))
    assert "comparable over all 1 s" in said[0] and "1.98" in said[1]
    assert [line.partition(":")[0] for line in said[2:]] == [
        f"error {target}" for target in ("0.1", "0.01", "0.001", "0.0001")
    ]
    assert "none of the settings tried" in said[-1]
    result.sparse_order = 2.1
    assert "exchange to the next: 2.10" in list(study_report.sentences(result))[2]
    stopped = Point("step", Settings(1e-5), "stopped: too deep")
    chaotic = Study(tmp_path, 1.0, 32, True, 8, [*points(), stopped])
    said = list(study_report.sentences(chaotic))
    assert "chaotic" in said[0] and "250 ms of 1 s" in said[0] and "too deep" in said[1]


def test_only_measures_that_were_compared_are_named(tmp_path):
    """In a box, say, without a substrate."""
    found = points()
    found[0].errors = {"trajectory": 5e-2, "contact force": 1e-2}
    found[1].errors = {"trajectory": 2e-3}
    said = next(study_report.sentences(Study(tmp_path, 1.0, 32, last=32, points=found)))
    assert "errors are those of trajectory, contact force;" in said
    found[0].means = {"radius of gyration": (1e-2, 1e-3)}
    said = next(study_report.sentences(Study(tmp_path, 1.0, 32, True, 8, found)))
    assert said.endswith("with their uncertainty: radius of gyration")
    assert "errors" not in next(study_report.sentences(Study(tmp_path, 1.0, 32, last=32)))


def test_where_nothing_touches_no_setting_is_advised(tmp_path):
    result = Study(tmp_path, 3e-3, 32, last=32, points=points(), touched=False)
    (said,) = study_report.sentences(result)
    assert said.startswith("nothing touched in these 3 ms:") and "longer --duration" in said


def test_knobs_of_a_ground_that_nothing_touches_are_said_to_change_nothing(tmp_path):
    turned = Point("residual", Settings(1e-5), "finished", error=1e-3, alone=0.0, seconds=[1.0])
    result = Study(tmp_path, 3e-3, 32, last=32, points=[turned], grounded=False)
    assert "touched the substrate in these 3 ms" in list(study_report.sentences(result))[1]
    turned.alone = 1e-5  # something touched between two samples
    assert "substrate" not in " ".join(study_report.sentences(result))
    turned.alone, result.grounded = 0.0, True
    assert "substrate" not in " ".join(study_report.sentences(result))


def test_advice_lists_what_was_turned_and_over_which_time_it_holds(tmp_path):
    tight = Settings.tightest(bobbing(), 1e-5)
    given = Settings.of(bobbing(), 1e-5)
    cheap, exact = (
        Point("", settings, "finished", error=error, seconds=[error])
        for settings, error in ((tight, 1e-4), (given, 1e-2))
    )
    turned = ("step", "coupling")
    result = Study(tmp_path, 1e-3, 32, last=32, points=[cheap, exact], tight=tight, turned=turned)
    said = list(study_report.sentences(result))
    assert said[1].startswith("turned: step, coupling; all else at its tightest (exchange impl")
    assert "step 10 µs, coupling finite is the cheapest" in said[-1]
    assert said[-1].endswith("over 1 ms its error is 0.0001")
    exact.seconds = [1e-5]  # the settings of the scene are looser in what was not turned
    said = list(study_report.sentences(result))
    assert f"residual {given.residual:g}" in said[-3] and "precision" not in said[-3]


def test_a_study_that_was_cut_short_says_so_and_nothing_that_was_not_measured(tmp_path):
    result = Study(tmp_path, 1.0, 32, last=32, compared=False, cut_short="interrupted")
    (said,) = study_report.sentences(result)
    assert said == "interrupted before there was a reference: nothing was compared"
    result.compared, result.planned = True, 22
    said = list(study_report.sentences(result))
    assert said == [
        "interrupted after 0 of 22 settings",
        "trajectories stay comparable over all 1 s",
    ]
    result.points = points()
    said = list(study_report.sentences(result))
    assert said[0] == "interrupted after 4 of 22 settings"
    assert "is the cheapest so far" in said[-2] and "settings tried so far" in said[-1]


def test_a_broken_study_is_reported_as_one(tmp_path, monkeypatch):
    """Ctrl-C while the reference is computed; then with the first settings."""
    said = []

    def interrupted(*_):
        raise KeyboardInterrupt

    def compared(bench, _):
        bench.study.compared, bench.study.planned = True, 8

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
        bench.study.compared, bench.study.touched = True, False

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
    bench._characterize([free])
    assert not bench.study.touched and bench.exact is None and bench.study.grounded is None
    bobs = Bench(bobbing(), tmp_path, 1.0, 8, 1, print)
    count = bobbing().spheres.count
    bobs._characterize([made(n=count), made(n=count)])
    assert bobs.study.touched and bobs.study.grounded


def test_progress_has_counts(tmp_path, monkeypatch):
    said = []
    bench = Bench(bobbing(), tmp_path, 1.0, 8, 1, said.append)
    monkeypatch.setattr(bench, "_worker_of", lambda point: None)
    bench._measure([Point("coupling", Settings(1e-5, coupling="none")) for _ in range(10)])
    bench._measure(points()[:1])
    assert said[0].startswith("settings 1 to 8 of 10: coupling none, ")
    assert said[1].startswith("settings 9 to 10 of 10: ")
    assert said[2] == "setting 11 of 11: step 1e-05 …"


def test_the_table_has_the_spread_of_the_times(tmp_path):
    append(tmp_path, Point("step", Settings(1e-5), "finished", seconds=[3.0, 1.0, 2.0]))
    append(tmp_path, Point("step", Settings(1e-5), "stopped: too deep"))
    names = [f"{which}seconds_per_simulated_second" for which in ("least_", "", "largest_")]
    found = [[float(row[name]) for name in names] for row in rows(tmp_path)]
    assert found == [[1.0, 2.0, 3.0], [math.inf] * 3]


def test_the_order_of_fewer_exchanges_is_fitted(tmp_path):
    """To what they add; one that was stopped has nothing to say."""
    bench = Bench(bobbing(), tmp_path, 1.0, 8, 1, print)
    for every in (2, 4, 8):
        settings = Settings.of(bobbing(), 1e-5).but("exchange", f"every {every}")
        bench.study.points.append(Point("exchange", settings, alone=1e-6 * every**2.2))
    bench.study.points.append(Point("exchange", settings.but("exchange", "every 16")))
    assert bench._sparse_order() == pytest.approx(2.2, abs=0.01)


def test_the_step_of_a_combination_is_fitted_or_one_that_was_tried(tmp_path):
    """The latter where errors do not go with the step."""
    bench = Bench(bobbing(), tmp_path, 1.0, 8, 1, print)
    bench.stable = 1e-4
    for step, error in ((1e-4, 2e-2), (5e-5, 5e-3)):
        bench.study.points.append(Point("step", Settings(step), "finished", error=error))
    assert bench._step_for(1e-2, (2.0, 1e8)) == pytest.approx(1e-5)
    assert bench._step_for(1e-2, (2.0, 1e4)) == 1e-4
    assert [bench._step_for(error, None) for error in (1e-1, 1e-2, 1e-3)] == [1e-4, 5e-5, None]


def test_without_its_twin_a_knob_has_no_error_of_its_own(tmp_path):
    """Where the step at which knobs are turned did not get through."""
    bench = Bench(bobbing(), tmp_path, 1.0, 8, 1, print)
    twin, turned = (Point(knob, Settings.of(bobbing(), 1e-5)) for knob in ("step", "residual"))
    bench.twin, bench.references = twin, [made()]
    bench._judge(turned, [made()])
    assert turned.alone is None and math.isfinite(turned.error)
    bench._judge(twin, [made()])
    bench._judge(turned, [made()])
    assert turned.alone == 0


def test_results_are_appended(tmp_path):
    for point in points():
        append(tmp_path, point)
    assert [float(row["error"]) for row in rows(tmp_path)] == [p.error for p in points()]


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
    while run.poll() is None and not ((folder / TABLE).exists() and rows(folder)):
        time.sleep(0.1)
    run.send_signal(signal.SIGINT)
    said, _ = run.communicate()
    assert run.returncode == cli.INTERRUPTED
    assert rows(folder) and "error 0.1" in said
    assert (folder / "study.txt").read_text().startswith("interrupted after ")
