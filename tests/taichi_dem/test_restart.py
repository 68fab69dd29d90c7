"""A simulation that starts again does, bit by bit, what a new one does."""

import gc
import warnings
import weakref

import numpy as np
import pytest
from setups import law, scene, state

import taichi_dem as dem

STONE = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e6, poissons_ratio=0.45)
R, STEPS = 5e-3, 400


def bed(**rest):
    """Spheres thrown into a box on soft ground under a piston."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(*3 * [np.arange(3.0)], indexing="ij"), axis=-1).reshape(-1, 3)
    place = (2.2 * grid + rng.uniform(1.1, 1.2, grid.shape)) * R
    side = 7 * R
    return scene(
        place,
        R * rng.uniform(0.8, 1, len(place)),
        STONE,
        velocity=0.3 * rng.normal(size=place.shape),
        gravity=(0, 0, -9.81),
        law=law(0.6, 0.4),
        substrate=dem.Substrate(SOIL),
        boundaries=[
            dem.Box((0, 0, -np.inf), (side, side, np.inf), STONE),
            dem.Piston((0, 0, side), (0, 0, -1), STONE, velocity=0.2),
        ],
        **rest,
    )


def outcome(sim):
    """All that a run can show, as bytes."""
    sim.run(steps=STEPS)
    parts = np.array(list(sim.energy().values()))
    return [a.tobytes() for a in (state(sim), sim.contacts(), sim.substrate.expansion, parts)]


@pytest.fixture(scope="module")
def used():
    """A simulation that has run, and what it showed."""
    sim = dem.Simulation(bed())
    return sim, outcome(sim)


def test_the_same_state_gives_the_same_bits(used):
    sim, first = used
    rebuilds = sim.summary()["rebuilds"]
    sim.restart()
    assert (sim.time, sim.steps, sim.energy()["balance_error"]) == (0.0, 0, 0.0)
    assert sim.summary()["outcome"] == "not run yet"
    assert outcome(sim) == first
    assert sim.summary()["rebuilds"] == rebuilds


def test_another_state_and_step_give_the_bits_of_a_new_simulation(used):
    sim, _ = used
    still, spin = np.zeros_like(sim.scene.spheres.velocity), sim.scene.spheres.omega + 20.0
    dt = 0.7 * sim.stable.value
    sim.restart(velocity=still, omega=spin, dt=dt)
    again = outcome(sim)
    spheres = dem.Spheres(sim.scene.spheres.position, sim.scene.spheres.radius, STONE, still, spin)
    setup = bed()
    new = dem.Simulation(
        dem.Scene(
            spheres=spheres,
            boundaries=setup.boundaries,
            substrate=setup.substrate,
            law=setup.law,
            gravity=setup.gravity,
        ),
        dt,
    )
    assert outcome(new) == again
    assert (sim.scene.spheres.omega == spin).all()


def test_warnings_and_counters_start_again(used):
    sim, _ = used
    fast = np.zeros_like(sim.scene.spheres.velocity)
    fast[:, 2] = -3.5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sim.restart(velocity=fast)
        sim.run(steps=20)
        assert sim.warnings["fast_impacts"] > 0
        sim.restart(dt=1.5 * sim.stable.value)
        assert set(sim.warnings) == {"time_step"}
        sim.restart()
    assert not sim.warnings and not any(sim._engine.exchange.doubts.counts().values())


def test_what_a_scene_refuses_leaves_the_simulation_as_it_was(used):
    sim, first = used
    sim.restart()
    below = sim.scene.spheres.position - [0, 0, 1]
    with pytest.raises(dem.InputError, match="substrate"):
        sim.restart(position=below)
    with pytest.raises(dem.InputError, match="dt"):
        sim.restart(dt=-1.0)
    assert outcome(sim) == first


def test_a_stopped_run_starts_again(used):
    sim, first = used
    thrown = np.zeros_like(sim.scene.spheres.velocity)
    thrown[0, 2] = -0.2 * R / 1e-5  # deep into what is below before its force can turn it
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(dem.SimulationStopped):
            sim.restart(velocity=thrown, dt=1e-5)
            sim.run(steps=STEPS)
    sim.restart()
    assert outcome(sim) == first


def test_no_result_depends_on_the_skin(used):
    _, first = used
    wide = dem.Simulation(bed(), skin=0.3 * R)
    assert outcome(wide)[0] == first[0]
    with pytest.raises(dem.InputError, match="skin"):
        dem.Simulation(bed(), skin=0.0)


def test_a_simulation_gives_its_fields_back_with_its_last_name():
    """Nothing that it owns holds on to it, so that series need not wait for the collector."""
    gc.disable()
    try:
        sim = dem.Simulation(scene([[0, 0, 1]], R, law=law(), gravity=(0, 0, -9.81)))
        sim.run(steps=3)
        left = weakref.ref(sim), weakref.ref(sim._engine)
        del sim
        assert [name() for name in left] == [None, None]
    finally:
        gc.enable()
