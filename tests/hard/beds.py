"""Many bodies: piles, presses, conveyors, mixtures of sizes, and rest that stays rest."""

import numpy as np

import taichi_dem as dem
from taichi_dem import packing
from tests.hard.impacts import GLASS
from tests.hard.kit import Figure, energy, finite, hard, kinetic, wobble
from tests.taichi_dem.setups import law, scene

R = 1e-3
FLOOR = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
DOWN = (0.0, 0.0, -9.81)


def box(width, floor=True):
    low = (0.0, 0.0, 0.0 if floor else -np.inf)
    return dem.Box(low, (width, width, np.inf), GLASS)


def poured(count, radius, width, height, seed=3):
    region = ((0.0, 0.0, 0.0), (width, width, height))
    return packing.generate(radius, region, count=count, seed=seed)


def weight_energy(sim):
    """What the spheres lose when they all fall by their mean height."""
    state = sim.particles
    return float(9.81 * (state.mass * state.position[:, 2]).sum())


@hard("a bed comes to rest and stays there")
def rest(setting):
    position, radius = poured(60, ("uniform", 0.8 * R, R), 9 * R, 12 * R)
    bed = scene(position, radius, GLASS, law=law(0.2, 0.5), boundaries=[box(9 * R)], gravity=DOWN)
    sim = setting.simulation(bed)
    scale = weight_energy(sim)
    sim.run(duration=0.8)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    settled = kinetic(sim)
    sim.run(duration=0.1)
    # What rolls or spins without resistance goes on for ever.
    yield Figure("kinetic energy over that of the fall", kinetic(sim) / scale, 1e-6)
    yield Figure("kinetic energy made at rest", kinetic(sim) - settled, 1e-12 * scale)


@hard("a small sphere under one {} times as large", 10, 20)
def large_on_small(setting, ratio):
    """A weight ratio of up to 8000 on one contact."""
    position = np.array([[0.0, 0.0, R / ratio], [0.0, 0.0, (2 / ratio + 1) * R]])
    pile = scene(
        position, [R / ratio, R], GLASS, law=law(0.5, 10.0), boundaries=[FLOOR], gravity=DOWN
    )
    sim = setting.simulation(pile)
    scale = weight_energy(sim)
    sim.run(steps=3000)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    heights = sim.particles.position[:, 2]
    yield Figure("small sphere out of its place, radii", abs(heights[0] * ratio / R - 1), 0.1)


@hard("a sphere at rest on a slope within its friction")
def slope(setting):
    """It would roll: held by its spin being blocked it may not slide; two glued by a wall stand."""
    angle = np.arctan(0.25)
    wall = dem.Plane((0, 0, 0), (-np.sin(angle), 0, np.cos(angle)), GLASS)
    stop = dem.Plane((0, 0, 0), (np.cos(angle), 0, np.sin(angle)), GLASS)
    up = np.array([[np.cos(angle), 0, np.sin(angle)], [-np.sin(angle), 0, np.cos(angle)]])
    start = 0.9999 * R * up.sum(axis=0)
    held = scene([start], R, GLASS, law=law(0.3, 0.5), boundaries=[wall, stop], gravity=DOWN)
    sim = setting.simulation(held)
    scale = 9.81 * float(sim.particles.mass[0]) * R
    sim.run(duration=0.05)
    yield finite(sim)
    yield Figure("kinetic energy left", kinetic(sim) / scale, 1e-12)
    yield energy(sim, scale, wobble(sim))


@hard("a bed of sizes 1:{} falls", 5, 20)
def polydisperse(setting, ratio):
    fine = R / ratio
    few, large = poured(4, R, 6 * R, 6 * R)
    many, small = poured(20 * ratio, ("uniform", fine, 1.5 * fine), 6 * R, 3 * R)
    position, radius = np.vstack([many, few + [0, 0, 3 * R]]), np.concatenate([small, large])
    bed = scene(
        position,
        radius,
        GLASS,
        velocity=(0.0, 0.0, -1.0 / ratio),
        law=law(0.5, 0.3),
        boundaries=[box(6 * R)],
    )
    sim = setting.simulation(bed)
    scale = kinetic(sim)
    sim.run(duration=0.006 * ratio)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    inside = sim.particles.position / sim.particles.radius[:, None]
    yield Figure("depth beyond the walls, radii", float(0.5 - inside.min()), 0)


