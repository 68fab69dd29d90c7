"""What each effect of a scene costs: steps of the scene timed against steps of it without one.

All start again and again from the same state and take turns; a figure is the median over the turns.
Times are those of the processor where one thread makes the steps, of the wall otherwise.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
import warnings
from collections.abc import Callable, Collection, Iterator
from typing import Any

from taichi_dem.contacts.cdt_jkr import CDTJKR
from taichi_dem.contacts.hertz import Hertz
from taichi_dem.effects import effects_of
from taichi_dem.guards import SimulationStopped
from taichi_dem.scene import Scene
from taichi_dem.shapes import Boundary, Piston, Plane
from taichi_dem.simulation import Simulation
from taichi_dem.validation import InputError

ROUNDS = 5
SECONDS = 0.3  # of a turn
FEWEST, MOST = 100, 20_000  # steps of a turn


@dataclasses.dataclass(frozen=True)
class Cost:
    """Of one effect: seconds of a step ``on`` and ``off``, for each turn; none where the scene
    without it was stopped, for the ``problem`` that is then said."""

    name: str
    on: tuple[float, ...] = ()
    off: tuple[float, ...] = ()
    problem: str = ""

    @property
    def ratios(self) -> list[float]:
        """The time of a step over that without the effect."""
        return [on / off for on, off in zip(self.on, self.off, strict=True)]

    @property
    def shares(self) -> list[float]:
        """What the effect takes of the time of a step; below zero it is lost in the noise."""
        return [1 - 1 / ratio for ratio in self.ratios]

    def words(self) -> str:
        """For people."""
        if not self.on:
            return f"{self.name} cannot be told: {self.problem}"
        shares = sorted(self.shares)
        median = statistics.median(shares)
        return f"{self.name} {median:.0%} ({shares[0]:.0%} to {shares[-1]:.0%})"

    def summary(self) -> dict[str, Any]:
        """For ``summary.json``."""
        if not self.on:
            return {"share_of_step": None, "share_problem": self.problem}
        shares = self.shares
        return {
            "share_of_step": statistics.median(shares),
            "share_spread": [min(shares), max(shares)],
        }


def measure(
    sim: Simulation,
    rounds: int = ROUNDS,
    seconds: float = SECONDS,
    only: Collection[str] | None = None,
) -> list[Cost]:
    """The cost of every effect of ``sim`` that can be left out (or of those ``only``), from its
    present state on; ``sim`` itself is left alone. Each effect is compiled out once, which takes
    seconds."""
    course = _Course(sim)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        whole = course.simulation(sim.scene, sim.effects.losses)
        course.run(whole, FEWEST)
        others: dict[str, Simulation] = {}
        failed = []
        for name, scene, books in variants(sim.scene, sim.effects.losses):
            if only is not None and name not in only:
                continue
            try:
                other = course.simulation(scene, books)
                course.run(other, FEWEST)
            except (InputError, SimulationStopped) as error:
                failed.append(Cost(name, problem=str(error)))
            else:
                others[name] = other
        steps = _steps(seconds / course.run(whole, FEWEST))
        turns = [
            (course.run(whole, steps), {name: course.run(o, steps) for name, o in others.items()})
            for _ in range(rounds)
        ]
    on = tuple(of_whole for of_whole, _ in turns)
    return [*(Cost(name, on, tuple(off[name] for _, off in turns)) for name in others), *failed]


def measure_pair(
    name: str, on: Simulation, off: Simulation, rounds: int = ROUNDS, seconds: float = SECONDS
) -> Cost:
    """The cost of an effect that wants a state of its own: steps of ``on``, which has it, and of
    ``off``, from where each of them is."""
    steps = {sim: _steps(seconds / _step_time(sim, FEWEST)) for sim in (on, off)}
    turns = [[_step_time(sim, steps[sim]) for sim in (on, off)] for _ in range(rounds)]
    return Cost(name, tuple(turn[0] for turn in turns), tuple(turn[1] for turn in turns))


def lines(sim: Simulation, found: list[Cost]) -> Iterator[str]:
    """For people: the costs ``found`` in the present state of ``sim``."""
    if not found:
        yield "there is no effect that could be left out"
        return
    turns = max(len(effect.on) for effect in found)
    yield (
        f"share of the time of a step at {sim.coordination():.2g} contacts per sphere, median "
        f"(and spread) of {turns} turns:"
    )
    yield from (effect.words() for effect in found)


class _Course:
    """Runs from the present state of ``sim``, with its step and driver."""

    def __init__(self, sim: Simulation):
        now = sim.particles
        self._place = {name: getattr(now, name) for name in ("position", "velocity", "omega")}
        self._motion = sim._engine.boundaries.read()
        self._dt, self._driver = sim.dt, sim.summary()["driver"]

    def simulation(self, scene: Scene, books: bool) -> Simulation:
        """One of ``scene``, to be run."""
        return Simulation(
            scene, self._dt, driver=self._driver, max_overlap=1.0, energy_balance=books
        )

    def run(self, sim: Simulation, steps: int) -> float:
        """Seconds of a step."""
        spheres = dataclasses.replace(sim.scene.spheres, **self._place)
        sim._restart(spheres, self._dt, self._motion)
        return _step_time(sim, steps)


def _step_time(sim: Simulation, steps: int) -> float:
    """Seconds of a step, over as many."""
    # One thread's own time, which others who use the cores do not add to.
    serial = sim.summary()["driver"] == "serial"
    clock: Callable[[], float] = time.process_time if serial else time.perf_counter
    start = clock()
    sim.run(steps=steps)
    return (clock() - start) / steps


def _steps(wanted: float) -> int:
    """Of a turn."""
    return int(min(max(wanted, FEWEST), MOST))


def variants(scene: Scene, books: bool) -> Iterator[tuple[str, Scene, bool]]:
    """Each effect that can be left out, the scene without it, and whether that keeps books of what
    is lost."""
    scene = dataclasses.replace(scene, law=effects_of(scene).law)
    law, ground = scene.law, scene.substrate

    def without(slot: str) -> Scene:
        return dataclasses.replace(scene, law=law.without(slot))

    if law.tangential is not None:
        yield "friction", without("tangential"), books
    if law.rolling is not None:
        yield "rolling", without("rolling"), books
    if getattr(law.normal, "adhesive", False) and not isinstance(law.rolling, CDTJKR):
        yield "adhesion", _not_sticking(scene), books
    if law.surface is not None:
        yield "multi-contact", without("surface"), books
    if ground is not None and ground.exchange != "none":
        rigid = dataclasses.replace(
            ground, exchange="none", exchange_every=1, layer=None, relaxation=None
        )
        yield "substrate coupling", dataclasses.replace(scene, substrate=rigid), books
        if ground.exchange == "lagged":
            implicit = dataclasses.replace(ground, exchange="implicit")
            yield "lagged exchange", dataclasses.replace(scene, substrate=implicit), books
        if ground.exchange_every > 1:
            solved = dataclasses.replace(ground, exchange_every=1)
            yield "extrapolated exchange", dataclasses.replace(scene, substrate=solved), books
        if ground.coupling == "finite":
            points = dataclasses.replace(ground, coupling="point")
            yield "finite contact size", dataclasses.replace(scene, substrate=points), books
        if ground.layer is not None:
            deep = dataclasses.replace(ground, layer=None)
            yield "layer", dataclasses.replace(scene, substrate=deep), books
        if ground.relaxation is not None:
            lasting = dataclasses.replace(ground, relaxation=None)
            yield "relaxation", dataclasses.replace(scene, substrate=lasting), books
    if any(wall.moves for wall in scene.boundaries):
        still = tuple(_standing(wall) for wall in scene.boundaries)
        yield "moving boundaries", dataclasses.replace(scene, boundaries=still), books
    if scene.sleep:
        yield "sleep", dataclasses.replace(scene, sleep=False), books
    if books:
        yield "dissipation", scene, False


def _not_sticking(scene: Scene) -> Scene:
    """Hertz in place of a law that sticks, or yields and sticks, with the same restitution."""
    law = scene.law
    pairs = {
        names: {**laws, "normal": Hertz(laws["normal"].restitution)} if "normal" in laws else laws
        for names, laws in law.pairs.items()
    }
    plain = dataclasses.replace(law, normal=Hertz(law.normal.restitution), pairs=pairs)
    return dataclasses.replace(scene, law=plain)


def _standing(wall: Boundary) -> Boundary:
    if isinstance(wall, Plane):
        return dataclasses.replace(wall, velocity=(0.0, 0.0, 0.0))
    if isinstance(wall, Piston):
        return dataclasses.replace(wall, velocity=0.0, program=None, load=None, mass=None)
    return wall
