"""Spheres on ground that creeps: its limits, its energy, and whose memory is whose."""

import os
import subprocess
import sys

import numpy as np
import pytest
from setups import law, order_of, restart, scene, skin_held_at
from test_determinism import everything

import halfspace
import taichi_dem as dem
from halfspace import reference
from taichi_dem import engine as engine_module
from taichi_dem.creep import Creep
from taichi_dem.ground_view import pressed

R, N = 5e-3, 9
NU, E0, E1, TAU = 0.45, 2e5, 5e4, 4e-3
CREEP = E0 / E1 - 1
SOIL = dem.Material("soil", density=1000, youngs_modulus=E0, poissons_ratio=NU)
STONE = dem.Material("stone", density=2500, youngs_modulus=4e5, poissons_ratio=0.2)
GROUND, RELAXED = (halfspace.HalfSpace(modulus, NU, coupling="point") for modulus in (E0, E1))
OTHER = STONE.youngs_modulus / (1 - STONE.poissons_ratio**2)
COMPOSITE = 1 / (1 / GROUND.modulus + 1 / OTHER)
SHARE = COMPOSITE / GROUND.modulus
FALL = (0.0, 0.0, -0.1)


def bed(**rest):
    side = 2.5 * R * (np.arange(3) - 1)
    grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(5)
    grid += rng.uniform(-0.05, 0.05, grid.shape) * R
    ground = dem.Substrate(
        SOIL,
        coupling="point",
        residual=1e-12,
        relaxation=dem.Relaxation(relaxed_modulus=E1, retardation_time=TAU),
        **rest,
    )
    position = np.column_stack([grid, R * (1 + rng.uniform(0, 0.01, N))])
    return scene(position, R, STONE, FALL, substrate=ground, law=law(), gravity=(0, 0, -9.81))


@pytest.fixture(scope="module")
def sim():
    return dem.Simulation(bed())


def creeping(sim, tau=TAU):
    """``sim`` from the start, falling, on ground with another time of retardation."""
    relaxation = dem.Relaxation(relaxed_modulus=E1, retardation_time=tau)
    sim._engine.ground.hosted.creep = Creep(GROUND, relaxation, residual=1e-12)
    return restart(sim, velocity=FALL, dt=5e-5)


@pytest.mark.parametrize(("tau", "ground"), [(1e9, GROUND), (1e-9, RELAXED)])
def test_very_slow_and_very_fast_creep_are_elastic(sim, tau, ground):
    """At once the instantaneous modulus, after long the relaxed one, in a step of any length."""
    creeping(sim, tau).run(steps=40)
    position = sim.particles.position
    hertz = reference.hertz_law(R, 1 / (1 / ground.modulus + 1 / OTHER))
    exact = halfspace.solve(ground, position[:, :2], R - position[:, 2], hertz, residual=1e-12)
    found = sim.substrate
    assert len(found.force) == N
    assert np.allclose(found.force, exact.force, rtol=1e-7)
    assert np.allclose(found.slope, exact.slope, rtol=1e-7, atol=1e-12)
    points = np.array([[0.0, 0.0], [3 * R, R]])
    radius = np.sqrt(R * exact.overlap)
    expected = ground.field(position[:, :2], exact.force, points, radius=radius)
    assert np.allclose(found.field(points), expected, rtol=1e-6)


def test_a_contact_held_still_relaxes(sim):
    """f = H/(1 + k) [1 + k exp(-(1 + k) t/tau)], k = sigma c; by the first order of the step."""
    overlap, tau, k = 0.03 * R, 1e-7, SHARE * CREEP
    position = sim.scene.spheres.position + [0, 0, 10 * R]
    position[0, 2] = R - overlap
    errors = []
    for steps in (50, 100, 200):
        creeping(sim, tau)
        restart(sim, position, dt=tau / steps)  # too short a time to move in
        sim.run(steps=steps)
        elastic = reference.hertz_law(R, COMPOSITE)(np.array([overlap]))[0][0]
        exact = elastic / (1 + k) * (1 + k * np.exp(-(1 + k)))
        [force] = sim.substrate.force
        errors.append(abs(force / exact - 1))
    assert np.allclose(order_of(errors), 1, atol=0.05)
    assert errors[-1] < 0.02
    sphere = pressed(sim.scene, sim.particles, np.array([0]))
    deep = sim._engine.ground.creep.depth(sphere, sim.substrate.force)
    assert deep == pytest.approx(overlap, rel=1e-5)


