"""The same bits, whatever does not belong to the problem: threads, driver, cuts, lists, order."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
from setups import law, restart, scene, skin_held_at

import taichi_dem as dem
from taichi_dem import contact_list
from taichi_dem import engine as engine_module

STONE = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
R, STEPS = 5e-3, 1200


def pouring(substrate=False, counts=(4, 4, 4)):
    """Spheres that fall in a box while a piston moves in, rubbing and spinning."""
    rng = np.random.default_rng(11)
    grid = np.stack(np.meshgrid(*[range(n) for n in counts], indexing="ij"), axis=-1).reshape(-1, 3)
    place = (grid + [0.6, 0.6, 0.5]) * 2.05 * R + rng.uniform(-0.02, 0.02, grid.shape) * R
    x, y = counts[0] * 2.05 * R + 0.3 * R, counts[1] * 2.05 * R + 0.3 * R
    floor = -np.inf if substrate else 0.0
    return scene(
        place,
        R * rng.uniform(0.7, 1, len(place)),
        STONE,
        velocity=0.3 * rng.normal(size=place.shape),
        omega=50 * rng.normal(size=place.shape),
        gravity=(0, 0, -9.81),
        law=law(0.6, 0.4),
        boundaries=[
            dem.Box((-np.inf, 0, floor), (x, y, np.inf), STONE),
            dem.Piston((0, 0, 0), (1, 0, 0), STONE, velocity=0.1),
        ],
        substrate=dem.Substrate(dem.Material("soil", 1000, 1e6, 0.45)) if substrate else None,
    )


def everything(sim):
    """All that a run leaves: the state, and what the contacts hold and remember."""
    now, records = sim.particles, sim.contacts()
    arrays = [now.position, now.velocity, now.omega, now.force, now.torque]
    arrays += [records[name] for name in records.dtype.names]
    return arrays + [sim.boundaries[b].force for b in range(len(sim.boundaries))]


def assert_same_bits(found, expected):
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other)


def digest(sim):
    """A fingerprint of :func:`everything`."""
    whole = hashlib.sha256()
    for array in everything(sim):
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()


# -- one process: cuts, lists, drivers -------------------------------------------------------------


@pytest.fixture(scope="module")
def sim():
    return dem.Simulation(pouring())


def begin(sim):
    spheres = sim.scene.spheres
    return restart(sim, velocity=spheres.velocity, omega=spheres.omega)


@pytest.fixture(scope="module")
def expected(sim):
    """After a run in one piece."""
    begin(sim).run(steps=STEPS)
    touching = sim.contacts()
    assert len(touching) > 60
    assert np.median(np.linalg.norm(touching["tangential_force"], axis=1)) > 0
    return everything(sim)


def test_run_to_run(sim, expected):
    begin(sim).run(steps=STEPS)
    assert_same_bits(everything(sim), expected)


@pytest.mark.parametrize("pieces", [[1] * STEPS, [7, 1, 92, 300, 800]], ids=["ones", "uneven"])
def test_cut_in_pieces_or_in_one(sim, expected, pieces):
    begin(sim)
    for steps in pieces:
        sim.run(steps=steps)
    assert_same_bits(everything(sim), expected)


@pytest.mark.parametrize("width", [1e-9, 0.05, 0.3])
def test_the_skin_changes_no_bit(sim, expected, width):
    """Lists that last for one step, for a few, and for many: nothing that contacts remember is
    lost, and sums do not depend on the list."""
    with skin_held_at(sim, width * 2 * R):
        rebuilds = begin(sim)._engine.rebuilds
        sim.run(steps=STEPS)
    rebuilds = sim._engine.rebuilds - rebuilds
    assert rebuilds >= STEPS - 1 if width < 1e-6 else rebuilds < STEPS / 4
    assert_same_bits(everything(sim), expected)


def test_reordering_in_memory_changes_no_bit(sim, expected, monkeypatch):
    """With particles moved in memory at every rebuild, results come back in the order given, each
    contact with its own history."""
    monkeypatch.setattr(engine_module, "REORDER_ABOVE", 0)
    monkeypatch.setattr(engine_module, "REORDER_EVERY", 1)
    begin(sim).run(steps=STEPS)
    moved = sim._engine.particles.spin.id.to_numpy()
    assert not np.array_equal(moved, np.arange(len(moved)))
    assert_same_bits(everything(sim), expected)
    radius = sim._engine.particles.body.radius.to_numpy()
    assert np.array_equal(sim.particles.radius[moved], radius)
    monkeypatch.undo()
    begin(sim).run(steps=STEPS)  # from an order that is not the user's
    assert_same_bits(everything(sim), expected)


@pytest.mark.parametrize("driver", ["parallel", "team"])
def test_all_drivers_give_the_same_bits(sim, expected, monkeypatch, driver):
    monkeypatch.setattr(sim._engine.pace, "driver", driver)
    begin(sim).run(steps=STEPS)
    assert_same_bits(everything(sim), expected)


def test_a_team_that_moves_particles_early_gives_the_same_bits(expected, monkeypatch):
    """As it does in beds that outgrow the caches: before all contacts are known, but its own."""
    monkeypatch.setattr(contact_list, "CACHED", 0)
    monkeypatch.setattr(engine_module, "REORDER_ABOVE", 0)
    early = dem.Simulation(pouring(), driver="team")
    early.run(steps=STEPS)
    contacts, n = early._engine.contacts, len(early.particles.radius)
    start = contacts.start.to_numpy()
    earliest, latest = contacts.earliest.to_numpy(), contacts.latest.to_numpy()
    middle = start[n // 2]  # of a team of two
    alone = np.where(np.arange(n) < n // 2, latest < middle, earliest >= middle)
    assert 0.2 * n < alone.sum() < n
    assert_same_bits(everything(early), expected)


# -- the order of the spheres ----------------------------------------------------------------------


def test_permuted_spheres_of_at_most_two_contacts_give_the_same_bits():
    """A sum of two does not depend on its order: in rows of spheres that strike each other, naming
    them in another order changes nothing."""
    rng = np.random.default_rng(12)
    rows, length = 12, 4
    row, column = (v.ravel() for v in np.indices((rows, length)))
    place = np.stack([column * 2.02 * R, row * 4 * R, 0 * row], axis=1)
    place[:, 1:] += rng.uniform(-0.2, 0.2, (len(row), 2)) * R
    radius = R * rng.uniform(0.9, 1, len(row))
    velocity = np.stack([-60 * (place[:, 0] - 3 * R), 0 * row, 0 * row], axis=1)
    omega = 50 * rng.normal(size=place.shape)
    permutation = rng.permutation(len(row))
    ends = []
    for order in (np.arange(len(row)), permutation):
        setup = scene(
            place[order], radius[order], STONE, velocity[order], omega[order], law=law(0.6, 0.4)
        )
        sim = dem.Simulation(setup)
        most = 0
        for _ in range(20):
            sim.run(steps=20)
            i, j = sim.contacts()["i"], sim.contacts()["j"]
            most = max(most, np.bincount(np.concatenate([i, j]), minlength=1).max())
        assert most == 2
        ends.append(sim.particles)
    for name in ("position", "velocity", "omega"):
        assert np.array_equal(getattr(ends[1], name), getattr(ends[0], name)[permutation])


# -- threads, in processes of their own ------------------------------------------------------------

SCRIPT = """
import test_determinism as test
from taichi_dem import Simulation, engine, neighbors

