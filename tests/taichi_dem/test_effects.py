"""An effect that is off leaves nothing behind: no instruction, no field."""

import dataclasses
import json

import numpy as np
import pytest
from kernel_counts import DRIVERS, FLAGS, counts, package_without, scenes

import taichi_dem as dem
from taichi_dem import cli, cost, output, run
from taichi_dem.effects import effects_of
from taichi_dem.guards import SimulationStopped
from taichi_dem.memory import by_effect, memory

ALONE = [effect for effect in FLAGS if effect not in ("rotation", "history")]  # which follow
BUT_ONE = [
    "friction",
    "rolling",
    "multi-contact",
    "adhesion",
    "substrate coupling",
    "extrapolated exchange",
    "finite contact size",
    "lagged exchange",
    "layer",
    "period",
    "moving boundaries",
]


def test_what_is_off_is_compiled_as_if_it_did_not_exist(tmp_path):
    assert package_without(tmp_path, FLAGS) > 50
    off = counts("plain", tmp_path / "off")
    assert off == counts("plain", tmp_path / "absent", package=tmp_path)
    assert min(dict(off)[driver] for driver in DRIVERS) > 1000


@pytest.mark.slow
@pytest.mark.parametrize("effect", BUT_ONE)
def test_so_it_is_where_all_others_are_on(effect, tmp_path):
    assert package_without(tmp_path, [effect]) > 0
    off = counts(f"all but {effect}", tmp_path / "off")
    assert off == counts(f"all but {effect}", tmp_path / "absent", package=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ALONE)
def test_what_is_on_is_seen_in_the_count(effect, tmp_path):
    """In all kernels together: one may be shorter, where what was inlined twice is a function."""
    on, off = counts(effect, tmp_path / "on"), counts("plain", tmp_path / "off")
    assert sum(number for _, number in on) > sum(number for _, number in off)
    assert all(dict(on)[driver] != dict(off)[driver] for driver in DRIVERS)


@pytest.fixture(scope="module")
def plain():
    return dem.Simulation(scenes()["plain"], driver="serial")


def test_what_is_off_has_no_field(plain):
    contacts = plain._engine.contacts
    assert set(contacts.result.keys) == {"force", "half_overlap"}
    for name in ("history", "old_history", "lost", "old_result", "number"):
        assert not hasattr(contacts, name)
    assert not any(by_effect(plain._engine).values())
    assert plain._engine.exchange is None and plain._engine.expansions is None


def test_every_effect_is_listed_with_a_reason(plain):
    told = plain.summary()["effects"]
    assert set(told) == {effect.name for effect in plain.effects.listed}
    assert set(told) >= set(ALONE)
    for effect in told.values():
        assert "share_of_step" not in effect
        assert effect["on"] is False and effect["memory_bytes"] == 0 and effect["reason"]


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["multi-contact", "substrate coupling", "adhesion", "sleep"])
def test_the_memory_of_an_effect_is_what_it_adds(effect, plain):
    """All fields of the scene with it, less those of the scene without; the contact lists of both
    are as long."""
    sim = dem.Simulation(scenes()[effect], driver="serial")
    told = by_effect(sim._engine)
    parts, before = memory(sim._engine), memory(plain._engine)
    assert bool(told.get(effect)) == (effect != "adhesion")  # which only looks farther
    for part in ("particles", "cells"):
        assert parts[part] == before[part]
    added = sum(parts.values()) - sum(before.values()) - parts["boundaries"] + before["boundaries"]
    assert sum(told.values()) == added


def test_wall_time_is_shared_out(plain):
    plain.restart()
    assert plain.summary()["seconds"] == {"steps": 0.0, "contact lists": 0.0, "output": 0.0}
    plain.run(steps=3)
    seconds = plain.summary()["seconds"]
    assert seconds["steps"] > 0 and min(seconds.values()) >= 0


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("plain", set()),
        ("friction", {"friction", "dissipation"}),
        ("rolling", {"rolling", "dissipation"}),
        ("adhesion", {"adhesion", "dissipation"}),
        ("multi-contact", {"multi-contact"}),
        ("substrate coupling", {"substrate coupling"}),
        ("moving boundaries", {"moving boundaries"}),
        ("finite contact size", {"substrate coupling", "finite contact size"}),
        ("lagged exchange", {"substrate coupling", "lagged exchange"}),
        ("extrapolated exchange", {"substrate coupling", "extrapolated exchange"}),
        ("layer", {"substrate coupling", "layer"}),
        ("relaxation", {"substrate coupling", "relaxation", "dissipation"}),
        ("sleep", {"sleep"}),
        (
            "all but adhesion",
            {"friction", "rolling", "dissipation", "substrate coupling", "moving boundaries"},
        ),
    ],
)
def test_each_effect_can_be_left_out_alone(name, expected):
    scene = scenes()[name]
    scene = dataclasses.replace(scene, gravity=(0, 0, -1.0))
    books = effects_of(scene).losses
    found = {effect: (one, kept) for effect, one, kept in cost.variants(scene, books)}
    assert set(found) == expected
    for effect, (without, kept) in found.items():
        told = {e.name: e.on for e in effects_of(without, kept).listed}
        assert told[effect] is False
        assert without.gravity == scene.gravity


