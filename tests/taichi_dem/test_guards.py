"""What stops a run, what it says, and what it leaves; what it warns of, and how often."""

import json
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from setups import GEL, GLASS, law, restart, scene, state

import taichi_dem as dem

R = 5e-3
TOY = dem.Material("toy", density=1, youngs_modulus=1, poissons_ratio=0.3)


def spy():
    """An output that only notes what it is told."""
    seen = []
    return seen, SimpleNamespace(
        every=None,
        start=lambda sim: seen.append("start"),
        write=lambda sim: seen.append("write"),
        finish=lambda sim: seen.append(("finish", sim.steps, np.isfinite(state(sim)).all())),
    )


def stop(sim, **length):
    """Run until it is stopped; the exception, and what an output saw."""
    seen, output = spy()
    with pytest.raises(dem.SimulationStopped) as caught:
        sim.run(**length, outputs=[output])
    return caught.value, seen


def assert_last_good_state(sim, stopped, seen):
    """It is finite, it is what the simulation holds, and outputs were finished there."""
    good = stopped.last_good
    for name in ("position", "velocity", "omega"):
        assert np.isfinite(good[name]).all()
        assert np.array_equal(getattr(sim.particles, name), good[name])
    assert (sim.steps, sim.time) == (good["step"], pytest.approx(good["time"]))
    assert seen == ["start", ("finish", good["step"], True)]
    assert str(stopped) in sim.summary()["outcome"]


# -- stopped ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def meeting():
    """Two spheres that repel each other by less than rounding, on their way to the same place, in
    steps and places that have no rounding."""
    setup = scene(
        [(50.0, 0, 0), (-1.0, 0, 0), (1.0, 0, 0)],
        0.75,
        TOY,
        velocity=[(0, 0, 0), (1.0, 0, 0), (-1.0, 0, 0)],
        law=dem.Law(dem.Hooke(1e-280, 1.0)),
    )
    with pytest.warns(RuntimeWarning, match="stable step"):
        return dem.Simulation(setup, dt=0.125)


@pytest.mark.parametrize(
    "pieces", [[20], [8, 1], [1] * 8], ids=["in one run", "at its end", "ones"]
)
def test_not_a_number_stops_the_run(meeting, pieces):
    """Centres that meet have no normal: whether it shows in the middle of a run or by its last
    half kick, no run ends with a state that is not finite."""
    restart(meeting, velocity=meeting.scene.spheres.velocity)
    meeting._engine.control.deepest[None] = np.inf  # or their overlap would stop them before
    for steps in pieces[:-1]:
        try:
            meeting.run(steps=steps)
        except dem.SimulationStopped:
            pieces = [steps]
            break
    stopped, seen = stop(meeting, steps=pieces[-1])
    assert_last_good_state(meeting, stopped, seen)
    assert stopped.particle == 1
    for words in ("at t = ", "sphere 1 is at", "not a number", "centres may have met", "time step"):
        assert words in str(stopped)


def test_too_deep_an_overlap_stops_the_run():
    """A soft sphere that falls too fast on another: which, where, when, how deep, what to do."""
    setup = scene(
        [(0, 0, 0), (0.1, 0.2, 0.3), (0.1, 0.2, 0.3 + 2.2 * R)],
        R,
        GEL,
        velocity=[(0, 0, 0), (0, 0, 0), (0, 0, -6.0)],
        law=law(),
    )
    sim = dem.Simulation(setup)
    stopped, seen = stop(sim, duration=0.01)
    assert_last_good_state(sim, stopped, seen)
    assert stopped.particle in (1, 2)
    time = float(str(stopped).split("t = ")[1].split()[0])
    assert 0.2 * R / 6 < time < 1.2 * R / 6 * 3
    for words in (
        "sphere 2 overlaps sphere 1 by 0.00",
        " at (0.1, 0.2, 0.30",
        "limit 0.5",
        "Try a",
    ):
        assert words in str(stopped)
    cures = ("lower load or speed", "stiffer material", "smaller time step", "max_overlap")
    places = [str(stopped).find(cure) for cure in cures]
    assert places[0] > 0 and places == sorted(places)


