"""Clusters at rest that sleep: against the run without, and what wakes them."""

import numpy as np
import pytest
from setups import law, restart, scene, skin_held_at, state

import taichi_dem as dem
from taichi_dem import engine as engine_module
from taichi_dem.pace import NEVER, Pace
from taichi_dem.sleep import LOOK_EVERY

STONE = dem.Material("stone", density=2500, youngs_modulus=1e7, poissons_ratio=0.2)
R, HEAP, WIDE = 5e-3, 14, 6.06 * 5e-3
STRIKER, PISTON = HEAP, 5
RISE = 1.5  # m/s, at which the striker is thrown up
PUSH = 0.6  # s, when the piston sets out
STEPS = 6000


def boxful(**rest):
    """A pyramid between four walls, of spheres that lose much at each impact, and one above; beside
    a wall a piston that comes through it later."""
    rng = np.random.default_rng(2)
    layers = [
        (1.01 * (2 * x + 1 + k) + 0.01, 1.01 * (2 * y + 1 + k) + 0.01, 1.02 + 1.45 * k)
        for k in range(3)
        for x in range(3 - k)
        for y in range(3 - k)
    ]
    place = (np.array(layers) + rng.uniform(-0.01, 0.01, (HEAP, 3))) * R
    walls = [((0, 0, 0), (0, 0, 1)), ((0, 0, 0), (1, 0, 0)), ((0, 0, 0), (0, 1, 0))]
    walls += [((WIDE, 0, 0), (-1, 0, 0)), ((0, WIDE, 0), (0, -1, 0))]
    program = [(0.0, 0.0), (PUSH, 0.0), (PUSH + 0.05, R)]
    come = dem.Piston((WIDE + 0.3 * R, 0, 0), (-1, 0, 0), STONE, program=program)
    return scene(
        np.vstack([place, [[2.7 * R, 3.1 * R, 9 * R]]]),
        R,
        STONE,
        gravity=(0, 0, -9.81),
        boundaries=[*(dem.Plane(*wall, STONE) for wall in walls), come],
        **{"sleep": True, "law": law(0.3, 0.4), **rest},
    )


@pytest.fixture(scope="module")
def sim():
    return dem.Simulation(boxful(), driver="serial")


def begin(sim, sleeps=True, rise=RISE):
    """From the start, the striker thrown up; or as without ``sleep``."""
    velocity = np.zeros((HEAP + 1, 3))
    velocity[STRIKER, 2] = rise
    restart(sim, velocity=velocity)
    if not sleeps:
        sim._engine.sleep.next = NEVER
    return sim


def meets(sim, other):
    """The spheres that touch sphere or boundary ``other``."""
    records = sim.contacts()
    i, j = records["i"], records["j"]
    return np.concatenate([i[j == other], j[(i == other) & (j >= 0)]])


def everything(sim):
    records = sim.contacts()
    return [state(sim), *(records[name] for name in ("i", "j", "overlap", "force"))]


def assert_same_bits(found, expected):
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other)


def test_a_heap_at_rest_sleeps_and_is_where_it_would_be(sim):
    """Places to 1e-4 of the overlaps, forces to 1e-4 of the largest, the books to 1e-4 of what
    the contacts hold. What sleeps does not move."""
    begin(sim, sleeps=False).run(steps=STEPS)
    awake, books = sim.particles.position.copy(), sim.energy()
    forces = sim.contacts()["force"]
    overlap = np.median(sim.contacts()["overlap"])
    begin(sim).run(steps=STEPS)
    assert np.array_equal(sim.asleep, np.arange(HEAP + 1) < HEAP)
    assert sim.summary()["asleep"] == HEAP
    assert not sim.particles.velocity[:HEAP].any() and not sim.particles.omega[:HEAP].any()
    assert np.abs(sim.particles.position - awake).max() < 1e-4 * overlap
    assert np.abs(sim.contacts()["force"] - forces).max() < 1e-4 * np.abs(forces).max()
    for part, value in sim.energy().items():
        assert value == pytest.approx(books[part], abs=1e-4 * books["normal"])
    slept = sim.particles.position[:HEAP].copy()
    sim.run(steps=100)
    assert np.array_equal(sim.particles.position[:HEAP], slept)


def test_who_is_struck_wakes_in_that_step(sim):
    """And after as many steps as there are spheres between all are awake; as they would move
    without having slept."""
    begin(sim).run(steps=STEPS + 1200)
    while not len(meets(sim, STRIKER)):
        assert sim.asleep[:HEAP].all()
        sim.run(steps=1)
    struck, when = meets(sim, STRIKER), sim.steps
    assert not sim.asleep[struck].any() and sim.asleep[:HEAP].sum() == HEAP - len(struck)
    assert sim.particles.velocity[struck].any(axis=1).all()
    sim.run(steps=10)
    assert not sim.asleep.any()
    sim.run(steps=100)
    found = sim.particles.position.copy()
    begin(sim, sleeps=False).run(steps=when + 110)
    assert np.abs(found - sim.particles.position).max() < 1e-4 * R


def test_a_wall_that_comes_wakes(sim):
    begin(sim, rise=0.0)
    steps = round(PUSH / sim.dt)
    sim.run(steps=steps)
    assert sim.asleep.all()
    while not len(meets(sim, -2 - PISTON)):
        assert sim.asleep.all()
        sim.run(steps=1)
    touched = meets(sim, -2 - PISTON)
    assert sim.steps > steps + 1
    assert not sim.asleep[touched].any() and sim.asleep.sum() == HEAP + 1 - len(touched)
    sim.run(steps=50)
    assert not sim.asleep.any()


