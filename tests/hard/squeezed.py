"""Soft spheres whose contacts feel each other through the bulk, up to where no forces fit."""

from itertools import product

import numpy as np

import taichi_dem as dem
from tests.hard.kit import (
    DRIVERS,
    TEAM,
    Figure,
    energy,
    finite,
    hard,
    kinetic,
    momentum,
    outcome,
    refused,
    total_momentum,
    wobble,
)
from tests.hard.late_surfaces import LateSurfaces
from tests.taichi_dem.multicontact_limits import (
    SOFT,
    R,
    cubic_packing,
    walls_closing,
    walls_limit,
)
from tests.taichi_dem.setups import scene

EXCHANGES = ("implicit", "lagged")
DRIVEN = (*DRIVERS, TEAM)  # whose members share the passes of the expansions
CORNERS = np.stack(np.meshgrid(*3 * [[-1, 1]]), axis=-1).reshape(-1, 3)


@hard(
    "a cube of eight soft spheres pressed together and let go, {}",
    *EXCHANGES,
    drivers=DRIVEN,
    seldom=True,
)
def let_go(setting, exchange):
    """They part with the energy that they held, and all as fast as each other; lagged, with what
    their late surfaces have put in, and one of two ever before the other."""
    law = dem.Law(dem.Hertz(1.0), surface=dem.MultiContact(exchange=exchange))
    sim = setting.simulation(scene(0.95 * R * CORNERS, R, SOFT, law=law), max_overlap=1.0)
    before, start = total_momentum(sim), without_expansion(sim)
    scale = sim.energy()["normal"] + abs(sim.energy()["expansion"])
    late = LateSurfaces(sim)
    late.run(300)
    yield finite(sim)
    yield Figure("contacts left", float(len(sim.contacts())), 0)
    velocity = sim.particles.velocity
    speed = np.abs(velocity).max()
    yield momentum(sim, before, float((sim.particles.mass * speed).sum()), sim.steps)
    if exchange == "lagged":
        made = without_expansion(sim) - start
        yield Figure("energy made", made / scale, wobble(sim) + late.unsure / scale)
        return
    yield energy(sim, scale, wobble(sim))
    # The solve may leave a residual of 1e-6 in an overlap, and so in a force, at each step.
    unlike = np.abs(velocity - speed * CORNERS).max() / speed
    yield Figure("unlike its twins", float(unlike), 1e-6 * sim.steps)


def without_expansion(sim):
    return sum(sim.energy().get(name, 0.0) for name in ("kinetic", "normal"))


@hard(
    "a packing of soft spheres struck at {0[0]} of its limit, {0[1]}",
    *product((0.5, 0.95), EXCHANGES),
    drivers=DRIVEN,
    seldom=True,
)
def struck(setting, what):
    """It comes back to rest; without the order in which lagged surfaces rise, each contact is
    pressed as its like."""
    share, exchange = what
    velocity = 0.02 * np.random.default_rng(4).normal(size=(8, 3))
    packing, _ = cubic_packing(share, 0.3, velocity, exchange=exchange)
    sim = setting.simulation(packing, max_overlap=1.0)
    before = kinetic(sim)
    held = sim.energy()["normal"] + abs(sim.energy()["expansion"])
    sim.run(steps=3000)
    yield finite(sim)
    yield Figure("kinetic energy left", kinetic(sim) / before, 1e-9)
    found = sim.contacts()
    yield Figure("contacts lost", float(36 - len(found)), 0)
    left = np.abs(sim.particles.force).max() / found["normal_force"].max()
    yield Figure("force left", float(left), 1e-6)  # the residual of the solve
    if exchange == "lagged":
        return
    yield energy(sim, before + held, wobble(sim))
    walls = found["j"] < 0
    for name, group in (("walls", walls), ("spheres", ~walls)):
        force = found["normal_force"][group]
        yield Figure(f"difference of forces, {name}", float(np.ptp(force) / force.mean()), 1e-6)


@hard("a packing of soft spheres at {} of its limit", 1.05, seldom=True)
def too_far(setting, share):
    """There are no forces that fit, and it is said so before the first step."""
    packing, _ = cubic_packing(share)
    error = outcome(lambda: setting.simulation(packing, max_overlap=1.0))
    yield from refused(error, dem.InputError, "no equilibrium")


@hard("walls close in on a soft sphere until no forces fit", seldom=True)
def closing(setting):
    """The run ends there, with the last good state."""
    speed = 0.05
    closes, bead = walls_closing(speed)
    sim = setting.simulation(closes, dt=4e-6)
    limit = walls_limit(bead)
    error = outcome(lambda: sim.run(steps=round(1.2 * limit / speed / sim.dt)))
    yield from refused(error, dem.SimulationStopped, "no equilibrium", "t = ")
    depth = speed * float(str(error).split("t = ")[1].split()[0])
    yield Figure("depth over the limit, error", abs(depth / limit - 1), 0.01)
    yield finite(sim)
