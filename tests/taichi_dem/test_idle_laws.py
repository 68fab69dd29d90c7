"""A law that can make neither force nor torque is as good as none: it is not compiled."""

import dataclasses

import numpy as np
import pytest
from setups import GEL, GLASS, scene, state

import taichi_dem as dem
from taichi_dem import check, cost
from taichi_dem.contacts.law import Law
from taichi_dem.effects import effects_of
from taichi_dem.memory import by_effect

HERTZ, RUBS, ROLLS = dem.Hertz(0.5), dem.Mindlin(0.3), dem.CDT(0.1)
WINDS = {"regularization": "spring", "torsion_torque": True, "rolling_damping": 0.3}
STICKS, SLIPS = dem.JKR(0.01, restitution=0.5), dem.JKR(0.0, restitution=0.5)
OF_TORQUE = ("tangential", "rolling")
NO_FRICTION = "friction coefficient is 0 for every pair of materials"
NO_ROLLING = "rolling friction coefficient is 0 for every pair of materials"
NO_HYSTERESIS = "adhesion hysteresis is 0 for every pair of materials"
NO_WORK = "work of adhesion is 0 for every pair of materials"
NO_BULK = "prefactor is 0 for every pair of materials"
SLOTS = {"friction": "tangential", "multi-contact": "surface"}
IDLE = [
    (dem.Law(HERTZ, dem.Mindlin(0.0)), {"friction": NO_FRICTION}),
    (dem.Law(HERTZ, dem.Mindlin(0, damping=3.0), ROLLS), {"friction": NO_FRICTION}),
    (dem.Law(HERTZ, rolling=dem.CDT(0.0)), {"rolling": NO_ROLLING}),
    (dem.Law(HERTZ, RUBS, dem.CDT(0.0, **WINDS)), {"rolling": NO_ROLLING}),
    (dem.Law(HERTZ, RUBS, dem.CDTJKR(0.0, **WINDS)), {"rolling": NO_WORK}),
    (dem.Law(SLIPS, RUBS, dem.CDTJKR()), {"rolling": NO_WORK}),
    (dem.Law(HERTZ, surface=dem.MultiContact(prefactor=0.0)), {"multi-contact": NO_BULK}),
    (
        dem.Law(STICKS, dem.Mindlin(0.0), dem.CDTJKR(adhesion_hysteresis=0.0)),
        {"friction": NO_FRICTION, "rolling": NO_HYSTERESIS},
    ),
]


def tumbling(law, material=GLASS):
    """Two spheres that fall on a floor and into each other, sliding and turning."""
    return scene(
        position=[[0, 0, 1.01e-3], [1.2e-3, 0, 2.7e-3]],
        radius=1e-3,
        velocity=[[0.05, 0.02, -0.1], [0, 0, -0.2]],
        omega=[[30.0, -80.0, 50.0], [10.0, 20.0, -40.0]],
        boundaries=[dem.Plane((0, 0, 0), (0, 0, 1), material)],
        law=law,
        gravity=(0, 0, -9.81),
    )


def bare(law, off):
    """Without the effects that are ``off``."""
    return law.without(*(SLOTS.get(name, name) for name in off))


@pytest.mark.parametrize(("law", "reasons"), IDLE)
def test_an_idle_law_falls_away(law, reasons):
    """What is compiled is what these say."""
    found = effects_of(tumbling(law))
    expected = effects_of(tumbling(bare(law, reasons)))
    assert dataclasses.replace(found, listed=()) == dataclasses.replace(expected, listed=())
    off = {effect.name: effect.reason for effect in found.listed if not effect.on}
    assert {name: off[name] for name in reasons} == reasons
    others = [[e for e in one.listed if e.name not in reasons] for one in (found, expected)]
    assert others[0] == others[1]
    left_out = {name for name, *_ in cost.variants(tumbling(law), True)}
    assert left_out == {name for name, *_ in cost.variants(tumbling(bare(law, reasons)), True)}


