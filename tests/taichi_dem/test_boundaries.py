"""Walls that stand, slide, move as told or under load, and what they read out."""

import numpy as np
import pytest
from setups import EPS, law, restart, rigid, scene

import taichi_dem as dem
from halfspace import reference

R, G = 5e-3, 9.81
STONE = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
MASS = STONE.density * 4 / 3 * np.pi * R**3
INF = np.inf


def resting_overlap(force, wall=STONE):
    modulus = reference.composite_modulus(
        STONE.youngs_modulus, STONE.poissons_ratio, wall.youngs_modulus, wall.poissons_ratio
    )
    return float(reference.hertz_overlap(force, R, modulus))


# -- motion as told --------------------------------------------------------------------------------

DT = 8e-5
PROGRAM = [(0.003, 0.001), (0.004, 0.001), (0.01, -0.002)]


@pytest.fixture(scope="module")
def movers():
    """A sphere far from four boundaries: a plane at a slant, and pistons of every kind."""
    walls = [
        dem.Plane((0, 0, 0), (0, 0, 2), STONE, velocity=(0.3, -0.2, 0.1)),
        dem.Piston((-1, 0, 0), (3, 0, 4), STONE, velocity=0.25),
        dem.Piston((0, -1, 0), (0, 1, 0), STONE, program=PROGRAM),
        dem.Piston((0, 0, 3), (0, 0, -1), STONE, load=0.7, mass=0.2),
    ]
    return dem.Simulation(scene([[0, 0, 1]], R, STONE, boundaries=walls, law=law()), dt=DT)


def test_boundaries_move_exactly_as_told(movers):
    """At constant speed, along the table, and, where nothing resists the load, by a t^2/2, which
    velocity Verlet gives without error."""
    starts = [wall.position for wall in restart(movers).boundaries]
    table = np.array([(0, 0), *PROGRAM])
    for _ in range(20):
        movers.run(steps=7)
        t, now = movers.time, movers.boundaries
        travelled = [wall.position - start for wall, start in zip(now, starts, strict=True)]
        program = np.interp(t, *table.T)
        expected = [
            np.multiply((0.3, -0.2, 0.1), t),
            np.multiply((0.6, 0, 0.8), 0.25 * t),
            np.multiply((0, 1, 0), program),
            np.multiply((0, 0, -1), 0.5 * 0.7 / 0.2 * t**2),
        ]
        assert np.allclose(travelled, expected, rtol=0, atol=200 * EPS)
        assert np.allclose(now[0].velocity, (0.3, -0.2, 0.1), rtol=1e-12)
        assert np.allclose(now[3].velocity, (0, 0, -0.7 / 0.2 * t), rtol=1e-12)
        slope = (program - np.interp(t - DT, *table.T)) / DT
        assert now[2].velocity[1] == pytest.approx(slope, abs=1e-10)


def test_a_program_is_held_after_its_last_row(movers):
    restart(movers).run(steps=150)
    assert movers.boundaries[2].position[1] == -1 + PROGRAM[-1][1]
    assert np.array_equal(movers.boundaries[2].velocity, (0, 0, 0))


# -- contact with a wall ---------------------------------------------------------------------------


def test_a_moving_wall_strikes_as_a_sphere_would():
    """A piston at speed v sends a weightless sphere off at 2v, and at (1 + e) v with damping."""
    kinds = [dem.Material(f"e = {e}", 2500, 2e6, 0.2) for e in (1.0, 0.5)]
    pairs = {(kind.name, "rigid"): {"normal": dem.Hertz(float(kind.name[4:]))} for kind in kinds}
    setup = scene(
        [(0, 0, 1.001 * R), (1, 0, 1.001 * R)],
        R,
        kinds,
        boundaries=[dem.Piston((0, 0, 0), (0, 0, 1), rigid(), velocity=0.1)],
        law=law(pairs=pairs),
    )
    sim = dem.Simulation(setup, dt=1e-5)
    sim.run(duration=0.02)
    assert not len(sim.contacts())
    assert np.allclose(sim.particles.velocity[:, 2], [0.2, 0.15], rtol=1e-3)
    assert np.array_equal(sim.particles.velocity[:, :2], np.zeros((2, 2)))


@pytest.fixture(scope="module")
def channel():
    """A box without walls across x, with spheres on the floor, in a lower edge, and in flight."""
    overlap = resting_overlap(MASS * G)
    place = [(0, 0, R - overlap), (1, -0.1 + 0.9 * R, R - overlap), (2, 0, 0.1)]
    setup = scene(
        place,
        R,
        STONE,
        gravity=(0, 0, -G),
        boundaries=[dem.Box((-INF, -0.1, 0), (INF, 0.1, INF), STONE)],
        law=law(0.5, 0.5),
    )
    return dem.Simulation(setup)


def test_infinite_sides_are_no_walls(channel):
    """Flying along the open direction, and up, meets nothing; the closed sides throw back."""
    velocity = np.array([(0, 0, 0), (0, 0, 0), (50.0, 0, 30.0)])
    restart(channel, velocity=velocity, dt=1e-5).run(steps=1000)
    flown = channel.particles.position[2] - (2, 0, 0.1)
    t = channel.time
    assert np.allclose(flown, (50 * t, 0, 30 * t - G * t**2 / 2), rtol=1e-12)
    assert len(channel.contacts()) >= 1 and set(channel.contacts()["face"]) <= {0, 1, 2}


