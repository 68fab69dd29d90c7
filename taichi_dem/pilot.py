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
from taichi_dem.closed_form import flown_freely, parabola
from taichi_dem.contact_list import SUBSTRATE
from taichi_dem.guards import SimulationStopped
from taichi_dem.moments import Moments
from taichi_dem.neglect import Neglected, neglected
from taichi_dem.record import SAMPLES, Record, even_step, record
from taichi_dem.scene import Scene
from taichi_dem.settings import EVERY, Settings
from taichi_dem.simulation import Simulation
from taichi_dem.spheres import Spheres

MOST_WORK = 1e7  # particle-steps
STRAIGHT = 1e-9  # radii, off the parabola that a sphere follows which touches nothing
LOOKS = 8  # in as much time as that, for the end of a flight
SMALLER = 3  # times half the stable step, where a guard stops it
STEADY = 0.5  # of the most contacts with the ground, there from the start


@dataclasses.dataclass(frozen=True)
class Span:
    """What is compared of a run: ``length`` (s) from ``start`` (s) on, before which nothing
    touches; ``chaotic``: no more because trajectories part; ``stable``: the stable step, s."""

    start: float
    length: float
    stable: float
    chaotic: bool = False


class Pilot:
    """Runs of ``scene``, ``duration`` (s) long, with any settings; each is computed once.

    ``span``: what they cover; ``whole``: whether that is all of the run but for a flight.
    """

    span: Span
    whole: bool

    def __init__(self, scene: Scene, duration: float):
        self.scene = scene
        self._simulations: dict[Settings, Simulation] = {}
        self._records: dict[Settings, Record] = {}
        self._steep: set[Settings] = set()
        self.tight = Settings.tightest(scene, 0.0)
        stable = self._simulation(self.tight).stable.value
        longest = min(duration, MOST_WORK / scene.spheres.count * stable)
        start = self._skip_flight(duration, longest)
        left = duration - start
        for smaller in range(SMALLER + 1):
            try:
                return self._compare(Span(start, min(longest, left), stable / 2**smaller), left)
            except SimulationStopped:  # a smaller step may get through
                self._records.clear()
                if smaller == SMALLER:
                    raise

    def _compare(self, longest: Span, left: float) -> None:
        """Find over how much of the ``longest`` span trajectories can be compared, of the ``left``
        time (s) of the run."""
        stable, length, chaotic, last = longest.stable, longest.length, False, 0
        whole = length >= left
        if not whole:
            length = _of_whole_steps(length, stable, left)
        while True:
            step = even_step(stable, length)  # so that halves of it are halves
            self.span = Span(longest.start, length, step, chaotic)
            self.whole = whole and not chaotic
            if last >= accuracy.FEWEST:
                return
            first = self.record(self.tight.but("step", step))
            last = accuracy.comparable(first, self._run(self.tight, step, 1))
            if last < first.samples:
                shorter = length * max(last, 1) / first.samples
                length, chaotic = _of_whole_steps(shorter, stable, shorter), True
                self._records.clear()

    def _skip_flight(self, duration: float, longest: float) -> float:
        """Start where something is about to touch, if not all can be run and no wall has moved by
        then; the time of it, s."""
        if longest >= duration or any(wall.moves for wall in self.scene.boundaries):
            return 0.0
        sim = self._simulation(self.tight)
        start, spheres = _before_touching(sim, duration, longest / LOOKS)
        if start > 0:
            self.scene = dataclasses.replace(self.scene, spheres=spheres)
            self._simulations.clear()
        return start

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
        """Whether anything touches at all."""
        return not flown_freely(self.record(settings), self.scene)

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
        sim, seen = self._simulation(self.tight), Moments(self.span.length)
        self._restart(sim, self.span.stable, 0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            sim.run(duration=self.span.length, outputs=[seen])
        return neglected(sim, seen.kept)

    def _run(self, settings: Settings, step: float, member: int) -> Record:
        sim = self._simulation(settings)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            self._restart(sim, step, member)
            found = record(sim, self.span.length, SAMPLES)
        if "sparse_exchange" in sim.warnings:
            self._steep.add(settings)
        return found

    def _restart(self, sim: Simulation, step: float, member: int) -> None:
        sim.restart(
            accuracy.perturbed(self.scene.spheres, member),
            dt=even_step(step, self.span.length, SAMPLES),
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


def _before_touching(sim: Simulation, duration: float, look: float) -> tuple[float, Spheres]:
    """Time (s) and spheres at the last look before anything touches in a run of ``sim`` over
    ``duration`` (s), with a look every so many seconds; those of the start if nothing does."""
    sim.restart()
    time, spheres = 0.0, sim.scene.spheres
    while time + look < duration:
        try:
            sim.run(duration=look)
        except SimulationStopped:
            return time, spheres
        now, passed = sim.particles, sim.time - time
        free = parabola(spheres.position, spheres.velocity, sim.scene.gravity, passed)
        if (np.abs(now.position - free) > STRAIGHT * spheres.radius[:, None]).any():
            return time, spheres
        time = sim.time
        spheres = dataclasses.replace(spheres, position=now.position, velocity=now.velocity)
    return 0.0, sim.scene.spheres


def _of_whole_steps(window: float, step: float, most: float) -> float:
    """``window`` (s) as a whole number of steps (s) between two samples, one at least, but no more
    than ``most`` (s)."""
    between = max(1, math.floor(window / (SAMPLES * step) * (1 + 1e-9)))
    return min(between * SAMPLES * step, most)
