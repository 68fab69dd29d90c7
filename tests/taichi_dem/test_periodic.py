"""Sides that repeat themselves: every sphere meets the nearest image of every other."""

import itertools

import numpy as np
import pytest
from setups import EPS, GLASS, law, order_of, restart, scene, skin_held_at, state
from test_determinism import assert_same_bits, everything
from test_neighbors import listed, place

import taichi_dem as dem
from taichi_dem import packing
from taichi_dem.contact_list import FIRST_FACE

R, N = 1e-3, 120
IMAGES = np.array([(*shift, 0) for shift in itertools.product((-1, 0, 1), repeat=2)])


def shortest(apart, period):
    """The shortest of each vector (..., 3) and its images, by trying them all."""
    sides = np.array([*period, np.inf])
    apart = np.where(np.isfinite(sides), np.mod(apart, sides), apart)
    tried = apart[..., None, :] + IMAGES * [*period, 0]
    best = np.linalg.norm(tried, axis=-1).argmin(axis=-1)
    return np.take_along_axis(tried, best[..., None, None], axis=-2)[..., 0, :]


def gaps(position, radius, period):
    """Between the surfaces of each sphere and the nearest image of each other, (n, n)."""
    apart = shortest(position[:, None] - position, period)
    return np.linalg.norm(apart, axis=-1) - radius[:, None] - radius


# -- who is near -----------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[(9 * R, 11 * R), (4 * R, 60 * R)], ids=["wide", "narrow"])
def cloud(request):
    """Spheres of radii up to five to one over a floor; the narrow cell is the narrowest allowed."""
    rng = np.random.default_rng(41)
    radius = R * rng.uniform(0.2, 1, N)
    radius[0] = R
    spread = np.stack([np.zeros(N), np.zeros(N), 3 * R * np.arange(1, N + 1)], axis=1)
    floor = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
    return dem.Simulation(
        scene(spread, radius, law=law(0.8, 0.3), boundaries=[floor], period=request.param)
    )


def anywhere(sim, seed):
    """Random places in cells far and near."""
    low, high = -3 * np.array([*sim.scene.period, 0]), 3 * np.array([*sim.scene.period, 0])
    high[2] = 1500 * R**3 / np.prod(sim.scene.period)
    return np.random.default_rng(seed).uniform(low, high, (N, 3))


def test_the_list_holds_exactly_what_is_near(cloud):
    radius, period = cloud.scene.spheres.radius, cloud.scene.period
    for seed, width in enumerate((1e-6 * R, 0.1 * R, R, 5 * R)):
        with skin_held_at(cloud, width):
            place(cloud, anywhere(cloud, seed))
            cloud._engine.rebuild()
            x = cloud.particles.position
            i, j = np.nonzero(np.triu(gaps(x, radius, period) < width, k=1))
            low = np.flatnonzero(x[:, 2] - radius < width)
            pairs = np.r_[np.c_[i, j], np.c_[np.full(len(low), FIRST_FACE), low]]
            assert len(pairs) > 20
            assert np.array_equal(listed(cloud), pairs[np.lexsort(pairs.T)])


def gather(sim, seed):
    """Start a cloud without overlaps whose spheres stir at random and drift over the sides."""
    rng = np.random.default_rng(seed)
    period, radius = sim.scene.period, sim.scene.spheres.radius
    height = 4 * np.pi * (radius**3).sum() / np.prod(period)
    x, factor = packing.place(radius, np.zeros(3), np.array([*period, height]), rng, periodic=True)
    assert factor == 1 and (gaps(x, radius, period)[np.triu_indices(N, k=1)] > 0).all()
    v = 0.5 * rng.normal(size=(N, 3)) + [2.0, -1.5, 0]
    return restart(sim, x, v, 200 * rng.normal(size=(N, 3)))


def test_no_contact_is_missed_on_the_move(cloud):
    """At every look those in contact are those that overlap an image; and nobody jumps."""
    gather(cloud, 42)
    period, radius = cloud.scene.period, cloud.scene.spheres.radius
    before, met, across = cloud.particles.position.copy(), set(), 0
    for _ in range(40):
        cloud.run(steps=80)
        x, records = cloud.particles.position, cloud.contacts()
        assert np.abs(x - before).max() < R * 80 * 0.1
        i, j = np.nonzero(np.triu(gaps(x, radius, period) < 0, k=1))
        records = records[records["j"] >= 0]
        found = {tuple(sorted(pair)) for pair in zip(records["i"], records["j"], strict=True)}
        assert found == set(zip(i.tolist(), j.tolist(), strict=True))
        apart = x[records["i"]] - x[records["j"]]
        near = shortest(apart, period)
        normal = near / np.linalg.norm(near, axis=1, keepdims=True)
        assert records["normal"] == pytest.approx(normal, abs=1e-10)
        met |= found
        across += int((np.abs(apart[:, :2]) > 0.5 * np.array(period)).any(axis=1).sum())
        before = x.copy()
    assert len(met) > 50 and across > 20


# -- what they do to each other --------------------------------------------------------------------


