"""Short runs of a scene that tell how its error goes with the settings.

A pilot covers a run from its start for as long as trajectories are comparable, and no longer than
``MOST_WORK`` particle-steps at the stable step take (a count, so that the same scene gives the same
settings on every machine).  Where that is not the whole run, it starts when something is about to
touch: of spheres in flight no setting can be judged.
"""

from __future__ import annotations

import dataclasses
import math
import warnings

import numpy as np

from taichi_dem import accuracy
from taichi_dem.contact_list import SUBSTRATE
from taichi_dem.guards import SimulationStopped
from taichi_dem.moments import Moments
from taichi_dem.neglect import Neglected, neglected
from taichi_dem.record import SAMPLES, Record, even_step, record
from taichi_dem.scene import Scene
from taichi_dem.settings import EVERY, Settings
from taichi_dem.simulation import Simulation

MOST_WORK = 1e7  # particle-steps
LOOKS = 8  # in as much time as that, for the end of a flight
STRAIGHT = 1e-9  # radii, off the parabola that a sphere follows which touches nothing
SMALLER = 3  # times half the stable step, where a guard stops it
STEADY = 0.5  # of the most contacts with the ground, there from the start


class Pilot:
    """Runs of ``scene``, ``duration`` (s) long, with any settings; each is computed once.

    ``window``: s from ``start`` (s) that are compared; ``chaotic``: whether that is less than all
    because trajectories part; ``whole``: whether it is all of the run but for a flight; ``stable``:
    the stable step, s.
    """

    def __init__(self, scene: Scene, duration: float):
        self.scene = scene
        self._simulations: dict[Settings, Simulation] = {}
        self._records: dict[Settings, Record] = {}
        self._steep: set[Settings] = set()
        self.tight = Settings.tightest(scene, 0.0)
        self.start = 0.0
        stable = self._simulation(self.tight).stable.value
        self.window = min(duration, MOST_WORK / scene.spheres.count * stable)
        if self.window < duration:
            self._skip_flight(duration)
        for smaller in range(SMALLER + 1):
            self.stable = stable / 2**smaller
            try:
                return self._compare(duration - self.start)
            except SimulationStopped:  # a smaller step may get through
                self._records.clear()
                if smaller == SMALLER:
                    raise

    def _compare(self, left: float) -> None:
        """Find how long trajectories can be compared in the ``left`` time (s) of the run."""
        stable, last = self.stable, 0
        self.window = min(left, self.window)
        self.whole, self.chaotic = self.window >= left, False
        if not self.whole:
            self.window = _of_whole_steps(self.window, stable, left)
        while last < accuracy.FEWEST:
            self.stable = even_step(stable, self.window)  # so that halves of it are halves
            first = self.record(self.tight.but("step", self.stable))
            last = accuracy.comparable(first, self._run(self.tight, self.stable, 1))
            if last < first.samples:
                self.whole, self.chaotic = False, True
                shorter = self.window * max(last, 1) / first.samples
                self.window = _of_whole_steps(shorter, stable, shorter)
                self._records.clear()
        self.stable = even_step(stable, self.window)

    def _skip_flight(self, duration: float) -> None:
        """Start at the last look before anything touches, if there is one."""
        if any(boundary.moves for boundary in self.scene.boundaries):
            return
        sim, spheres = self._simulation(self.tight), self.scene.spheres
        sim.restart()
        begun, gravity = sim.time, np.array(self.scene.gravity)
        position, velocity = np.array(sim.particles.position), np.array(sim.particles.velocity)
        while sim.time + self.window / LOOKS < duration:
            begun, at, moving = sim.time, position, velocity
            try:
                sim.run(duration=self.window / LOOKS)
            except SimulationStopped:
                break
            position, velocity = np.array(sim.particles.position), np.array(sim.particles.velocity)
            passed = sim.time - begun
            off = at + passed * (moving + 0.5 * passed * gravity) - position
            if (np.abs(off) > STRAIGHT * spheres.radius[:, None]).any():
                break
        else:
            return
        if begun > 0:
            flown = dataclasses.replace(spheres, position=at, velocity=moving)
            self.scene, self.start = dataclasses.replace(self.scene, spheres=flown), begun
            self._simulations.clear()

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

    def touching(self, settings: Settings) -> bool:
        """Whether there is a contact at all."""
        return len(self.record(settings).contact) > 0

    def grounded(self, settings: Settings) -> int:
        """The most contacts with the substrate at a time."""
        return int(self._grounded(settings).max())

    def steady(self, settings: Settings) -> bool:
        """Whether what is on the ground has been there from the start, so that what comes after the
        window will be like what is in it."""
        grounded = self._grounded(settings)
        return bool(grounded[0] >= STEADY * grounded.max())

    def _grounded(self, settings: Settings) -> np.ndarray:
        contact = self.record(settings).contact
        samples = contact[contact[:, 2] == SUBSTRATE, 0].astype(np.int64)
        return np.bincount(samples, minlength=1)

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


def _of_whole_steps(window: float, step: float, most: float) -> float:
    """``window`` (s) as a whole number of steps (s) between two samples, one at least, but no more
    than ``most`` (s)."""
    between = max(1, math.floor(window / (SAMPLES * step) * (1 + 1e-9)))
    return min(between * SAMPLES * step, most)
