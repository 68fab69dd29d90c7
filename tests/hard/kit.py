"""What a hard case is: a scene that is known to break codes, run under each driver and exchange
that it says, and figures that must stay within bounds which follow from physics or the scheme."""

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

import taichi_dem as dem
from taichi_dem.settings import exchange_keys
from tests.taichi_dem.setups import EPS

DRIVERS = ("serial", "parallel")
# All drivers make the same bits. A team's members meet several times a step and wait busily, which
# is slow where others use the cores: it runs only the cases in which they share more than spheres
# and contacts, the passes of a substrate's solve and of the expansions.
TEAM = "team"
VERLET_LIMIT = 2.0  # omega dt at which velocity Verlet ceases to be stable


@dataclass(frozen=True)
class Figure:
    """``value`` must not exceed ``bound``; not-a-number exceeds everything."""

    what: str
    value: float
    bound: float

    @property
    def holds(self) -> bool:
        return bool(self.value <= self.bound)


@dataclass(frozen=True)
class Setting:
    """How a case is run; ``exchange``: of ``Substrate``, or "every m" (steps)."""

    driver: str
    exchange: str | None = None

    def posed(self, scene: dem.Scene) -> dem.Scene:
        """``scene`` under this exchange, if it has a substrate."""
        if self.exchange is None or scene.substrate is None:
            return scene
        substrate = replace(scene.substrate, **exchange_keys(self.exchange))
        return replace(scene, substrate=substrate)

    def simulation(self, scene: dem.Scene, **options) -> dem.Simulation:
        """``scene`` under this driver and exchange; quiet."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return dem.Simulation(self.posed(scene), driver=self.driver, **options)

    def attempt(self, sim: dem.Simulation, dt: float, steps: int) -> BaseException | None:
        """What is raised by so many steps of ``dt`` (s) from the start."""

        def run() -> None:
            sim.restart(dt=dt)
            sim.run(steps=steps)

        return outcome(run)

    def __str__(self) -> str:
        return self.driver if self.exchange is None else f"{self.driver}, {self.exchange}"


@dataclass(frozen=True)
class Case:
    """``run(setting)`` yields the figures; ``kind`` is the module that it stands in; one that is
    ``seldom`` run is left to the slow tests."""

    kind: str
    name: str
    run: Callable[[Setting], Iterable[Figure]]
    settings: tuple[Setting, ...]
    seldom: bool = False

    def figures(self, setting: Setting) -> list[Figure]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            return list(self.run(setting))


CASES: list[Case] = []


def hard(
    name: str,
    *values,
    exchanges: tuple[str | None, ...] = (None,),
    drivers=DRIVERS,
    seldom: bool = False,
):
    """Register a case, or one for each of ``values``, which ``name`` and the function then take."""

    def register(run):
        kind = run.__module__.rpartition(".")[2]
        settings = tuple(Setting(*both) for both in product(drivers, exchanges))
        if not values:
            CASES.append(Case(kind, name, run, settings, seldom))
        for value in values:
            CASES.append(Case(kind, name.format(value), _with(run, value), settings, seldom))
        return run

    return register


def _with(run, value):
    return lambda setting: run(setting, value)


def settings_of(kind: str):
    """The cases of a kind for a test: the first setting of each every time unless it is seldom run,
    the others if slow ones are asked for."""
    return pytest.mark.parametrize(
        ("case", "setting"),
        [
            pytest.param(
                case,
                setting,
                id=f"{case.name} [{setting}]",
                marks=[pytest.mark.slow] if case.seldom or setting != case.settings[0] else [],
            )
            for case in CASES
            if case.kind == kind
            for setting in case.settings
        ],
    )


def assert_holds(case: Case, setting: Setting) -> None:
    """That every figure is within its bound."""
    figures = case.figures(setting)
    assert figures
    assert not [f"{f.what}: {f.value:.3g} > {f.bound:.3g}" for f in figures if not f.holds]


# -- figures that many cases share -----------------------------------------------------------------


def finite(sim: dem.Simulation) -> Figure:
    """How many numbers of the state are not finite."""
    state = sim.particles
    values = np.hstack([state.position, state.velocity, state.omega, state.force])
    return Figure("numbers not finite", float((~np.isfinite(values)).sum()), 0)


def energy(
    sim: dem.Simulation, scale: float, share: float, what="energy unaccounted for"
) -> Figure:
    """The balance error over ``scale`` (J): energy made from nothing, or lost without a word."""
    return Figure(what, abs(sim.energy()["balance_error"]) / scale, share)


def wobble(sim: dem.Simulation) -> float:
    """The share by which Verlet's energy may swing: (omega dt)^2 / 4 covers a spring that stiffens,
    at the twentieth of a half period that the stable step is, scaled by the step in use."""
    return 0.25 * (math.pi / 20 * sim.dt / sim.stable.value) ** 2


def momentum(sim: dem.Simulation, before: np.ndarray, scale: float, steps: int) -> Figure:
    """Change of the spheres' momentum over ``scale`` (kg m/s): rounding alone, step by step."""
    change = np.abs(total_momentum(sim) - before).max() / scale
    return Figure("momentum made", float(change), 8 * EPS * max(steps, 1) ** 0.5 + 8 * EPS)


def total_momentum(sim: dem.Simulation) -> np.ndarray:
    state = sim.particles
    return (state.mass[:, None] * state.velocity).sum(axis=0)


def kinetic(sim: dem.Simulation) -> float:
    return float(sim.energy()["kinetic"])


def outcome(run: Callable[[], object]) -> BaseException | None:
    """What ``run()`` raises."""
    try:
        run()
    except Exception as error:
        return error
    return None


def refused(error: BaseException | None, kind: type, *words: str) -> Iterator[Figure]:
    """That it was refused, in words that help."""
    yield Figure("not refused", 0.0 if isinstance(error, kind) else 1.0, 0)
    text = str(error)
    yield Figure("words missing", float(sum(word not in text for word in words)), 0)
