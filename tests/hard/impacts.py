"""Two bodies that meet: any size, stiffness, speed and law of loss."""

import numpy as np

import taichi_dem as dem
from taichi_dem.guards import FARTHEST_STEP
from tests.hard.kit import (
    Figure,
    energy,
    finite,
    hard,
    momentum,
    outcome,
    refused,
    total_momentum,
    wobble,
)
from tests.taichi_dem.setups import law, scene

GLASS = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)


def head_on(setting, speed=0.5, radius=(1e-3, 1e-3), materials=(GLASS, GLASS), laws=None):
    """Two spheres that fly into each other and apart again; the simulation, the closing and the
    parting speed."""
    radius = np.array(radius)
    gap = 1e-3 * radius.min()
    position = np.array([[0.0, 0.0, 0.0], [radius.sum() + gap, 0.0, 0.0]])
    velocity = np.array([[0.5 * speed, 0.0, 0.0], [-0.5 * speed, 0.0, 0.0]])
    spheres = dem.Spheres(position, radius, list(materials), velocity)
    laws = laws or law(restitution=0.5)
    sim = setting.simulation(dem.Scene(spheres=spheres, law=laws, gravity=(0, 0, 0)))
    before, steps = total_momentum(sim), 0
    while steps < 100_000 and (steps < 100 or len(sim.contacts())):
        sim.run(steps=max(50, steps // 8))
        steps = sim.steps
    velocity = sim.particles.velocity[:, 0]
    scale = 0.5 * speed * sim.particles.mass.max()
    return sim, velocity[1] - velocity[0], before, scale, steps


def closing_energy(sim, speed):
    mass = sim.particles.mass
    return 0.5 * mass.prod() / mass.sum() * speed**2


def judge(sim, parting, before, scale, steps, speed, restitution, error):
    yield finite(sim)
    yield Figure("restitution, error", abs(parting / speed - restitution), error)
    yield energy(sim, closing_energy(sim, speed), wobble(sim))
    yield momentum(sim, before, scale, steps)


# Verlet damps with the velocity of the half step: restitution is right to the first order in the
# step, (omega dt) times what is lost; twenty steps a half period make pi / 20.
def restitution_error(restitution):
    return np.pi / 20 * (1 - restitution**2) * 0.5 + 1e-3


@hard("impact, restitution {}", 0.01, 0.1, 0.5, 1.0)
def impact(setting, restitution):
    run = head_on(setting, laws=law(restitution))
    yield from judge(*run, 0.5, restitution, restitution_error(restitution))


@hard("impact of spheres of radius {} m", 1e-8, 1e-5, 10.0)
def sizes(setting, radius):
    run = head_on(setting, radius=(radius, radius))
    yield from judge(*run, 0.5, 0.5, restitution_error(0.5))


@hard("impact of sizes 1:{}", 20, 100)
def size_ratio(setting, ratio):
    run = head_on(setting, radius=(1e-3, 1e-3 / ratio))
    yield from judge(*run, 0.5, 0.5, restitution_error(0.5))


@hard("impact of stiffnesses 1:{:.0e}", 1e6)
def stiffness_ratio(setting, ratio):
    soft = dem.Material("soft", 1000, 1e5, 0.3)
    stiff = dem.Material("stiff", 1000, 1e5 * ratio, 0.3)
    run = head_on(setting, speed=0.2, materials=(soft, stiff))
    yield from judge(*run, 0.2, 0.5, restitution_error(0.5))


@hard("impact of densities 1:{:.0e}", 1e6)
def density_ratio(setting, ratio):
    light = dem.Material("light", 1.0, 5e7, 0.22)
    heavy = dem.Material("heavy", 1.0 * ratio, 5e7, 0.22)
    run = head_on(setting, materials=(light, heavy))
    yield from judge(*run, 0.5, 0.5, restitution_error(0.5))


@hard("impact with Poisson's ratio {}", -0.9, 0.0, 0.5)
def poisson(setting, ratio):
    matter = dem.Material("matter", 1000, 5e7, ratio)
    run = head_on(setting, materials=(matter, matter), laws=law(0.5, friction=0.3))
    yield from judge(*run, 0.5, 0.5, restitution_error(0.5))


@hard("impact at {:.0e} m/s", 1e-9, 1e-4)
def slow(setting, speed):
    """Overlaps of a millionth of a nanometre: no absolute length decides what touches."""
    sim, *_ = head_on(setting, speed=speed, laws=law(1.0))
    yield finite(sim)
    yield Figure("steps without an end", float(len(sim.contacts())), 0)


@hard("oblique impact on a wall, friction {}", 0.0, 0.3, 10.0)
def oblique(setting, friction):
    speed, radius = 1.0, 1e-3
    wall = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
    flying = scene(
        [[0.0, 0.0, 1.01 * radius]],
        radius,
        GLASS,
        velocity=(speed, 0.0, -speed),
        omega=(0.0, 300.0, 50.0),
        law=law(0.9, friction),
        boundaries=[wall],
    )
    sim = setting.simulation(flying)
    before = sim.energy()["kinetic"]
    sim.run(steps=400)
    state = sim.particles
    yield finite(sim)
    yield Figure("contacts left", float(len(sim.contacts())), 0)
    yield energy(sim, before, wobble(sim))
    yield Figure("kinetic energy gained", sim.energy()["kinetic"] / before - 1, wobble(sim))
    impulse = state.mass[0] * (state.velocity[0] - [speed, 0.0, -speed])
    # A spring of friction gives back beside the cone for a moment only: the impulse is within it.
    across = np.hypot(*impulse[:2]) / impulse[2]
    if friction:
        yield Figure("impulse over that of the cone", across / friction, 1 + 1e-9)
    else:
        yield Figure("impulse of no friction", across, 1e-12)


@hard("a sphere in a corner of {} walls", 2, 3)
def corner(setting, walls):
    low = [0.0, 0.0, 0.0]
    low[: 3 - walls] = [-np.inf] * (3 - walls)
    box = dem.Box(tuple(low), (np.inf,) * 3, GLASS)
    radius = 1e-3
    start = np.full((1, 3), 1.05 * radius)
    sim = setting.simulation(
        scene(start, radius, GLASS, velocity=-0.3, law=law(0.7, 0.5), boundaries=[box])
    )
    before = sim.energy()["kinetic"]
    sim.run(steps=600)
    yield finite(sim)
    yield energy(sim, before, wobble(sim))
    inside = sim.particles.position[0, 3 - walls :] / radius
    yield Figure("depth beyond the walls, radii", float(0.5 - inside.min()), 0)


# What a step of nearly the farthest makes of it: a spring so stiff for it that the sphere would be
# thrown back too fast, one that the step resolves, and one too soft to turn the sphere round.
STOPS = {2.0: "it could pass through others", 20.0: None, 100.0: "overlaps sphere"}


@hard("a fast sphere and a thin gap, {} m/s", *STOPS)
def thin_gap(setting, speed):
    """It goes 0.24 of its radius in a step, the farthest being 0.25: it must not pass through what
    it meets, and where the step is too coarse for the contact the run must stop and say so."""
    radius = 1e-3
    row = np.array([[0.0, 0.0, 0.0], [3.0 * radius, 0.0, 0.0], [5.0001 * radius, 0.0, 0.0]])
    velocity = np.zeros((3, 3))
    velocity[0, 0] = speed
    flying = scene(row, radius, GLASS, velocity=velocity, law=law(1.0))
    dt = 0.96 * FARTHEST_STEP * radius / speed
    sim = setting.simulation(flying, dt=dt, max_overlap=1.0)
    before = sim.energy()["kinetic"]
    momentum_before = total_momentum(sim)
    error = outcome(lambda: sim.run(steps=40))
    why = STOPS[speed]
    if why:
        yield from refused(error, dem.SimulationStopped, why, "Try")
    else:
        yield Figure("stopped", float(error is not None), 0)
        yield Figure("impacts missed", float(sim.particles.velocity[2, 0] <= 0), 0)
        yield energy(sim, before, wobble(sim))
    yield finite(sim)
    order = np.diff(sim.particles.position[:, 0])
    yield Figure("spheres passed through", float((order <= 0).sum()), 0)
    yield momentum(sim, momentum_before, np.abs(momentum_before).max(), sim.steps)