def loss_rate(sim):
    """W, by the dashpot of the solid: from forces, memory and places alone."""
    rows, force = sim.substrate.particle, sim.substrate.force
    saved = sim._engine.ground.hosted.creep.save()
    s, f = np.zeros(N), np.zeros(N)
    s[saved["ids"]], f[rows] = saved["memory"], force
    strength, own = 4 / 3 * COMPOSITE * np.sqrt(R), SHARE * CREEP
    rate = (f - s) / TAU
    depth = ((f + own * s) / strength) ** (2 / 3)
    local = own * (depth - ((1 + own) * s / strength) ** (2 / 3)) @ rate
    return CREEP * TAU * rate @ GROUND.matrix(sim.particles.position[:, :2]) @ rate + local


def test_what_creep_takes_is_lost_in_the_dashpot(sim):
    """All is accounted for, by the second order of the step; and what is booked as lost is the loss
    of the dashpot, by the first, as forces are held over a step."""
    errors, balance = [], []
    for steps in (40, 80, 160):
        creeping(sim)
        restart(sim, velocity=FALL, dt=4e-3 / steps)
        rates = []
        for _ in range(steps):
            sim.run(steps=1)
            rates.append(loss_rate(sim))
        energy = sim.energy()
        scale = energy["kinetic"] + energy["dissipated"]
        balance.append(abs(energy["balance_error"]) / scale)
        assert min(rates) >= -1e-12 * scale / TAU
        errors.append(abs(np.sum(rates) * 4e-3 / steps / energy["dissipated"] - 1))
    assert energy["dissipated"] > 0.1 * scale
    assert np.allclose(order_of(balance), 2, atol=0.05)
    assert np.allclose(order_of(errors), 1, atol=0.15)
    assert errors[-1] < 0.05


def test_memory_follows_the_spheres_wherever_they_stand(sim, monkeypatch):
    """Drivers, reordering in memory and a start anew change no bit; lists that reach farther, none
    but of rounding."""
    creeping(sim).run(steps=80)
    expected = [*everything(sim), *remembered(sim)]
    assert len(expected[-1]) == N

    def same():
        creeping(sim).run(steps=80)
        found = [*everything(sim), *remembered(sim)]
        return all(map(np.array_equal, found, expected))

    for driver in ("serial", "parallel", "team"):
        monkeypatch.setattr(sim._engine.pace, "driver", driver)
        assert same()
    with skin_held_at(sim, 1e-9):
        creeping(sim).run(steps=80)
        near = everything(sim)
        assert all(map(close, near, expected))
        monkeypatch.setattr(engine_module, "REORDER_ABOVE", 0)
        monkeypatch.setattr(engine_module, "REORDER_EVERY", 1)
        creeping(sim).run(steps=80)
        assert all(map(np.array_equal, near, everything(sim)))


def remembered(sim):
    saved = sim._engine.ground.hosted.creep.save()
    return saved["ids"], saved["memory"]


def close(one, other):
    return np.allclose(one, other, rtol=1e-9, atol=1e-15)


def test_a_guard_s_stop_brings_back_the_memory(sim):
    creeping(sim).run(steps=60)
    creep, deepest = sim._engine.ground.hosted.creep, sim._engine.control.deepest
    before, force, limit = creep.save(), sim.substrate.force, deepest[None]
    lost = sim.energy()["dissipated"]
    deepest[None] = 1e-4
    with pytest.raises(dem.SimulationStopped, match="overlaps the substrate"):
        sim.run(steps=10)
    deepest[None] = limit
    sim._memo.clear()
    assert sim.steps == 60 and len(before["ids"]) == N
    assert np.allclose(creep.save()["memory"], before["memory"], rtol=1e-12)
    assert np.allclose(sim.substrate.force, force, rtol=1e-2)  # of the moment, not of a step
    assert sim.energy()["dissipated"] == pytest.approx(lost, rel=1e-2)


def test_points_too_close_for_that_are_warned_of(sim):
    position = sim.scene.spheres.position.copy()
    position[:, 2] = 0.7 * R
    with pytest.warns(RuntimeWarning, match="closer than 6 of their radii"):
        restart(creeping(sim), position, dt=1e-7).run(steps=1)
    assert sim.warnings["close_points"] == N


def put(sim, position, velocity):
    sim._engine.particles.write(position, velocity, np.zeros((N, 3)))