def test_a_sphere_rests_where_hertz_says(channel):
    """On the floor at its own overlap from the start: nothing moves."""
    restart(channel).run(steps=200)
    assert np.abs(channel.particles.velocity[0]).max() < 1e-12
    assert channel.particles.force[0, 2] == pytest.approx(0, abs=1e-12 * MASS * G)
    touching = channel.contacts()[0]
    assert touching["face"] == 2 and touching["j"] == -2  # no low x, no high x: low z is third
    assert np.array_equal(touching["normal"], (0, 0, 1))
    assert touching["force"][2] == pytest.approx(MASS * G, rel=1e-12)
    assert np.allclose(touching["position"], (0, 0, -touching["overlap"] / 2), atol=1e-15)


# -- load ------------------------------------------------------------------------------------------


def test_a_plate_under_load_comes_to_rest_on_a_bed():
    """Four spheres carry the plate, each a quarter of its load (plates have no weight); the floor
    carries the spheres too.  Overlaps are Hertz's."""
    load = 2.0
    place = [(x, y, R) for x in (-0.02, 0.02) for y in (-0.02, 0.02)]
    setup = scene(
        place,
        R,
        STONE,
        gravity=(0, 0, -G),
        boundaries=[
            dem.Plane((0, 0, 0), (0, 0, 1), STONE),
            dem.Piston((0, 0, 2 * R), (0, 0, -1), STONE, load=load, mass=0.01),
        ],
        law=law(0.2, 0.5),
    )
    sim = dem.Simulation(setup)
    sim.run(duration=0.5)
    floor, plate = sim.boundaries
    assert plate.force[2] == pytest.approx(load, rel=1e-9)
    assert floor.force[2] == pytest.approx(-(load + 4 * MASS * G), rel=1e-9)
    assert np.abs(plate.velocity).max() < 1e-9
    above, below = resting_overlap(load / 4), resting_overlap(load / 4 + MASS * G)
    assert plate.position[2] == pytest.approx(2 * R - above - below, rel=1e-9)
    for one, other in zip(plate.torque, floor.torque, strict=True):
        assert one == pytest.approx(0, abs=1e-12) and other == pytest.approx(0, abs=1e-12)


# -- conveyors -------------------------------------------------------------------------------------


BELT, MU = np.array([0.06, 0.08, 0.0]), 0.4


@pytest.fixture(scope="module")
def conveyor():
    """On a belt: a sphere at rest, and one of twice its size held by a second belt above."""
    overlap, gap = resting_overlap(MASS * G), 3.98 * R
    walls = [
        dem.Plane((0, 0, 0), (0, 0, 1), STONE, velocity=BELT),
        dem.Plane((0, 0, gap), (0, 0, -1), STONE, velocity=BELT),
    ]
    place = [(0, 0, R - overlap), (0.3, 0, gap / 2)]
    setup = scene(place, [R, 2 * R], STONE, boundaries=walls, law=law(0.5, MU), gravity=(0, 0, -G))
    return dem.Simulation(setup), R - overlap / 2


def test_a_conveyor_sets_a_sphere_rolling(conveyor):
    """Dragged from rest by mu g until it rolls at 2/7 of the belt's speed (for an arm b,
    2/5 m R^2/(m b^2 + 2/5 m R^2)), with its surface as fast as the belt."""
    sim, arm = restart(conveyor[0]), conveyor[1]
    share = 0.4 * R**2 / (arm**2 + 0.4 * R**2)
    assert share == pytest.approx(2 / 7, rel=2 * (1 - arm / R))
    rolls = share * 0.1 / (MU * G)
    sim.run(duration=0.5 * rolls)
    assert np.allclose(sim.particles.velocity[0], 10 * BELT * MU * G * sim.time, rtol=0.01)
    sim.run(duration=8 * rolls)
    velocity, omega = sim.particles.velocity[0], sim.particles.omega[0]
    assert np.allclose(velocity, share * BELT, rtol=1e-6, atol=1e-9)
    assert np.allclose(velocity - np.cross(omega, [0, 0, arm]), BELT, rtol=1e-6, atol=1e-9)


def test_between_two_conveyors_a_sphere_goes_along(conveyor):
    """Held between belts of the same speed it cannot roll: it reaches their speed and stops
    spinning."""
    sim = restart(conveyor[0])
    sim.run(duration=0.3)
    assert np.allclose(sim.particles.velocity[1], BELT, rtol=1e-6, atol=1e-9)
    assert np.abs(sim.particles.omega[1]).max() < 1e-6 * 0.1 / R


# -- read-outs -------------------------------------------------------------------------------------


def test_torque_is_about_the_reference_point(channel):
    """Spheres at rest press with their weight on the arm from the box's reference point, its low
    corner where that is finite; one that spins twists it through friction."""
    sim = restart(channel)
    point = np.array([0, -0.1, 0])
    box, resting = sim.boundaries[0], sim.contacts()["i"]
    assert np.array_equal(box.position, point)
    assert box.force[2] == pytest.approx(-2 * MASS * G, rel=1e-9)
    records = sim.contacts()
    expected = np.cross(records["position"] - point, -records["force"]).sum(axis=0)
    assert np.allclose(box.torque, expected, rtol=1e-12, atol=1e-15)
    by_hand = np.cross(sim.particles.position[0] - point, [0, 0, -MASS * G])
    alone = np.cross(records["position"][0] - point, -records["force"][0])
    assert np.allclose(alone, by_hand, rtol=1e-12, atol=1e-15) and 0 in resting

    omega = np.array([(0, 50.0, 0), (0, 0, 0), (0, 0, 0)])
    restart(channel, omega=omega).run(steps=20)
    records = sim.contacts()
    assert abs(records["force"][0, 0]) == pytest.approx(0.5 * MASS * G, rel=1e-3)
    expected = np.cross(records["position"] - point, -records["force"]).sum(axis=0)
    assert np.allclose(sim.boundaries[0].torque, expected, rtol=1e-12, atol=1e-15)
    assert abs(sim.boundaries[0].torque[2]) > 0.9 * 0.1 * 0.5 * MASS * G
