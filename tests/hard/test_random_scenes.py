"""Random valid scenes of every law and ground: no exception but a guard's, no not-a-number, no
energy made."""

import warnings
from collections import Counter

import numpy as np
import pytest

import taichi_dem as dem
from tests.hard.kit import finite, wobble
from tests.hard.random_scenes import drawn

SCENES, PORTION = 200, 20
STEPS, LOOK = 2000, 100
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


class MovingSurfaces:
    """What surfaces do that do not answer to the forces of the present step.

    A contact that rests on a surface which rises by itself gets F times that rise: with the spheres
    held it is all that such an exchange can make. ``work``, J, is the sum of its size over steps.
    """

    def __init__(self, sim):
        self.sim, self.work = sim, 0.0
        self.before = self.look()

    @staticmethod
    def present(problem):
        ground, surface = problem.substrate, problem.law.surface
        late = ground is not None and (ground.exchange == "lagged" or ground.exchange_every > 1)
        return late or (surface is not None and surface.lagged)

    def look(self):
        """By contact: force, N; how far its surfaces have risen, m; slope; place, m."""
        found, records, nothing = {}, self.sim.contacts(), np.zeros(2)
        if self.sim.scene.law.surface is not None:
            for one in records:
                key = int(one["i"]), int(one["j"]), int(one["face"])
                force = np.linalg.norm(one["force"])
                found[key] = force, one["expansion"].sum(), nothing, nothing
        ground = self.sim.substrate
        if ground is not None:
            values = (
                ground.particle,
                ground.force,
                ground.expansion,
                ground.slope,
                ground.position,
            )
            for i, force, *rest in zip(*values, strict=True):
                found[int(i), "ground"] = abs(force), *rest
        return found

    def step(self):
        self.sim.run(steps=1)
        now = self.look()
        for key in now.keys() | self.before.keys():
            nothing = 0.0, 0.0, np.zeros(2), (now.get(key) or self.before[key])[3]
            a, b = self.before.get(key, nothing), now.get(key, nothing)
            slope = max(np.linalg.norm(a[2]), np.linalg.norm(b[2]))
            moved = abs(b[1] - a[1]) + slope * np.linalg.norm(b[3] - a[3])
            self.work += max(a[0], b[0]) * moved
        self.before = now


def holds(problem):
    """Run ``problem``; a guard may stop it with its reason, nothing else may happen.

    Of conservative forces Verlet makes at most ``wobble`` of the energy of a contact that swings; a
    surface that moves by itself its work, beside what it is said to hold. What has been lost never
    comes back, within the same.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sim = dem.Simulation(problem, driver="serial", max_overlap=1.0)
        late = MovingSurfaces(sim) if MovingSurfaces.present(problem) else None
        scale, lost, held, stopped = 0.0, 0.0, 0.0, None
        height = sim.energy()["gravity"]
        for _ in range(0, STEPS + 1, LOOK):
            parts = dict(sim.energy())
            held = max(held, abs(parts.get("substrate", 0.0)) + abs(parts.get("expansion", 0.0)))
            parts["gravity"] -= height
            turned_over = set(parts) - {"dissipated", "balance_error"}
            scale = max(scale, sum(abs(parts[name]) for name in turned_over))
            made = SWINGS * wobble(sim) * scale
            if late:
                made += late.work + 2 * held
            assert finite(sim).holds
            assert parts["balance_error"] <= made
            assert parts.get("dissipated", 0.0) >= lost - made
            lost = max(lost, parts.get("dissipated", 0.0))
            if stopped or sim.steps == STEPS:
                break
            try:
                if late:
                    for _ in range(LOOK):
                        late.step()
                else:
                    sim.run(steps=LOOK)
            except dem.SimulationStopped as stop:
                stopped = str(stop)
                assert "not a number" not in stopped and "try" in stopped.lower()
    return sim, stopped


@pytest.mark.slow
@pytest.mark.parametrize(
    "number", range(SCENES), ids=lambda number: f"portion{number // PORTION}-{number}"
)
def test_random_scene_holds(number):
    holds(drawn(number))