def test_a_law_stays_where_one_pair_needs_it():
    law = dem.Law(HERTZ, dem.Mindlin(0.0), pairs={("gel", "glass"): {"tangential": RUBS}})
    assert effects_of(tumbling(law, GEL)).friction
    assert not effects_of(tumbling(dataclasses.replace(law, pairs={}), GEL)).friction


def test_all_pairs_may_be_idle_for_different_reasons():
    kinds = [("glass", "glass"), ("gel", "gel"), ("glass", "gel")]
    laws = [dem.CDTJKR(0.0), dem.CDTJKR(0.0), dem.CDTJKR(0.1, adhesion_hysteresis=0.0)]
    pairs = {pair: {"rolling": law} for pair, law in zip(kinds, laws, strict=True)}
    law = dem.Law(HERTZ, rolling=dem.CDTJKR(0.1), pairs=pairs)
    found = effects_of(tumbling(law, GEL))
    assert not found.rolling and not any(found.law.pairs.values())
    (rolling,) = (effect for effect in found.listed if effect.name == "rolling")
    both = "work of adhesion is 0 or adhesion hysteresis is 0 for every pair of materials"
    assert rolling.reason == both


def go_alike(first, second, steps):
    """Run both, whose motions must have the same bits all along, and touch now and then."""
    touching = 0
    for _ in range(20):
        first.run(steps=steps // 20)
        second.run(steps=steps // 20)
        assert np.array_equal(state(first), state(second))
        assert np.array_equal(first.contacts()["force"], second.contacts()["force"])
        touching += len(first.contacts())
    assert touching


def test_a_scene_with_idle_laws_is_the_scene_without():
    law = dem.Law(HERTZ, dem.Mindlin(0.0), dem.CDT(0.0, **WINDS))
    first = dem.Simulation(tumbling(law), driver="serial")
    second = dem.Simulation(tumbling(law.without(*OF_TORQUE)), driver="serial")
    assert first.stable == second.stable and first.dt == second.dt
    go_alike(first, second, 400)
    assert first.energy() == second.energy() and "tangential" not in first.energy()
    contacts = first._engine.contacts
    assert {"couple", "torque"}.isdisjoint(contacts.result.keys)
    assert not hasattr(contacts, "history") and not hasattr(contacts, "number")
    assert by_effect(first._engine) == by_effect(second._engine)
    told = first.summary()["effects"]
    for name, reason in {"friction": NO_FRICTION, "rolling": NO_ROLLING}.items():
        assert told[name] == {"on": False, "reason": reason, "memory_bytes": 0}
    assert told["rotation"]["reason"] == "nothing makes torque"
    assert told["history"]["on"] is False
    lines = list(check.effects(first))
    assert f"friction ({NO_FRICTION})" in dict(lines)["off"]
    assert not any("Mindlin" in text or "CDT" in text for _, text in lines)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        dem.Law(HERTZ, dem.Mindlin(0.0, damping=2.0), dem.CDT(0.0, **WINDS)),
        dem.Law(HERTZ, rolling=dem.CDT(0.0, torsion_torque=True)),
        dem.Law(HERTZ, rolling=dem.CDTJKR(0.0, **WINDS)),
        dem.Law(STICKS, rolling=dem.CDTJKR(adhesion_hysteresis=0.0, **WINDS)),
        dem.Law(STICKS, rolling=dem.CDTJKR(adhesion_hysteresis=0.0)),
    ],
)
def test_what_a_law_says_of_itself_is_what_it_computes(law, monkeypatch):
    """Compiled all the same, it changes no bit of a motion."""
    plain = dem.Simulation(tumbling(law), 1e-6, driver="serial")
    monkeypatch.setattr(Law, "idle", lambda *_: {})
    whole = dem.Simulation(tumbling(law), 1e-6, driver="serial")
    assert whole.effects.rotation and not plain.effects.rotation
    go_alike(plain, whole, 2000)
    assert whole.energy()["dissipated"] == pytest.approx(plain.energy()["dissipated"], rel=1e-12)
