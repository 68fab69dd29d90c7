"""An effect that is off leaves nothing behind: no instruction, no field."""

import dataclasses

import numpy as np
import pytest
from kernel_counts import FLAGS, counts, package_without, scenes

import taichi_dem as dem
from taichi_dem import check, cli, cost
from taichi_dem.effects import effects_of
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
    absent = counts("plain", tmp_path / "absent", package=tmp_path)
    assert sum(off) > 5000  # of all kernels
    assert off == absent


@pytest.mark.slow
@pytest.mark.parametrize("effect", BUT_ONE)
def test_so_it_is_where_all_others_are_on(effect, tmp_path):
    assert package_without(tmp_path, [effect]) > 0
    off = counts(f"all but {effect}", tmp_path / "off")
    assert off == counts(f"all but {effect}", tmp_path / "absent", package=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ALONE)
def test_what_is_on_is_seen_in_the_count(effect, tmp_path):
    assert sum(counts(effect, tmp_path / "on")) > sum(counts("plain", tmp_path / "off"))


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
    assert set(told) >= set(ALONE) - {"friction", "rolling", "lagged exchange"}
    for effect in told.values():
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
        ("extrapolated exchange", {"substrate coupling", "extrapolated exchange"}),
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
        assert told.get(effect) in (False, None)
        assert without.gravity == scene.gravity


def test_costs_are_told_as_shares():
    told = cost.Cost("friction", on=(2.0, 2.0, 2.0), off=(1.0, 1.6, 1.5))
    assert told.ratios == pytest.approx([2, 1.25, 4 / 3])
    assert told.shares == pytest.approx([0.5, 0.2, 0.25])
    assert told.words() == "friction 25% (20% to 50%)"
    assert "cannot be told: too deep" in cost.Cost("rolling", problem="too deep").words()


def test_check_says_them_if_asked(plain, monkeypatch):
    told = cost.Cost("friction", on=(2.0,), off=(1.0,))
    monkeypatch.setattr(cost, "measure", lambda sim: [told])
    first, second = check.costs(plain)
    assert f"{plain.coordination():.2g} contacts per sphere" in first
    assert second == told.words()
    monkeypatch.setattr(cost, "measure", lambda sim: [])
    assert "no effect" in next(check.costs(plain))
    assert cli._parser().parse_args(["check", "scene.toml", "--cost"]).cost is True


@pytest.mark.slow
def test_costs_are_measured_on_a_scene_that_is_left_alone():
    sim = dem.Simulation(scenes()["friction"], driver="serial")
    sim.run(steps=10)
    before = sim.particles.position.copy()
    found = cost.measure(sim, rounds=2, seconds=0.01)
    assert {one.name for one in found} == {"friction", "dissipation"}
    assert all(len(one.on) == len(one.off) == 2 and min(one.ratios) > 0 for one in found)
    assert np.array_equal(sim.particles.position, before) and sim.steps == 10
