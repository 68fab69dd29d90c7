"""A scene in motion, as a user runs it and looks at it."""

import dataclasses
import inspect
import math
import time
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np

from halfspace import backend
from taichi_dem.contact_list import FIRST_FACE, SUBSTRATE
from taichi_dem.contacts.elasticity import effective_youngs_modulus
from taichi_dem.effects import Effects, effects_of
from taichi_dem.engine import Engine
from taichi_dem.exchange import ground_of
from taichi_dem.forces import Coefficients
from taichi_dem.guards import FARTHEST_STEP, SimulationStopped
from taichi_dem.memory import by_effect
from taichi_dem.pace import WAYS
from taichi_dem.periodic import narrow_problem
from taichi_dem.pressed import Pressed
from taichi_dem.scene import Scene, Spheres
from taichi_dem.schedule import Schedule, interruptible
from taichi_dem.time_step import StableStep, stable_time_step
from taichi_dem.validation import InputError, Problem, Range, number_problem, unknown
from taichi_dem.views import BoundaryState, ParticleState, SubstrateState
from taichi_dem.writing import Output

if TYPE_CHECKING:
    from taichi_dem.neglect import Neglected

SECONDS_PER_CHUNK = 0.3  # between two looks at the world outside; no result depends on it
FIRST_CHUNK = 50  # steps
STEPS_TO_LOOK = 100  # at the energy, at least, and a tenth of those made
MADE = 0.05  # of the largest part of the energy: so much from nothing is warned of
ROUNDING = 1e-9  # of the energy in the heights, at most
DRIVERS = ("auto", *WAYS)

WARNINGS = {
    "fast_impacts": "a sphere hit the substrate at more than a tenth of its shear wave speed: the "
    "substrate is taken as quasi-static, and waves that carry energy away are left out",
    "wide_contacts": "a contact with the substrate is wider than 0.3 of its sphere's radius: "
    "strains are not small",
    "close_points": "contacts with the substrate are closer than 6 of their radii: "
    'coupling="point" neglects their size, coupling="finite" does not',
    "wide_for_layer": "a contact is wide for the thickness of the layer below it: beyond 0.4 of it "
    "(0.2 for points) forces err by a percent and more",
    "sparse_exchange": "a contact with the substrate turns by more than 0.3 rad of its own "
    "oscillation between two exchanges: extrapolation takes or gives some percent of its energy in "
    "each of its periods; a smaller exchange_every or time step does less",
    "unseen_contacts": "a sphere met the substrate between two exchanges of which the last one did "
    "not know it, and found the surface undeformed: exchange_every times the step is long for "
    "spheres so fast",
    "lagged_exchange": "the lagged exchange is close to divergence, with a spectral radius above "
    '0.5: it damps some motions and feeds others; exchange="implicit" does not',
}


