"""What is left out is estimated right: against closed forms, and without touching the run."""

import dataclasses
import json

import numpy as np
import pytest
from setups import GLASS, law, scene, state

import taichi_dem as dem
from taichi_dem import cli, moments, neglect, output, run
from taichi_dem.contact_list import SUBSTRATE

RADIUS, APART, DEPTH = 1e-3, 2.5e-3, 2e-5  # m
STIFF = dataclasses.replace(GLASS, youngs_modulus=5e6)
PLANE_MODULUS = STIFF.youngs_modulus / (1 - STIFF.poissons_ratio**2)
HERTZ = 4 / 3 * (PLANE_MODULUS / 2) * np.sqrt(RADIUS)


def pressed(**ground):
    """Two spheres between the ground and a piston on its way down, all of one material."""
    height = RADIUS - DEPTH
    return scene(
        [[0, 0, height], [APART, 0, height]],
        RADIUS,
        STIFF,
        boundaries=[
            dem.Piston((0, 0, height + RADIUS - 0.5 * DEPTH), (0, 0, -1), STIFF, velocity=0.2)
        ],
        substrate=dem.Substrate(STIFF, **ground),
        law=law(restitution=0.5, friction=0.3),
    )


@pytest.fixture(scope="module")
def running():
    sim = dem.Simulation(pressed(exchange="none", coupling="point"), driver="serial")
    sim.run(steps=20)
    return sim


@pytest.fixture(scope="module")
def before(running):
    return state(running).copy()


@pytest.fixture(scope="module")
def found(running, before):
    return {effect.name: effect for effect in running.neglected()}


def overlaps(sim):
    """With the ground and with the piston, which has moved."""
    z, plate = sim.particles.position[0, 2], sim.boundaries[0].position[2]
    assert plate < sim.scene.boundaries[0].point[2]
    return np.array([RADIUS - z, RADIUS - (plate - z)])


def converged(answer, start):
    """A fixed point of ``answer``, which changes little."""
    value = start
    for _ in range(100):
        value = answer(value)
    return value


def test_substrate_coupling_is_that_of_two_points(running, found):
    overlap = overlaps(running)[0]
    alone = HERTZ * overlap**1.5
    compliance = 1 / (np.pi * PLANE_MODULUS * APART)
    together = converged(lambda f: HERTZ * (overlap - compliance * f) ** 1.5, alone)
    lateral = together**2 * compliance / APART
    expected = np.hypot(together - alone, lateral) / alone
    effect = found["substrate coupling"]
    assert effect.size == pytest.approx(expected, rel=1e-5)
    assert effect.contacts == 2 and effect.size > 0.01


def test_multi_contact_is_that_of_two_poles(running, found):
    overlap = overlaps(running)
    nu, a = STIFF.poissons_ratio, RADIUS - overlap / 2
    raised = 1.125 * (1 + nu) * (3 - 2 * nu) / (4 * np.pi * STIFF.youngs_modulus)
    raised *= np.mean(1 / a)
    alone = HERTZ * overlap**1.5
    together = converged(lambda f: HERTZ * (overlap + raised * f[::-1]) ** 1.5, alone)
    effect = found["multi-contact"]
    # The forces that the place of the contacts adds to these are smaller by a / R.
    expected = np.median(together - alone) / np.median(alone)
    assert effect.size == pytest.approx(expected, rel=0.05)
    assert effect.contacts == 4


def test_a_run_is_left_alone(running, before, found):
    assert found and np.array_equal(state(running), before)


def records(forces, j=SUBSTRATE):
    """Contact records with the given normal forces."""
    made = np.zeros(len(forces), [("i", int), ("j", int), ("face", int), ("force", float, 3)])
    made["i"], made["j"], made["face"] = np.arange(len(forces)), j, -1
    made["force"][:, 2] = forces
    return made


