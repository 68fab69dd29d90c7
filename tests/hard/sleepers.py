"""Clusters that sleep: what must wake them, what must not, and what must never fall asleep."""

from functools import cache

import numpy as np

import taichi_dem as dem
from taichi_dem.sleep import LOOK_EVERY
from tests.hard.kit import (
    Figure,
    energy,
    finite,
    hard,
    kinetic,
    momentum,
    total_momentum,
    wobble,
)
from tests.taichi_dem.setups import law, restart, scene, state

R = 5e-3
STONE = dem.Material("stone", density=2500, youngs_modulus=1e7, poissons_ratio=0.2)
PILE = 5  # the last sphere comes from above
SIDE = 4.04 * R
OUT = 0.3 * R  # of the box, where the piston waits
SETTLED = 0.25  # s, when the pile of five sleeps
PUSH = 2.5  # s, when all do, and the piston sets out
PISTON = 5  # among the boundaries: after the five walls of the box

HOLD = dem.CDT(0.2, torsion_torque=True, regularization="spring", rolling_damping=0.5)


@cache
def box(setting):
    """Four spheres and one upon them in a box, and one more; beside a wall a piston that comes
    through it later. Compiled once for all cases."""
    low = [(1.01 * (2 * x + 1), 1.01 * (2 * y + 1), 1.01) for x in (0, 1) for y in (0, 1)]
    place = np.array([*low, (2.02, 2.02, 2.45), (2.1, 2.2, 8.0)]) * R
    walls = [((0, 0, 0), (0, 0, 1)), ((0, 0, 0), (1, 0, 0)), ((0, 0, 0), (0, 1, 0))]
    walls += [((SIDE, 0, 0), (-1, 0, 0)), ((0, SIDE, 0), (0, -1, 0))]
    program = [(0.0, 0.0), (PUSH, 0.0), (PUSH + 0.05, OUT + 0.1 * R)]
    piston = dem.Piston((SIDE + OUT, 0, 0), (-1, 0, 0), STONE, program=program)
    boxful = scene(
        place,
        R,
        STONE,
        gravity=(0, 0, -9.81),
        law=dem.Law(dem.Hertz(0.2), dem.Mindlin(0.5), HOLD),
        boundaries=[*(dem.Plane(*wall, STONE) for wall in walls), piston],
        sleep=True,
    )
    return setting.simulation(boxful, max_overlap=1.0)


def touching(sim, other):
    """Spheres that touch sphere or boundary ``other``, by the records' numbers."""
    records = sim.contacts()
    i, j = records["i"], records["j"]
    return np.unique(np.concatenate([i[j == other], j[(i == other) & (j >= 0)]]))


def until_touched(sim, sleepers, other, steps):
    """Step by step, ``steps`` at most: the figures of the first so many ``sleepers`` up to where
    ``other`` touches one, and in that step."""
    early, before = 0, sim.particles.position[:sleepers].copy()
    slept, place = sim.asleep[:sleepers].all(), before
    touched = touching(sim, other)
    while steps and not len(touched):
        place = sim.particles.position[:sleepers]
        early += int(not sim.asleep[:sleepers].all())
        sim.run(steps=1)
        steps, touched = steps - 1, touching(sim, other)
    yield Figure("not asleep at first", float(not slept), 0)
    yield Figure("steps awake before the touch", float(early), 0)
    yield Figure("sleepers moved, m", float(np.abs(place - before).max()), 0)
    yield Figure("nobody touched", float(not len(touched)), 0)
    yield Figure("asleep though touched", float(sim.asleep[touched].sum()), 0)


def inside(sim):
    """That centres are half a radius inside the walls."""
    place = sim.particles.position
    depth = max(-place.min(), (place[:, :2] - SIDE).max()) / R + 0.5
    return Figure("depth beyond the walls, radii", float(depth), 0)


@hard("a sleeping pile is struck at {} m/s", 3.0, 12.0, seldom=True)
def struck(setting, speed):
    """Who is struck is awake in that step, all are soon; then they rest, and sleep, again."""
    sim = box(setting)
    start, velocity = sim.scene.spheres.position.copy(), np.zeros((PILE + 1, 3))
    thrown = speed - 9.81 * SETTLED
    velocity[PILE, 2] = -thrown
    start[PILE, 2] = 5 * R + (thrown + 9.81 * SETTLED / 2) * SETTLED
    restart(sim, start, velocity)
    sim.run(duration=SETTLED)
    scale = kinetic(sim)
    yield from until_touched(sim, PILE, PILE, 4000)
    sim.run(steps=PILE)
    yield Figure("still asleep", float(sim.asleep.sum()), 0)
    sim.run(duration=2.0)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    yield inside(sim)
    yield Figure("awake at the end", float((~sim.asleep).sum()), 0)
    yield Figure("kinetic energy at the end", kinetic(sim), 0)


@hard("a piston sets out when all sleep", seldom=True)
def pushed(setting):
    """It wakes whom it touches, in that step, and its work is on the books."""
    sim = restart(box(setting))
    sim.run(duration=PUSH)
    yield from until_touched(sim, PILE + 1, -2 - PISTON, 10_000)
    sim.run(steps=2 * PILE)
    yield Figure("still asleep", float(sim.asleep.sum()), 0)
    sim.run(duration=0.3)
    work = sim.energy()["external_work"]
    weight = 9.81 * float(sim.particles.mass.sum()) * R
    yield finite(sim)
    yield energy(sim, abs(work) + weight, wobble(sim))
    leaning = touching(sim, -2 - PISTON)
    yield Figure("asleep though they lean on it", float(sim.asleep[leaning].sum()), 0)


# -- without weight --------------------------------------------------------------------------------