def test_a_shift_changes_nothing(cloud):
    """All spheres moved by a share of the sides, and each by its own number of whole ones."""
    ends = []
    rng = np.random.default_rng(43)
    sides = np.array([*cloud.scene.period, 0])
    for shift in (0.0, 0.37 * sides, sides * rng.integers(-4, 5, (N, 3))):
        gather(cloud, 44)
        start = cloud.particles
        restart(cloud, start.position + shift, start.velocity.copy(), start.omega.copy())
        cloud.run(steps=300)
        assert len(cloud.contacts()) > 5
        ends.append(state(cloud) - np.pad(np.broadcast_to(shift, (N, 3)), ((0, 0), (0, 6))))
    scale = np.abs(ends[0]).max(axis=0)
    for end in ends[1:]:
        assert np.abs(end - ends[0]).max(axis=0) / scale == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize("cloud", [(9 * R, 11 * R)], ids=["wide"], indirect=True)
def test_all_drivers_give_the_same_bits(cloud, monkeypatch):
    seen = []
    for driver in ("serial", "parallel", "team"):
        monkeypatch.setattr(cloud._engine.pace, "driver", driver)
        gather(cloud, 45).run(steps=400)
        seen.append(everything(cloud))
    assert_same_bits(seen[1], seen[0])
    assert_same_bits(seen[2], seen[0])


@pytest.fixture(scope="module")
def gas():
    """Elastic spheres without friction that fill a cell."""
    grid = np.stack(np.meshgrid(*[range(3)] * 3), axis=-1).reshape(-1, 3)
    return dem.Simulation(scene(2.4 * R * grid, R, law=law(), period=(7.2 * R, 7.2 * R)))


def test_momentum_and_energy_are_conserved(gas):
    rng = np.random.default_rng(46)
    velocity = rng.normal(size=(27, 3))
    velocity[:, 2] = 0.1 * rng.normal(size=27)  # so that the layers stay together
    dt, errors, across = gas.stable.value / 2, [], 0
    for halving in range(4):
        restart(gas, velocity=velocity, dt=dt / 2**halving)
        seen = []
        for _ in range(30):
            gas.run(steps=4 * 2**halving)
            seen.append(gas.energy()["balance_error"])
            i, j = gas.contacts()["i"], gas.contacts()["j"]
            apart = gas.particles.position[i] - gas.particles.position[j]
            across += int((np.abs(apart) > 3.6 * R).any(axis=1).sum())
        now = gas.particles
        lost = now.mass @ now.velocity - now.mass @ velocity
        assert np.abs(lost).max() < 1e4 * EPS * np.abs(now.mass @ np.abs(velocity)).max()
        errors.append(np.abs(seen).max())
    assert across > 30
    assert order_of(errors)[1:] == pytest.approx(2, abs=0.3)


def test_a_collision_over_the_seam_is_that_in_the_middle():
    """Rubbing and spinning; one of the two may even be several cells away."""
    period = (10 * R, 8 * R)
    x = np.array([[0.0, 0, 5 * R], [1.6 * R, 1.1 * R, 5.3 * R]])
    v, omega = np.array([[0.5, 0.1, 0], [-0.4, -0.2, 0.1]]), np.array([[30.0, 0, 9], [0, -70, 0]])
    sim = dem.Simulation(scene(x + 4 * R, R, velocity=v, omega=omega, law=law(0.7, 0.4),
                               period=period))  # fmt: skip
    ends = []
    for shift in ([4, 4, 0], [[9.4, 4, 0], [-0.6, 4, 0]], [[-1, -1, 0], [29, -17, 0]]):
        moved = np.array(shift) * R
        restart(sim, x + moved, v, omega)
        sim.run(steps=10)
        assert len(sim.contacts()) == 1
        sim.run(steps=150)
        assert len(sim.contacts()) == 0
        end = state(sim)
        end[:, :3] -= moved
        ends.append(end)
    scale = np.abs(ends[0]).max(axis=0)
    for end in ends[1:]:
        assert np.abs(end - ends[0]).max(axis=0) / scale == pytest.approx(0, abs=1e-11)


# -- laws that reach further -----------------------------------------------------------------------


def test_a_cell_leaves_room_for_contacts_held_past_touching():
    setup = scene(
        [[0, 0, 5 * R]], R, law=dem.Law(dem.JKR(0.5, restitution=1.0)), period=(4 * R, 9 * R)
    )
    with pytest.raises(dem.InputError, match=r"period = .* twice the .* m that contacts are held"):
        dem.Simulation(setup)


@pytest.mark.slow
def test_contacts_that_feel_each_other_do_so_over_the_seam():
    """A cluster of spheres whose bulk bulges: the same wherever the sides cut it."""
    rng = np.random.default_rng(47)
    x = 1.96 * R * np.stack(np.meshgrid(*[range(2)] * 3), axis=-1).reshape(-1, 3) + 5 * R
    x += rng.uniform(-0.01, 0.01, x.shape) * R
    laws = dem.Law(dem.Hertz(1.0), surface=dem.MultiContact())
    sim = dem.Simulation(scene(x, R, law=laws, period=(8 * R, 7 * R)))
    ends = []
    for shift in (
        np.zeros(3),
        [2.1 * R, 1.2 * R, 0],
        [80 * R, -7 * R, 0] * rng.integers(-1, 2, (8, 1)),
    ):
        restart(sim, x + shift)
        force = sim.particles.force.copy()
        sim.run(steps=100)
        ends.append(np.hstack([sim.particles.position - shift, sim.particles.velocity, force]))
    plain = dem.Simulation(scene(x, R, law=law(), period=(8 * R, 7 * R))).particles.force
    scale = np.abs(ends[0]).max(axis=0)
    assert np.abs(ends[0][:, 6:] - plain).max() > 0.01 * np.abs(plain).max()
    for end in ends[1:]:
        assert np.abs(end - ends[0]).max(axis=0) / scale == pytest.approx(0, abs=1e-8)
