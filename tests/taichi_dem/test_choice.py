"""Settings for an asked error: the arithmetic on made-up errors, then whole runs."""

import dataclasses
import json
import math

import numpy as np
import pytest
from bobbing import STONE, R, bobbing
from setups import law, scene

import taichi_dem as dem
from taichi_dem import accuracy, choice, cli, scene_file
from taichi_dem.asked_error import settled
from taichi_dem.guards import SimulationStopped
from taichi_dem.moments import STATES
from taichi_dem.neglect import Neglected, turned_on
from taichi_dem.pilot import Pilot, Span


class Made:
    """A pilot whose runs err by ``constant`` step^``order``."""

    span, whole, scene = Span(0.0, 1.0, 1.0), True, None

    def __init__(self, constant, order):
        self.constant, self.order = constant, order
        self.tight = choice.Settings(0.0)
        self.finest = 1.0

    def distance(self, settings, reference):
        self.finest = min(self.finest, reference.step)
        away = settings.step**self.order - reference.step**self.order
        return {"trajectory": self.constant * away}

    def touching(self, settings):
        return True


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
    assert found.limit.startswith("short runs") and found.expected > 1e-7
    assert not found.met and any("more than the 1e-07 asked for" in line for line in found.words())


class Grounded(Made):
    """One on whose ground, not solved for at every step, runs err by ``late`` (steps between)^2
    more; contacts swing too far from ``far`` steps on."""

    scene = bobbing()

    def __init__(self, late, contacts=16, far=math.inf, **changes):
        super().__init__(0.03, 2.0)
        self.late, self.contacts, self.far = late, contacts, far
        self.tight = dataclasses.replace(choice.Settings.tightest(self.scene, 0.0), **changes)

    def distance(self, settings, reference):
        if settings.coupling != reference.coupling:
            return {"trajectory": 1.0}
        found = super().distance(settings, reference)["trajectory"]
        between = [one.every * one.step * (one.every > 1) for one in (settings, reference)]
        return {"trajectory": abs(found) + self.late * abs(between[0] ** 2 - between[1] ** 2)}

    def grounded(self, settings):
        return self.contacts

    def is_steep(self, settings):
        return settings.every >= self.far


@pytest.mark.parametrize(
    ("pilot", "asked", "exchange"),
    [
        (Grounded(1e-6), 1e-3, "every 16"),
        (Grounded(2e-4), 1e-3, "every 4"),  # of the step 0.16: 8e-5, a tenth
        (Grounded(1.0), 1e-3, "implicit"),
        (Grounded(1e-6, far=8), 1e-3, "every 4"),
        (Grounded(1e-6, contacts=2), 1e-3, "implicit"),  # nothing to be saved
        (Grounded(1e-6, exchange="lagged"), 1e-3, "lagged"),
        (Grounded(1e-4), 1e-1, "every 16"),  # the stable step leaves room: 0.026 of 0.05
    ],
)
def test_the_ground_is_solved_for_as_seldom_as_the_error_allows(pilot, asked, exchange):
    found = choice.choose_by(pilot, asked)
    settings = found.settings
    assert settings.exchange == exchange
    true = pilot.distance(settings, settings.but("step", 0.0).but("exchange", "implicit"))[
        "trajectory"
    ]
    assert found.expected == pytest.approx(true, rel=0.05) and true <= asked


def test_ground_that_is_never_solved_for_rarely_is_left_alone():
    """Creeping ground follows the force of every step."""
    creeps = dem.Substrate(STONE, coupling="point", relaxation=dem.Relaxation(1e6, 1.0))
    pilot = Grounded(1e-6)
    pilot.scene = dataclasses.replace(bobbing(), substrate=creeps)
    pilot.tight = choice.Settings.tightest(pilot.scene, 0.0)
    assert choice.choose_by(pilot, 1e-3).settings.exchange == "implicit"


class Uncoupled(Grounded):
    """One whose contacts on the ground do not feel each other yet."""

    def __init__(self, *, whole, steady, contacts=16):
        super().__init__(1e-6, contacts)
        self.whole, self.is_steady = whole, steady
        given = dataclasses.replace(self.scene.substrate, coupling="point", residual=3e-5)
        self.scene = dataclasses.replace(self.scene, substrate=given)

    def distance(self, settings, reference):
        return {"trajectory": 0.0}

    def steady(self, settings):
        return self.is_steady


