"""Measures of error on records made by hand, and closed forms."""

import dataclasses

import numpy as np
import pytest
from records import made
from setups import GLASS, law, scene

import taichi_dem as dem
from taichi_dem import accuracy
from taichi_dem.closed_form import flown_freely, is_over, rebound, rebound_error
from taichi_dem.record import even_step, record

R = 1e-3


def test_a_run_is_as_it_is():
    run = made()
    found = accuracy.errors(run, run, 8)
    drift = found.pop("energy drift")
    assert drift == np.abs(run.balance).max() / 2
    assert set(found) == {"trajectory", "contact force", "force on walls", "depression"}
    assert set(found.values()) == {0.0}


def test_errors_are_shares_of_what_there_is():
    run = made()
    moved = run.position[0] + 1.01 * (run.position - run.position[0])
    other = dataclasses.replace(
        run, position=moved, force=1.02 * run.force, depression=1.03 * run.depression
    )
    found = accuracy.errors(other, run, 8)
    assert found["trajectory"] == pytest.approx(0.01)
    assert found["contact force"] == pytest.approx(0.02)
    assert found["depression"] == pytest.approx(0.03)
    assert accuracy.worst(found) == pytest.approx(0.03)
    assert "depression" not in accuracy.errors(other, run, 5)  # which is that of the end


def test_drifts_of_opposite_sign_do_not_cancel():
    run = made()
    other = dataclasses.replace(run, balance=-run.balance)
    drift = accuracy.errors(run, run, 8)["energy drift"]
    assert accuracy.errors(other, run, 8)["energy drift"] == drift
    assert accuracy.drift_between(other, run, 8) == pytest.approx(2 * drift)


def test_a_contact_that_is_missing_counts_in_full():
    run = made()
    none = dataclasses.replace(run, contact=run.contact[:0], force=run.force[:0])
    assert accuracy.errors(none, run, 8)["contact force"] == pytest.approx(1.0)


def test_faces_of_one_boundary_are_contacts_of_their_own():
    """A sphere in the corner of a box: all three faces bear the number of the box."""
    corner = np.array([[k, 0, -2, face] for k in range(9) for face in (0, 2, 4)])
    run = dataclasses.replace(made(), contact=corner, force=np.tile(np.eye(3), (9, 1)))
    assert accuracy.errors(run, run, 8)["contact force"] == 0
    force = run.force.copy()
    force[::3, 0] += 100  # the last two of three faces are right
    wrong = dataclasses.replace(run, force=force)
    assert accuracy.errors(wrong, run, 8)["contact force"] == pytest.approx(100 / np.sqrt(3))


def test_what_is_not_a_number_is_no_small_error():
    assert accuracy.worst({"a": 1e-3, "b": float("nan")}) == float("inf")
    assert accuracy.worst({}) == float("inf")


def test_the_worst_mean_is_the_largest_with_its_own_uncertainty():
    found = {"large": (2e-2, 1e-3), "uncertain": (1e-2, 1e-2)}
    assert accuracy.worst_mean(found) == (2e-2, 1e-3)
    assert accuracy.worst_mean({}) == (float("inf"), 0.0)
    lost = {"lost": (float("nan"), 0.0), **found}
    assert accuracy.worst_mean(lost) == (float("inf"), 0.0)


def test_comparable_until_a_perturbation_has_grown():
    run = made()
    away = np.array([1, 2, 5, 50, 90, 101, 50, 1, 1])[:, None, None]
    other = dataclasses.replace(run, position=run.position + 1e-9 * away)
    assert accuracy.comparable(run, other) == 4
    assert accuracy.comparable(run, run) == 8


def test_an_ensemble_knows_its_uncertainty():
    """Runs drawn at random from one distribution: errors are as large as they are said to be."""
    rng = np.random.default_rng(4)
    ratios = []
    for _ in range(200):
        two = [
            [
                dataclasses.replace(made(), depression=np.array([rng.normal(1, 0.1)]))
                for _ in range(5)
            ]
            for _ in range(2)
        ]
        error, uncertainty = accuracy.ensemble_errors(*two)["depression"]
        ratios.append(error / uncertainty)
    assert 0.8 < np.sqrt(np.median(np.square(ratios))) / 0.6745 < 1.4


def test_ensembles_are_as_far_apart_as_their_scatter_explains_or_farther():
    """Of one distribution; of two that are 30 times the scatter of a mean apart; of single runs."""
    rng = np.random.default_rng(5)

    def drawn(away, count=5):
        place = made(n=200).position + away
        return [
            dataclasses.replace(made(), position=place + 1e-3 * rng.normal(size=place.shape))
            for _ in range(count)
        ]

    assert accuracy.apart(drawn(0), drawn(0)) == pytest.approx(1, abs=0.1)
    between = 30e-3 * np.sqrt(2 / 5)
    assert accuracy.apart(drawn(between), drawn(0)) == pytest.approx(30, rel=0.05)
    assert accuracy.apart(drawn(0, 1), drawn(1, 1)) == 1
    here, there = drawn(between), drawn(0)
    for k, run in enumerate([*here, *there]):
        run.depression[:] = 1 + 1e-3 * k
    error, uncertainty = accuracy.ensemble_errors(here, there)["depression"]
    scatter = np.sqrt(2 * np.var([1e-3 * k for k in range(5)], ddof=1) / 5)
    assert uncertainty == pytest.approx(30 * scatter / 1.007, rel=0.05) and error < uncertainty


def test_steps_fit_between_samples():
    step = even_step(3e-5, 1e-2, 32)
    assert step <= 3e-5 and (1e-2 / 32 / step) == pytest.approx(round(1e-2 / 32 / step), abs=1e-9)
    assert even_step(1.0, 1e-2, 32) == 1e-2 / 32