def test_a_dent_stays_where_a_sphere_has_left_it(sim):
    """It recovers there, and acts on the others by the same equations as before, until the sphere
    is back in it."""
    creeping(sim).run(steps=60)
    creep, velocity = sim._engine.ground.hosted.creep, np.zeros((N, 3))
    velocity[4] = 4.0, 0.0, 10.0
    put(sim, sim.particles.position, velocity)
    while sim.particles.position[4, 2] < R:
        sim.run(steps=1)
    dent = sim.particles.position[4, :2]
    s0 = creep.save()["memory"][4]
    sim.run(steps=10)
    saved = creep.save()
    creep.forget()
    creep.restore(saved)
    sim.run(steps=10)
    position, ground = sim.particles.position, sim.substrate
    assert np.array_equal(ground.particle, np.delete(np.arange(N), 4))
    assert ground.dent_position == pytest.approx(dent[None])
    assert ground.dent_load == pytest.approx(CREEP * s0 * np.exp(-20 * sim.dt / TAU), rel=1e-12)
    place = np.append(ground.position, ground.dent_position, axis=0)
    sunk = GROUND.matrix(place) @ np.append(ground.load, ground.dent_load)
    depth = R - position[ground.particle, 2] - sunk[:-1]
    crept = SHARE * (ground.load - ground.force)
    force = 4 / 3 * COMPOSITE * np.sqrt(R) * depth**1.5 - crept
    assert np.allclose(ground.force, force, rtol=1e-8)
    points = np.array([dent, [0.7 * R, R]])
    radius = np.append(ground.contact_radius, ground.dent_radius)
    loads = np.append(ground.load, ground.dent_load)
    assert np.allclose(ground.field(points), GROUND.field(place, loads, points, radius))

    before, position = creep.save()["memory"].sum(), position.copy()
    position[4] = [*(dent + 0.2 * ground.dent_radius), R - 1e-3 * R]
    put(sim, position, np.zeros((N, 3)))
    sim.run(steps=1)
    assert not len(creep.save()["_dents"].ids) and len(creep.save()["ids"]) == N
    assert creep.save()["memory"].sum() == pytest.approx(before, rel=0.02)


@pytest.mark.filterwarnings("ignore:.*have come from nothing")  # the test has put it in
def test_dents_without_spheres_recover_and_are_forgotten(sim, monkeypatch):
    """What they hold falls by closed forms into heat, however many steps are made at once."""
    creeping(sim).run(steps=60)
    creep = sim._engine.ground.hosted.creep
    put(sim, sim.particles.position, np.tile([0, 0, 20.0], (N, 1)))
    sim.run(steps=4)
    assert not sim._engine.exchange.count and len(sim.substrate.dent_load) == N
    s, start, first = remembered(sim)[1][::-1], sim.steps, sim.energy()
    places, own = creep.save()["_dents"].place, SHARE * CREEP
    coupled = 0.5 * CREEP * s @ GROUND.matrix(places) @ s
    strength = 4 / 3 * COMPOSITE * np.sqrt(R)
    local = np.sum(0.6 * (own * s) ** (5 / 3)) / strength ** (2 / 3)
    local *= ((1 + own) / own) ** (2 / 3) - 1
    for driver, steps in (("serial", 100), ("serial", 7), ("parallel", 50)):
        monkeypatch.setattr(sim._engine.pace, "driver", driver)
        sim.run(steps=steps)
        left, now = np.exp(-(sim.steps - start) * sim.dt / TAU), sim.energy()
        assert now["substrate"] == pytest.approx(coupled * left**2 + local * left ** (5 / 3))
        heat = now["dissipated"] - first["dissipated"]
        assert heat == pytest.approx(first["substrate"] - now["substrate"], rel=1e-9)
    sim.run(steps=int(30 * TAU / sim.dt))
    assert not len(remembered(sim)[0]) and not len(sim.substrate.dent_load)


SCRIPT = """
import test_relaxation as test
from taichi_dem import Layer, Simulation
sim = Simulation(test.bed(layer=Layer(2 * test.R)))
for driver in ("serial", "parallel", "team"):
    sim._engine.pace.driver = driver
    sim.restart()
    sim.run(steps=150)
    assert len(sim.substrate.force)
    print(test.everything(sim)[0].tobytes().hex())
"""


@pytest.mark.slow
def test_threads_give_the_same_bits_on_a_layer_that_creeps():
    tests, package = os.path.dirname(__file__), os.path.dirname(os.path.dirname(dem.__file__))
    lines = []
    for threads in (1, 2):
        path = os.pathsep.join([package, tests])
        environment = {**os.environ, "HALFSPACE_THREADS": str(threads), "PYTHONPATH": path}
        run = [sys.executable, "-W", "ignore", "-c", SCRIPT]
        done = subprocess.run(run, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        lines += done.stdout.splitlines()
    assert len(lines) == 6 and len(set(lines)) == 1