@pytest.mark.parametrize(
    ("pilot", "coupling"),
    [
        (Uncoupled(whole=True, steady=False), "none"),
        (Uncoupled(whole=False, steady=True), "none"),
        (Uncoupled(whole=False, steady=False), "point"),
        (Uncoupled(whole=True, steady=True, contacts=0), "point"),
    ],
)
def test_coupling_is_left_out_only_where_all_contacts_were_seen(pilot, coupling):
    found = choice.choose_by(pilot, 1e-2)
    assert found.settings.coupling == coupling
    unseen = pilot.contacts == 0
    assert (found.settings.residual == 3e-5) == unseen
    assert any("nothing touched the ground" in line for line in found.words()) == unseen


def falling(height):
    setup = bobbing()
    up = setup.spheres.position + (0, 0, height * R)
    return dataclasses.replace(setup, spheres=dataclasses.replace(setup.spheres, position=up))


def test_a_pilot_that_is_shorter_than_the_run_skips_the_flight(monkeypatch):
    """Of 31 ms; without, it would find all settings good."""
    setup = falling(1.0)
    lands = np.sqrt(2 * 0.98 * R / 9.81)
    stable = dem.Simulation(setup).stable.value
    monkeypatch.setattr("taichi_dem.pilot.MOST_WORK", 2 * 0.01 / stable)  # so many of 10 ms
    pilot = Pilot(setup, 0.1)
    assert 0.009 < pilot.span.length <= 0.01 and not pilot.whole
    assert pilot.span.stable == pytest.approx(stable)
    assert lands - 0.01 / 8 <= pilot.span.start <= lands
    moved = falling(1.0).spheres.position[:, 2] - 0.5 * 9.81 * pilot.span.start**2
    assert pilot.scene.spheres.position[:, 2] == pytest.approx(moved, rel=1e-9)
    told = choice.choose_by(pilot, 1e-2)
    assert told.settings.coupling == "finite" and told.unseen == ""
    assert any("nothing touches before" in line for line in told.words())
    assert told.summary()["compared_from_s"] == pilot.span.start


def test_a_step_that_a_guard_stops_is_halved(monkeypatch):
    tried, compare = [], Pilot._compare

    def stopped_at_first(self, longest, left):
        tried.append(longest.stable)
        if len(tried) < 3:
            raise SimulationStopped("sphere 0 moves too far", 0, {})
        compare(self, longest, left)

    monkeypatch.setattr(Pilot, "_compare", stopped_at_first)
    pilot = Pilot(bobbing(), 0.01)
    assert tried == [tried[0], tried[0] / 2, tried[0] / 4] and pilot.span.stable <= tried[2]


def test_of_flight_alone_nothing_is_learnt():
    pilot = Pilot(falling(10.0), 0.01)
    told = choice.choose_by(pilot, 1e-2)
    assert pilot.span.start == 0.0 and "free flight" in told.unseen
    assert told.settings == choice.Settings.of(pilot.scene, told.settings.step)


def test_the_error_found_is_about_the_one_asked():
    asked, pilot = 1e-5, Pilot(bobbing(), 0.01)
    told = choice.choose_by(pilot, asked)
    assert pilot.grounded(pilot.tight.but("step", pilot.span.stable)) == 2
    fine = pilot.tight.but("step", told.settings.step / 8)
    found = accuracy.worst(pilot.distance(told.settings, fine))
    assert told.limit == "the asked error"
    assert "times as many steps" in next(told.words())
    assert asked / 3 < found < 2 * asked
    assert told.expected == pytest.approx(found, rel=0.5)


@pytest.mark.slow
def test_fewer_exchanges_leave_the_error_what_was_asked():
    """Twelve that bob together, with damping: that is of first order in the step, extrapolation of
    second."""
    asked, pilot = 1e-3, Pilot(dataclasses.replace(bobbing(2), law=law(0.5)), 0.01)
    told = choice.choose_by(pilot, asked)
    fine = pilot.tight.but("step", told.settings.step / 8)
    found = accuracy.worst(pilot.distance(told.settings, fine))
    assert told.settings.every > 1 and told.limit == "the asked error"
    assert asked / 3 < found < 2 * asked


