"""Laws as the steps apply them: motions against twins, the same bits, energy, invariance."""

import numpy as np
import pytest
from law_twins import EEPA
from scene_twins import Friction, Resistance, Twin, Yielding, sticking
from setups import order_of, random_rotation, restart, scene, skin_held_at, watch
from test_determinism import assert_same_bits, everything
from twins import Motion, Pair, composite_modulus, composite_shear_modulus

import taichi_dem as dem
from halfspace import backend, reference
from taichi_dem import engine, scene_file, scene_writer
from taichi_dem.coefficients import Coefficients
from taichi_dem.run_plan import Run
from taichi_dem.time_step import stable_time_step

GEL = dem.Material("gel", density=1000, youngs_modulus=2e5, poissons_ratio=0.4)
STONE = dem.Material("stone", density=2000, youngs_modulus=1e6, poissons_ratio=0.25)
R, WORK, GAMMA, KAPPA, E = 2e-3, 0.02, 0.1, 3.0, 0.7
SPEED = 0.2
PAIRS, ON_WALL = 6, 6

JKR, SOFT = dem.JKR(WORK, E), dem.EEPA(E, KAPPA, surface_energy=GAMMA, pull_off_force=-1e-6)
RUBS = dem.Mindlin(0.4)
LAWS = {
    "JKR": dem.Law(JKR),
    "JKR, CDT-JKR": dem.Law(JKR, RUBS, dem.CDTJKR(adhesion_hysteresis=3.0)),
    "EEPA": dem.Law(SOFT),
    "EEPA, CDT spring": dem.Law(SOFT, RUBS, dem.CDT(0.1, True, "spring", rolling_damping=0.3)),
    "JKR, CDT-JKR spring": dem.Law(
        JKR, RUBS, dem.CDTJKR(regularization="spring", torsion_torque=True)
    ),
    "EEPA, CDT": dem.Law(SOFT, RUBS, dem.CDT(0.1)),
    "Hertz, CDT": dem.Law(dem.Hertz(E), RUBS, dem.CDT(0.1, torsion_torque=True)),
    "Hooke, CDT": dem.Law(dem.Hooke(50.0, E), RUBS, dem.CDT(0.1)),
}
TWINS = list(LAWS)[:4]


def start_of_pairs():
    """Unequal spheres far apart from all others that meet at random: pairs, then some on a wall."""
    rng = np.random.default_rng(7)
    n = PAIRS + ON_WALL
    radius_i, radius_j = R * rng.uniform(0.6, 1.4, (2, n))
    wall = np.arange(n) >= PAIRS
    way = rng.normal(size=(n, 3))
    way[wall] = (0, 0, 1)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    x_j = np.zeros((n, 3))
    x_j[:, 0], x_j[:, 2] = 20 * R * np.arange(n), np.where(wall, 0, 20 * R)
    gap = radius_i + np.where(wall, 0, radius_j)
    x_i = x_j + (gap * 1.002)[:, None] * way
    speed = SPEED * 10 ** rng.uniform(-1.5, 0, n)
    side = rng.normal(size=(n, 3)) * 0.3
    v_i = speed[:, None] * (side - way)
    v_j = np.where(wall[:, None], 0, -v_i * rng.random((n, 1)))
    w_i, w_j = (speed / R)[:, None] * rng.normal(size=(2, n, 3))
    w_j[wall] = 0
    return radius_i, radius_j, wall, Motion(x_i, v_i, w_i, x_j, v_j, w_j)


def scene_of_pairs(law):
    radius_i, radius_j, wall, start = start_of_pairs()
    pairs = ~wall
    position, velocity, omega = (
        np.concatenate([a, b[pairs]])
        for a, b in ((start.x_i, start.x_j), (start.v_i, start.v_j), (start.w_i, start.w_j))
    )
    return scene(
        position,
        np.concatenate([radius_i, radius_j[pairs]]),
        GEL,
        velocity,
        omega,
        law=law,
        boundaries=[dem.Plane((0, 0, 0), (0, 0, 1), STONE)],
    )


