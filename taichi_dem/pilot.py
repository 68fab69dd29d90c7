"""Short runs of a scene that tell how its error goes with the settings.

A pilot covers a run from its start for as long as trajectories are comparable, and no longer than
``MOST_WORK`` particle-steps at the stable step take (a count, so that the same scene gives the same
settings on every machine).
"""

from __future__ import annotations

import warnings

import numpy as np

from taichi_dem import accuracy
from taichi_dem.contact_list import SUBSTRATE
from taichi_dem.moments import Moments
from taichi_dem.neglect import Neglected, neglected
from taichi_dem.record import SAMPLES, Record, even_step, record
from taichi_dem.scene import Scene
from taichi_dem.settings import EVERY, Settings
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
        self._steep: set[Settings] = set()
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

    def is_steep(self, settings: Settings) -> bool:
        """Whether contacts swing so far between two exchanges that a run would warn of it."""
        self.record(settings)
        return settings in self._steep

    def grounded(self, settings: Settings) -> int:
        """The most contacts with the substrate at a time."""
        contact = self.record(settings).contact
        samples = contact[contact[:, 2] == SUBSTRATE, 0].astype(np.int64)
        return int(np.bincount(samples, minlength=1).max())

    def left_out(self) -> list[Neglected]:
        """What the effects would change that no setting turns on (:mod:`taichi_dem.neglect`)."""
        sim, seen = self._simulation(self.tight), Moments(self.window)
        self._restart(sim, self.stable, 0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            sim.run(duration=self.window, outputs=[seen])
        return neglected(sim, seen.kept)

    def _run(self, settings: Settings, step: float, member: int) -> Record:
        sim = self._simulation(settings)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            self._restart(sim, step, member)
            found = record(sim, self.window, SAMPLES)
        if "sparse_exchange" in sim.warnings:
            self._steep.add(settings)
        return found

    def _restart(self, sim: Simulation, step: float, member: int) -> None:
        sim.restart(
            accuracy.perturbed(self.scene.spheres, member),
            dt=even_step(step, self.window, SAMPLES),
        )

    def _simulation(self, settings: Settings) -> Simulation:
        """One for all steps, and for all that are solved for every few of them: it is compiled
        once."""
        compiled = settings.but("step", 0.0)
        if settings.every > 1:
            compiled = compiled.but("exchange", f"{EVERY}2")
        if compiled not in self._simulations:
            self._simulations[compiled] = Simulation(compiled.applied(self.scene))
        sim = self._simulations[compiled]
        if settings.every > 1 and (exchange := sim._engine.exchange) is not None:
            exchange.between.every[None] = settings.every
        return sim