@pytest.mark.slow
def test_the_pilot_says_what_no_setting_turns_on():
    """Three in a row between walls: those of the middle one feel each other through it. Where it
    is added, nothing is left out."""
    gap = 2 * R * 0.99
    place = np.column_stack([gap * np.arange(3), np.zeros(3), np.zeros(3)])
    ends = [((-0.98 * R, 0, 0), (1, 0, 0)), ((2 * gap + 0.98 * R, 0, 0), (-1, 0, 0))]
    walls = [dem.Plane(*end, STONE) for end in ends]
    setup = scene(place, R, STONE, law=law(), boundaries=walls)
    (effect,) = Pilot(setup, 1e-3).left_out()
    assert effect.name == "multi-contact" and effect.size > 0.01 and effect.states == STATES
    fuller = turned_on(setup, effect.name)
    assert isinstance(fuller.law.surface, dem.MultiContact)
    assert Pilot(fuller, 1e-3).left_out() == []


def left_out(size):
    """A choice, and a multi-contact law of that size that the scene lacks."""
    entry = 'law.surface = { type = "MultiContact" }'
    lacks = Neglected("multi-contact", entry, size, 4, 4)
    settings = choice.Settings(2e-5, 1e-5, 1e-5, "point", "every 4")
    return choice.Choice(
        settings, 1e-3, 8e-4, Span(0.0, 1e-3, 2e-5), "the asked error", {}, (lacks,)
    )


@pytest.mark.parametrize(
    ("size", "how", "said", "law"),
    [
        (0.12, "warn", "not in this error: multi-contact would change", None),
        (0.12, "add", "turned on: multi-contact would change", dem.MultiContact),
        (1e-4, "warn", "", None),
        (1e-4, "refuse", "", None),
        (1e-4, "add", "", None),
    ],
)
def test_what_no_setting_turns_on_is_told_or_added(monkeypatch, size, how, said, law):
    chosen_for, lines = [], []

    def choose(scene, *_):
        chosen_for.append(scene)
        lacks = left_out(size)
        if scene.law.surface is None:
            return lacks
        implicit = lacks.settings.but("exchange", "implicit")
        return dataclasses.replace(lacks, settings=implicit, left_out=())

    monkeypatch.setattr(choice, "choose", choose)
    plan = scene_file.Run(duration=1e-3)
    setup, plan, notes = settled(bobbing(), plan, 1e-3, how, lines.append)
    assert type(setup.law.surface) is (law or type(None))
    assert setup.substrate.exchange_every == (1 if law else 4) and plan.dt == 2e-5
    assert len(chosen_for) == (2 if law else 1)
    assert any(said in line for line in lines)
    told = notes["asked_error"]["left_out"]
    assert told == {} if law else told["multi-contact"]["size"] == size


def test_what_no_setting_turns_on_is_refused_if_asked(monkeypatch):
    monkeypatch.setattr(choice, "choose", lambda *_: left_out(0.12))
    with pytest.raises(dem.InputError, match=r"0\.001: cannot be met: multi-contact would"):
        settled(bobbing(), scene_file.Run(duration=1e-3), 1e-3, "refuse", print)


@pytest.mark.parametrize(("sleeps", "size"), [(True, 0.12), (False, None)])
def test_what_a_scene_cannot_have_is_not_added(monkeypatch, sleeps, size):
    """Clusters that sleep know no law that solves for all contacts together; and what has no
    solution is not asked for."""
    setup = scene([[0, 0, 1.0]], 1.0, STONE, law=law(), sleep=sleeps)
    monkeypatch.setattr(choice, "choose", lambda *_: left_out(size))
    lines = []
    found, _, _ = settled(setup, scene_file.Run(duration=1e-3), 1e-3, "add", lines.append)
    assert found.law.surface is None and any("not in this error" in line for line in lines)


def test_what_was_chosen_is_on_record(tmp_path, monkeypatch):
    settings = choice.Settings(2e-5, 1e-5, 1e-5, "point", "implicit")
    made = choice.Choice(settings, 1e-3, 8e-4, Span(0.0, 1e-3, 2e-5), "the asked error", {})
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
    assert pilot.span.chaotic and 0 < pilot.span.length < 0.1


def test_an_error_must_be_one(tmp_path, capsys):
    bobbing().to_toml(tmp_path / "scene.toml")
    command = ["run", str(tmp_path / "scene.toml"), "--duration", "1e-3", "-o", str(tmp_path / "x")]
    assert cli.main([*command, "--error", "2"]) == cli.WRONG_INPUT
    assert "--error = 2.0: must be > 0 and < 1" in capsys.readouterr().err
    assert cli.main([*command, "--left-out", "add"]) == cli.WRONG_INPUT
    assert "goes with --error only" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
