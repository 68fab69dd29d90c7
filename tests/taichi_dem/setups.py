"""What the physics tests share: materials, scenes in one line, and a way to start one compiled
simulation again from another state (a Simulation costs seconds to compile, a restart none)."""

from contextlib import contextmanager

import numpy as np

import taichi_dem as dem

GLASS = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
GEL = dem.Material("gel", density=1050, youngs_modulus=2e4, poissons_ratio=0.49)
EPS = np.finfo(float).eps


def rigid(name="rigid", poissons_ratio=0.3):
    """A wall so stiff that its share of the contact's compliance is lost in rounding."""
    return dem.Material(name, 1000, 1e30, poissons_ratio)


def law(restitution=1.0, friction=None, damping=1.0, pairs=None):
    """Hertz, with Mindlin friction where a coefficient is given."""
    tangential = None if friction is None else dem.Mindlin(friction, damping)
    return dem.Law(dem.Hertz(restitution), tangential, pairs=pairs or {})


def scene(position, radius, material=GLASS, velocity=0.0, omega=0.0, **rest):
    """A scene of spheres, weightless unless ``gravity`` says otherwise."""
    position = np.asarray(position, dtype=float)
    shape = position.shape
    spheres = dem.Spheres(
        position,
        np.broadcast_to(radius, shape[:1]),
        material,
        np.broadcast_to(velocity, shape),
        np.broadcast_to(omega, shape),
    )
    rest.setdefault("gravity", (0, 0, 0))
    return dem.Scene(spheres=spheres, **rest)


def restart(sim, position=None, velocity=0.0, omega=0.0, dt=None):
    """Put ``sim`` back to time zero in another state (that of the scene unless given), with no
    memory of contacts; ``dt`` changes its step."""
    engine, control = sim._engine, sim._engine.control
    position = sim.scene.spheres.position if position is None else position
    if dt is not None:
        sim.dt = engine.time_step = float(dt)
        control.time_step[None] = sim.dt
    arrays = [np.array(np.broadcast_to(v, position.shape)) for v in (position, velocity, omega)]
    engine.particles.write(*arrays)
    materials = sim.scene.materials
    engine.boundaries.fill({material: index for index, material in enumerate(materials)})
    if engine.exchange is not None:
        engine.exchange.forget()
    sim.steps = control.step[None] = 0
    control.flags.fill(0)
    engine.skin._built_at = 0
    engine.rebuild(remember=False)
    engine._solve_on_host()
    engine.drivers.evaluate(0.0)
    engine.drivers.note_pushes()
    engine.lost = 0.0
    sim._memo.clear()
    sim._first_energy = 0.0
    sim._first_energy = sim.energy()["balance_error"]
    return sim


@contextmanager
def skin_held_at(sim, width):
    """Within it, the contact list of ``sim`` always reaches ``width`` (m) beyond touching."""
    engine, skin = sim._engine, sim._engine.skin
    kept = dict(vars(skin))
    skin.width = skin._least = skin._most = width
    engine.grid.cell_size[None] = engine._set_skin()
    yield
    vars(skin).update(kept)
    engine.grid.cell_size[None] = engine._set_skin()


def watch(sim, steps, every, look):
    """Run ``steps`` and return an array of what ``look(sim)`` gives at the start and after each
    ``every``-th step."""
    seen = [look(sim)]
    for _ in range(steps // every):
        sim.run(steps=every)
        seen.append(look(sim))
    return np.array(seen)


def state(sim):
    """Positions, velocities and angular velocities, one row per sphere."""
    now = sim.particles
    return np.hstack([now.position, now.velocity, now.omega])


def order_of(errors, factor=2.0):
    """The orders of convergence between successive ``errors`` at steps divided by ``factor``."""
    errors = np.asarray(errors)
    return np.log(errors[:-1] / errors[1:]) / np.log(factor)


def random_rotation(rng):
    """A proper rotation matrix, uniformly distributed."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))
