"""The hydrogel piston on the measured packing: forces, balances, and the input for LIGGGHTS."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import taichi_dem as dem
from benchmarks import hydrogel, liggghts, run
from examples import hydrogel_piston as example

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "reference" / "hydrogel"
PACKING, REFERENCE = DATA / "particles.data", DATA / "piston_force_liggghts.csv"
STEPS = 6000  # of 30000 down

needs_data = pytest.mark.skipif(
    not (PACKING.exists() and REFERENCE.exists()), reason=f"the measured packing is not in {DATA}"
)


@pytest.fixture(scope="module")
def scene():
    return example.scene(example.packing(PACKING))


@pytest.fixture(scope="module")
def pressed(scene):
    """The simulation after the first fifth of the way down, and the piston's forces till then."""
    simulation, force = dem.Simulation(scene, dt=example.TIME_STEP), example.PistonForce()
    simulation.run(steps=STEPS, outputs=[force])
    return simulation, force.curve()


def small_scene():
    """Two materials, a slow wall and a piston that waits before it turns."""
    gel, wall = example.GEL, example.WALL
    return dem.Scene(
        spheres=dem.Spheres(
            [[0.02, 0.02, 0.01], [0.05, 0.02, 0.012]],
            [0.01, 0.012],
            [gel, wall],
            velocity=[[0.1, 0.0, 0.0], [-0.1, 0.0, 1 / 3]],
            omega=[[0.0, 2.0, 0.0], [0.0, 0.0, -1.0]],
        ),
        boundaries=(
            dem.Box((0.0, 0.0, 0.0), (0.07, 0.04, np.inf), gel),
            dem.Piston(
                (0.0, 0.0, 0.03),
                (0.0, 0.0, -1.0),
                wall,
                program=((0.01, 1e-3), (0.03, 1e-3), (0.04, 0)),
            ),
            dem.Plane((0.0, 0.0, 0.05), (0.0, 0.0, -1.0), wall, velocity=(0.0, 0.0, 0.5)),
        ),
        law=dem.Law(
            normal=dem.Hertz(0.9),
            tangential=dem.Mindlin(0.3),
            pairs={(wall.name, gel.name): {"tangential": dem.Mindlin(0.2)}},
        ),
        gravity=(0.0, 3.0, -4.0),
    )


@needs_data
def test_packing_is_the_measured_one(scene):
    beads = scene.spheres
    assert beads.count == 514
    inside = (beads.position > 0) & (beads.position < (*example.BOX, example.HIGHEST))
    assert inside.all()
    box = np.prod(example.BOX) * example.HIGHEST
    fraction = (4 / 3 * np.pi * beads.radius**3).sum() / box
    assert 0.55 < fraction < 0.64  # a random packing, before it is pressed


@needs_data
def test_first_forces_are_those_of_liggghts(pressed):
    """Before chaos parts the two codes."""
    _, curve = pressed
    reference = example.read_reference(REFERENCE)[: len(curve)]
    assert np.array_equal(curve[:, 0], reference[:, 0])
    full_scale = 6.754  # N
    assert np.abs(curve[:, 3] - reference[:, 1]).max() < 5e-5 * full_scale
    assert curve[-1, 3] > 0.03 * full_scale


@needs_data
def test_forces_balance(pressed):
    """Newton's third law: what the walls do not carry accelerates the beads."""
    simulation, _ = pressed
    state = simulation.particles
    walls = np.sum([boundary.force for boundary in simulation.boundaries], axis=0)
    weight = state.mass.sum() * np.array(simulation.scene.gravity)
    scale = np.abs(simulation.contacts()["force"]).sum()
    np.testing.assert_allclose(state.force.sum(axis=0), weight - walls, atol=1e-13 * scale)


@needs_data
def test_work_of_the_piston_is_accounted_for(pressed):
    energy = pressed[0].energy()
    assert energy["external_work"] > 0
    assert abs(energy["balance_error"]) < 1e-6 * energy["external_work"]


@needs_data
def test_floor_carries_beads_and_piston(pressed):
    """On the mean of many moments, but for the little that the smooth side walls take."""
    simulation, _ = pressed
    loads = []
    for _ in range(20):
        simulation.run(steps=50)
        box, piston = (boundary.force[2] for boundary in simulation.boundaries)
        loads.append((-box, piston))
    floor, piston = np.mean(loads, axis=0)
    weight = simulation.particles.mass.sum() * 9.81
    assert floor == pytest.approx(weight + piston, rel=0.01)