engine.REORDER_ABOVE, engine.REORDER_EVERY, neighbors.SERIAL_BELOW = 0, 1, 0
sim = Simulation(test.pouring(True, (6, 6, 3)))
for driver in ("serial", "parallel", "team"):
    sim._engine.pace.driver = driver
    test.begin(sim).run(steps=500)
    assert sim._engine.rebuilds > 10 and len(sim.contacts()) > 30
    print(test.digest(sim))
"""


def start(threads, script=SCRIPT):
    """A process that runs ``script`` by so many threads."""
    tests, package = os.path.dirname(__file__), os.path.dirname(os.path.dirname(dem.__file__))
    environment = {
        **os.environ,
        "HALFSPACE_THREADS": str(threads),
        "PYTHONPATH": os.pathsep.join([package, tests]),
    }
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", script],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def same_lines(script=SCRIPT):
    """What one thread prints, which two threads must print too."""
    runs = [start(threads, script) for threads in (1, 2)]
    lines = []
    for run in runs:
        out, errors = run.communicate()
        assert run.returncode == 0, errors
        lines.append(out.splitlines())
    assert lines[0] == lines[1]
    return lines[0]


def test_threads_and_drivers_give_the_same_bits():
    """A bed with every parallel path in use, a piston and a coupled substrate, by one and by two
    threads, by every driver."""
    lines = same_lines()
    assert len(lines) == 3 and len(set(lines)) == 1