def test_the_limit_of_overlaps_is_the_users_for_spheres_walls_and_substrate():
    """Spheres that strike a wall, the substrate and each other: each is named; below the limit they
    rebound."""
    place = [(0.9 * R - 1, 0, 1), (0, 0, 1.1 * R), (0, 1, 1), (0, 1, 1 + 2.2 * R)]
    far, near = (
        dem.Plane((-2, 0, 0), (1, 0, 0), GEL),
        dem.Plane((-1 - 0.2 * R, 0, 0), (1, 0, 0), GEL),
    )
    ground = dem.Substrate(GEL, exchange="none")
    setup = scene(place, R, GEL, law=law(), boundaries=[far, near], substrate=ground)
    sim = dem.Simulation(setup, dt=5e-5, max_overlap=0.2)
    for sphere, way, name in (
        (0, (-1, 0, 0), "sphere 0 overlaps boundary 1 by"),
        (1, (0, 0, -1), "sphere 1 overlaps the substrate by"),
        (3, (0, 0, -1), "sphere 3 overlaps sphere 2 by"),
    ):
        velocity = np.zeros((4, 3))
        velocity[sphere] = np.multiply(way, 1.5)
        stopped, _ = stop(restart(sim, velocity=velocity), duration=0.02)
        assert stopped.particle == sphere and name in str(stopped) and "limit 0.2" in str(stopped)
    restart(sim, velocity=velocity / 10).run(duration=0.05)
    assert sim.particles.velocity[2, 2] == pytest.approx(-0.15, rel=1e-3)


def test_contacts_remember_after_a_stop_what_they_did_before():
    """Beads that lean on each other and on walls by friction: after a stop, as if none had been."""
    rng = np.random.default_rng(3)
    beads = np.array([[x, 0, z] for x in (-1, 1) for z in (1, 2.98)]) * R
    floor = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
    leaning = law(0.5, friction=0.6)
    spin = rng.uniform(-5, 5, (4, 3))
    setup = scene(beads, R, omega=spin, boundaries=[floor], law=leaning, gravity=(1.0, 0.5, -9.81))
    sim = dem.Simulation(setup, driver="serial")
    ends = []
    for interrupted in (False, True):
        sim.restart()
        sim.run(steps=60)
        if interrupted:
            before, force = sim.contacts(), sim.particles.force
            deepest = sim._engine.control.deepest
            limit, deepest[None] = deepest[None], 1e-9
            stop(sim, steps=50)
            deepest[None] = limit
            assert np.abs(before["tangential_force"]).max() > 0
            assert np.array_equal(sim.contacts()["tangential_force"], before["tangential_force"])
            assert np.array_equal(sim.particles.force, force)
        sim.run(steps=60)
        ends.append(state(sim))
    assert np.allclose(*ends, rtol=1e-12, atol=0)


def test_too_fast_a_sphere_stops_the_run(monkeypatch):
    """Free fall to a speed at which a quarter of the radius goes by in one step.  What was there
    before can be looked at, and goes on."""
    place = [(0, 0, 0), (0.3, 0, 0)]
    monkeypatch.setattr("taichi_dem.simulation.SECONDS_PER_CHUNK", 1e9)  # one piece: no later state
    setup = scene(place, [R, 10 * R], law=law(0.5, 0.3), gravity=(0, 0, -1e3))
    sim = dem.Simulation(setup, dt=1e-5)
    sim.run(steps=100)
    kept = state(sim)
    stopped, seen = stop(sim, duration=1.0)
    assert_last_good_state(sim, stopped, seen)
    assert stopped.particle == 0
    limit = 0.25 * R / sim.dt
    time = float(str(stopped).split("t = ")[1].split()[0])
    assert limit <= 1e3 * time < 1.02 * limit
    for words in (
        "sphere 0 at (0, 0, -",
        "in one step at 12",
        "0.25 of its radius",
        "smaller time",
    ):
        assert words in str(stopped)

    assert stopped.last_good["step"] == sim.steps == 100
    assert np.array_equal(state(sim), kept)
    sim.run(steps=100)
    assert sim.steps == 200 and sim.particles.velocity[0, 2] == pytest.approx(-1e3 * 200e-5)