def test_liggghts_data_read_back_the_same(tmp_path):
    scene = small_scene()
    liggghts.write_data(tmp_path / "beads.data", scene)
    kinds = [scene.materials.index(material) + 1 for material in scene.spheres.materials]
    materials = dict(zip(kinds, scene.spheres.materials, strict=True))
    assert dem.Spheres.from_lammps_data(tmp_path / "beads.data", materials) == scene.spheres


def test_liggghts_script_follows_the_program(tmp_path):
    script = liggghts.write(tmp_path, small_scene(), dt=1e-4, steps=500, skin=1e-3)
    lines = script.read_text().splitlines()
    moves = [line for line in lines if "move/mesh" in line or line.startswith("run")]
    speeds = [(line.split()[1], float(line.split()[-1])) for line in moves]
    expected = [
        *[("boundary1_motion", -0.1), ("boundary2_motion", 0.5), ("100", 100)],
        *[("boundary2_motion", 0.5), ("200", 200)],
        *[("boundary1_motion", 0.1), ("boundary2_motion", 0.5), ("100", 100)],
        *[("boundary2_motion", 0.5), ("100", 100)],
    ]
    for found, wanted in zip(speeds, expected, strict=True):
        assert found[0] == wanted[0]
        assert found[1] == pytest.approx(wanted[1])
    friction = next(line for line in lines if "coefficientFriction" in line)
    assert friction.endswith("peratomtypepair 2 0.3 0.2 0.2 0.3")
    assert sum("primitive" in line for line in lines) == 5


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"law": dem.Law(normal=dem.Hooke(1e3, 0.5))}, "Hertz"),
        ({"boundaries": (dem.Plane((0, 0, 0), (0, 1, 1), example.WALL),)}, "axis"),
        (
            {"boundaries": (dem.Plane((0, 0, 0), (0, 0, 1), example.WALL, velocity=(1, 1, 0)),)},
            "conveyor",
        ),
        (
            {"boundaries": (dem.Piston((0, 0, 1), (0, 0, -1), example.WALL, load=1, mass=1),)},
            "load",
        ),
    ],
    ids=["Hooke", "slanted", "conveyor", "load"],
)
def test_liggghts_refuses_what_it_would_do_otherwise(change, what, tmp_path):
    scene = dataclasses.replace(small_scene(), **change)
    with pytest.raises(ValueError, match=what):
        liggghts.write(tmp_path, scene, dt=1e-4, steps=10)


@pytest.mark.peers
@needs_data
def test_liggghts_gives_its_reference(scene, tmp_path):
    """The written input is the one behind the reference curve."""
    if not liggghts.available():
        pytest.skip(f"{liggghts.BINARY} is not installed")
    sampling = liggghts.Sampling(every=500, count=100)
    script = liggghts.write(tmp_path, scene, dt=example.TIME_STEP, steps=STEPS, sampling=sampling)
    liggghts.run(script)
    force = liggghts.forces(tmp_path, example.PISTON)
    reference = example.read_reference(REFERENCE)[: len(force)]
    assert np.array_equal(force[:, 0], reference[:, 0])
    np.testing.assert_allclose(force[:, 3], reference[:, 1], rtol=1e-3)


@pytest.mark.peers
@needs_data
def test_benchmark_finds_the_same_forces(tmp_path):
    if not liggghts.available():
        pytest.skip(f"{liggghts.BINARY} is not installed")
    short = ["--packings", "2", "--steps", "2000"]
    run.main(["hydrogel", str(PACKING), "--reference", str(REFERENCE), *short, "-o", str(tmp_path)])
    figures = json.loads((tmp_path / "hydrogel.json").read_text())["figures"]
    value = {figure["what"]: figure["value"] for figure in figures}
    for code in hydrogel.OURS, hydrogel.OWN_STEP:
        assert value[f"{code} and liggghts, curves"] < 1  # % of the 0.03 N reached
    curves = np.loadtxt(tmp_path / "hydrogel.csv", delimiter=",", skiprows=1)
    assert curves.shape == (4, 4)


def test_packings_are_displaced_by_the_same_length_each_in_its_own_way():
    beads = example.random_packing(50)
    first, second = (hydrogel.displaced(beads, seed).position - beads.position for seed in (0, 1))
    for way in (first, second):
        np.testing.assert_allclose(np.linalg.norm(way, axis=1), hydrogel.DISPLACEMENT, rtol=1e-9)
    assert np.abs(first - second).max() > hydrogel.DISPLACEMENT
    assert hydrogel.displaced(beads, 1) == hydrogel.displaced(beads, 1)
