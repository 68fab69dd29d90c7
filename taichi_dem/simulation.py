"""A scene in motion, as a user runs it and looks at it."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from halfspace import backend
from taichi_dem import summary
from taichi_dem.alerts import Alerts
from taichi_dem.asked import refuse_options, refuse_step, steps_asked
from taichi_dem.coefficients import Coefficients
from taichi_dem.effects import Effects, effects_of
from taichi_dem.engine import Engine
from taichi_dem.exchange import ground_of
from taichi_dem.ground_view import substrate_state
from taichi_dem.guards import SimulationStopped
from taichi_dem.periodic import narrow_problem
from taichi_dem.scene import Scene, Spheres
from taichi_dem.schedule import Schedule, interruptible
from taichi_dem.time_step import StableStep, stable_time_step
from taichi_dem.validation import InputError, Problem
from taichi_dem.views import (
    BoundaryState,
    ParticleState,
    SubstrateState,
    boundary_states,
    relative_overlaps,
)
from taichi_dem.writing import Output

if TYPE_CHECKING:
    from taichi_dem.cost import Cost
    from taichi_dem.neglect import Neglected

SECONDS_PER_CHUNK = 0.3  # between two looks at the world outside; no result depends on it
FIRST_CHUNK = 50  # steps
STEPS_TO_LOOK = 100  # at the energy, at least, and a tenth of those made


class Simulation:
    """A scene with its fields, ready to run.

    dt: s; None takes the stable step (``dt_reason`` says what sets it). driver: "serial", "team"
    (threads that stay together), "parallel" (loops that wake them) or "auto", the fastest of the
    three; the results are the same bits. max_overlap: share of the smaller radius beyond which an
    overlap stops the run. energy_balance: whether to sum up what is lost, so that :meth:`energy`
    can tell whether all is accounted for; it takes about a fifth of the time. skin: m, how far
    beyond touching contacts are listed; None tunes it; no state depends on it, and energies only by
    the order in which they are summed up. Raises ``InputError``.
    """

    def __init__(
        self,
        scene: Scene,
        dt: float | None = None,
        *,
        driver: str = "auto",
        max_overlap: float = 0.5,
        energy_balance: bool = True,
        skin: float | None = None,
    ):
        refuse_options(dt, driver, max_overlap, skin)
        refuse_step(dt, scene.spheres)
        backend.start()
        self.scene, self.steps = scene, 0
        self._built_with = scene.spheres
        self.warnings = Alerts(self)
        self._memo: dict[str, Any] = {}  # what was asked for in the present state
        self._outcome, self._chunk, self._next_look = "not run yet", FIRST_CHUNK, STEPS_TO_LOOK
        effects = effects_of(scene, energy_balance)
        largest = scene.spheres.radius.max()
        bulge = largest if scene.law.surface else 0.0  # more than bodies bulge before they give up
        if problem := narrow_problem(scene.period, largest, effects.reach + bulge):
            raise InputError([problem])
        law, materials = effects.law, scene.materials
        coefficients = {slot: Coefficients(law, slot, materials) for slot in law.parts()}
        self._coefficients = coefficients
        self._stepping = self._writing = 0.0  # s of wall time
        self._surface = ground_of(scene.substrate, scene.period) if scene.substrate else None
        self.dt, self.dt_reason = self._choose_step(dt)
        try:
            self._engine = Engine(scene, effects, coefficients, self.dt, driver, max_overlap, skin)
        except SimulationStopped as stop:
            key, value = stop.setting or ("spheres.position", None)
            raise InputError([Problem(key, value, str(stop))]) from None
        self._first_energy = _total(self._energy_parts())

    def restart(
        self,
        position: np.ndarray | None = None,
        velocity: np.ndarray | None = None,
        omega: np.ndarray | None = None,
        *,
        dt: float | None = None,
    ) -> None:
        """Start again at time zero: no contact remembers anything, nothing is counted or warned of.

        position, velocity, omega: (n, 3) in m, m/s, rad/s, those of the scene as it was built where
        they are None; dt: s, None the stable step. The bits are those of a new ``Simulation``, but
        nothing is compiled, so that series and ensembles are cheap. Raises ``InputError``, after
        which the simulation is as it was.
        """
        given = {"position": position, "velocity": velocity, "omega": omega}
        changed: Any = {name: values for name, values in given.items() if values is not None}
        spheres = dataclasses.replace(self._built_with, **changed)
        refuse_step(dt, spheres)
        self.scene = dataclasses.replace(self.scene, spheres=spheres)
        self._restart(spheres, dt)

    def _restart(
        self, spheres: Spheres, dt: float | None, motion: np.ndarray | None = None
    ) -> None:
        """:meth:`restart` with ``spheres`` that are known to be right and do not become those of
        the scene; ``motion`` is that of the boundaries, if not as in the scene."""
        self._stepping = self._writing = 0.0
        self.warnings.clear()
        self._memo.clear()
        self._outcome, self.steps, self._next_look = "not run yet", 0, STEPS_TO_LOOK
        self.dt, self.dt_reason = self._choose_step(dt)
        self._engine.restart(spheres, self.dt, motion)
        self._first_energy = _total(self._energy_parts())

    # -- running ---------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.steps * self.dt

    def run(
        self,
        duration: float | None = None,
        steps: int | None = None,
        outputs: Sequence[Output] = (),
    ) -> None:
        """Advance by ``duration`` (s, in whole steps) or by ``steps``, writing ``outputs``.

        Ctrl-C ends the run between two steps, with the outputs finished; ``SimulationStopped`` is
        raised when a guard stops it, with the outputs finished at the last good state.
        """
        last = self.steps + steps_asked(duration, steps, self.dt)
        schedule = Schedule(outputs, self.dt)
        self._outcome = "running"
        with interruptible() as asked_to_stop:
            try:
                for output in outputs:
                    output.start(self)
                self._write(schedule.due(self.steps))
                while self.steps < last and not asked_to_stop.is_set():
                    limit = min(self._chunk, last - self.steps)
                    self._advance(schedule.steps_to_next(self.steps, limit))
                    self._write(schedule.due(self.steps))
                self._outcome = "interrupted" if asked_to_stop.is_set() else "finished"
            except KeyboardInterrupt:
                self._outcome = "interrupted"
                raise
            except BaseException as error:
                self._outcome = f"stopped: {error or type(error).__name__}"
                raise
            finally:
                with ExitStack() as all_of_them:  # one that fails does not keep back the others
                    for output in reversed(outputs):
                        all_of_them.callback(output.finish, self)
        if self._outcome == "interrupted":
            raise KeyboardInterrupt
        self._watch_energy()

    def _write(self, outputs: Sequence[Output]) -> None:
        start = time.perf_counter()
        for output in outputs:
            output.write(self)
        self._writing += time.perf_counter() - start

    def _advance(self, steps: int) -> None:
        self._memo.clear()
        start = time.perf_counter()
        try:
            self._engine.advance(steps)
        finally:  # a stop goes back to the last good state
            self.steps = self._engine.step
        took = time.perf_counter() - start
        self._stepping += took
        self._chunk = max(1, int(SECONDS_PER_CHUNK * steps / took))
        self.warnings.look_at_substrate(self._engine.ground.doubts())

    @property
    def stable(self) -> StableStep:
        """The stable step of the scene, and what sets it."""
        base, surface = 0.0, self._surface
        if surface is not None and (surface.layer is not None or surface.period is not None):
            base = min(0.0, float(surface.matrix(np.zeros((1, 2)))[0, 0]))
        return stable_time_step(self.scene, self._coefficients, base)

    def _choose_step(self, dt: float | None) -> tuple[float, str]:
        stable = self.stable
        if dt is None:
            return stable.value, stable.reason
        if dt > stable.value:
            self.warnings.tell(
                "time_step",
                f"dt = {dt:.3g} s is beyond the stable step of {stable.value:.3g} s, which is "
                f"{stable.reason}",
            )
        return float(dt), f"given; the stable step is {stable.value:.3g} s, {stable.reason}"

    def _watch_energy(self) -> None:
        """Look where it comes from, now and then."""
        if self.effects.balanced and self.steps >= self._next_look:
            self._next_look = self.steps + max(STEPS_TO_LOOK, self.steps // 10)
            self.warnings.look_at_energy(self.energy(), self.dt, self.stable.value)

    # -- looking ---------------------------------------------------------------------------------

    @property
    def particles(self) -> ParticleState:
        """The spheres now, in the order given."""
        return self._once("particles", self._engine.particle_state)

    def contacts(self) -> np.ndarray:
        """The touching contacts now; see :func:`taichi_dem.views.contact_records`."""
        return self._once("contacts", self._engine.records)

    @property
    def substrate(self) -> SubstrateState | None:
        """The contacts with the substrate now, or None where the scene has none."""
        if self._surface is None:
            return None
        look = partial(substrate_state, self.scene, self._engine.ground, self._surface)
        return self._once("substrate", lambda: look(self.particles, self.contacts()))

    @property
    def boundaries(self) -> list[BoundaryState]:
        """The boundaries now, in the scene's order."""
        walls, contacts = self._engine.boundaries, self.contacts
        return self._once("boundaries", lambda: boundary_states(walls, contacts()))

    def energy(self) -> dict[str, float]:
        """J: kinetic, potential by part, dissipated, work put in by moving boundaries, and the
        balance error: what is there and was lost, less what was there at first and was put in.
        Without ``energy_balance``, where something is lost, neither of the last two is known."""
        parts = self._energy_parts()
        if not self.effects.balanced:
            return parts
        return {**parts, "balance_error": _total(parts) - self._first_energy}

    @property
    def effects(self) -> Effects:
        """What the scene calls for, and why."""
        return self._engine.effects

    @property
    def asleep(self) -> np.ndarray:
        """Which spheres sleep now, (n,): none unless the scene has ``sleep``."""
        sleep = self._engine.sleep
        return np.zeros(len(self.particles.radius), bool) if sleep is None else sleep.read()

    def neglected(self) -> "list[Neglected]":
        """How much each effect that is off though it would act would change the contact forces in
        the present state; see :mod:`taichi_dem.neglect`. It compiles a simulation for each."""
        from taichi_dem.neglect import neglected

        return neglected(self)

    def effect_costs(self) -> "list[Cost]":
        """What each effect that is on takes of the time of a step in the present state, for which
        :meth:`summary` then says it too; see :mod:`taichi_dem.cost`. It compiles a simulation for
        each. Raises ``SimulationStopped`` where steps from this state are stopped."""
        from taichi_dem.cost import measure

        return self._once("effect_costs", lambda: measure(self))

    def coordination(self) -> float:
        """Mean number of contacts of a sphere."""
        records = self.contacts()
        return (len(records) + int((records["j"] >= 0).sum())) / self.scene.spheres.count

    def largest_overlap(self) -> float:
        """Over the smaller radius."""
        shares = relative_overlaps(self.contacts(), self.scene.spheres.radius)
        return float(shares.max(initial=0.0))

    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` says of the simulation, beside its state."""
        return summary.of(self)

    def _once(self, name: str, make: Callable[[], Any]) -> Any:
        """What ``make`` gives, kept under ``name`` until the state changes."""
        if name not in self._memo:
            self._memo[name] = make()
        return self._memo[name]

    def _energy_parts(self) -> dict[str, float]:
        return self._once("energy", self._engine.energy_parts)


def _total(parts: dict[str, float]) -> float:
    """What there is and what was lost, less what was put in."""
    there = sum(value for part, value in parts.items() if part != "external_work")
    return there - parts["external_work"]
