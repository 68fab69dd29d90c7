"""The skin follows from counts of steps alone, and thins where nothing moves."""

import numpy as np
import pytest
from setups import law, restart, scene

import taichi_dem as dem
from taichi_dem import pace
from taichi_dem.pace import NEVER, Skin

R = 1e-3


def test_a_skin_grows_while_lists_go_stale_soon_and_shrinks_while_they_last():
    skin = Skin(np.full(1000, R))
    widths, step = [skin.width], 0
    for _ in range(20):
        step += 1
        skin.rebuilt(step)
        widths.append(skin.width)
    assert widths == sorted(widths) and widths[-1] == widths[-2] > 2 * widths[0]
    while skin.review < NEVER:
        assert skin.review > step
        step = skin.review
        assert skin.rebuilt(step)
        widths.append(skin.width)
    assert widths[-1] < 0.5 * widths[0]
    assert not skin.rebuilt(step + 10**6) and skin.width == widths[-1]


def test_a_skin_that_was_halved_does_not_grow_again():
    """For a list of half the skin lasts half as long: widths come to rest."""
    skin, step, speed, widths = Skin(np.full(1000, R)), 0, 2e-6, []
    for _ in range(50):
        step += min(int(skin.width / (2 * speed)) + 1, skin.review - step)
        skin.rebuilt(step)
        widths.append(skin.width)
    assert len(set(widths[25:])) == 1


def test_two_rebuilds_at_one_step_say_nothing():
    skin = Skin(np.full(10, R))
    width = skin.width
    assert not skin.rebuilt(0) and skin.width == width


@pytest.fixture(scope="module")
def resting():
    grid = np.stack(np.meshgrid(*[range(7)] * 3), axis=-1).reshape(-1, 3)
    return dem.Simulation(scene(grid * 2.05 * R, R, law=law(), boundaries=[]))


def thinning(sim, pieces):
    """Step of the last rebuild and width of the skin after each of ``pieces`` that ends with one
    of a hundred steps."""
    engine = sim._engine
    engine.skin.width = Skin(sim.particles.radius).width
    engine.grid.cell_size[None] = engine._set_skin()
    restart(sim)
    seen = {}
    for steps in pieces:
        sim.run(steps=steps)
        if sim.steps % 100 == 0:
            seen[sim.steps] = (engine.skin._built_at, engine.skin.width, engine.contacts.count())
    return seen


@pytest.mark.parametrize("driver", ["serial", "parallel"])
def test_at_rest_it_thins_at_the_same_steps_however_a_run_is_cut(resting, driver, monkeypatch):
    monkeypatch.setattr(resting._engine.pace, "driver", driver)
    whole = thinning(resting, [100] * 12)
    widths = [width for _, width, _ in whole.values()]
    assert widths == sorted(widths, reverse=True) and len(set(widths)) > 3
    assert whole[1200][2] < whole[100][2]
    for pieces in ([1] * 1200, [7, 93] * 12, [1200]):
        found = thinning(resting, pieces)
        assert found.items() <= whole.items() and 1200 in found


def test_a_way_that_is_disturbed_in_one_trial_is_chosen_for_its_better_one(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(pace.time, "perf_counter", lambda: clock[0])
    asked = []

    def way(name, cost):
        def make(steps):
            disturbed = name == "team" and steps > 1 and asked.count("team") == 1
            asked.extend([name] * (steps > 1))
            clock[0] += steps * cost * (5.0 if disturbed else 1.0)
            return steps

        return make

    ways = {"serial": way("serial", 2.0e-4), "team": way("team", 1.0e-4)}
    chooser = pace.Pace(1000, "auto", lambda: True)
    while len(asked) < 4:
        chooser.advance(1000, ways)
    assert asked == ["serial", "team", "team", "serial"]
    assert chooser.driver == "team"

    ways["team"] = way("team", 3.0e-4)  # others have come to use the cores
    for _ in range(10):
        chooser.advance(1000, ways)
    assert chooser.driver == "serial"


def test_trials_take_a_hundredth_of_the_time(monkeypatch):
    clock, trying = [0.0], [0.0]
    monkeypatch.setattr(pace.time, "perf_counter", lambda: clock[0])

    def way(name, cost):
        def make(steps):
            clock[0] += steps * cost
            trying[0] += steps * cost * (name != "team")
            return steps

        return make

    ways = {"serial": way("serial", 2e-2), "team": way("team", 1e-2), "parallel": way("p", 1.5e-2)}
    chooser = pace.Pace(100_000, "auto", lambda: True)
    while clock[0] < 2000.0:
        chooser.advance(200, ways)
    assert chooser.driver == "team"
    one = 2 * (pace.TRIAL_STEPS + 1) * (2e-2 + 1.5e-2)
    assert 2 * one <= trying[0] <= 0.01 * clock[0] + one