_STEP = Range("s", "time step", above=0)
_SKIN = Range("m", "how far beyond touching contacts are listed", above=0)
_DEEPEST = Range("-", "share of the smaller radius", above=0, at_most=1)


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
        problems = [number_problem("max_overlap", max_overlap, _DEEPEST)]
        if driver not in DRIVERS:
            problems.append(unknown("driver", driver, driver, DRIVERS, "driver"))
        if dt is not None:
            problems.append(number_problem("dt", dt, _STEP))
        if skin is not None:
            problems.append(number_problem("skin", skin, _SKIN))
        if found := [problem for problem in problems if problem]:
            raise InputError(found)
        self._refuse_step(dt, scene.spheres)
        backend.start()
        self.scene, self.steps = scene, 0
        self._built_with = scene.spheres
        self.warnings: dict[str, int] = {}
        self._memo: dict[str, Any] = {}
        self._outcome, self._chunk, self._next_look = "not run yet", FIRST_CHUNK, STEPS_TO_LOOK
        effects = effects_of(scene, energy_balance)
        largest = scene.spheres.radius.max()
        bulge = largest if scene.law.surface else 0.0  # more than bodies bulge before they give up
        if problem := narrow_problem(scene.period, largest, effects.reach + bulge):
            raise InputError([problem])
        coefficients = {
            slot: Coefficients(scene.law, slot, scene.materials) for slot in scene.law.parts()
        }
        self._coefficients = coefficients
        self._stepping = self._writing = 0.0  # s of wall time
        self._ground = ground_of(scene.substrate, scene.period) if scene.substrate else None
        self.dt, self.dt_reason = self._choose_step(dt)
        try:
            self._engine = Engine(scene, effects, coefficients, self.dt, driver, max_overlap, skin)
        except SimulationStopped as stop:
            raise InputError([Problem("spheres.position", None, str(stop))]) from None
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
        if dt is not None and (problem := number_problem("dt", dt, _STEP)):
            raise InputError([problem])
        given = {"position": position, "velocity": velocity, "omega": omega}
        changed: Any = {name: values for name, values in given.items() if values is not None}
        spheres = dataclasses.replace(self._built_with, **changed)
        self._refuse_step(dt, spheres)
        self.scene = dataclasses.replace(self.scene, spheres=spheres)
        self._restart(spheres, dt)

    def _restart(
        self, spheres: Spheres, dt: float | None, motion: np.ndarray | None = None
    ) -> None:
        """Without a look at whether the scene makes sense; ``motion`` is that of the boundaries."""
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
        last = self.steps + _steps_asked(duration, steps, self.dt)
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
        per_step = took / steps
        self._chunk = max(1, int(SECONDS_PER_CHUNK / per_step))
        self._watch()

    @property
    def stable(self) -> StableStep:
        """The stable step of the scene, and what sets it."""
        base, ground = 0.0, self._ground
        if ground is not None and (ground.layer is not None or ground.period is not None):
            base = min(0.0, float(ground.matrix(np.zeros((1, 2)))[0, 0]))
        return stable_time_step(self.scene, self._coefficients, base)

    def _refuse_step(self, dt: float | None, spheres: Spheres) -> None:
        """Where a sphere would go too far in its first step."""
        if dt is None:
            return
        speed = np.linalg.norm(spheres.velocity, axis=1)
        row = int((speed / spheres.radius).argmax())
        if (limit := FARTHEST_STEP * spheres.radius[row]) <= speed[row] * dt:
            rule = (
                f"must be < {limit / speed[row]:.3g} s: sphere {row} at {speed[row]:.3g} m/s would "
                f"move more than {FARTHEST_STEP:g} of its radius in a step, through others perhaps"
            )
            raise InputError([Problem("dt", dt, rule)])

    def _choose_step(self, dt: float | None) -> tuple[float, str]:
        stable = self.stable
        if dt is None:
            return stable.value, stable.reason
        if dt > stable.value:
            self._warn(
                "time_step",
                f"dt = {dt:.3g} s is beyond the stable step of {stable.value:.3g} s, which is "
                f"{stable.reason}",
            )
        return float(dt), f"given; the stable step is {stable.value:.3g} s, {stable.reason}"

    def _warn(self, name: str, message: str, count: int = 1) -> None:
        """Warn once of each kind, at the line that called this class, and keep the count."""
        if name not in self.warnings:
            frame, level = inspect.currentframe(), 1
            while frame and frame.f_locals.get("self") is self:
                frame, level = frame.f_back, level + 1
            warnings.warn(message, RuntimeWarning, stacklevel=level)
        self.warnings[name] = count

    def _watch(self) -> None:
        """Warn where the substrate's assumptions fail."""
        for name, count in self._engine.doubts().items():
            if count > self.warnings.get(name, 0):
                self._warn(name, WARNINGS[name], count)

    def _watch_energy(self) -> None:
        """Warn where energy has come from nothing, now and then."""
        if not self.effects.balanced or self.steps < self._next_look:
            return
        self._next_look = self.steps + max(STEPS_TO_LOOK, self.steps // 10)
        parts = self.energy()
        made, height = parts.pop("balance_error"), abs(parts.pop("gravity"))
        most = max(abs(part) for part in parts.values())
        if made > max(MADE * most, ROUNDING * height):
            self._warn(
                "energy",
                f"{made:.3g} J have come from nothing, beside {most:.3g} J in motion, contacts or "
                f"heat. The time step of {self.dt:.3g} s may be too long: stable is "
                f"{self.stable.value:.3g} s",
            )

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
        if self.scene.substrate is None:
            return None
        return self._once("substrate", self._substrate_state)

    @property
    def boundaries(self) -> list[BoundaryState]:
        """The boundaries now, in the scene's order."""
        return self._once("boundaries", self._boundary_states)

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

    def coordination(self) -> float:
        """Mean number of contacts of a sphere."""
        records = self.contacts()
        return (len(records) + int((records["j"] >= 0).sum())) / self.scene.spheres.count

    def largest_overlap(self) -> float:
        """Over the smaller radius."""
        records, radius = self.contacts(), self.scene.spheres.radius
        i, j = records["i"], records["j"]
        smaller = np.where(j >= 0, np.minimum(radius[i], radius[np.maximum(j, 0)]), radius[i])
        return float((records["overlap"] / smaller).max(initial=0.0))

    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` says of the simulation, beside its state."""
        held = by_effect(self._engine)
        lists = self._engine.listing
        return {
            "outcome": self._outcome,
            "driver": self._engine.pace.driver,
            "threads": backend.THREADS,
            "precision": backend.PRECISION,
            "rebuilds": self._engine.rebuilds,
            "skin_m": self._engine.skin.width,
            **self._exchange_summary(),
            **({"asleep": int(self.asleep.sum())} if self.effects.sleep else {}),
            "seconds": {
                "steps": self._stepping - lists,
                "contact lists": lists,
                "output": self._writing,
            },
            "effects": {
                effect.name: {
                    "on": effect.on,
                    "reason": effect.reason,
                    "memory_bytes": held.get(effect.name, 0),
                }
                for effect in self.effects.listed
            },
        }

    def _exchange_summary(self) -> dict[str, float]:
        """How far its cheaper ways are from failing."""
        lag, exchange = self._engine.lag, self._engine.exchange
        if lag is not None:
            return {"lagged_spectral_radius": lag.largest}
        if exchange is not None and exchange.extrapolates:
            return {"exchange_phase": float(exchange.between.largest[None])}
        return {}

    def _once(self, name: str, make: Any) -> Any:
        if name not in self._memo:
            self._memo[name] = make()
        return self._memo[name]

    def _substrate_state(self) -> SubstrateState:
        records = self.contacts()
        records = records[records["j"] == SUBSTRATE]
        rows = records["i"]
        force, expansion = records["force"][:, 2], np.zeros(len(rows))
        slope = np.zeros((len(rows), 2))
        if self._engine.exchange is not None:
            force, expansion, slope = (values[rows] for values in self._engine.exchange.read())
        load, overlap, creep = force, records["overlap"], self._engine.creep
        dents = np.empty((0, 2)), np.empty(0), np.empty(0)
        if creep is not None:
            load, dents = creep.load(rows, force), creep.dents(rows)
            overlap = creep.depth(self._pressed(rows), force)
        return SubstrateState(
            particle=rows,
            position=self.particles.position[rows, :2],
            force=force,
            expansion=expansion,
            slope=slope,
            contact_radius=self._contact_radius(rows, overlap),
            load=load,
            dent_position=dents[0],
            dent_load=dents[1],
            dent_radius=dents[2],
            ground=self._ground,
        )

    def _pressed(self, rows: np.ndarray) -> Pressed:
        """The spheres ``rows`` on the ground."""
        spheres, ground = self.scene.spheres, self.scene.substrate
        assert ground is not None
        moduli = [effective_youngs_modulus(kind, ground.material) for kind in spheres.materials]
        which = spheres.material_index[rows]
        place = self.particles.position[rows, :2]
        return Pressed(rows, place, spheres.radius[rows], np.array(moduli)[which])

    def _contact_radius(self, rows: np.ndarray, overlap: np.ndarray) -> np.ndarray:
        """Of contacts of the spheres ``rows`` with the substrate, m."""
        scene, radius = self.scene, self.scene.spheres.radius[rows]
        if not self.effects.adhesion:
            return np.sqrt(radius * overlap)
        assert scene.substrate is not None
        law, soil = scene.law, scene.substrate.material
        kinds = [
            law.between("normal", material.name, soil.name) for material in scene.spheres.materials
        ]
        k = [
            kind.coefficients(material, soil)
            for kind, material in zip(kinds, scene.spheres.materials, strict=True)
        ]
        which = scene.spheres.material_index[rows]
        found = [
            law.normal.contact_radius(k[m], r, d)
            for m, r, d in zip(which, radius, overlap, strict=True)
        ]
        return np.array(found)

    def _boundary_states(self) -> list[BoundaryState]:
        records = self.contacts()
        states = []
        for b in range(self._engine.boundaries.count):
            mine = records[records["j"] == FIRST_FACE - b]
            position, velocity = self._engine.boundaries.state(b)
            torque = np.cross(mine["position"] - position, -mine["force"]).sum(axis=0)
            if self.effects.rolling:
                torque -= mine["torque"].sum(axis=0)
            states.append(BoundaryState(-mine["force"].sum(axis=0), torque, position, velocity))
        return states

    def _energy_parts(self) -> dict[str, float]:
        return self._once("energy", self._engine.energy_parts)


def _total(parts: dict[str, float]) -> float:
    """What there is and what was lost, less what was put in."""
    return (
        sum(value for part, value in parts.items() if part != "external_work")
        - parts["external_work"]
    )


def _steps_asked(duration: float | None, steps: int | None, dt: float) -> int:
    if (duration is None) == (steps is None):
        raise InputError([Problem("duration", None, "give either duration (s) or steps")])
    if steps is not None:
        if isinstance(steps, bool) or not isinstance(steps, (int, np.integer)) or steps < 0:
            raise InputError([Problem("steps", steps, "must be a whole number >= 0")])
        return int(steps)
    if problem := number_problem("duration", duration, Range("s", "simulated time", at_least=0)):
        raise InputError([problem])
    assert duration is not None
    return math.ceil(duration / dt * (1 - 1e-12))
