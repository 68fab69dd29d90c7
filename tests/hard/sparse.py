"""Ground that is solved for every few steps only: phases near the limits, contacts that come and go
between two solves, adhesion, and beds that come to rest."""

import dataclasses
from functools import cache

import numpy as np

import halfspace
import taichi_dem as dem
from taichi_dem.extrapolation import LOST_PHASE, STEEP_PHASE
from taichi_dem.guards import SimulationStopped
from tests.hard.kit import Figure, energy, finite, hard, kinetic, outcome, refused, wobble
from tests.taichi_dem.setups import law, restart, rigid, scene

R = 5e-3
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e5, poissons_ratio=0.45)
GROUND = halfspace.HalfSpace(SOIL.youngs_modulus, SOIL.poissons_ratio, coupling="point")
RIGID = dataclasses.replace(rigid(), density=2500)
BEADS = dem.Material("beads", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
MASS = BEADS.density * 4 / 3 * np.pi * R**3
SPACING = 2.5 * R
STIFFNESS = 0.2 * np.pi * GROUND.modulus * SPACING  # K C = 0.2 between neighbours
RATE = np.sqrt(STIFFNESS / MASS)
OVERLAP = 1e-3 * R
GRAVITY = STIFFNESS * OVERLAP / MASS
HIGH = 50 * R
LEAST = -0.5  # K C of any mode of contacts that do not overlap each other


def square(n, spacing):
    steps = np.arange(n) - (n - 1) / 2
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2) * spacing


GRID = square(3, SPACING)
MODES = np.linalg.eigvalsh(STIFFNESS * GROUND.matrix(GRID))  # K C


def drawn(phase, turns, c):
    """The share of the energy that extrapolation gives or takes while a contact turns by ``turns``
    rad of its own oscillation, at most (``taichi_dem.extrapolation``); c: K C of the modes."""
    c = np.asarray(c)
    return float(np.expm1(turns * phase**3 / 3 * np.max(np.abs(c) / (1 + c) ** 2)))


# -- linear contacts of points without losses ------------------------------------------------------


@cache
def linear(setting):
    """Nine spheres; compiled once for all cases."""
    up = np.column_stack([GRID, np.full(len(GRID), HIGH)])
    ground = dem.Substrate(SOIL, coupling="point", residual=1e-12, exchange_every=8)
    beads = scene(
        up,
        R,
        RIGID,
        gravity=(0, 0, -GRAVITY),
        law=dem.Law(dem.Hooke(STIFFNESS, 1.0)),
        substrate=ground,
    )
    return setting.simulation(beads, max_overlap=1)


def begin(setting, every, phase, height=None, velocity=0.0):
    """With the phase (rad) from one exchange to the next; in equilibrium unless ``height`` (9,) m
    of their lowest points says otherwise, moving up at ``velocity`` (9,)."""
    sim = linear(setting)
    if height is None:
        load = np.full(len(GRID), STIFFNESS * OVERLAP)
        height = -OVERLAP - GROUND.matrix(GRID) @ load
    sim._engine.exchange.between.every[None] = every
    motion = np.zeros((len(GRID), 3))
    motion[:, 2] = velocity
    return restart(sim, np.column_stack([GRID, height + R]), motion, dt=phase / (every * RATE))


@hard("neighbours bob on the ground, {} rad between two exchanges", 0.29, 0.31, 0.99, 1.01)
def bob(setting, phase):
    """Against each other and together: warned of where due, stopped where due, and between that no
    more energy than theory says is made or lost."""
    velocity = 0.05 * OVERLAP * RATE * np.random.default_rng(3).normal(size=len(GRID))
    if phase > LOST_PHASE:
        error = outcome(lambda: begin(setting, 8, phase, velocity=velocity))
        yield from refused(error, SimulationStopped, "exchange_every = 2", "between two exchanges")
        return
    sim = begin(setting, 8, phase, velocity=velocity)
    scale = kinetic(sim)
    periods = 4 if phase < 0.5 else 1
    turns = 2 * np.pi * periods
    sim.run(steps=8 * round(turns / phase))  # between exchanges the energy is extrapolated too
    warned = "sparse_exchange" in sim.warnings
    yield finite(sim)
    missing = warned != (phase > STEEP_PHASE)
    yield Figure("warned where not due, or not where due", float(missing), 0)
    yield energy(sim, scale, drawn(phase, turns, MODES))


@hard("an impact {} exchanges that are 200 steps apart", "between", "across")
def missed(setting, where):
    """It lasts a sixth of the time between two: it is that of one contact alone, or the run
    is stopped."""
    turn, every = 2 * np.pi / 64, 200
    begin_at = {"between": 250, "across": 385}[where]
    speed, time = 0.01 * R * RATE, begin_at * turn / RATE
    height = np.full(len(GRID), HIGH)
    height[0] = speed * time + GRAVITY * time**2 / 2
    velocity = np.zeros(len(GRID))
    velocity[0] = -speed
    sim = begin(setting, every, every * turn, height, velocity)
    scale = MASS * (speed + GRAVITY * time) ** 2 / 2
    error = outcome(lambda: sim.run(steps=600))
    yield finite(sim)
    if where == "across":
        yield from refused(error, SimulationStopped, "exchange_every = ", "between two exchanges")
        return
    yield energy(sim, scale, wobble(sim))
    yield Figure("not thrown back", float(sim.particles.velocity[0, 2] <= 0), 0)


