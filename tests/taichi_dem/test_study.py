"""The study of a scene: which settings are tried, and the whole from scene to files."""

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
from made_studies import made_study, rows
from setups import law, scene

import taichi_dem as dem
from taichi_dem import cli, study_plan
from taichi_dem.settings import KNOBS, Settings, ladder
from taichi_dem.studies import study
from taichi_dem.study_bench import Bench
from taichi_dem.study_point import TABLE, Point
from taichi_dem.study_result import Reference

ROOT = Path(__file__).parents[2]


# Settings


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


def timed(folder):
    """Whether there is a time in the table."""
    return (folder / TABLE).exists() and any(int(row["rounds"]) for row in rows(folder))


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
