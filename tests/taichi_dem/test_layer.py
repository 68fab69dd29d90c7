"""Spheres on a layer of finite thickness: forces, energy, and the half-space as its limit."""

import dataclasses
import warnings

import numpy as np
import pytest
from setups import law, order_of, restart, rigid, scene, state, watch
from test_determinism import everything

import halfspace
import taichi_dem as dem
from halfspace import reference
from taichi_dem.coefficients import Coefficients
from taichi_dem.time_step import stable_time_step

R, N = 5e-3, 16
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e5, poissons_ratio=0.49)
RIGID = rigid()
MODULUS = SOIL.youngs_modulus / (1 - SOIL.poissons_ratio**2)
LAYER = dem.Layer(1.2 * R)
HALF_SPACE = halfspace.HalfSpace(SOIL.youngs_modulus, SOIL.poissons_ratio)


def places(rng):
    """A square array, nearly, all but touching."""
    side = 2.4 * R * (np.arange(4) - 1.5)
    grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid + rng.uniform(-0.05, 0.05, grid.shape) * R


def bed(rng, **rest):
    position = np.column_stack([places(rng), R * (1 - rng.uniform(0.02, 0.03, N))])
    rest.setdefault("law", law())
    ground = dem.Substrate(SOIL, residual=1e-11, layer=LAYER)
    return scene(position, R, RIGID, substrate=ground, **rest)


@pytest.fixture(scope="module")
def sim():
    return dem.Simulation(bed(np.random.default_rng(3)), max_overlap=1)


def on(sim, layer):
    """``sim`` from the start, on ground with another layer or none."""
    exchange = sim._engine.exchange
    exchange.halfspace = dataclasses.replace(HALF_SPACE, layer=layer)
    return restart(sim)


@pytest.fixture
def fresh(sim):
    return on(sim, halfspace.Layer(LAYER.thickness, LAYER.base))


def solved(sim, ground):
    position = sim.scene.spheres.position
    hertz = reference.hertz_law(R, MODULUS)
    return halfspace.solve(ground, position[:, :2], R - position[:, 2], hertz, residual=1e-12)


def test_forces_are_those_of_the_solve_on_a_layer(fresh):
    ground = dataclasses.replace(HALF_SPACE, layer=halfspace.Layer(LAYER.thickness))
    exact, found = solved(fresh, ground), fresh.substrate
    assert len(found.force) == N
    assert np.allclose(found.force, exact.force, rtol=1e-9)
    assert np.allclose(found.slope, exact.slope, rtol=1e-8, atol=1e-10)
    alone = solved(fresh, HALF_SPACE)
    assert found.force.sum() > 1.5 * alone.force.sum()
    points = np.array([[0.0, 0.0], [20 * R, 0.0]])
    held = ground.field(found.position, found.force, points, radius=found.contact_radius)
    assert np.array_equal(found.field(points), held)


def test_a_thick_layer_is_the_half_space_by_the_inverse_of_its_thickness(sim):
    exact, errors = solved(sim, HALF_SPACE).force, []
    for thickness in np.array([200, 400, 800]) * R:
        force = on(sim, halfspace.Layer(thickness)).substrate.force
        errors.append(np.abs(force / exact - 1).max())
    assert np.allclose(order_of(errors), 1, atol=0.05)
    assert errors[-1] < 0.02


def test_energy_error_falls_by_four_per_halved_step(fresh):
    """Spheres that bob on the layer while they are drawn together."""
    period = 2 * np.pi * np.sqrt(RIGID.density * 4 / 3 * np.pi * R**3 / (4 * MODULUS * 0.15 * R))
    velocity = np.zeros((N, 3))
    velocity[:, :2] = -0.02 * 2 * np.pi / period * fresh.scene.spheres.position[:, :2]
    errors = []
    for steps in (50, 100, 200):
        restart(fresh, velocity=velocity, dt=period / steps)
        stored = fresh.energy()["normal"]
        seen = watch(fresh, steps // 2, steps // 50, lambda sim: sim.energy()["balance_error"])
        errors.append(np.abs(seen).max())
    assert np.allclose(order_of(errors), 2, atol=0.03)
    assert errors[-1] < 1e-3 * stored


def test_contacts_too_wide_for_the_layer_are_warned_of(fresh):
    """Once, and counted; the library does not say it again.  Much wider ones stop the run."""
    position = fresh.scene.spheres.position.copy()
    position[:3, 2] = 0.7 * R
    restart(fresh, position, dt=1e-7)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        fresh.run(steps=2)
        fresh.run(steps=2)
    assert len([w for w in seen if "layer" in str(w.message)]) == 1
    assert fresh.warnings["wide_for_layer"] == 3
    position[:3, 2] = 0.55 * R
    with pytest.raises(dem.SimulationStopped, match=r"a contact is wider than 0\.6 .*thicker"):
        restart(fresh, position, dt=1e-7)


def test_drivers_and_runs_give_the_same_bits(fresh, monkeypatch):
    found = []
    for driver in ("serial", "serial", "parallel", "team"):
        monkeypatch.setattr(fresh._engine.pace, "driver", driver)
        restart(fresh, velocity=(0.02, 0, -0.02), dt=2e-5).run(steps=30)
        found.append([*everything(fresh), state(fresh), fresh.substrate.expansion])
    for other in found[1:]:
        assert all(map(np.array_equal, found[0], other))


def test_the_stable_step_knows_that_a_layer_is_stiffer():
    """By the stiffness of a contact that the base holds."""
    layer = dataclasses.replace(HALF_SPACE, layer=halfspace.Layer(LAYER.thickness))
    stone = dem.Material("stone", 2500, 1e5, 0.3)  # softer: it is the ground that sets the step
    ground = dem.Substrate(SOIL, layer=LAYER)
    setup = scene([[0, 0, 1.1 * R]], R, stone, substrate=ground, law=law())
    table = {"normal": Coefficients(setup.law, "normal", setup.materials)}
    alone = stable_time_step(setup, table).value
    composite = 1 / (1 / MODULUS + (1 - stone.poissons_ratio**2) / stone.youngs_modulus)
    expected = np.sqrt(1 + layer.matrix([[0.0, 0.0]])[0, 0] * 2 * composite * np.sqrt(0.02) * R)
    assert dem.Simulation(setup).stable.value / alone == pytest.approx(expected, rel=1e-6)
    assert expected < 0.99
