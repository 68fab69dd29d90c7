"""Random valid scenes of every law and ground: no exception but a guard's, no not-a-number, no
energy made."""

import traceback
import warnings
from collections import Counter

import numpy as np
import pytest

import taichi_dem as dem
from tests.hard.kit import finite, wobble
from tests.hard.late_surfaces import LateSurfaces
from tests.hard.random_scenes import drawn

SCENES, PORTION = 200, 20
STEPS, LOOK = 2000, 100
SHARE = 0.6  # of a portion that no guard stops, at least; 18 of 20 in the first
SWINGS = 4  # contacts that a sphere swings between along one line: so much stiffer than one


def kinds(problem):
    """What has been drawn, in words."""
    law, ground = problem.law, problem.substrate
    yield from (type(part).__name__ for part in law.parts().values())
    yield f"{law.surface.exchange} surfaces" if law.surface else "no surface law"
    yield "periodic" if problem.period else "walls"
    yield from {wall.kind for wall in problem.boundaries if wall.moves}
    yield from ["sleep"] * problem.sleep + ["pairs"] * bool(law.pairs)
    if ground is None:
        yield "floor"
        return
    creeps, layer = ground.relaxation is not None, ground.layer is not None
    way = "creeping" if creeps else "every" if ground.exchange_every > 1 else ground.exchange
    yield f"{way}, {ground.coupling}"
    yield f"{way}, {'layer' if layer else 'half-space'}"


def test_every_kind_is_drawn_and_accepted():
    """Each by itself, and each surface law on each kind of ground that goes with it."""
    scenes = [list(kinds(drawn(number))) for number in range(SCENES)]
    seen = Counter(kind for scene in scenes for kind in scene)
    ways = ("implicit", "lagged", "every", "none")
    wanted = [f"{way}, {coupling}" for way in ways for coupling in ("finite", "point")]
    wanted += [
        f"{way}, {below}" for way in (*ways[:3], "creeping") for below in ("layer", "half-space")
    ]
    wanted += ["creeping, point", "floor", "periodic", "walls", "sleep", "pairs", "no surface law"]
    wanted += ["Hertz", "Hooke", "JKR", "EEPA", "Mindlin", "CDT", "CDTJKR", "Piston", "Plane"]
    assert not [kind for kind in wanted if not seen[kind]]
    both = {(surface, kind) for scene in scenes for surface in scene for kind in scene}
    for way in ("floor", "implicit, layer", "implicit, half-space", "none, half-space"):
        assert ("implicit surfaces", way) in both
    for way in ("lagged, layer", "creeping, layer", "implicit, layer", "floor"):
        assert ("lagged surfaces", way) in both


def holds(problem):
    """Run ``problem``; a guard may stop it with its reason, nothing else may happen.

    What moves and what is held never become more but for the work of walls, and of surfaces that
    answer late; Verlet makes at most ``wobble`` of the energy of a contact that swings.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sim = dem.Simulation(problem, driver="serial", max_overlap=1.0)
        late = LateSurfaces(sim)
        scale, least, height = 0.0, np.inf, sim.energy()["gravity"]
        while True:
            parts = dict(sim.energy())
            parts["gravity"] -= height
            error, _ = parts.pop("balance_error"), parts.pop("dissipated", None)
            scale = max(scale, sum(map(abs, parts.values())))
            made = SWINGS * wobble(sim) * scale + late.unsure
            put_in = parts.pop("external_work") + late.work
            now = sum(part for name, part in parts.items() if name not in late.without) - put_in
            assert finite(sim).holds
            assert now <= least + made
            assert late.present or abs(error) <= made
            if sim.steps == STEPS:
                return sim
            least = min(least, now)
            try:
                late.run(LOOK)
            except dem.SimulationStopped as stop:
                assert "not a number" not in str(stop) and "try" in str(stop).lower()
                assert finite(sim).holds
                return sim


@pytest.mark.slow
@pytest.mark.parametrize(
    "portion", range(SCENES // PORTION), ids=lambda portion: f"portion{portion}"
)
def test_random_scenes_hold(portion):
    """And most are not stopped: a guard that stops them all would hide whatever comes after."""
    reached, broken = [], []
    for number in range(portion * PORTION, (portion + 1) * PORTION):
        try:
            reached.append(holds(drawn(number)).steps)
        except Exception as error:
            broken.append(f"scene {number}: {type(error).__name__}: {error}")
            traceback.print_exc()
    told = f"steps reached, of {STEPS}: {sorted(reached)}"
    print(told)
    assert not broken
    assert reached.count(STEPS) >= SHARE * PORTION, told