def test_the_size_is_the_median_over_contacts_that_change():
    without = records([1.0, 2.0, 3.0, 100.0])
    with_it = records([1.1, 2.2, 3.3, 100.0])
    assert neglect.change([without], [with_it]) == (pytest.approx(0.1), 3)
    assert neglect.change([without], [without]) == (0.0, 0)


def test_contacts_that_open_or_close_count_in_full():
    assert neglect.change([records([1.0, 1.0])], [records([1.0])]) == (1.0, 1)
    size, contacts = neglect.change([records([2.0])], [records([2.0, 1.0])])
    assert contacts == 1 and size == np.inf  # there is no force to compare with


def test_states_that_barely_touch_do_not_decide():
    grazing = records([1e-6]), records([2e-6])
    pressing = records([1.0, 1.0]), records([1.05, 1.05])
    size, contacts = neglect.change(*zip(grazing, pressing, strict=True))
    assert size == pytest.approx(0.05) and contacts == 3


def test_only_what_can_be_turned_on_is_looked_at():
    def names(one):
        return [candidate.name for candidate in neglect._candidates(neglect._bare(one))]

    points = ["finite contact size", "multi-contact"]
    assert names(pressed(exchange="none")) == ["substrate coupling", "multi-contact"]
    assert names(pressed(coupling="point")) == points
    assert names(pressed(coupling="point", exchange="lagged")) == points
    assert names(pressed()) == ["multi-contact"]
    creeping = dem.Relaxation(relaxed_modulus=0.5 * STIFF.youngs_modulus, retardation_time=0.1)
    creeps = pressed(coupling="point", relaxation=creeping)
    assert names(creeps) == points  # estimated on ground as stiff as this is at once
    assert names(pressed(exchange_every=4)) == ["multi-contact"]
    sleeping = dataclasses.replace(pressed(exchange="none"), sleep=True)
    assert names(sleeping) == ["substrate coupling", "multi-contact"]
    whole = dataclasses.replace(pressed(), law=dem.Law(dem.Hertz(0.5), surface=dem.MultiContact()))
    assert names(whole) == [] and not neglect.applicable(whole)
    sticky = dem.Law(dem.JKR(restitution=0.5, work_of_adhesion=0.01))
    assert names(dataclasses.replace(pressed(), law=sticky)) == ["multi-contact"]


def test_where_nothing_can_act_nothing_is_compiled(running, monkeypatch):
    monkeypatch.setattr(neglect, "_forces", None)
    lonely = dataclasses.replace(moments.Moment.of(running), grounded=1, crowded=False)
    assert [effect.size for effect in neglect.neglected(running, [lonely])] == [0.0, 0.0]


def test_sentences_say_what_to_do():
    entry = 'substrate.exchange = "implicit"'
    large = neglect.Neglected("substrate coupling", entry, 0.1234, 7, 4)
    assert large.sentence() == (
        "substrate coupling would change the median contact force by 12 %: turn it on "
        '(substrate.exchange = "implicit")'
    )
    creeping = pressed(coupling="point", relaxation=dem.Relaxation(1e6, 1.0))
    barred = dataclasses.replace(large, **neglect._turning_on(creeping, "finite contact size"))
    assert "12 %: but it cannot be turned on here: coupling = finite: must be" in barred.sentence()
    assert barred.summary()["turn_on"] is False
    small = neglect.Neglected("finite contact size", entry, 0.0002, 7, 4)
    assert "0.02 % of the median contact force: rightly off" in small.sentence()
    assert small.matters(1e-4) and not small.matters()
    failed = neglect.Neglected("multi-contact", entry, None, problem="no equilibrium")
    assert failed.sentence() == "multi-contact cannot be estimated: no equilibrium"
    assert failed.summary()["turn_on"] is None and large.summary()["turn_on"] is True


