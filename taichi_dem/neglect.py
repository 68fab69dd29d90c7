"""Effects that a scene leaves out though they would act on it, and how much they would change.

Each is evaluated on a few states of a run: the elastic contact forces of the scene with it and of
the scene without it, the spheres and boundaries in the same places and at rest.  Nothing that
depends on the past takes part: friction, rolling and damping are off in both, a law that yields
finds its contacts new, and what adhesion holds past zero overlap is apart.  So this is what the
effect does to forces before the spheres have moved in answer to it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from taichi_dem.contacts.multicontact import MultiContact
from taichi_dem.guards import SimulationStopped
from taichi_dem.moments import Moment
from taichi_dem.scene import Scene
from taichi_dem.validation import InputError

THRESHOLD = 0.01  # of the contact forces, from which an effect had better be on


@dataclasses.dataclass(frozen=True)
class Neglected:
    """One effect that is off though it would act.

    size: the median change of the contact forces that it changes, over the median force, in the
    worst of the states; None where it could not be computed, for the ``problem`` that is then said.
    contacts: how many it changes in all states; entry: what turns it on in a scene file, unless it
    is ``barred``, for the reason that is then said.
    """

    name: str
    entry: str
    size: float | None
    contacts: int = 0
    states: int = 0
    problem: str = ""
    barred: str = ""

    def matters(self, threshold: float = THRESHOLD) -> bool:
        """Whether it had better be on."""
        return self.size is None or self.size > threshold

    def sentence(self, threshold: float = THRESHOLD) -> str:
        """For people."""
        if self.size is None:
            return f"{self.name} cannot be estimated: {self.problem}"
        advice = f"turn it on ({self.entry})"
        if self.barred:
            advice = f"but it cannot be turned on here: {self.barred}"
        if self.size == np.inf:
            return f"{self.name} would make forces where there are none: {advice}"
        if self.matters(threshold):
            return (
                f"{self.name} would change the median contact force by {percent(self.size)}: "
                f"{advice}"
            )
        return f"{self.name}: {percent(self.size)} of the median contact force: rightly off"

    def summary(self, threshold: float = THRESHOLD) -> dict[str, Any]:
        """For ``summary.json``."""
        found = dataclasses.asdict(self) | {"threshold": threshold, "turn_on": None}
        if self.size is not None:
            found["turn_on"] = self.matters(threshold) and not self.barred
        return {name: value for name, value in found.items() if name != "name"}


@dataclasses.dataclass(frozen=True)
class _Candidate:
    name: str
    entry: str
    scene: Scene  # with the effect on
    acts: Callable[[Moment], bool]  # whether it changes anything there


def applicable(scene: Scene) -> bool:
    """Whether the scene leaves out an effect that could be turned on."""
    return any(True for _ in _candidates(_bare(scene)))


def turned_on(scene: Scene, name: str) -> Scene | None:
    """The scene with the effect of this name; None where it cannot have it."""
    return next((one.scene for one in _candidates(scene) if one.name == name), None)


def neglected(
    sim: Any, moments: Sequence[Moment] | None = None, say: Callable[[str], None] | None = None
) -> list[Neglected]:
    """What the effects that ``sim`` leaves out would change, at ``moments`` (now, unless given).
    ``sim`` itself is left alone; ``say`` hears what is being compiled."""
    moments = [Moment.of(sim)] if moments is None else list(moments)
    bare = _bare(sim.scene)
    found, without = [], None
    for candidate in _candidates(bare):
        there = [moment for moment in moments if candidate.acts(moment)]
        if not there:
            found.append(Neglected(candidate.name, candidate.entry, 0.0, 0, len(moments)))
            continue
        if say is not None:
            say(f"estimating what is left out: {candidate.name} …")
        try:
            without = without or _forces(bare, moments)
            with_it = _forces(candidate.scene, moments)
        except SimulationStopped as stop:
            found.append(_failed(candidate, str(stop)))
        except InputError as error:  # the first state cannot even be started
            found.append(_failed(candidate, str(error.problems[0])))
        else:
            size, contacts = change(without, with_it)
            found.append(Neglected(candidate.name, candidate.entry, size, contacts, len(moments)))
    return [dataclasses.replace(one, **_turning_on(sim.scene, one.name)) for one in found]


def change(without: Sequence[np.ndarray], with_it: Sequence[np.ndarray]) -> tuple[float, int]:
    """``Neglected.size`` and ``contacts``, by the contact records of each state.

    The force that a change is measured by is the median of the state, or of all states where that
    is larger: spheres that barely touch in an early state say little.
    """
    pairs = [_matched(*records) for records in zip(without, with_it, strict=True)]
    changed = [(here != there).any(axis=1) for here, there in pairs]
    size = [np.linalg.norm(here[of], axis=1) for (here, _), of in zip(pairs, changed, strict=True)]
    pooled = np.concatenate(size)
    if not len(pooled):
        return 0.0, 0
    worst, typical = 0.0, float(np.median(pooled))
    for (here, there), of, force in zip(pairs, changed, size, strict=True):
        if of.any():
            by = float(np.median(np.linalg.norm((there - here)[of], axis=1)))
            scale = max(typical, float(np.median(force)))
            worst = max(worst, by / scale if scale > 0 else np.inf)
    return worst, len(pooled)


def percent(share: float) -> str:
    """Two digits: 12 %, 0.02 %."""
    return f"{float(f'{100 * share:.2g}'):g} %"


def _bare(scene: Scene) -> Scene:
    """The scene without what depends on the past, its contacts on the ground solved together at
    every step if they feel each other at all; nobody sleeps, and ground that creeps is as stiff as
    it is at once."""
    ground = scene.substrate
    if ground is not None:
        together = "implicit" if ground.exchange == "lagged" else ground.exchange
        ground = dataclasses.replace(ground, exchange=together, exchange_every=1, relaxation=None)
    bare = scene.law.without("tangential", "rolling")
    return dataclasses.replace(scene, law=bare, substrate=ground, sleep=False)


def _turning_on(scene: Scene, name: str) -> dict[str, Any]:
    """What turns an effect on in the scene as it is, and why that cannot be done though it acts."""
    entry, changes = next((entry, how) for one, entry, how, _ in _changes(scene) if one == name)
    try:
        dataclasses.replace(scene, **changes())
    except InputError as error:
        return {"entry": entry, "barred": "; ".join(str(problem) for problem in error.problems)}
    return {"entry": entry, "barred": ""}


def _candidates(scene: Scene) -> Iterator[_Candidate]:
    for name, entry, changes, acts in _changes(scene):
        try:
            yield _Candidate(name, entry, dataclasses.replace(scene, **changes()), acts)
        except InputError:  # nothing that this scene can have
            continue


def _changes(scene: Scene) -> Iterator[tuple[str, str, Callable[[], dict[str, Any]], Any]]:
    """Name, entry in a scene file, what changes in the scene, and where that acts."""
    ground, law = scene.substrate, scene.law

    def soil(**changes: Any) -> Callable[[], dict[str, Any]]:
        return lambda: {"substrate": dataclasses.replace(ground, **changes)}  # type: ignore[type-var]

    def several(moment: Moment) -> bool:
        return moment.grounded > 1

    if ground is not None and ground.exchange == "none":
        entry = 'substrate.exchange = "implicit"'
        yield "substrate coupling", entry, soil(exchange="implicit"), several
    elif ground is not None and ground.coupling == "point":
        entry = 'substrate.coupling = "finite"'
        yield "finite contact size", entry, soil(coupling="finite"), several
    if law.surface is None:
        surface, entry = MultiContact(), 'law.surface = { type = "MultiContact" }'
        if ground is not None and (ground.exchange == "lagged" or ground.relaxation is not None):
            surface = MultiContact(exchange="lagged")
            entry = 'law.surface = { type = "MultiContact", exchange = "lagged" }'
        yield (
            "multi-contact",
            entry,
            lambda: {"law": dataclasses.replace(law, surface=surface)},
            lambda moment: moment.crowded,
        )


def _forces(scene: Scene, moments: Sequence[Moment]) -> list[np.ndarray]:
    """The contact records of ``scene`` at each moment."""
    from taichi_dem.simulation import Simulation

    still = np.zeros_like(scene.spheres.position)
    sim = Simulation(scene, driver="serial", max_overlap=1.0, energy_balance=False)
    found = []
    for moment in moments:
        there = dataclasses.replace(
            scene.spheres, position=moment.position, velocity=still, omega=still
        )
        sim._restart(there, None, moment.motion)
        found.append(sim.contacts())
    return found


def _matched(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces (c, 3) of the contacts that either has, zero where one has none."""
    both = [
        np.column_stack([records[name] for name in ("i", "j", "face")])
        for records in (first, second)
    ]
    each, place = np.unique(np.concatenate(both), axis=0, return_inverse=True)
    place = place.reshape(-1)
    forces = np.zeros((2, len(each), 3))
    forces[0, place[: len(first)]] = first["force"]
    forces[1, place[len(first) :]] = second["force"]
    return forces[0], forces[1]


def _failed(candidate: _Candidate, problem: str) -> Neglected:
    return Neglected(candidate.name, candidate.entry, None, problem=problem)