@pytest.mark.filterwarnings("ignore:.* J have come from nothing")  # the books know of gravity
def test_a_blow_goes_through_sleepers_as_through_others(sim):
    """Spheres that float in a row without weight, all but touching: asleep from the first look on,
    they are struck one after the other, and no bit differs; momentum is conserved."""
    gravity = sim._engine.control.gravity
    place = np.tile([[0.5 * WIDE, 0.5 * WIDE, 0.0]], (HEAP + 1, 1))
    place[:, 2] = (20 + 2.02 * np.arange(HEAP + 1)) * R
    place[STRIKER, 2] = 10 * R
    velocity = np.zeros((HEAP + 1, 3))
    velocity[STRIKER, 2] = 1.0
    gravity[0] = (0, 0, 0)
    ends = []
    for sleeps in (True, False):
        restart(sim, place, velocity)
        if not sleeps:
            sim._engine.sleep.next = NEVER
        slept = 0
        for _ in range(8):
            sim.run(steps=LOOK_EVERY)
            slept += sim.asleep.sum()
        assert (slept > HEAP) == sleeps and len(np.unique(sim.particles.velocity[:, 2])) > 4
        assert sim.particles.velocity.sum(axis=0) == pytest.approx((0, 0, 1.0), abs=1e-13)
        ends.append(everything(sim))
    assert_same_bits(*ends)
    gravity[0] = sim.scene.gravity


def test_no_bit_depends_on_cuts_lists_or_order(sim, monkeypatch):
    def ends(pieces):
        begin(sim)
        for steps in pieces:
            sim.run(steps=steps)
        return everything(sim)

    total = 2 * STEPS + 17
    expected = ends([total])
    blow = [1] * 600  # the striker arrives within these
    found = [ends([LOOK_EVERY, 1, LOOK_EVERY - 2, 1, 6600, *blow, total - 7600])]
    for width in (0.02, 0.3):
        with skin_held_at(sim, width * R):
            found.append(ends([total]))
    monkeypatch.setattr(engine_module, "REORDER_ABOVE", 0)
    monkeypatch.setattr(engine_module, "REORDER_EVERY", 1)
    found.append(ends([total]))
    moved = sim._engine.particles.spin.id.to_numpy()
    assert not np.array_equal(moved, np.arange(len(moved)))
    for one in found:
        assert_same_bits(one, expected)


def test_who_touches_nobody_sleeps_as_well(sim):
    """Without weight and motion, and without a contact on the list."""
    gravity = sim._engine.control.gravity
    gravity[0] = (0, 0, 0)
    place = np.tile([[0.5 * WIDE, 0.5 * WIDE, 0.0]], (HEAP + 1, 1))
    place[:, 2] = (5 + 4 * np.arange(HEAP + 1)) * R
    restart(sim, place).run(steps=LOOK_EVERY)
    assert sim._engine.contacts.count() == 0 and sim.asleep.all()
    gravity[0] = sim.scene.gravity


def test_a_stop_wakes_all(sim):
    begin(sim).run(steps=STEPS)
    assert sim.asleep.any()
    sim._engine.control.deepest[None] = 1e-9
    with pytest.raises(dem.SimulationStopped):
        sim.run(steps=2000)
    sim._engine.control.deepest[None] = 0.5
    assert not sim.asleep.any()


@pytest.mark.slow
def test_drivers_and_a_run_that_never_looks(sim):
    """The three drivers give the same bits; and one that never looks those of a scene without
    sleep."""
    begin(sim).run(steps=STEPS)
    expected, engine = everything(sim), sim._engine
    for driver in ("team", "parallel"):
        engine.pace = Pace(HEAP + 1, driver, engine.meeting.assembles)
        begin(sim).run(steps=STEPS)
        assert_same_bits(everything(sim), expected)
    begin(sim, sleeps=False).run(steps=STEPS)
    without = dem.Simulation(boxful(sleep=False), driver="serial")
    assert without._engine.sleep is None and not without.asleep.any()
    restart(without, velocity=np.where(np.arange(HEAP + 1)[:, None] == STRIKER, (0, 0, RISE), 0.0))
    without.run(steps=STEPS)
    assert_same_bits(everything(sim), everything(without))


def test_what_does_not_go_together_is_refused(tmp_path):
    with pytest.raises(dem.InputError, match=r"substrate\.exchange.*dents the ground"):
        boxful(substrate=dem.Substrate(STONE))
    multi = dem.Law(dem.Hertz(0.3), surface=dem.MultiContact())
    with pytest.raises(dem.InputError, match=r"law\.surface.*solved for all together"):
        boxful(law=multi)
    with pytest.raises(dem.InputError, match="sleep = 1: must be true or false"):
        boxful(sleep=1)
    setup = boxful(substrate=dem.Substrate(STONE, exchange="none"))
    setup.to_toml(tmp_path / "scene.toml")
    assert dem.Scene.from_toml(tmp_path / "scene.toml").sleep is True
    boxful(sleep=False).to_toml(tmp_path / "other.toml")
    assert "sleep" not in (tmp_path / "other.toml").read_text()
