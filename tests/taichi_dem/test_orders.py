"""Orders of convergence in the time step: which, and why.

Velocity Verlet is of second order where forces depend on places alone and smoothly enough. The
dashpot sees the velocities of half a step before, so a damped contact is of first order; so is
friction that sticks, whose spring is carried on from step to step. Friction that slides is the
normal force times a coefficient, whatever the spring, and keeps the second order. An impact costs a
smooth law nothing: Hertz' force starts as the overlap to 3/2, so that the step in which it starts
errs by dt^(5/2) at most.
"""

import numpy as np
import pytest
from setups import law, order_of, scene

import taichi_dem as dem
from taichi_dem import orders

STONE = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e5, poissons_ratio=0.45)
R, G, FINEST = 5e-3, 9.81, 6
WALL = [dem.Plane((0, 0, 0), (0, 0, 1), STONE)]
TRIANGLE = np.array([[0, 0, 0.98], [2.2, 0, 0.985], [1.0, 2.1, 0.99]]) * R
LASTING = np.array([[0, 0, 0.994], [2.2, 0, 0.9945], [1.0, 2.1, 0.9955]]) * R  # on the wall


def outcomes(setup, duration, coarsest, look, finest=FINEST):
    """What ``look`` gives after ``duration`` (s), with ``coarsest`` steps and twice as many and so
    on."""
    sim = dem.Simulation(setup)
    found = []
    for k in range(finest):
        steps = coarsest * 2**k
        sim.restart(dt=duration / steps)
        sim.run(steps=steps)
        found.append(look(sim))
    return np.array(found)


def orders_seen(found):
    """From the differences of runs whose steps differ by a factor of two."""
    return order_of(np.linalg.norm(np.diff(found, axis=0).reshape(len(found) - 1, -1), axis=1))


def place(sim):
    return sim.particles.position / R


def test_on_a_smooth_scene_the_order_is_two():
    """Three spheres that bob on soft ground and never leave it."""
    setup = scene(
        TRIANGLE,
        R,
        STONE,
        gravity=(0, 0, -G),
        law=law(),
        substrate=dem.Substrate(SOIL, residual=1e-12),
    )
    found = outcomes(setup, 0.01, 40, place)
    assert np.allclose(orders_seen(found), 2, atol=0.05)


def test_with_a_dashpot_the_order_is_one():
    """The same with damping: the velocity in the force is that of half a step before."""
    setup = scene(LASTING, R, STONE, gravity=(0, 0, -G), law=law(0.5), boundaries=WALL)
    found = outcomes(setup, 0.004, 40, place)
    assert np.allclose(orders_seen(found)[-2:], 1, atol=0.1)


@pytest.mark.parametrize(
    ("friction", "speed", "slides", "order"),
    [
        pytest.param(10.0, 0.05, False, 1.0, id="sticks"),
        pytest.param(0.4, 0.2, True, 2.0, id="slides"),
    ],
)
def test_order_of_friction_that_sticks_and_that_slides(friction, speed, slides, order):
    """Undamped but for friction, all contacts lasting and on one side of Coulomb's cone.

    A spring that sticks is advanced by the velocity of half a step before: order 1. One that slides
    is cut back to the cone, whose size is that of the normal force, of order 2; which step is the
    first to slide makes single slopes scatter, hence the mean of three.
    """
    velocity = np.zeros_like(LASTING)
    velocity[:, 0] = speed
    setup = scene(
        LASTING,
        R,
        STONE,
        velocity=velocity,
        gravity=(0, 0, -G),
        law=law(1.0, friction, damping=0.0),
        boundaries=WALL,
    )

    def look(sim):
        force = sim.contacts()["force"]
        rubbing, pressing = np.linalg.norm(force[:, :2], axis=1), np.abs(force[:, 2])
        assert len(force) == len(LASTING)
        assert np.all((rubbing >= friction * pressing * (1 - 1e-9)) == slides)
        return place(sim)

    found = outcomes(setup, 0.004, 40, look, finest=7)
    assert orders_seen(found)[-3:].mean() == pytest.approx(order, abs=0.15)


def test_a_damped_impact_is_of_first_order():
    """The dashpot sees the velocities of half a step before. Where in a step it touches and leaves
    matters as much, so many spheres meet the wall at different moments of the coarsest step, and
    the slope is that of the root mean square over six halvings."""
    steps, duration, speed = 200, 0.006, 0.5
    moments = np.arange(64) * (np.sqrt(5) - 1) / 2 % 1  # no two alike, also in a finer step
    start = np.zeros((64, 3))
    start[:, 0] = 3 * R * np.arange(64)
    start[:, 2] = 1.05 * R + speed * duration / steps * moments
    setup = scene(start, R, STONE, velocity=[0, 0, -speed], law=law(0.5), boundaries=WALL)

    def look(sim):
        assert not len(sim.contacts())
        return sim.particles.velocity[:, 2]

    found = outcomes(setup, duration, steps, look, finest=8)
    assert orders_seen(found).mean() == pytest.approx(1, abs=0.15)


def test_an_undamped_impact_keeps_the_second_order():
    setup = scene([[0, 0, 1.05 * R]], R, STONE, velocity=[0, 0, -0.5], law=law(), boundaries=WALL)
    duration = 0.006
    found = outcomes(setup, duration, 200, place)
    slope = np.log2(np.abs(found[0] - found[-1]).max() / np.abs(found[3] - found[-1]).max())
    assert slope / 3 > 1.7  # over three halvings; one alone depends on where in a step it touches


@pytest.mark.parametrize("order", [1.0, 2.0])
@pytest.mark.parametrize("reference", [0.0, 1 / 32])
def test_the_fit_finds_the_order_that_is_there(order, reference):
    steps = np.array([1, 1 / 2, 1 / 4, 1 / 8])
    errors = 3.0 * (steps**order - reference**order)
    found = orders.fit(steps, errors, reference)
    assert found == pytest.approx((order, 3.0), rel=1e-6)


def test_no_order_without_errors():
    assert orders.fit([1, 0.5], [0.0, 0.0]) is None
    assert orders.fit([1, 0.5], [1.0, np.inf]) is None


@pytest.mark.parametrize("reference", [0.0, 1 / 32])
def test_no_order_of_what_does_not_go_with_the_step(reference):
    steps = [1, 1 / 2, 1 / 4, 1 / 8]
    assert orders.fit(steps, [1.5] * 4, reference) is None
    assert orders.fit(steps, [1e-2, 1e-5, 1e-8, 1e-11], reference) is None
    assert orders.fit(steps, [4e-12, 1e-12, 2e-13, 1e-12], reference) is None
    assert orders.fit(steps, [0.06, 0.05, 0.025, 2e-6], reference) is None
    assert orders.fit(steps, [0.13, 0.11, 0.056, 0.0037], reference) is None
