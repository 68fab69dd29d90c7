"""Time steps at the edge and beyond, and states that no scene should start from."""

import numpy as np

import taichi_dem as dem
from taichi_dem.guards import SimulationStopped
from tests.hard.impacts import GLASS
from tests.hard.kit import (
    VERLET_LIMIT,
    Figure,
    energy,
    finite,
    hard,
    outcome,
    refused,
    total_momentum,
    wobble,
)
from tests.taichi_dem.setups import law, scene

R = 1e-3


def chain(velocity=0.3):
    """Three spheres in a row, the first of which flies into the others."""
    position = np.array([[0.0, 0.0, 0.0], [2.01 * R, 0.0, 0.0], [4.01 * R, 0.0, 0.0]])
    speeds = np.zeros((3, 3))
    speeds[0, 0] = velocity
    return scene(position, R, GLASS, velocity=speeds, law=law(1.0))


@hard("{} stable steps", 0.9, 1.1, 3.0)
def multiples(setting, factor):
    """Energy swings by the square of the step; beyond the stable one that is warned of."""
    sim = setting.simulation(chain())
    sim = setting.simulation(chain(), dt=factor * sim.stable.value)
    before = sim.energy()["kinetic"]
    warned = "time_step" in sim.warnings
    sim.run(steps=600)
    yield Figure("warned where not due, or not where due", float(warned != (factor > 1)), 0)
    yield finite(sim)
    yield energy(sim, before, wobble(sim))


@hard("a step beyond Verlet's own limit")
def explosion(setting):
    """A sphere held between two walls so that its spring is stiff, at 3 times 2 / omega: the run
    stops with the reason, and what was good is kept."""
    walls = [
        dem.Plane((-0.95 * R, 0, 0), (1, 0, 0), GLASS),
        dem.Plane((0.95 * R, 0, 0), (-1, 0, 0), GLASS),
    ]
    held = scene([[1e-6, 0.0, 0.0]], R, GLASS, law=law(1.0), boundaries=walls)
    stable = setting.simulation(held).stable.value
    sim = setting.simulation(held, dt=3 * VERLET_LIMIT * 20 / np.pi * stable)
    error = outcome(lambda: sim.run(steps=2000))
    yield from refused(error, SimulationStopped, "t = ", "Try a smaller time step")
    yield finite(sim)
    good = getattr(error, "last_good", {"position": np.full(3, np.nan)})
    yield Figure("last good state not finite", float(~np.isfinite(good["position"]).all()), 0)


@hard("spheres that overlap by {} of the radius at the start", 0.1, 0.45)
def overlapping(setting, share):
    """What was pressed together comes apart with the energy it held, no more."""
    position = np.array([[0.0, 0.0, 0.0], [(2 - share) * R, 0.0, 0.0]])
    sim = setting.simulation(scene(position, R, GLASS, law=law(1.0)))
    held = sim.energy()["normal"]
    sim.run(steps=400)
    yield finite(sim)
    yield Figure("contacts left", float(len(sim.contacts())), 0)
    yield energy(sim, held, wobble(sim))
    apart = np.abs(total_momentum(sim)).max() / np.sqrt(2 * held * sim.particles.mass[0])
    yield Figure("momentum made", apart, 1e-12)


@hard("spheres that overlap by more than half the radius at the start", drivers=("serial",))
def too_deep(setting):
    position = np.array([[0.0, 0.0, 0.0], [1.45 * R, 0.0, 0.0]])
    error = outcome(lambda: scene(position, R, GLASS, law=law(1.0)))
    yield from refused(error, dem.InputError, "spheres.position[1]", "overlaps sphere 0")


@hard("coincident spheres at the start", drivers=("serial",))
def coincident(setting):
    error = outcome(lambda: scene(np.zeros((2, 3)), R, GLASS, law=law(1.0)))
    yield from refused(error, dem.InputError, "same centre as sphere 0")


@hard("a sphere thrown too fast for any step asked", drivers=("serial", "parallel"))
def too_fast(setting):
    """A step in which it would go a radius: refused, or stopped where gravity makes it so fast,
    before it can pass through anything."""
    flying = scene([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], R, GLASS, velocity=(1.0, 0, 0), law=law(1.0))
    error = outcome(lambda: setting.simulation(flying, dt=R))
    yield from refused(error, dem.InputError, "dt = 0.001", "sphere 0", "must be < 0.00025 s")
    falling = scene([[0.0, 0.0, 0.0]], R, GLASS, law=law(1.0), gravity=(0, 0, -10.0))
    sim = setting.simulation(falling, dt=0.1 * R)
    error = outcome(lambda: sim.run(steps=4000))
    yield from refused(error, SimulationStopped, "sphere 0", "Try a smaller time step")


@hard("two clumps a kilometre apart")
def clumps(setting):
    """Positions lose digits with distance; both clumps must do the same within them."""
    near = np.array([[0.0, 0.0, 0.0], [2.005 * R, 0.0, 0.0], [0.0, 2.005 * R, 0.0]])
    far = near + [1000.0, 1000.0, 1000.0]
    velocity = np.zeros((6, 3))
    velocity[[1, 4], 0] = -0.1
    velocity[[2, 5], 1] = -0.1
    sim = setting.simulation(
        scene(np.vstack([near, far]), R, GLASS, velocity=velocity, law=law(0.8, 0.3))
    )
    before = sim.energy()["kinetic"]
    sim.run(steps=500)
    state = sim.particles
    yield finite(sim)
    yield energy(sim, before, wobble(sim))
    # A kilometre resolves 1e-13 m, 5e-9 of the overlap here, which stays as small in the speeds.
    yield Figure("difference", np.abs(state.velocity[:3] - state.velocity[3:]).max() / 0.1, 1e-4)
