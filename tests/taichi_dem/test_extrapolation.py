"""The ground solved for every few steps, and extrapolated between."""

import pickle
import warnings

import numpy as np
import pytest
from setups import law, restart, rigid, scene, skin_held_at, state, watch

import halfspace
import taichi_dem as dem
from taichi_dem import check
from taichi_dem import engine as engine_module
from taichi_dem import exchange as exchange_module
from taichi_dem import simulation as simulation_module

FAR = pytest.mark.filterwarnings("ignore:a contact with the substrate turns")
R = 5e-3
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e5, poissons_ratio=0.45)
RIGID = rigid()
MASS = RIGID.density * 4 / 3 * np.pi * R**3
GROUND = halfspace.HalfSpace(SOIL.youngs_modulus, SOIL.poissons_ratio, coupling="point")
SPACING, SIDE = 2.5 * R, 5
STIFFNESS = 0.4 * np.pi * GROUND.modulus * SPACING  # c = K C = +-0.4 of two neighbours
RATE = np.sqrt(STIFFNESS / MASS)
PERIOD = 2 * np.pi / RATE
OVERLAP = 1e-3 * R
GRAVITY = STIFFNESS * OVERLAP / MASS
HIGH = 50 * R


def places(n):
    """A square of n x n, (n^2, 2)."""
    steps = np.arange(n) - (n - 1) / 2
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2) * SPACING


def bed(**substrate):
    """Linear contacts of points without losses."""
    substrate = {"coupling": "point", "residual": 1e-12, "exchange_every": 4, **substrate}
    return scene(
        np.column_stack([places(SIDE), np.full(SIDE**2, HIGH)]),
        R,
        RIGID,
        gravity=(0, 0, -GRAVITY),
        law=dem.Law(dem.Hooke(STIFFNESS, 1.0)),
        substrate=dem.Substrate(SOIL, **substrate),
    )


@pytest.fixture(scope="module")
def sim():
    return dem.Simulation(bed(), driver="serial", max_overlap=1)


def begin(sim, velocity, every, steps):
    """The first spheres in equilibrium on the ground and moving up at ``velocity`` (k,), the others
    out of reach; an exchange ``every`` steps, so many ``steps`` in a period of a contact."""
    count = len(velocity)
    grid, load = places(SIDE), np.full(count, STIFFNESS * OVERLAP)
    position = np.column_stack([grid, np.full(SIDE**2, HIGH)])
    position[:count, 2] = R - OVERLAP - GROUND.matrix(grid[:count]) @ load
    motion = np.zeros((SIDE**2, 3))
    motion[:count, 2] = velocity
    sim._engine.exchange.between.every[None] = every
    return restart(sim, position, motion, dt=PERIOD / steps)


def theory(velocity, every, steps, periods):
    """What the energy balance gains, J: each mode, of c = an eigenvalue of K C, loses
    2 pi A (w_H T)^3 c/(1 + c)^2 of its energy in a period of one contact alone (gains, if c < 0);
    A = <s (s + T) (2 s + T)>/(6 T^3) over the steps between, 1/3 for many."""
    c, modes = np.linalg.eigh(STIFFNESS * GROUND.matrix(places(SIDE)[: len(velocity)]))
    s = np.arange(every) / every
    shape = np.mean(s * (s + 1) * (2 * s + 1)) / 6
    rate = 2 * np.pi * shape * (2 * np.pi * every / steps) ** 3 * c / (1 + c) ** 2
    energy = 0.5 * MASS * (velocity @ modes) ** 2
    return np.expm1(-np.outer(periods, rate)) @ energy


def slope(time, values):
    """Of the line through them, by least squares."""
    return np.polyfit(time, values, 1)[0]


@FAR
@pytest.mark.parametrize(("every", "steps"), [(2, 64), (4, 64), (16, 512)])
@pytest.mark.parametrize("others", [[1], [-1], 24])
def test_the_energy_goes_as_theory_says(sim, others, every, steps):
    """Two contacts in phase and in antiphase; 25 in random motion, with c from -0.6 to 3."""
    rng = np.random.default_rng(3)
    shape = np.array([1, *others]) if isinstance(others, list) else rng.normal(size=25)
    velocity = 0.05 * OVERLAP * RATE * shape
    begin(sim, velocity, every, steps)
    seen = watch(sim, 8 * steps, 16, lambda sim: sim.energy()["balance_error"])
    time = np.linspace(0, 8, len(seen))
    expected = slope(time, theory(velocity, every, steps, time))
    assert slope(time, seen) == pytest.approx(expected, rel=0.05)


def test_only_every_few_steps_are_solved_for(sim):
    """Steps 0 and 1, then all multiples."""
    solver, velocity = sim._engine.exchange.solver, np.full(4, 0.05 * OVERLAP * RATE)
    begin(sim, velocity, 8, 256)
    solved = []
    for step in range(1, 34):
        before = solver.exact_sums[None]
        sim.run(steps=1)
        if solver.exact_sums[None] > before:
            solved.append(step)
    assert solved == [1, 8, 16, 24, 32]