@cache
def row(setting):
    """Four spheres that float, and a wall that comes up from far below."""
    place = np.column_stack([np.zeros((4, 2)), 2.01 * R * np.arange(4)])
    wall = dem.Plane((0, 0, -10 * R), (0, 0, 1), STONE, velocity=(0, 0, 0.5))
    return setting.simulation(
        scene(place, R, STONE, law=law(1.0), boundaries=[wall], sleep=True), max_overlap=1.0
    )


@hard("a sphere passes a sleeper, {:+.0e} radii from touching it", 1e-9, -1e-9)
def passing(setting, gap):
    """It wakes if it is touched, and only then; nothing else can have moved it."""
    sim = row(setting)
    aside = 1000 * R + 100 * R * np.arange(4)  # far from the wall
    place = np.column_stack([np.zeros(4), np.zeros(4), aside])
    place[1] = (-0.02 * R, (2 + gap) * R, aside[0])
    velocity = np.zeros((4, 3))
    velocity[1, 0] = 2e-5 * R / sim.dt
    restart(sim, place, velocity)
    before = total_momentum(sim)
    sim.run(steps=LOOK_EVERY)
    slept = bool(sim.asleep[0])
    sim.run(steps=2000 - LOOK_EVERY)
    moved = np.abs(sim.particles.velocity[0]).max() > 0
    yield finite(sim)
    yield Figure("not asleep at first", float(not slept), 0)
    yield Figure("moved untouched, or not when touched", float(moved != (gap < 0)), 0)
    yield momentum(sim, before, float(np.linalg.norm(before)), sim.steps)


@hard("a wall comes at a row of sleepers", seldom=True)
def wall_comes(setting):
    """They fly off as from a wall that meets them awake: bit for bit."""
    ends, slept = [], []
    sim = row(setting)
    for look in (True, False):
        restart(sim)
        if not look:
            sim._engine.sleep.next = np.iinfo(np.int64).max
        sim.run(steps=LOOK_EVERY)
        slept.append(sim.asleep.all())
        sim.run(duration=12 * R / 0.5)
        ends.append(state(sim))
    yield finite(sim)
    yield Figure("not asleep at first", float(slept != [True, False]), 0)
    yield Figure("not struck", float((sim.particles.velocity[:, 2] <= 0).any()), 0)
    yield Figure("difference to those awake", float(np.abs(ends[0] - ends[1]).max()), 0)
    yield energy(sim, kinetic(sim), wobble(sim))


@hard("a sphere that swings is looked at where it {}", "turns", "passes its rest", seldom=True)
def swinging(setting, where):
    """Without speed, or without force on it: it is never at rest."""
    gap = 1.98 * R
    walls = [dem.Plane((0, 0, 0), (1, 0, 0), STONE), dem.Plane((gap, 0, 0), (-1, 0, 0), STONE)]
    held = scene([[0.992 * R, 0, 0]], R, STONE, law=law(1.0), boundaries=walls, sleep=True)
    sim = setting.simulation(held)
    period = _period(sim)
    looks = {"turns": LOOK_EVERY, "passes its rest": LOOK_EVERY * 4 / 5}[where]
    restart(sim, dt=period / looks)
    total = sim.energy()["normal"]
    sim.run(steps=10 * LOOK_EVERY)
    yield finite(sim)
    yield Figure("asleep", float(sim.asleep.sum()), 0)
    yield Figure("energy lost", 1 - (kinetic(sim) + sim.energy()["normal"]) / total, wobble(sim))
    yield energy(sim, total, wobble(sim))


def _period(sim):
    """Of the oscillation that starts at rest: two steps where the velocity changes its sign."""
    turned, last = [], 0.0
    while len(turned) < 2:
        sim.run(steps=1)
        now = sim.particles.velocity[0, 0]
        if last * now < 0:
            turned.append(sim.time - sim.dt * now / (now - last))
        last = now
    return turned[1]


@hard("a sphere is thrown against a belt's way", seldom=True)
def belt(setting):
    """It comes to a halt, turns round, and rolls at 2/7 of the difference: never asleep."""
    ground = dem.Plane((0, 0, 0), (0, 0, 1), STONE, velocity=(0.2, 0, 0))
    thrown = scene(
        [[0, 0, R * (1 - 1e-4)]],
        R,
        STONE,
        velocity=(-0.1, 0, 0),
        gravity=(0, 0, -9.81),
        law=law(0.2, 0.5),
        boundaries=[ground],
        sleep=True,
    )
    sim = setting.simulation(thrown)
    slept = 0
    for _ in range(20):
        sim.run(duration=0.01)
        slept += int(sim.asleep.sum())
    speed = -0.1 + 2 / 7 * 0.3  # what sliding friction gives until it rolls
    yield finite(sim)
    yield Figure("asleep", float(slept), 0)
    yield Figure("speed, error", abs(sim.particles.velocity[0, 0] / speed - 1), 1e-2)


@hard("a sphere comes down on a sticky sleeper", seldom=True)
def sticky(setting):
    """It is drawn in at the touch, which wakes the other, and both sleep one upon the other."""
    floor = dem.Plane((0, 0, 0), (0, 0, 1), STONE)
    place = np.array([[0, 0, R * (1 - 1e-4)], [0, 0, 50 * R]])
    stuck = dem.Law(dem.JKR(0.2, 0.1))
    sim = setting.simulation(
        scene(place, R, STONE, gravity=(0, 0, -9.81), law=stuck, boundaries=[floor], sleep=True)
    )
    sim.run(duration=0.2)
    scale = 9.81 * float(sim.particles.mass[0]) * 48 * R
    yield from until_touched(sim, 1, 1, 10_000)
    sim.run(duration=0.5)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    yield Figure("contacts lost", float(2 - len(sim.contacts())), 0)
    yield Figure("awake at the end", float((~sim.asleep).sum()), 0)