def test_what_is_advised_can_be_done():
    """The entry that turns an effect on is one that the scene, as it is, takes; or it says why
    there is none."""
    creeping = {"coupling": "point", "relaxation": dem.Relaxation(1e6, 1.0)}
    for changes in (creeping, {"exchange": "lagged", "coupling": "point"}):
        one = pressed(**changes)
        how = neglect._turning_on(one, "multi-contact")
        assert how["entry"].endswith('exchange = "lagged" }') and not how["barred"]
        assert neglect.turned_on(one, "multi-contact").law.surface.lagged
    seldom = neglect._turning_on(pressed(exchange_every=4), "multi-contact")
    assert seldom["barred"].startswith("substrate.exchange_every = 4: must be 1")
    sleeping = dataclasses.replace(pressed(exchange="none"), sleep=True)
    assert "with sleep" in neglect._turning_on(sleeping, "substrate coupling")["barred"]


def test_a_run_writes_them_to_its_summary(running, found, tmp_path, monkeypatch, capsys):
    (tmp_path / output.SUMMARY).write_text('{"outcome": "finished"}')
    monkeypatch.setattr(neglect, "neglected", lambda *_, **__: list(found.values()))
    run._estimate(running, [], tmp_path, 1e-3)
    written = json.loads((tmp_path / output.SUMMARY).read_text())
    assert written["outcome"] == "finished"
    assert written["neglected"]["multi-contact"]["size"] == found["multi-contact"].size
    assert written["neglected"]["multi-contact"]["threshold"] == 1e-3
    assert capsys.readouterr().out.count("left out") == len(found)


def test_an_interrupted_estimate_spoils_nothing(running, tmp_path, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(neglect, "neglected", interrupted)
    run._estimate(running, [], tmp_path, 0.01)
    assert "not estimated" in capsys.readouterr().out and not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("asked", [True, False])
def test_the_command_line_estimates_unless_told_not_to(asked, tmp_path, capsys):
    path, folder = tmp_path / "scene.toml", tmp_path / "out"
    pressed(exchange="none").to_toml(path)
    command = ["run", str(path), "-o", str(folder), "--duration", "2e-4"]
    switch = [] if asked else ["--set", "run.estimate_neglected=false"]
    assert cli.main([*command, *switch]) == cli.DONE
    said = json.loads((folder / output.SUMMARY).read_text())
    assert ("neglected" in said) == asked
    assert ("substrate coupling would change" in capsys.readouterr().out) == asked
    if asked:
        assert all(effect["states"] == moments.STATES for effect in said["neglected"].values())


@pytest.mark.slow
def test_the_size_of_contacts_is_that_of_two_close_ones():
    """By docs/substrate.md: E_c with the sizes of both contacts, which lie uphill."""
    apart, depth = 2.02 * RADIUS, 0.1 * RADIUS
    given = pressed(coupling="point")
    place = np.array([[0, 0, RADIUS - depth], [apart, 0, RADIUS - depth]])
    spheres = dataclasses.replace(given.spheres, position=place)
    sim = dem.Simulation(dataclasses.replace(given, spheres=spheres, boundaries=()))
    effects = {effect.name: effect for effect in sim.neglected()}
    assert set(effects) == {"finite contact size", "multi-contact"}
    effect = effects["finite contact size"]

    def forces(force, sized):
        square = sized * (3 * force * RADIUS / (4 * PLANE_MODULUS / 2)) ** (2 / 3)
        unit, r = force / (np.pi * PLANE_MODULUS), apart
        for _ in range(20):  # the points of contact are moved apart by the tilt of the surface
            slope = unit * (1 / r**2 + 0.6 * square / r**4)
            r = apart + 2 * sized * RADIUS * slope
        sunk = unit * (1 / r + (2 + 2 / 3) * square / (10 * r**3))
        overlap = depth - sunk - 0.5 * sized * RADIUS * slope**2
        return np.array([HERTZ * overlap**1.5, force * slope])

    points, sizes = (
        forces(converged(lambda f, s=sized: forces(f, s)[0], HERTZ * depth**1.5), sized)
        for sized in (0, 1)
    )
    expected = np.linalg.norm(sizes - points) / np.linalg.norm(points)
    assert effect.contacts == 2
    assert effect.size == pytest.approx(expected, rel=1e-3)