def everything(sim):
    ground = sim.substrate
    return [state(sim), sim.contacts()["force"], ground.force, ground.expansion, ground.slope]


def test_no_bit_depends_on_cuts_lists_or_order(sim, monkeypatch):
    velocity = 1.5 * OVERLAP * RATE * np.random.default_rng(4).normal(size=SIDE**2)

    def ends(pieces):
        begin(sim, velocity, 8, 256)
        for steps in pieces:
            sim.run(steps=steps)
        return everything(sim)

    expected = ends([515])
    assert len(expected[2]) < SIDE**2  # some have lifted off
    found = [ends([3, 1, 7, 89, 400, 15])]
    for width in (0.02, 0.4):
        with skin_held_at(sim, width * R):
            found.append(ends([515]))
    monkeypatch.setattr(engine_module, "REORDER_ABOVE", 0)
    monkeypatch.setattr(engine_module, "REORDER_EVERY", 1)
    with skin_held_at(sim, 0.001 * R):
        found.append(ends([515]))
    moved = sim._engine.particles.spin.id.to_numpy()
    assert not np.array_equal(moved, np.arange(len(moved)))
    for one in found:
        for array, other in zip(one, expected, strict=True):
            assert np.array_equal(array, other)
    assert sim.warnings.get("unseen_contacts", 0) == 0


def test_what_swings_too_far_is_warned_of_and_stopped(sim):
    """By the contact's own oscillation: 2 pi every/steps rad between two exchanges."""
    velocity = 0.05 * OVERLAP * RATE * np.random.default_rng(5).normal(size=4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        begin(sim, velocity, 8, 200)
        sim.run(steps=100)
    assert sim.summary()["exchange_phase"] == pytest.approx(2 * np.pi * 8 / 200)
    with pytest.warns(RuntimeWarning, match=r"0\.3 rad of its own"):
        begin(sim, velocity, 8, 120)
        sim.run(steps=100)
    assert sim.warnings["sparse_exchange"] == 4
    with pytest.raises(dem.SimulationStopped, match=r"1\.05 rad.* exchange_every = 2 or"):
        begin(sim, velocity, 8, 48)


def test_a_mistake_is_told_by_what_it_is_put_down_to(sim, monkeypatch):
    """What stops a simulation before its first step is one."""
    with pytest.raises(dem.SimulationStopped) as stopped:
        begin(sim, np.zeros(4), 8, 48)
    stop = stopped.value
    assert pickle.loads(pickle.dumps(stop)).setting == ("substrate.exchange_every", 8)

    def stops(*_):
        raise stop

    monkeypatch.setattr(simulation_module, "Engine", stops)
    with pytest.raises(dem.InputError) as mistake:
        dem.Simulation(bed(exchange_every=8))
    assert str(mistake.value) == f"substrate.exchange_every = 8: {stop}"
    stop.setting = None
    with pytest.raises(dem.InputError) as mistake:
        dem.Simulation(bed(exchange_every=8))
    assert str(mistake.value) == f"spheres.position: {stop}"


def test_a_sphere_that_the_last_exchange_did_not_know_is_counted(sim):
    """Off the list until it is about to touch; with a wide skin it has been known for long."""
    position = np.column_stack([places(SIDE), np.full(SIDE**2, HIGH)])
    position[0, 2] = 1.005 * R
    velocity = np.zeros((SIDE**2, 3))
    velocity[0, 2] = -0.05
    sim._engine.exchange.between.every[None] = 16
    for width, told in ((4e-4, 1), (0.1, 0)):
        with skin_held_at(sim, width * R), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            restart(sim, position, velocity, dt=PERIOD / 400).run(steps=200)
            assert len(sim.substrate.force) == 1
            assert sim.warnings.get("unseen_contacts", 0) == told


@FAR
def test_a_stop_goes_back_and_begins_anew(sim):
    """A step grown too long for the exchange: the last good state, then solved for twice."""
    velocity = 0.05 * OVERLAP * RATE * np.random.default_rng(6).normal(size=4)
    begin(sim, velocity, 8, 256)
    sim.run(steps=50)
    before, between = state(sim), sim._engine.exchange.between
    between.every[None] = 60
    with pytest.raises(dem.SimulationStopped, match="between two exchanges"):
        sim.run(steps=20)
    assert sim.steps == 50 and np.array_equal(state(sim), before)
    assert between.since[None] == 50 and between.next[None] == 51
    between.every[None] = 8
    sim._engine.control.flags.fill(0)  # the good state is none with an exchange so rare
    sim.run(steps=20)
    assert sim.steps == 70 and between.since[None] == 64


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"exchange_every": 0}, "whole number of steps >= 1"),
        ({"exchange_every": True}, "whole number of steps >= 1"),
        ({"exchange_every": 2.0}, "whole number of steps >= 1"),
        ({"exchange_every": 2, "exchange": "lagged"}, "must be 1 with exchange = 'lagged'"),
        ({"exchange_every": 2, "exchange": "none"}, "must be 1 with exchange = 'none'"),
        (
            {"exchange_every": 2, "coupling": "point", "relaxation": dem.Relaxation(1e4, 1.0)},
            "must be 1 with relaxation",
        ),
    ],
)
def test_what_has_no_meaning_is_refused(changes, message):
    with pytest.raises(dem.InputError, match=message):
        dem.Substrate(SOIL, **changes)


