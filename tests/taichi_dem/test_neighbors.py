"""The contact list against brute force, on compact and scattered layouts, resting and moving."""

from contextlib import suppress

import numpy as np
import pytest
from scipy.spatial import cKDTree
from setups import GLASS, law, restart, scene, skin_held_at, state

import taichi_dem as dem
from taichi_dem import engine as engine_module
from taichi_dem.contact_list import FIRST_FACE, SUBSTRATE
from taichi_dem.grid import BLOCK
from taichi_dem.types import ti

R, N = 1e-3, 300


def listed(sim):
    """The pairs on the contact list, as a sorted array of (smaller, larger) body numbers; each must
    be there once."""
    engine = sim._engine
    count = engine.contacts.count()
    ids = engine.particles.spin.id.to_numpy()
    i = ids[engine.contacts.ends.i.to_numpy()[:count]]
    j = engine.contacts.ends.j.to_numpy()[:count]
    j = np.where(j >= 0, ids[j], j)
    pairs = np.sort(np.stack([i, j], axis=1), axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    return pairs[np.lexsort(pairs.T)]


def brute_force(sim, skin):
    """All pairs nearer than ``skin``, in the same form."""
    x, radius = sim.particles.position, sim.particles.radius
    apart = np.linalg.norm(x[:, None] - x, axis=2) - radius[:, None] - radius
    i, j = np.nonzero(np.triu(apart < skin, k=1))
    pairs = [np.stack([i, j], axis=1)]
    faces = [face for wall in sim.scene.boundaries for face in wall.faces()]
    grounds = [(FIRST_FACE - f, *face) for f, face in enumerate(faces)]
    if sim.scene.substrate is not None:
        grounds += [(SUBSTRATE, *face) for face in sim.scene.substrate.faces()]
    for number, point, normal in grounds:
        near = np.flatnonzero((x - point) @ normal - radius < skin)
        pairs.append(np.stack([np.full(len(near), number), near], axis=1))
    pairs = np.concatenate(pairs)
    return pairs[np.lexsort(pairs.T)]


def assert_complete(sim):
    """The list as it was just built holds exactly what is within the skin."""
    sim._engine.rebuild()
    skin = sim._engine.skin.width
    assert np.array_equal(listed(sim), brute_force(sim, skin))
    touching = np.sort(np.stack([sim.contacts()["i"], sim.contacts()["j"]], axis=1), axis=1)
    assert len(touching) <= len(listed(sim))


def place(sim, position, velocity=0.0):
    with suppress(dem.SimulationStopped):  # spheres may well lie within each other here
        restart(sim, np.ascontiguousarray(position, dtype=float), velocity)
    return sim


# -- layouts ---------------------------------------------------------------------------------------


def layouts(rng, ball):
    """Positions of N spheres: name to (N, 3), within about a box of ``ball``."""
    line = np.zeros((N, 3))
    line[:, 0] = np.linspace(-1, 1, N) * ball
    clusters = rng.uniform(-1, 1, (10, 3))[rng.integers(0, 10, N)] * ball
    clumps = rng.normal(size=(N, 3)) * 5 * R
    clumps[: N // 2] += (1000.0, -700.0, 500.0)
    faraway = rng.normal(size=(N, 3)) * 5 * R
    faraway[0] = (1e6, 0, 0)
    return {
        "random": rng.uniform(-1, 1, (N, 3)) * ball,
        "clustered": clusters + rng.normal(size=(N, 3)) * 3 * R,
        "in a line": line,
        "in a slanting line": line @ np.linalg.qr(rng.normal(size=(3, 3)))[0],
        "in a plane": rng.uniform(-1, 1, (N, 3)) * ball * (1, 1, 0),
        "a kilometre apart": clumps,
        "one far away": faraway,
        "all at one place": np.zeros((N, 3)) + rng.normal(size=(N, 3)) * 0.01 * R,
    }


@pytest.fixture(scope="module", params=["dense", "sparse"])
def cloud(request):
    """Radii from 1 to 20, so that the largest see hundreds of the smallest; on the layout of cells
    that the first positions call for."""
    rng = np.random.default_rng(21)
    radius = R * np.exp(rng.uniform(-np.log(20), 0, N))
    grid = np.stack(np.meshgrid(*[range(7)] * 3), axis=-1).reshape(-1, 3)[:N]
    spread = 2.1 if request.param == "dense" else 50
    setup = scene(grid * spread * R, radius, law=law(0.8, 0.3), substrate=None)
    sim = dem.Simulation(setup)
    assert sim._engine.grid.dense == (request.param == "dense")
    return sim


def some_layouts(seed):
    return layouts(np.random.default_rng(seed), 12 * R)


@pytest.mark.parametrize("name", some_layouts(0))
def test_the_list_holds_exactly_what_is_near(cloud, name):
    """Also where cells wrap around, and whatever the skin."""
    position = some_layouts(22)[name]
    for width in (1e-6 * R, 0.1 * R, R):
        with skin_held_at(cloud, width):
            place(cloud, position)
            assert_complete(cloud)


def test_wherever_the_cloud_is(cloud):
    """Moved over the edges of cells and blocks, positive and negative."""
    rng = np.random.default_rng(23)
    position = some_layouts(24)["clustered"]
    for _ in range(6):
        place(cloud, position + rng.uniform(-300, 300, 3) * R)
        assert_complete(cloud)


def test_walls_and_substrate_are_listed():
    rng = np.random.default_rng(25)
    setup = scene(
        rng.uniform(0.1, 0.9, (100, 3)) * 30 * R,
        0.4 * R * rng.uniform(0.3, 1, 100),
        GLASS,
        law=law(),
        boundaries=[
            dem.Box((0, 0, -np.inf), (30 * R, 30 * R, np.inf), GLASS),
            dem.Plane((0, 0, 30 * R), (0.3, 0.1, -1), GLASS),
        ],
        substrate=dem.Substrate(GLASS),
    )
    sim = dem.Simulation(setup)
    for width in (0.1 * R, 5 * R, 40 * R):
        with skin_held_at(sim, width):
            place(sim, setup.spheres.position)
            assert_complete(sim)
    assert np.array_equal(np.unique(listed(sim)[:, 0])[:6], [-6, -5, -4, -3, -2, -1])


def test_a_single_sphere_has_nobody():
    sim = dem.Simulation(scene([[1, 2, 3]], R, law=law(0.8, 0.3), gravity=(0, 0, -9.81)))
    sim.run(steps=50)
    assert sim._engine.contacts.count() == 0 and len(sim.contacts()) == 0
    fallen = -0.5 * 9.81 * sim.time**2
    assert sim.particles.position[0, 2] - 3 == pytest.approx(fallen, rel=1e-9)


def test_blocks_of_cells_stand_in_the_order_of_place(cloud):
    """Whatever the order of the spheres; what a search reads is in the order of the cells."""
    position = some_layouts(29)["random"]
    place(cloud, position)
    cloud._engine.rebuild()
    engine, grid = cloud._engine, cloud._engine.grid
    occupied = grid.occupied.to_numpy()[: grid.occupied_count[0]]
    assert len(occupied) > 10
    number = np.ravel_multi_index(occupied.T, grid.blocks)
    assert np.all(np.diff(number) > 0)
    ids = engine.particles.spin.id.to_numpy()[grid.particle.to_numpy()]
    assert np.array_equal(np.sort(ids), np.arange(N))
    assert np.array_equal(grid.near.position.to_numpy(), position[ids])


# -- on the move -----------------------------------------------------------------------------------


def test_no_contact_is_missed_on_the_move(cloud):
    """A cloud that falls together and scatters again: at every step those that overlap, by a
    search of their own, are those in contact."""
    rng = np.random.default_rng(26)
    grid = np.stack(np.meshgrid(*[range(7)] * 3), axis=-1).reshape(-1, 3)[:N] - 3
    position = grid * 2.05 * R + rng.uniform(-0.02, 0.02, (N, 3)) * R
    place(cloud, position, -position / (20000 * cloud.dt))
    radius, met, before = cloud.particles.radius, set(), cloud._engine.rebuilds
    for _ in range(80):
        cloud.run(steps=120)
        x, records = cloud.particles.position, cloud.contacts()
        near = cKDTree(x).query_pairs(2 * radius.max(), output_type="ndarray")
        gap = np.linalg.norm(x[near[:, 0]] - x[near[:, 1]], axis=1) - radius[near].sum(axis=1)
        overlapping = set(map(tuple, near[gap < 0].tolist()))
        found = {tuple(sorted(pair)) for pair in zip(records["i"], records["j"], strict=True)}
        assert found == overlapping
        met |= found
    assert len(met) > 100 and cloud._engine.rebuilds - before > 5


# -- capacity --------------------------------------------------------------------------------------


def test_a_list_that_outgrows_its_room_loses_nothing(monkeypatch):
    """Spheres that start apart and crowd together: the list is made larger on the way, and no
    contact, no history and no bit differs from a run with room from the start."""
    rng = np.random.default_rng(27)
    grid = np.stack(np.meshgrid(*[range(5)] * 3), axis=-1).reshape(-1, 3) - 2
    position = grid * 2.3 * R + rng.uniform(-0.1, 0.1, grid.shape) * R
    setup = scene(
        position,
        R * rng.uniform(0.9, 1, len(grid)),
        GLASS,
        velocity=-100 * position,
        omega=100 * rng.normal(size=grid.shape),
        law=law(0.3, 0.5),
    )
    runs = []
    for share, growth in ((40, 1.3), (0, 1.1)):
        monkeypatch.setattr(engine_module, "CONTACTS_PER_PARTICLE", share)
        monkeypatch.setattr(engine_module, "SPARE_CONTACTS", 64)
        monkeypatch.setattr(engine_module, "GROWTH", growth)
        sim, seen = dem.Simulation(setup), []
        for _ in range(10):
            sim.run(steps=50)
            room = sim._engine.contacts.capacity
            seen.append((room, sim.contacts(), state(sim), sim.energy()["balance_error"]))
        runs.append(seen)
    roomy, tight = runs
    assert len({seen[0] for seen in roomy}) == 1
    outgrown = [k for k in range(9) if tight[k + 1][0] > tight[k][0]]
    assert len(tight[outgrown[-1]][1]) > 20  # contacts that had something to lose
    for (_, contacts, *others), (_, tight_contacts, *tight_others) in zip(*runs, strict=True):
        for name in contacts.dtype.names:
            assert np.array_equal(contacts[name], tight_contacts[name])
        for one, other in zip(others, tight_others, strict=True):
            assert np.array_equal(one, other)


# -- memory ----------------------------------------------------------------------------------------


@ti.kernel
def active_blocks(grid: ti.template()) -> ti.i32:
    number = 0
    for _ in ti.grouped(grid.block_population):
        number += 1
    return number


def occupied_blocks(sim):
    """Blocks of cells that hold a particle, counted from the positions."""
    size = np.multiply(BLOCK, sim._engine.grid.cell_size[None])
    return len(np.unique(np.floor(sim.particles.position / size), axis=0))


def test_memory_follows_the_occupied_cells():
    """A sparse grid holds the blocks that are occupied, and gives back those that have emptied."""
    rng = np.random.default_rng(28)
    position = rng.normal(size=(N, 3)) * 5 * R
    position[: N // 2] += (1000.0, 0, 0)
    sim = dem.Simulation(scene(position, 0.05 * R, law=law()))
    assert not sim._engine.grid.dense
    for shift in (0, 3000 * R, -5 * R):
        moved = position + shift
        moved[: N // 2, 1] += 77 * shift
        place(sim, moved)
        occupied = occupied_blocks(sim)  # of which some may share a slot, as cells wrap
        assert 0.9 * occupied < active_blocks(sim._engine.grid) <= occupied
    place(sim, np.zeros((N, 3)) + rng.uniform(0, 0.01, (N, 3)) * R)
    assert active_blocks(sim._engine.grid) == occupied_blocks(sim) == 1