@hard("a press of given load on a bed, {} of its weight", 0.01, 100.0)
def press(setting, share):
    position, radius = poured(40, R, 8 * R, 10 * R)
    weight = float(len(radius) * 2500 * 4 / 3 * np.pi * R**3 * 9.81)
    top = float(position[:, 2].max() + 1.1 * R)
    plate = dem.Piston((0, 0, top), (0, 0, -1), GLASS, load=share * weight, mass=weight / 9.81)
    bed = scene(
        position, radius, GLASS, law=law(0.3, 0.3), boundaries=[box(8 * R), plate], gravity=DOWN
    )
    sim = setting.simulation(bed)
    scale = weight_energy(sim) + share * weight * top
    sim.run(duration=0.15)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))


@hard("a piston that shatters a bed, {} m/s", 2.0)
def hammer(setting, speed):
    position, radius = poured(40, R, 8 * R, 10 * R)
    top = float(position[:, 2].max() + 1.1 * R)
    rows = ((0.0, 0.0), (0.3 * top / speed, 0.3 * top), (0.6 * top / speed, 0.0))
    plate = dem.Piston((0, 0, top), (0, 0, -1), GLASS, program=rows)
    bed = scene(
        position, radius, GLASS, law=law(0.9, 0.3), boundaries=[box(8 * R), plate], gravity=DOWN
    )
    sim = setting.simulation(bed)
    sim.run(duration=rows[-1][0])
    parts = sim.energy()
    yield finite(sim)
    yield energy(sim, parts["external_work"] + weight_energy(sim), wobble(sim))
    inside = sim.particles.position / sim.particles.radius[:, None]
    yield Figure("depth beyond the walls, radii", float(0.5 - inside.min()), 0)


@hard("a conveyor carries a pile")
def conveyor(setting):
    """The belt brings a sphere to its own speed and then works no more."""
    belt = dem.Plane((0, 0, 0), (0, 0, 1), GLASS, velocity=(0.2, 0.0, 0.0))
    carried = scene([[0, 0, R]], R, GLASS, law=law(0.5, 0.5), boundaries=[belt], gravity=DOWN)
    sim = setting.simulation(carried)
    sim.run(duration=0.1)
    state = sim.particles
    yield finite(sim)
    # It slides, then rolls: at v = 2/7 of the belt's speed, with the rest as spin.
    yield Figure("speed, error", abs(state.velocity[0, 0] / 0.2 - 2 / 7), 1e-3)
    surface = state.velocity[0, 0] - state.omega[0, 1] * R
    yield Figure("slip left", abs(surface / 0.2 - 1), 1e-3)


@hard("{} spheres in a line between closing walls", 10)
def jam(setting, count):
    """Compressed to 2 % each, held, and let go: what was put in comes out."""
    length = 2 * R * count
    position = np.column_stack([R + 2 * R * np.arange(count), np.zeros(count), np.zeros(count)])
    squeeze = 0.02 * length
    rows = ((0.0, 0.0), (0.02, squeeze), (0.03, squeeze), (0.05, 0.0))
    walls = [
        dem.Plane((0, 0, 0), (1, 0, 0), GLASS),
        dem.Piston((length, 0, 0), (-1, 0, 0), GLASS, program=rows),
    ]
    sim = setting.simulation(scene(position, R, GLASS, law=law(1.0), boundaries=walls))
    sim.run(duration=0.025)
    parts = sim.energy()
    scale = parts["external_work"]
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    sim.run(duration=0.025)
    yield Figure("work kept", abs(sim.energy()["external_work"]) / scale, 0.05)
    yield energy(sim, scale, wobble(sim))