def test_it_stands_in_a_file(tmp_path):
    setup = bed(exchange_every=12)
    setup.to_toml(tmp_path / "scene.toml")
    assert dem.Scene.from_toml(tmp_path / "scene.toml").substrate == setup.substrate


def test_check_says_how_far_contacts_swing(sim):
    begin(sim, np.zeros(2), 8, 200)
    (said,) = check.exchanges(sim)
    assert said.startswith("every 4 steps") and " 0.25 rad" in said  # the scene's own 4


# -- compiled once more ----------------------------------------------------------------------------

SOFT = dem.Material("soft", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)


def pile(exchange_every, grounded=25, kind=dem.Hertz, ground=None, **rest):
    """Spheres on soft ground and a few dropped on them, in touch with each other; without losses
    unless ``rest`` says otherwise."""
    rng = np.random.default_rng(7)
    side = int(np.sqrt(grounded))
    below = places(SIDE)[: side * SIDE] * (2.02 / 2.5)
    low = np.column_stack([below, R * (1 - rng.uniform(0.005, 0.02, len(below)))])
    high = np.array([[x, y, 3.2 * R] for x in (-2 * R, 2 * R) for y in (-2 * R, 2 * R)])
    position = np.vstack([low, high])
    rest.setdefault("law", dem.Law(kind(restitution=1.0)))
    return scene(
        position,
        R,
        SOFT,
        gravity=(0, 0, -9.81),
        substrate=dem.Substrate(SOIL, exchange_every=exchange_every, **(ground or {})),
        **rest,
    )


def run_of(setup, steps, driver="serial", **given):
    sim = dem.Simulation(setup, driver=driver, **given)
    sim.run(steps=steps)
    return sim


@pytest.mark.slow
def test_one_step_between_exchanges_is_every_step():
    """The same bits as without extrapolation, which then has nothing to do."""
    plain = run_of(pile(1, law=law(0.7, 0.3)), 400)
    sparse = dem.Simulation(pile(2, law=law(0.7, 0.3)), driver="serial")
    sparse._engine.exchange.between.every[None] = 1
    restart(sparse).run(steps=400)
    for one, other in zip(everything(sparse), everything(plain), strict=True):
        assert np.array_equal(one, other)
    assert sparse.energy() == plain.energy()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rubbing", "sticky"])
@FAR
def test_drivers_give_the_same_bits(kind):
    laws = {
        "rubbing": law(0.7, 0.3),
        "sticky": dem.Law(dem.JKR(work_of_adhesion=0.05, restitution=0.7)),
    }
    ends = [
        everything(run_of(pile(6, law=laws[kind]), 400, driver))
        for driver in ("serial", "team", "parallel")
    ]
    for found in ends[1:]:
        for one, other in zip(found, ends[0], strict=True):
            assert np.array_equal(one, other)


@pytest.mark.slow
def test_the_host_does_the_same(monkeypatch):
    """To the residual, over a few exchanges."""
    ground = {"residual": 1e-11}
    inside = run_of(pile(6, ground=ground), 100)
    monkeypatch.setattr(exchange_module, "IN_KERNEL_CONTACTS", 4)
    hosted = run_of(pile(6, ground=ground), 100)
    assert hosted._engine.exchange.hosted and not inside._engine.exchange.hosted
    scales = [np.repeat([R, 0.1, 1.0], 3), *(np.abs(a).max() for a in everything(inside)[1:])]
    for one, other, scale in zip(everything(hosted), everything(inside), scales, strict=True):
        assert np.max(np.abs(one - other) / scale) < 1e-7
    assert hosted.energy()["balance_error"] == pytest.approx(
        inside.energy()["balance_error"], abs=1e-6 * inside.energy()["normal"]
    )


def drift(sim):
    """The largest error of the energy balance over the energy turned over, in a tenth of a second;
    and the largest phase."""
    steps = round(0.1 / sim.dt)
    look = watch(
        sim, steps, 12, lambda sim: [sim.energy()[k] for k in ("balance_error", "kinetic")]
    )
    return np.abs(look[:, 0]).max() / look[:, 1].max(), sim.summary().get("exchange_phase", 0.0)


@pytest.mark.slow
@FAR
@pytest.mark.parametrize("ground", ["half-space", "layer"])
def test_the_energy_error_of_a_pile(ground):
    """Impacts on spheres that bob, without losses, for a tenth of a second: 0.2 % of the energy by
    the step of the impacts, and 0.3 phase^3 by what is extrapolated."""
    layer = {"layer": dem.Layer(4 * R)} if ground == "layer" else {}
    sim = dem.Simulation(pile(2, ground=layer), driver="serial")
    for every in (1, 2, 4, 8):
        sim._engine.exchange.between.every[None] = every
        error, phase = drift(restart(sim))
        assert error < 2e-3 + 0.3 * phase**3
