"""A setting that keeps what a case runs, so that other codes can be given the same."""

from collections.abc import Callable
from dataclasses import dataclass, field

import taichi_dem as dem
from tests.hard.kit import Setting


@dataclass
class Trial:
    """One simulation of a case; ``held``: J in its contacts at the start; ``refused``: the step (s)
    that it was not made with; ``asked``: how many it should have made then, or when it
    ``stopped``, and why it did."""

    sim: dem.Simulation
    held: float
    refused: float | None = None
    stopped: str = ""
    asked: int = 0

    @property
    def dt(self) -> float:
        """s, the step that others are to make."""
        return self.refused or self.sim.dt

    @property
    def steps(self) -> int:
        """How many of them."""
        return max(self.sim.steps, self.asked)


@dataclass(frozen=True)
class Witness(Setting):
    """``admit(scene)`` raises before anything is compiled where nobody else can have the scene.

    A trial is taken to begin as its scene says: those that start again from elsewhere are of
    scenes (that sleep, or whose ground gives) which nobody else can have.
    """

    admit: Callable[[dem.Scene], None] = field(default=lambda scene: None, compare=False)
    trials: list[Trial] = field(default_factory=list, compare=False)

    def simulation(self, scene: dem.Scene, **options) -> dem.Simulation:
        self.admit(self.posed(scene))
        sim = super().simulation(scene, **options)
        trial = Trial(sim, held=sim.energy()["normal"])
        self.trials.append(trial)
        make_steps = sim.run

        def run(**asked) -> None:
            before = sim.steps
            try:
                make_steps(**asked)
            except dem.SimulationStopped as reason:
                more = asked.get("steps") or round(asked["duration"] / sim.dt)
                trial.stopped, trial.asked = str(reason), before + more
                raise

        sim.run = run
        return sim

    def attempt(self, sim: dem.Simulation, dt: float, steps: int) -> BaseException | None:
        error = super().attempt(sim, dt, steps)
        if isinstance(error, dem.InputError):
            trial = next(trial for trial in self.trials if trial.sim is sim)
            trial.refused, trial.stopped, trial.asked = dt, str(error), steps
        return error