def test_costs_are_told_as_shares():
    told = cost.Cost("friction", on=(2.0, 2.0, 2.0), off=(1.0, 1.6, 1.5))
    assert told.ratios == pytest.approx([2, 1.25, 4 / 3])
    assert told.shares == pytest.approx([0.5, 0.2, 0.25])
    assert told.words() == "friction 25% (20% to 50%)"
    assert told.summary()["share_of_step"] == pytest.approx(0.25)
    assert told.summary()["share_spread"] == pytest.approx([0.2, 0.5])
    failed = cost.Cost("rolling", problem="too deep")
    assert "cannot be told: too deep" in failed.words()
    assert failed.summary() == {"share_of_step": None, "share_problem": "too deep"}


def test_costs_are_told_with_the_state_they_were_measured_in(plain):
    told = cost.Cost("friction", on=(2.0,), off=(1.0,))
    first, second = cost.lines(plain, [told])
    assert f"{plain.coordination():.2g} contacts per sphere" in first
    assert second == told.words()
    assert "no effect" in next(cost.lines(plain, []))


@pytest.fixture
def rubbing(plain, monkeypatch):
    """A simulation that says to have friction, of which nothing need be compiled."""
    plain.restart()
    with monkeypatch.context() as patch:
        patch.setattr(plain._engine, "effects", effects_of(scenes()["friction"]))
        yield plain


def test_a_run_writes_them_to_its_summary(rubbing, tmp_path, monkeypatch, capsys):
    told = cost.Cost("friction", on=(2.0, 2.0, 2.0), off=(1.0, 1.6, 1.5))
    monkeypatch.setattr(cost, "measure", lambda sim: [told])
    (tmp_path / output.SUMMARY).write_text('{"outcome": "finished"}')
    assert rubbing.summary()["effects"]["friction"]["share_of_step"] is None
    run._time_effects(rubbing, tmp_path)
    written = json.loads((tmp_path / output.SUMMARY).read_text())
    assert written["outcome"] == "finished"
    friction = written["effects"]["friction"]
    assert friction["share_of_step"] == pytest.approx(0.25) and friction["memory_bytes"] == 0
    assert written["effects"]["history"]["share_of_step"] is None  # goes with friction
    assert "share_of_step" not in written["effects"]["rolling"]
    assert told.words() in capsys.readouterr().out
    rubbing.run(steps=1)  # in another state they are not known
    assert rubbing.summary()["effects"]["friction"]["share_of_step"] is None


@pytest.mark.parametrize("end", [KeyboardInterrupt(), SimulationStopped("too deep", None, {})])
def test_what_cannot_be_timed_spoils_nothing(end, rubbing, tmp_path, monkeypatch, capsys):
    def ended(sim):
        raise end

    monkeypatch.setattr(cost, "measure", ended)
    run._time_effects(rubbing, tmp_path)
    said = capsys.readouterr().out
    assert f"not timed: {end}" in said or "not timed: interrupted" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("asked", [["--cost"], ["--set", "run.effect_costs=true"]])
def test_the_command_line_times_them_if_asked(asked, tmp_path, capsys):
    path, folder = tmp_path / "scene.toml", tmp_path / "out"
    scenes()["friction"].to_toml(path)
    assert cli.main(["run", str(path), "-o", str(folder), "--duration", "2e-5", *asked]) == cli.DONE
    said = json.loads((folder / output.SUMMARY).read_text())
    assert said["outcome"] == "finished"
    timed = {name for name, one in said["effects"].items() if one.get("share_of_step") is not None}
    assert timed == {"friction", "dissipation"}
    for name in timed:
        low, high = said["effects"][name]["share_spread"]
        assert low <= said["effects"][name]["share_of_step"] <= high < 1
    assert "share of the time of a step" in capsys.readouterr().out
    assert "effect_costs = true" in (folder / output.SCENE).read_text()


@pytest.mark.slow
def test_costs_are_measured_on_a_scene_that_is_left_alone():
    sim = dem.Simulation(scenes()["friction"], driver="serial")
    sim.run(steps=10)
    before = sim.particles.position.copy()
    found = cost.measure(sim, rounds=2, seconds=0.01)
    assert {one.name for one in found} == {"friction", "dissipation"}
    assert all(len(one.on) == len(one.off) == 2 and min(one.ratios) > 0 for one in found)
    assert np.array_equal(sim.particles.position, before) and sim.steps == 10
