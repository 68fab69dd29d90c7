"""The study of a scene, from the choice of points to the sentences."""

import csv
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
from setups import law, scene

import taichi_dem as dem
from taichi_dem import cli, study_report
from taichi_dem.settings import KNOBS, Settings, ladder
from taichi_dem.studies import study
from taichi_dem.study_bench import Bench, Study
from taichi_dem.study_point import TABLE, Point, append, cheapest, pareto

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


def test_the_order_of_fewer_exchanges_is_fitted(tmp_path):
    """To what they add; one that was stopped has nothing to say."""
    bench = Bench(bobbing(), tmp_path, 1.0, 8, 1, print)
    for every in (2, 4, 8):
        settings = Settings.of(bobbing(), 1e-5).but("exchange", f"every {every}")
        bench.study.points.append(Point("exchange", settings, alone=1e-6 * every**2.2))
    bench.study.points.append(Point("exchange", settings.but("exchange", "every 16")))
    assert bench._sparse_order() == pytest.approx(2.2, abs=0.01)


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
    assert rows(folder) and "error 0.1" in said and (folder / "study.txt").exists()
