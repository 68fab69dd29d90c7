"""Short runs of a scene that tell how its error goes with the settings.

A pilot covers a run from its start for as long as trajectories are comparable, and no longer than
``MOST_WORK`` particle-steps at the stable step take (a count, so that the same scene gives the same
settings on every machine).
"""

from __future__ import annotations

import warnings

from taichi_dem import accuracy
from taichi_dem.record import SAMPLES, Record, even_step, record
from taichi_dem.scene import Scene
from taichi_dem.settings import Settings
from taichi_dem.simulation import Simulation

MOST_WORK = 1e7  # particle-steps


class Pilot:
    """Runs of ``scene``, ``duration`` (s) long, with any settings; each is computed once.

    ``window``: s from the start that are compared; ``chaotic``: whether that is less than all
    because trajectories part; ``stable``: the stable step, s.
    """

    def __init__(self, scene: Scene, duration: float):
        self.scene = scene
        self._simulations: dict[Settings, Simulation] = {}
        self._records: dict[Settings, Record] = {}
        self.tight = Settings.tightest(scene, 0.0)
        stable = self._simulation(self.tight).stable.value
        self.window = min(duration, MOST_WORK / scene.spheres.count * stable)
        self.chaotic = False
        last = 0
        while last < accuracy.FEWEST:
            self.stable = even_step(stable, self.window)  # so that halves of it are halves
            first = self.record(self.tight.but("step", self.stable))
            last = accuracy.comparable(first, self._run(self.tight, self.stable, 1))
            if last < first.samples:
                self.chaotic = True
                self.window *= max(last, 1) / first.samples
                self._records.clear()
        self.stable = even_step(stable, self.window)

    def record(self, settings: Settings) -> Record:
        """What a run with ``settings`` gives."""
        if settings not in self._records:
            self._records[settings] = self._run(settings, settings.step, 0)
        return self._records[settings]

    def distance(self, settings: Settings, reference: Settings) -> dict[str, float]:
        """Errors of one run against another, by name."""
        reference_run = self.record(reference)
        return accuracy.errors(self.record(settings), reference_run, reference_run.samples)

    def _run(self, settings: Settings, step: float, member: int) -> Record:
        sim = self._simulation(settings.but("step", 0.0))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            sim.restart(
                accuracy.perturbed(self.scene.spheres, member),
                dt=even_step(step, self.window, SAMPLES),
            )
            return record(sim, self.window, SAMPLES)

    def _simulation(self, settings: Settings) -> Simulation:
        """One for all steps: it is compiled once."""
        if settings not in self._simulations:
            self._simulations[settings] = Simulation(settings.applied(self.scene))
        return self._simulations[settings]
