"""Settings for an asked error: the arithmetic on made-up errors, then whole runs."""

import json

import numpy as np
import pytest
from bobbing import bobbing
from setups import law, scene

import taichi_dem as dem
from taichi_dem import accuracy, choice, cli, scene_file
from taichi_dem.pilot import Pilot


class Made:
    """A pilot whose runs err by ``constant`` step^``order``."""

    stable, window, chaotic, scene = 1.0, 1.0, False, None

    def __init__(self, constant, order):
        self.constant, self.order = constant, order
        self.tight = choice.Settings(0.0)
        self.finest = 1.0

    def distance(self, settings, reference):
        self.finest = min(self.finest, reference.step)
        away = settings.step**self.order - reference.step**self.order
        return {"trajectory": self.constant * away}


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("asked", [1e-2, 1e-3, 1e-4])
def test_the_step_is_the_one_that_errs_as_asked(order, asked):
    pilot = Made(0.03, order)
    found = choice.choose_by(pilot, asked)
    true = 0.03 * found.settings.step**order
    assert found.limit == "the asked error"
    assert true == pytest.approx(choice.AIM * asked, rel=0.05)
    assert found.expected == pytest.approx(true, rel=0.05)
    # A steady order is followed beyond what was run, ...
    assert pilot.finest >= found.settings.step / 4


def test_where_the_stable_step_is_good_enough_it_is_taken():
    found = choice.choose_by(Made(1e-3, 2.0), 1e-2)
    assert found.settings.step == 1.0 and found.limit == "the stable step"
    assert found.expected == pytest.approx(1e-3, rel=0.05)


def test_what_cannot_be_met_is_said():
    found = choice.choose_by(Made(0.1, 1.0), 1e-7)  # ... but not without end
    assert found.limit.startswith("no step below") and found.expected > 1e-7


def test_the_error_found_is_about_the_one_asked():
    asked, pilot = 1e-5, Pilot(bobbing(), 0.01)
    told = choice.choose_by(pilot, asked)
    fine = pilot.tight.but("step", told.settings.step / 8)
    found = accuracy.worst(pilot.distance(told.settings, fine))
    assert told.limit == "the asked error"
    assert asked / 3 < found < 2 * asked
    assert told.expected == pytest.approx(found, rel=0.5)


def test_what_was_chosen_is_on_record(tmp_path, monkeypatch):
    settings = choice.Settings(2e-5, 1e-5, 1e-5, "point", "implicit")
    made = choice.Choice(settings, 1e-3, 8e-4, 1e-3, False, "the asked error", {})
    monkeypatch.setattr(choice, "choose", lambda *_: made)
    bobbing().to_toml(tmp_path / "scene.toml")
    command = ["run", str(tmp_path / "scene.toml"), "--duration", "1e-3", "--error", "1e-3"]
    assert cli.main([*command, "-o", str(tmp_path / "out")]) == cli.DONE
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    told = summary["asked_error"]
    setup, plan = scene_file.read(tmp_path / "out" / "scene.toml")
    assert plan.dt == told["settings"]["step"] == summary["dt_s"]
    assert setup.substrate.residual == told["settings"]["residual"]
    assert (told["asked"], told["expected"]) == (1e-3, 8e-4)


def test_trajectories_that_part_end_the_comparison():
    """A sphere between others, hit again and again."""
    rng = np.random.default_rng(3)
    stone = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
    grid = np.stack(np.meshgrid(*3 * [np.arange(2.0)], indexing="ij"), axis=-1).reshape(-1, 3)
    place = (3.5 * grid + 2 + rng.uniform(-0.3, 0.3, grid.shape)) * 1e-3
    box = dem.Box((0, 0, 0), (8e-3, 8e-3, 8e-3), stone)
    velocity = rng.normal(size=place.shape)
    setup = scene(place, 1e-3, stone, velocity=velocity, law=law(), boundaries=[box])
    pilot = Pilot(setup, 0.2)
    assert pilot.chaotic and 0 < pilot.window < 0.1


def test_an_error_must_be_one(tmp_path, capsys):
    bobbing().to_toml(tmp_path / "scene.toml")
    command = ["run", str(tmp_path / "scene.toml"), "--duration", "1e-3", "-o", str(tmp_path / "x")]
    assert cli.main([*command, "--error", "2"]) == cli.WRONG_INPUT
    assert "--error = 2.0: must be > 0 and < 1" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