# -- warned ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def anything():
    return dem.Simulation(scene([(0, 0, 0)], R, law=law()))


def messages(caught):
    return [str(warning.message) for warning in caught if warning.category is RuntimeWarning]


def test_a_step_beyond_the_stable_one_is_warned_of(anything):
    stable = anything.dt
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert dem.Simulation(anything.scene, dt=0.99 * stable).warnings == {}
        assert messages(caught) == []
        sim = dem.Simulation(anything.scene, dt=1.01 * stable)
        sim.run(steps=3)
    (message,) = messages(caught)
    assert sim.warnings == {"time_step": 1}
    assert f"dt = {1.01 * stable:.3g} s" in message and f"{stable:.3g} s" in message
    assert sim.dt == 1.01 * stable and "half period" in sim.dt_reason


def test_fast_and_wide_contacts_are_warned_of_once_and_counted():
    """Spheres that strike the gel at more and at less than a tenth of its shear wave speed, and
    some that sink to more than 0.3 of their radius: one warning of each kind, all counted."""
    wave = np.sqrt(GEL.youngs_modulus / (2 * (1 + GEL.poissons_ratio)) / GEL.density)
    speeds = np.array([0.005, 0.01, 0.08, 0.12, 0.2]) * wave
    place = [(k, 0, 1.001 * R) for k in range(5)]
    velocity = np.zeros((5, 3))
    velocity[:, 2] = -speeds
    setup = scene(place, R, GLASS, velocity, law=law(), substrate=dem.Substrate(GEL))
    sim = dem.Simulation(setup)
    deepest = np.zeros(5)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(600):
            sim.run(steps=10)
            deepest = np.maximum(deepest, 1 - sim.particles.position[:, 2] / R)
    wide = int(np.sum(deepest > 0.3**2))
    assert not len(sim.contacts()) and 0 < wide < 5
    assert np.abs(deepest - 0.09).min() > 0.002  # none so near the mark that couplings decide
    assert sim.warnings == {"fast_impacts": 2, "wide_contacts": wide}
    found = messages(caught)
    assert len(found) == 2
    assert sum("shear wave speed" in message for message in found) == 1
    assert sum("0.3 of its sphere's radius" in message for message in found) == 1


# -- refused ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dt": 0}, "dt = 0: must be > 0 s"),
        ({"dt": -1e-6}, "dt = -1e-06: must be > 0 s"),
        ({"dt": float("nan")}, "dt = nan: must be > 0 s"),
        ({"dt": "fast"}, 'dt = "fast": must be a number'),
        ({"driver": "paralel"}, "did you mean 'parallel'?"),
        ({"max_overlap": 0}, "max_overlap = 0: must be > 0"),
        ({"max_overlap": 1.5}, "max_overlap = 1.5: must be > 0 and <= 1"),
    ],
)
def test_bad_arguments_of_a_simulation_are_refused(anything, arguments, words):
    with pytest.raises(dem.InputError) as caught:
        dem.Simulation(anything.scene, **arguments)
    assert words in str(caught.value)


def test_all_bad_arguments_are_named_at_once(anything):
    with pytest.raises(dem.InputError) as caught:
        dem.Simulation(anything.scene, dt=-1, driver="gpu", max_overlap=-1)
    for name in ("dt", "driver", "max_overlap"):
        assert name in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, "give either duration (s) or steps"),
        ({"duration": 1.0, "steps": 3}, "give either duration (s) or steps"),
        ({"steps": -1}, "steps = -1: must be a whole number >= 0"),
        ({"steps": 1.5}, "steps = 1.5: must be a whole number"),
        ({"steps": True}, "steps = True: must be a whole number"),
        ({"duration": -1.0}, "duration = -1.0: must be >= 0 s"),
        ({"duration": float("inf")}, "duration = inf: must be >= 0 s"),
        ({"duration": "long"}, 'duration = "long": must be a number'),
    ],
)
def test_bad_arguments_of_run_are_refused_before_anything_moves(meeting, arguments, words):
    before = meeting.steps
    with pytest.raises(dem.InputError) as caught:
        meeting.run(**arguments)
    assert words in str(caught.value) and meeting.steps == before


