"""Clusters that sleep: what must wake them, what must not, and what must never fall asleep."""

from functools import cache

import numpy as np

import taichi_dem as dem
from taichi_dem.sleep import LOOK_EVERY
from tests.hard.kit import (
    EPS,
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
SETTLED = 0.25  # s
PISTON = 5  # among the boundaries: after the five walls of the box


@cache
def box(setting):
    """Four spheres and one upon them in a box, and one more; beside a wall a piston that comes
    through it later. Compiled once for all cases."""
    low = [(1.01 * (2 * x + 1), 1.01 * (2 * y + 1), 1.01) for x in (0, 1) for y in (0, 1)]
    place = np.array([*low, (2.02, 2.02, 2.45), (2.1, 2.2, 8.0)]) * R
    walls = [((0, 0, 0), (0, 0, 1)), ((0, 0, 0), (1, 0, 0)), ((0, 0, 0), (0, 1, 0))]
    walls += [((SIDE, 0, 0), (-1, 0, 0)), ((0, SIDE, 0), (0, -1, 0))]
    program = [(0.0, 0.0), (SETTLED + 0.15, 0.0), (SETTLED + 0.2, OUT + 0.1 * R)]
    piston = dem.Piston((SIDE + OUT, 0, 0), (-1, 0, 0), STONE, program=program)
    boxful = scene(
        place,
        R,
        STONE,
        gravity=(0, 0, -9.81),
        law=law(0.2, 0.5),
        boundaries=[*(dem.Plane(*wall, STONE) for wall in walls), piston],
        sleep=True,
    )
    return setting.simulation(boxful, max_overlap=1.0)


def touching(sim, other):
    """Spheres that touch sphere or boundary ``other``, by the records' numbers."""
    records = sim.contacts()
    i, j = records["i"], records["j"]
    return np.unique(np.concatenate([i[j == other], j[(i == other) & (j >= 0)]]))


def until_touched(sim, other, steps):
    """Step by step, ``steps`` at most; by how many steps a sphere woke untouched, how far sleepers
    moved (m), and who is touched."""
    early, moved, before = 0, 0.0, sim.particles.position[:PILE].copy()
    for _ in range(steps):
        sim.run(steps=1)
        if len(touched := touching(sim, other)):
            return early, moved, touched
        early += int(not sim.asleep[:PILE].all())
        moved = max(moved, float(np.abs(sim.particles.position[:PILE] - before).max()))
    return early, moved, np.empty(0, int)


def inside(sim):
    """How far a centre is outside the box, less half a radius."""
    place = sim.particles.position
    out = np.maximum(0.5 * R - place, 0.0)[:, :].max()
    return Figure(
        "depth beyond the walls, m", max(out, float((place[:, :2] - SIDE).max() + 0.5 * R)), 0
    )


@hard("a sleeping pile is struck at {} m/s", 3.0, 12.0, seldom=True)
def struck(setting, speed):
    """All sleep until that step, who is struck is awake in it, all are soon; then they rest again."""
    sim = box(setting)
    start, velocity = sim.scene.spheres.position.copy(), np.zeros((PILE + 1, 3))
    velocity[PILE, 2] = -(speed - 9.81 * SETTLED)
    start[PILE, 2] = 4 * R + (speed - 9.81 * SETTLED / 2) * SETTLED
    restart(sim, start, velocity)
    steps = round(SETTLED / sim.dt)
    sim.run(steps=steps - 200)
    slept = sim.asleep[:PILE].all()
    scale = kinetic(sim)
    early, moved, touched = until_touched(sim, PILE, 600)
    yield Figure("not asleep when struck", float(not slept), 0)
    yield Figure("woke untouched, or not when touched", early + float(sim.asleep[touched].sum()), 0)
    yield Figure("sleepers moved, m", moved, 0)
    yield Figure("spheres missed", float(len(touched) == 0), 0)
    sim.run(steps=PILE)
    yield Figure("still asleep", float(sim.asleep.sum()), 0)
    sim.run(duration=0.6)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    yield inside(sim)
    yield Figure("awake at the end", float((~sim.asleep).sum()), 0)
    yield Figure("kinetic energy at the end", kinetic(sim), 0)


@hard("a piston sets out when all sleep", seldom=True)
def pushed(setting):
    """It wakes whom it touches, in that step, and its work is on the books."""
    sim = box(setting)
    start = sim.scene.spheres.position.copy()
    restart(sim, start)
    sim.run(duration=SETTLED + 0.15)
    slept = sim.asleep.all()
    early, moved, touched = until_touched(sim, -2 - PISTON, 4000)
    yield Figure("not asleep at first", float(not slept), 0)
    yield Figure("woke untouched, or not when touched", early + float(sim.asleep[touched].sum()), 0)
    yield Figure("sleepers moved, m", moved, 0)
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
    aside = 100 * R * np.arange(4)
    place = np.column_stack([np.zeros(4), np.zeros(4), aside])
    place[1] = (-0.02 * R, (2 + gap) * R, 0.0)
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
    yield Figure("energy lost", sim.energy()["dissipated"] / total, 8 * EPS * sim.steps)
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


@hard("sticky sleepers are struck and hold on", seldom=True)
def sticky(setting):
    """Two that float in touch; a third joins them, and all go on together."""
    pair = np.array([[0, 0, 0], [1.9995 * R, 0, 0], [6 * R, 0, 0]])
    velocity = np.zeros((3, 3))
    velocity[2, 0] = -0.05
    stuck = scene(pair, R, STONE, velocity, law=dem.Law(dem.JKR(1.0, 0.1)), sleep=True)
    sim = setting.simulation(stuck)
    before, slept = total_momentum(sim), 0
    while len(sim.contacts()) < 2 and sim.steps < 100_000:
        slept += int(sim.asleep.sum())
        sim.run(steps=20)
    sim.run(steps=20 * LOOK_EVERY)
    velocity = sim.particles.velocity[:, 0]
    yield finite(sim)
    yield Figure("never asleep", float(slept == 0), 0)
    yield Figure("apart", float(2 - len(sim.contacts())), 0)
    yield Figure("speeds differ", float(np.ptp(velocity) / abs(velocity.mean())), 1e-6)
    yield momentum(sim, before, float(np.abs(before).max()), sim.steps)