def twin_of(law):
    radius_i, radius_j, wall, _ = start_of_pairs()
    other_e, other_nu = np.where(wall, 1e6, 2e5), np.where(wall, 0.25, 0.4)
    modulus = composite_modulus(2e5, 0.4, other_e, other_nu)
    shear = composite_shear_modulus(2e5, 0.4, other_e, other_nu)
    mass_i, mass_j = (1000 * 4 / 3 * np.pi * r**3 for r in (radius_i, radius_j))
    radius = np.where(wall, radius_i, 1 / (1 / radius_i + 1 / radius_j))
    mass = np.where(wall, mass_i, 1 / (1 / mass_i + 1 / mass_j))
    if isinstance(law.normal, dem.JKR):
        normal = sticking(WORK, modulus, radius, mass, E)
    else:
        numbers = (np.full(len(mass), v) for v in (E, KAPPA, GAMMA, -1e-6))
        far = np.where(wall, np.inf, radius_j)
        normal = Yielding(EEPA(modulus, *numbers, radius_i, far, mass, 1.5, 1.0))
    friction = rolling = None
    if law.tangential:
        friction = Friction(0.4, 4 * shear / modulus)
    if isinstance(law.rolling, dem.CDTJKR):
        a_0 = (9 * np.pi * WORK * radius**2 / (2 * modulus)) ** (1 / 3)
        rolling = Resistance(np.pi * a_0 * 3.0 / (4 * radius))
    elif law.rolling:
        rolling = Resistance(np.full(len(mass), 0.1), True, True, damping=0.3)
    facing = np.tile((0.0, 0.0, 1.0), (len(mass), 1))
    return Twin(Pair(radius_i, mass_i, radius_j, mass_j, wall, facing), normal, friction, rolling)


@pytest.fixture(scope="module")
def pairs():
    """Simulations of the pairs, by law, made once."""
    made = {}

    def simulation(name):
        if name not in made:
            made[name] = dem.Simulation(scene_of_pairs(LAWS[name]), driver="serial")
        return made[name]

    return simulation


@pytest.mark.parametrize("name", TWINS)
def test_impacts_equal_those_of_the_twin(pairs, name):
    """Spheres that meet, rub, roll, stick and part: positions to 1e-10 of the radius."""
    sim = pairs(name)
    spheres, wall = sim.scene.spheres, start_of_pairs()[2]
    restart(sim, velocity=spheres.velocity, omega=spheres.omega)
    steps, every = 1500, 25
    path = twin_of(LAWS[name]).run(start_of_pairs()[3], sim.dt, steps)
    counts, least = [], []
    for k in range(0, steps + 1, every):
        now, then = sim.particles, path[k]
        for ours, theirs, unit in (
            (now.position, (then.x_i, then.x_j), R),
            (now.velocity, (then.v_i, then.v_j), SPEED),
            (now.omega, (then.w_i, then.w_j), SPEED / R),
        ):
            expected = np.concatenate([theirs[0], theirs[1][~wall]])
            assert np.abs(ours - expected).max() < 1e-10 * unit, k
        counts.append(len(sim.contacts()))
        least.append(sim.contacts()["overlap"].min(initial=0.0))
        sim.run(steps=every)
    met = np.any(path[-1].v_i != path[0].v_i, axis=1)
    assert counts[0] == 0 and met.sum() > len(wall) / 2
    assert 0 < counts[-1] < met.sum()  # some stick, some part
    assert (min(least) < 0) == ("JKR" in name)


# -- the same bits ---------------------------------------------------------------------------------