def test_a_run_of_nothing_does_nothing_and_a_duration_is_whole_steps(meeting):
    restart(meeting)
    before = state(meeting)
    meeting.run(steps=0)
    meeting.run(duration=0)
    assert meeting.steps == 0 and np.array_equal(state(meeting), before)
    meeting.run(duration=3 * 0.125)
    assert meeting.steps == 3
    meeting.run(duration=0.126)
    assert meeting.steps == 5


# -- outputs that fail -----------------------------------------------------------------------------


class Failing:
    """An output that raises ``error`` at the first write that is not at the start."""

    every = 1e-9

    def __init__(self, error):
        self.error = error

    def start(self, sim):
        pass

    def write(self, sim):
        if sim.steps > 0:
            raise self.error

    def finish(self, sim):
        pass


@pytest.mark.parametrize(
    ("error", "outcome"),
    [(OSError("disk full"), "stopped: disk full"), (KeyboardInterrupt(), "interrupted")],
)
def test_whatever_ends_a_run_is_its_outcome(tmp_path, error, outcome):
    sim = dem.Simulation(scene([(0, 0, 0)], R, law=law()))
    with pytest.raises(type(error)):
        sim.run(steps=10, outputs=[dem.Summary(tmp_path), Failing(error)])
    assert json.loads((tmp_path / "summary.json").read_text())["outcome"] == outcome


def test_a_light_plate_under_load_is_followed_or_refused():
    """The plate swings with its own mass: the automatic step must follow it."""
    beads = [(0, 0, R), (3 * R, 0, R)]
    floor = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
    plate = dem.Piston((0, 0, 2.05 * R), (0, 0, -1), GLASS, load=1e-3, mass=1e-9)
    sim = dem.Simulation(scene(beads, R, boundaries=[floor, plate], law=law(0.5)))
    sim.run(steps=5000)
    energy = sim.energy()
    assert abs(energy["balance_error"]) < 0.05 * energy["external_work"]

    heavy = dem.Piston((0, 0, 2.05 * R), (0, 0, -1), GLASS, load=1e-3, mass=1.0)
    slow = dem.Simulation(scene(beads, R, boundaries=[floor, heavy], law=law(0.5)))
    assert sim.dt < 0.1 * slow.dt


def test_the_fall_to_a_wall_counts_in_the_time_step():
    floor = dem.Plane((0, 0, 0), (0, 0, 1), GLASS)
    near = dem.Simulation(
        scene([(0, 0, 2 * R)], R, boundaries=[floor], law=law(), gravity=(0, 0, -10))
    )
    far = dem.Simulation(
        scene([(0, 0, 10.0)], R, boundaries=[floor], law=law(), gravity=(0, 0, -10))
    )
    assert far.dt < near.dt
    assert "14 m/s" in far.dt_reason  # sqrt(2 g h)


def test_energy_from_nothing_is_warned_of_once():
    """A spring between two walls, at a step beyond what Verlet can follow, gains at every swing."""
    walls = [dem.Plane((s * 0.99 * R, 0, 0), (-s, 0, 0), GLASS) for s in (-1.0, 1.0)]
    held = scene([(1e-6, 0, 0)], R, GLASS, law=dem.Law(dem.Hooke(1e3, 1.0)), boundaries=walls)
    frequency = np.sqrt(2e3 / held.spheres.mass[0])
    with pytest.warns(RuntimeWarning, match="stable step"):
        sim = dem.Simulation(held, dt=2.1 / frequency)
    with pytest.warns(RuntimeWarning, match="J have come from nothing.*stable is"):
        for _ in range(100):
            sim.run(steps=1)
    assert sim.warnings["energy"] == 1
    assert sim.energy()["balance_error"] > 0
    sim.restart(dt=0.2 / frequency)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.run(steps=1000)
    assert "energy" not in sim.warnings
