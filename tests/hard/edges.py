"""Steps, speeds and stiffnesses at which codes go on with nonsense: what any must keep is kept, or
the run is stopped with the reason.  Steps beyond the stable one may make energy; then that must be
warned of."""

import numpy as np

import taichi_dem as dem
from tests.hard.beds import DOWN, R, box, poured
from tests.hard.impacts import GLASS
from tests.hard.invariants import kept
from tests.hard.kit import Figure, hard
from tests.taichi_dem.setups import law, scene, state


def survives(setting, setup, step=1.0, steps=2000):
    """At ``step`` times the stable step."""
    sim = setting.simulation(setup)
    held = sim.energy()["normal"]
    error = setting.attempt(sim, step * sim.stable.value, steps)
    reasons = dem.InputError, dem.SimulationStopped, type(None)
    yield Figure("ended without a reason", float(not isinstance(error, reasons)), 0)
    if error is None:
        for figure in kept(setup, state(sim), held, sim.time):
            if figure.what == "energy made" and "energy" in sim.warnings:
                figure = Figure("energy made without a warning", 0.0, figure.bound)
            yield figure


def pair(material=GLASS, speed=0.5, **laws):
    """Two spheres that meet head on."""
    velocity = np.array([[0.5 * speed, 0, 0], [-0.5 * speed, 0, 0]])
    return scene([[0, 0, 0], [2.001 * R, 0, 0]], R, material, velocity, law=law(**laws))


def pouring(count, restitution, smallest=0.8):
    width = 1.4 * (count / 0.3) ** (1 / 3) * R
    position, radius = poured(count, ("uniform", smallest * R, R), width, 1.5 * width)
    laws = law(restitution, 0.3)
    return scene(position, radius, GLASS, law=laws, boundaries=[box(width)], gravity=DOWN)


def at_wall(speed):
    """A sphere that flies into a wall."""
    wall = dem.Plane((3 * R, 0, 0), (-1, 0, 0), GLASS)
    return scene([[0, 0, 0]], R, GLASS, (speed, 0, 0), law=law(0.5, 0.3), boundaries=[wall])


@hard("impact at a modulus of {:g} Pa", 1e5, 1e12, seldom=True)
def stiffness(setting, modulus):
    material = dem.Material("grain", 2500, modulus, 0.22)
    yield from survives(setting, pair(material, 0.1, restitution=0.5, friction=0.3))


@hard("impact at {} stable steps", 1.5, 3.0, 8.0, 15.0, seldom=True)
def long_steps(setting, step):
    yield from survives(setting, pair(friction=0.3), step)


@hard("a bed at {} stable steps", 1.5, 3.0, 8.0, 15.0, seldom=True)
def bed(setting, step):
    yield from survives(setting, pouring(40, 0.3), step, 8000)


@hard("a bed of sizes 1:10 comes to rest", seldom=True)
def mixed_bed(setting):
    yield from survives(setting, pouring(60, 0.2, 0.1), 1.0, 8000)


@hard("a sphere wedged between walls, {} stable steps", 3.0, 20.0, 60.0, seldom=True)
def wedged(setting, step):
    """Walls that are nearer to each other than its diameter."""
    walls = [dem.Plane((s * 0.8 * R, 0, 0), (-s, 0, 0), GLASS) for s in (-1.0, 1.0)]
    laws = law(1.0, 0.3)
    yield from survives(setting, scene([[1e-5, 0, 0]], R, GLASS, law=laws, boundaries=walls), step)


@hard("a sphere into a wall at {:g} m/s", 30.0, 300.0, 3000.0, seldom=True)
def fast(setting, speed):
    yield from survives(setting, at_wall(speed), 1.0, 400)


@hard("a sphere into a wall, {} stable steps", 3.0, 9.0, 40.0, seldom=True)
def far_in_a_step(setting, step):
    yield from survives(setting, at_wall(30.0), step, 400)