def bed_of(law, substrate=True):
    """Sticky spheres that fall on a soft ground (or a wall) in a box while a piston moves in."""
    rng = np.random.default_rng(11)
    grid = np.stack(np.meshgrid(*[range(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    place = (grid + [0.7, 0.6, 0.5]) * 2.05 * R + rng.uniform(-0.02, 0.02, grid.shape) * R
    side = 6.6 * R
    walls = dem.Box((-np.inf, 0, -np.inf if substrate else 0), (side, side, np.inf), STONE)
    return scene(
        place,
        R * rng.uniform(0.7, 1, len(place)),
        GEL,
        velocity=0.1 * rng.normal(size=place.shape),
        omega=30 * rng.normal(size=place.shape),
        gravity=(0, 0, -9.81),
        law=law,
        boundaries=[walls, dem.Piston((0, 0, 0), (1, 0, 0), STONE, velocity=0.02)],
        substrate=dem.Substrate(dem.Material("soil", 1000, 1e5, 0.45)) if substrate else None,
    )


@pytest.mark.parametrize("name", ["JKR, CDT-JKR spring", "EEPA, CDT"])
def test_all_drivers_give_the_same_bits(name, monkeypatch):
    """On the coupled ground; energies are accounted for, and nothing is ever won."""
    sim = dem.Simulation(bed_of(LAWS[name]), driver="serial")
    spheres, found = sim.scene.spheres, []
    for driver in ("serial", "parallel", "team"):
        monkeypatch.setattr(sim._engine.pace, "driver", driver)
        restart(sim, velocity=spheres.velocity, omega=spheres.omega)
        sim.run(steps=800)
        found.append(everything(sim))
    assert_same_bits(found[1], found[0])
    assert_same_bits(found[2], found[0])
    energy = sim.energy()
    assert len(sim.substrate.force) > 3 and len(sim.contacts()) > 20
    assert energy["dissipated"] > 0
    assert abs(energy["balance_error"]) < 2e-3 * energy["dissipated"]
    assert ("rolling" in energy) == ("spring" in name)


@pytest.mark.parametrize("name", ["JKR, CDT-JKR spring", "EEPA, CDT"])
def test_lists_and_places_in_memory_change_no_bit(name, monkeypatch):
    """What contacts remember survives: who is held, yielded, wound up; how many share a sphere."""
    sim = dem.Simulation(bed_of(LAWS[name], substrate=False), driver="serial")
    spheres = sim.scene.spheres
    restart(sim, velocity=spheres.velocity, omega=spheres.omega).run(steps=1500)
    expected = everything(sim)
    assert len(sim.contacts()) > 15
    for width in (1e-9, 0.3):
        with skin_held_at(sim, width * 2 * R):
            restart(sim, velocity=spheres.velocity, omega=spheres.omega).run(steps=1500)
        assert_same_bits(everything(sim), expected)
    monkeypatch.setattr(engine, "REORDER_ABOVE", 0)
    monkeypatch.setattr(engine, "REORDER_EVERY", 1)
    restart(sim, velocity=spheres.velocity, omega=spheres.omega).run(steps=1500)
    assert_same_bits(everything(sim), expected)


# -- pull-off, and what a cycle takes --------------------------------------------------------------


def pressed_and_lifted(law, depth, lift, speed, ground, exchange="implicit", count=2):
    """``count``^2 spheres, three radii apart, which a plate presses down and lifts again."""
    places = [(3 * R * a, 3 * R * b, R) for a in range(count) for b in range(count)]
    down, up = depth / speed, (depth + lift) / speed
    plate = dem.Piston(
        (0, 0, 2 * R), (0, 0, -1), PLATE, program=[(down, depth), (down + up, -lift)]
    )
    under = {"substrate": dem.Substrate(GROUND, exchange=exchange, residual=1e-9)}
    if not ground:
        under = {"boundaries": [dem.Plane((0, 0, 0), (0, 0, 1), GROUND)]}
    boundaries = [plate, *under.pop("boundaries", [])]
    return scene(places, R, GEL, law=law, boundaries=boundaries, **under), down + up


PLATE = dem.Material("plate", density=1000, youngs_modulus=2e5, poissons_ratio=0.4)
GROUND = dem.Material("ground", density=1000, youngs_modulus=2e5, poissons_ratio=0.4)


@pytest.mark.parametrize("ground", [False, True], ids=["wall", "ground"])
def test_jkr_spheres_are_pulled_off_at_the_closed_form_force(ground):
    """-3/2 pi W R each, from a wall and from a ground that gives way under all of them; the plate,
    which sticks better, keeps them, and they part where the law says."""
    law = dem.Law(dem.JKR(WORK, 0.5), pairs={("gel", "plate"): {"normal": dem.JKR(3 * WORK, 0.5)}})
    setup, duration = pressed_and_lifted(law, 0.01 * R, 0.02 * R, 2e-4, ground)
    sim, seen = dem.Simulation(setup, driver="serial"), []
    steps = int(duration / sim.dt)
    for _ in range(150):
        sim.run(steps=steps // 150)
        j = sim.contacts()["j"]
        seen.append((sim.boundaries[0].force[2], (j == (-1 if ground else -3)).sum()))
    force, held = np.array(seen).T
    pull = 1.5 * np.pi * WORK * R
    assert -force.min() / 4 == pytest.approx(pull, rel=0.02)
    assert held.max() == 4 and held[-1] == 0 and (sim.contacts()["j"] == -2).sum() == 4
    energy = sim.energy()
    assert abs(energy["balance_error"]) < 1e-3 * energy["dissipated"]


def test_what_sticks_and_does_not_jump_loses_nothing():
    """JKR spheres that swing on a soft ground, and on each other through it: what counts as lost is
    the error of the step, second order."""
    place = np.array([(2.6 * R * a, 2.6 * R * b, R) for a in range(3) for b in range(3)])
    place[:, 2] -= R * np.random.default_rng(4).uniform(0.002, 0.006, len(place))
    soil = dem.Substrate(GROUND, residual=1e-10)
    setup = scene(place, R, GEL, law=dem.Law(dem.JKR(WORK, 1.0)), substrate=soil)
    sim, found = dem.Simulation(setup, driver="serial"), []
    coarse = sim.dt / 2
    for n in (1, 2, 4):
        restart(sim, dt=coarse / n)
        parts = watch(sim, 400 * n, 20 * n, lambda sim: [*sim.energy().values()])
        lost = parts[:, list(sim.energy()).index("dissipated")]
        assert len(sim.substrate.force) == len(place)
        found.append(np.abs(lost).max() / np.ptp(parts[:, 0]))
    assert np.allclose(order_of(found), 2, atol=0.1)
    assert found[-1] < 1e-3


def wide_and_sticky(**more):
    """Spheres far apart whose adhesive contacts are wider by far than overlaps alone would make
    them; returns also their radii."""
    modulus = composite_modulus(2e5, 0.4, GROUND.youngs_modulus, GROUND.poissons_ratio)
    work = 0.01 * modulus * R / (2 * np.pi)
    wide = R * np.array([0.25, 0.28, 0.32, 0.36])
    overlap = wide**2 / R - np.sqrt(2 * np.pi * work * wide / modulus)
    assert (overlap > 0).all() and (np.sqrt(R * overlap) < 0.27 * R).all()
    place = [(200 * R * k, 0, R - d) for k, d in enumerate(overlap)]
    soil, law = dem.Substrate(GROUND, **more), dem.Law(dem.JKR(work, 0.5))
    return scene(place, R, GEL, law=law, substrate=soil), wide


def test_an_adhesive_contact_is_watched_by_its_own_radius():
    setup, wide = wide_and_sticky()
    sim = dem.Simulation(setup, driver="serial")
    with pytest.warns(RuntimeWarning, match="wider than 0.3"):
        sim.run(steps=1)
    assert np.allclose(sim.substrate.contact_radius, wide, rtol=1e-2)
    assert sim.warnings == {"wide_contacts": 2}


@pytest.mark.slow
def test_adhesive_contacts_too_wide_for_a_layer_stop_the_run():
    """By their own radius, which on a layer is smaller than on a half-space but not by half."""
    setup, wide = wide_and_sticky(layer=dem.Layer(1.2 * R))
    sim = dem.Simulation(setup, driver="serial")
    radii = sim.substrate.contact_radius
    assert (0.6 * wide < radii).all() and (radii < 0.6 * 1.2 * R).all()
    thickness = 0.95 * radii.max() / 0.6
    setup, _ = wide_and_sticky(layer=dem.Layer(thickness))
    with pytest.raises(dem.InputError, match=r"a contact is wider than 0\.6 .*thicker"):
        dem.Simulation(setup, driver="serial")


@pytest.mark.parametrize("ground", [False, True], ids=["wall", "ground"])
def test_an_eepa_cycle_takes_the_area_of_its_loop(ground):
    """Between a plate and a wall or the ground (under one sphere the two are the same), also when
    the list is made anew at every step."""
    law = dem.Law(dem.EEPA(E, KAPPA))
    setup, duration = pressed_and_lifted(law, 0.04 * R, 0.02 * R, 4e-4, ground, count=1)
    sim, losses = dem.Simulation(setup, driver="serial"), []
    steps = int(1.02 * duration / sim.dt)
    for width in (1e-9, 0.1):
        with skin_held_at(sim, width * 2 * R):
            restart(sim)
            sim.run(steps=steps)
        energy = sim.energy()
        losses.append(energy["dissipated"])
        assert len(sim.contacts()) == 0
        assert abs(energy["balance_error"]) < 1e-4 * losses[-1]
    modulus = composite_modulus(2e5, 0.4, 2e5, 0.4)
    one = (np.array([v]) for v in (modulus, E, KAPPA, 0.0, 0.0, R, np.inf, 1.0))
    given, back = EEPA(*one, 1.5, 1.0).loop(np.array([0.02 * R]))
    assert losses[0] == pytest.approx(losses[1], rel=1e-6)
    assert losses[0] == pytest.approx(2 * (given - back)[0], rel=0.03)


# -- rolling ---------------------------------------------------------------------------------------


def test_a_sphere_rolls_out_at_a_constant_rate_and_lies_still():
    """CDT on a level wall: (5/7) mu_r g from start to end, then not a bit of motion along it."""
    speed, g = 0.05, 9.81
    modulus = composite_modulus(2e5, 0.4, 1e6, 0.25)
    height = R - float(reference.hertz_overlap(GEL.density * 4 / 3 * np.pi * R**3 * g, R, modulus))
    setup = scene(
        [(0, 0, height), (10 * R, 0, height)],
        [R, R],
        GEL,
        [(speed, 0, 0), (0, -speed, 0)],
        [(0, speed / R, 0), (speed / R, 0, 0)],
        gravity=(0, 0, -g),
        law=dem.Law(dem.Hertz(0.1), RUBS, dem.CDT(0.1)),
        boundaries=[dem.Plane((0, 0, 0), (0, 0, 1), STONE)],
    )
    sim = dem.Simulation(setup, driver="serial")
    rate = 5 / 7 * 0.1 * g
    sim.run(duration=0.2 * speed / rate)
    first, start = sim.particles.velocity, sim.time
    sim.run(duration=0.5 * speed / rate)
    change = np.abs(sim.particles.velocity - first)[[0, 1], [0, 1]] / (sim.time - start)
    assert np.allclose(change, rate, rtol=0.02)
    sim.run(duration=3 * speed / rate)
    state = sim.particles
    assert np.abs(state.velocity[:, :2]).max() < 1e-9 * speed
    assert np.abs(state.omega).max() < 1e-9 * speed / R
    gone = np.abs(state.position - setup.spheres.position)[[0, 1], [0, 1]]
    assert np.allclose(gone, speed**2 / (2 * rate), rtol=0.02)
    before = state.position
    sim.run(steps=2000)
    assert np.abs(sim.particles.position - before)[:, :2].max() < 1e-9 * R


def test_a_spring_holds_on_a_slope_below_the_rolling_angle_and_not_above():
    """tan(slope) = 0.1: mu_r = 0.15 holds, 0.05 lets go with (5/7) g (sin - mu_r cos)."""
    angle, g = np.arctan(0.1), 9.81
    slow = dem.Material("slow", 1000, 2e5, 0.4)
    setup = scene(
        [(0, 0, R), (0, 10 * R, R)],
        [R, R],
        [GEL, slow],
        gravity=(g * np.sin(angle), 0, -g * np.cos(angle)),
        law=dem.Law(
            dem.Hertz(0.1),
            RUBS,
            dem.CDT(0.15, regularization="spring", rolling_damping=0.5),
            pairs={("slow", "stone"): {"rolling": dem.CDT(0.05, regularization="spring")}},
        ),
        boundaries=[dem.Plane((0, 0, 0), (0, 0, 1), STONE)],
    )
    sim = dem.Simulation(setup, driver="serial")
    sim.run(duration=0.2)
    first, start = sim.particles, sim.time
    sim.run(duration=0.1)
    now, elapsed = sim.particles, sim.time - start
    assert abs(now.position[0, 0] - first.position[0, 0]) < 1e-6 * R
    assert now.position[0, 0] < 0.2 * R
    rate = 5 / 7 * g * (np.sin(angle) - 0.05 * np.cos(angle))
    found = (now.velocity[1, 0] - first.velocity[1, 0]) / elapsed
    assert found == pytest.approx(rate, rel=0.01)
    assert set(sim.contacts().dtype.names) >= {"rolling_displacement", "tangential_force"}


# -- invariance ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["JKR, CDT-JKR spring", "EEPA, CDT"])
def test_a_turned_and_mirrored_scene_moves_as_the_first(pairs, name):
    first = pairs(name)
    spheres = first.scene.spheres
    turn = random_rotation(np.random.default_rng(5)) @ np.diag([1.0, 1.0, -1.0])
    turned = scene(
        spheres.position @ turn.T,
        spheres.radius,
        GEL,
        spheres.velocity @ turn.T,
        -spheres.omega @ turn.T,  # a mirror turns spins the other way
        law=first.scene.law,
        boundaries=[dem.Plane((0, 0, 0), tuple(turn @ (0, 0, 1)), STONE)],
    )
    restart(first, velocity=spheres.velocity, omega=spheres.omega).run(steps=1000)
    second = dem.Simulation(turned, driver="serial")
    second.run(steps=1000)
    assert np.abs(second.particles.position - first.particles.position @ turn.T).max() < 1e-9 * R
    spins = second.particles.omega + first.particles.omega @ turn.T
    assert np.abs(spins).max() < 1e-8 * SPEED / R


# -- the balance left out --------------------------------------------------------------------------


def test_without_the_balance_nothing_is_summed_up_and_nothing_else_changes(pairs):
    first = pairs("EEPA, CDT")
    spheres = first.scene.spheres
    restart(first, velocity=spheres.velocity, omega=spheres.omega).run(steps=500)
    second = dem.Simulation(first.scene, driver="serial", energy_balance=False)
    second.run(steps=500)
    assert_same_bits(everything(second)[:5], everything(first)[:5])
    assert not hasattr(second._engine.contacts, "lost")
    missing = set(first.energy()) - set(second.energy())
    assert missing == {"dissipated", "balance_error"}
    assert not second.effects.losses and "energy_balance" in str(second.summary()["effects"])


# -- scene files and stable steps ------------------------------------------------------------------


@pytest.mark.parametrize("name", LAWS)
def test_a_scene_file_keeps_every_law(name, tmp_path):
    setup = scene_of_pairs(LAWS[name])
    path = tmp_path / "scene.toml"
    scene_writer.write(path, setup, Run(steps=3, energy_balance=False))
    again, plan = scene_file.read(path)
    assert again == setup and again.law == LAWS[name] and not plan.energy_balance


def stable(law):
    """The stable step of a sphere of gel that may meet another at 0.1 m/s, s, and its reason."""
    backend.start()
    setup = scene([(0, 0, 0), (3 * R, 0, 0)], R, GEL, (0.05, 0, 0), law=law)
    tables = {slot: Coefficients(law, slot, setup.materials) for slot in law.parts()}
    found = stable_time_step(setup, tables)
    return found.value, found.reason


def test_the_stable_step_sees_every_law():
    """Stiffer unloading, adhesion, springs of rolling and strong dashpots each shorten it."""
    plain, _ = stable(dem.Law(dem.Hertz(0.5)))
    assert stable(dem.Law(dem.Hertz(0.5), dem.Mindlin(0.5)))[0] == plain
    step, reason = stable(dem.Law(dem.Hertz(0.5), dem.Mindlin(0.5, damping=20.0)))
    assert step < plain / 5 and "tangential dashpot" in reason
    assert stable(dem.Law(dem.Hertz(0.5), dem.Mindlin(0.5, damping=40.0)))[0] == step / 2
    hard = stable(dem.Law(dem.EEPA(0.5, 9.0)))[0]
    assert stable(dem.Law(dem.EEPA(0.5, 1.0)))[0] / hard > 2
    assert stable(dem.Law(dem.JKR(5.0, 0.5)))[0] < plain
    rolls = dem.CDT(2.0, regularization="spring")
    step, reason = stable(dem.Law(dem.Hertz(0.5), rolling=rolls))
    assert step < plain / 2 and "rolling" in reason