@hard("contacts on the ground open and close between exchanges", seldom=True)
def bouncing(setting):
    """Each at its own time. What a contact meets is late by at most two times T between exchanges,
    which in an impact is work of at most 4 (w T)^2 of its energy."""
    phase, bounces = 0.05, 4
    height = np.random.default_rng(5).uniform(0.0, 0.05, len(GRID)) * R
    sim = begin(setting, 4, phase, height)
    scale = MASS * GRAVITY * height.sum()
    changes, touching = 0, 0
    for _ in range(150):
        sim.run(steps=20)
        now = len(sim.substrate.force)
        changes, touching = changes + abs(now - touching), now
    yield finite(sim)
    yield Figure("few impacts", float(changes < bounces * len(GRID)), 0)
    yield energy(sim, scale, 4 * phase**2 * changes / len(GRID) + wobble(sim))


# -- adhesion --------------------------------------------------------------------------------------

WORK = 0.05  # J/m2
PULL_OFF = 1.5 * np.pi * WORK * R


def upward(sim):
    """Kinetic energy along z: nothing holds them against the slope of each other's dents."""
    return float(0.5 * (sim.particles.mass * sim.particles.velocity[:, 2] ** 2).sum())


@cache
def sticky(setting):
    position = np.column_stack([square(2, 2.1 * R), np.full(4, 0.998 * R)])
    ground = dem.Substrate(SOIL, exchange_every=4)
    stuck = scene(position, R, BEADS, law=dem.Law(dem.JKR(WORK, 0.3)), substrate=ground)
    return setting.simulation(stuck)


@hard("spheres hang from the ground at {} of what it holds", 0.5, 1.5, seldom=True)
def hanging(setting, share):
    """That they feel each other, and not at every step, changes nothing in the force that each is
    held with."""
    sim = sticky(setting)
    sim._engine.control.gravity[0] = (0, 0, share * PULL_OFF / MASS)
    restart(sim)
    scale = abs(sim.energy()["normal"]) + abs(sim.energy()["substrate"])
    sim.run(steps=8000)
    left = len(sim.substrate.force)
    bobbing = upward(sim)
    sim._engine.control.gravity[0] = (0, 0, 0)
    yield finite(sim)
    if share > 1:
        yield Figure("contacts left", float(left), 0)
        return
    yield Figure("contacts lost", float(4 - left), 0)
    yield Figure("force, error", abs(sim.substrate.force.sum() / (-4 * share * PULL_OFF) - 1), 1e-3)
    yield Figure("kinetic energy left", bobbing / scale, 1e-6)


@hard("spheres come down on sticky ground between two exchanges", seldom=True)
def snapping(setting):
    """They are drawn in, and stay: what is lost is on the books."""
    sim = sticky(setting)
    position = sim.scene.spheres.position + np.array([[0, 0, 0.01 * R]])
    velocity = np.zeros((4, 3))
    velocity[:, 2] = -0.005 * (1 + np.arange(4))
    restart(sim, position, velocity)
    scale = kinetic(sim)
    sim.run(duration=0.1)
    yield finite(sim)
    yield Figure("contacts missed", float(4 - len(sim.substrate.force)), 0)
    yield Figure("kinetic energy left", upward(sim) / scale, 1e-6)
    phase, turns = sim.summary()["exchange_phase"], 2 * np.pi  # within which damping ends it
    yield energy(sim, scale, wobble(sim) + drawn(phase, turns, LEAST))


# -- beds ------------------------------------------------------------------------------------------


@hard("a bed on ground solved for every {} steps is struck and comes to rest", 2, 4, seldom=True)
def struck(setting, every):
    """The ground carries the weight, as when solved for at every step; nothing chatters."""
    low = np.column_stack([square(3, 2.02 * R), np.full(9, 0.99 * R)])
    high = np.array([[x, y, 2.6 * R] for x in (-R, R) for y in (-R, R)])
    shot = np.array([[0.1 * R, 0.2 * R, 8 * R]])
    velocity = np.zeros((14, 3))
    velocity[-1, 2] = -1.0
    side = 3.05 * R
    walls = dem.Box((-side, -side, -np.inf), (side, side, np.inf), BEADS)
    bed = scene(
        np.vstack([low, high, shot]),
        R,
        BEADS,
        velocity,
        boundaries=[walls],
        gravity=(0, 0, -9.81),
        law=law(0.2, 0.5),
        substrate=dem.Substrate(SOIL, exchange_every=every),
    )
    sim = setting.simulation(bed)
    scale = kinetic(sim)
    sim.run(duration=1.0)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
    before = sim.contacts()[["i", "j", "face"]].copy()
    sim.run(steps=200)
    now = sim.contacts()[["i", "j", "face"]]
    changed = len(np.setxor1d(before, now))
    pushed = sim.contacts()
    carried = pushed["force"][pushed["j"] < 0, 2].sum() / (14 * MASS * 9.81)
    yield Figure("contacts made or lost at rest", float(changed), 0)
    yield Figure("kinetic energy left", kinetic(sim) / scale, 1e-9)
    yield Figure("weight not carried", abs(carried - 1), 1e-3)