def test_a_record_is_of_the_same_times_whatever_the_step():
    setup = scene([[0, 0, 2 * R]], R, gravity=(0, 0, -9.81), law=law())
    sim, runs = dem.Simulation(setup), []
    for step in (1e-4, 3e-5):
        sim.restart(dt=even_step(step, 0.01, 8))
        runs.append(record(sim, 0.01, 8))
    assert np.allclose(runs[0].time, runs[1].time, rtol=1e-12)
    fallen = 2 * R - 9.81 / 2 * runs[0].time ** 2
    assert np.allclose(runs[0].position[:, 0, 2], fallen, rtol=1e-12)


def test_a_record_tells_the_faces_of_a_box_apart():
    """A sphere that presses into a corner."""
    box = dem.Box((0, 0, 0), (10 * R, 10 * R, 10 * R), GLASS)
    setup = scene([[0.99 * R] * 3, [5 * R] * 3], R, law=law(), boundaries=[box])
    found = record(dem.Simulation(setup), 4e-5, 4).contact
    assert found.shape == (15, 4) and len(np.unique(found, axis=0)) == 15
    assert set(found[:, 2]) == {-2} and len(set(found[:, 3])) == 3


def test_two_spheres_part_as_they_should():
    setup = scene(
        [[0, 0, 0], [3 * R, 0, 0]],
        [R, 0.8 * R],
        velocity=[[0.4, 0, 0], [-0.1, 0, 0]],
        law=law(0.7),
    )
    exact = rebound(setup)
    mass = setup.spheres.mass
    assert mass @ exact == pytest.approx(mass @ setup.spheres.velocity)
    assert exact[1, 0] - exact[0, 0] == pytest.approx(0.7 * 0.5)
    sim = dem.Simulation(setup)
    sim.run(duration=6e-3)
    assert not len(sim.contacts())
    assert rebound_error(sim.particles.velocity, exact, setup.spheres.velocity) < 5e-3
    assert rebound_error(exact, exact, setup.spheres.velocity) == 0


def flight(setup, duration, velocity=None, rows=9):
    """The record of spheres that nothing touches, until at the end they have ``velocity``."""
    spheres, time = setup.spheres, np.linspace(0, duration, rows)[:, None, None]
    way = spheres.velocity * time + 0.5 * np.asarray(setup.gravity) * time**2
    return dataclasses.replace(
        made(rows - 1, spheres.count),
        time=time[:, 0, 0],
        position=spheres.position + way,
        velocity=spheres.velocity if velocity is None else velocity,
        contact=np.empty((0, 4), dtype=int),
        force=np.empty((0, 3)),
    )


@pytest.mark.parametrize("ahead", [-0.1, 0.39])  # m/s, of the one in front
def test_an_impact_after_the_end_is_none(ahead):
    """Two spheres that meet at 10 ms, or only just catch up."""
    toward = [[0.4, 0, 0], [ahead, 0, 0]]
    setup = scene([[0, 0, 0], [7 * R, 0, 0]], R, velocity=toward, law=law(0.5))
    exact, before = rebound(setup), setup.spheres.velocity
    assert not is_over(flight(setup, 2e-3), exact, before)
    after = flight(setup, 2e-2, exact + 1e-3)
    assert is_over(after, exact, before)
    last = np.array([[8, 0, 1, -1]])
    pressed = dataclasses.replace(after, contact=last, force=np.ones((1, 3)))
    assert not is_over(pressed, exact, before)


def test_a_free_flight_is_known_as_one():
    """Also where an impact fell between two samples."""
    setup = scene([[0, 0, 0], [7 * R, 0, 0]], R, velocity=0.3, law=law(), gravity=(0, 0, -9.81))
    run = flight(setup, 0.1)
    assert flown_freely(run, setup)
    knocked = run.position.copy()
    knocked[5:, 1, 0] += 1e-4 * R
    assert not flown_freely(dataclasses.replace(run, position=knocked), setup)
    contact, force = np.array([[0, 0, 1, -1]]), np.zeros((1, 3))
    assert not flown_freely(dataclasses.replace(run, contact=contact, force=force), setup)


def test_no_closed_form_on_ground_that_is_no_elastic_half_space():
    ground = dem.Substrate(GLASS)
    grounds = {
        "half-space": ground,
        "layer": dataclasses.replace(ground, layer=dem.Layer(5 * R)),
        "creep": dataclasses.replace(
            ground, coupling="point", relaxation=dem.Relaxation(GLASS.youngs_modulus / 2, 1e-3)
        ),
    }
    known = {
        name: rebound(scene([[0, 0, 2 * R]], R, velocity=[0, 0, -1], law=law(), substrate=soil))
        for name, soil in grounds.items()
    }
    assert np.allclose(known["half-space"], [[0, 0, 1]])
    assert known["layer"] is None and known["creep"] is None


def test_a_closed_form_only_where_there_is_one():
    apart = [[0, 0, 0], [3 * R, 0, 0]]
    toward = [[0.4, 0, 0], [-0.1, 0, 0]]
    assert rebound(scene(apart, R, velocity=toward, law=law(), gravity=(0, 0, -1))) is None
    assert rebound(scene(apart, R, velocity=[[0, 1, 0], [0, 0, 0]], law=law())) is None
    floor = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
    single = scene([[0, 0, 2 * R]], R, velocity=[0, 0, -1], law=law(0.5), boundaries=[floor])
    assert np.allclose(rebound(single), [[0, 0, 0.5]])
