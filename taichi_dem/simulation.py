"""A scene in motion: owns the fields, advances them, and stops before it computes nonsense."""

import math
import warnings
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from halfspace import backend
from taichi_dem import guards, time_step
from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import FIRST_FACE, SUBSTRATE, ContactList
from taichi_dem.drivers import Drivers
from taichi_dem.energy import Energy
from taichi_dem.exchange import Exchange, ground_of
from taichi_dem.forces import STALE, Coefficients, Forces, history_of
from taichi_dem.grid import Grid, best_cell_size
from taichi_dem.guards import SimulationStopped
from taichi_dem.integrate import Verlet
from taichi_dem.material import Material
from taichi_dem.neighbors import Neighbors
from taichi_dem.pace import Pace, Skin
from taichi_dem.particles import Particles
from taichi_dem.scene import Scene
from taichi_dem.schedule import Schedule, interruptible
from taichi_dem.types import real, ti
from taichi_dem.validation import InputError, Problem, Range, number_problem
from taichi_dem.views import (
    BoundaryState,
    ParticleState,
    SubstrateState,
    contact_records,
)
from taichi_dem.writing import Output

CONTACTS_PER_PARTICLE = 4  # of the first list; it regrows
GROWTH = 1.3
STEPS_PER_CHUNK = 5e6  # particle-steps between two looks at the world outside
REORDER_ABOVE = 4000  # particles: fewer fit in the cache in any order
REORDER_EVERY = 8  # rebuilds

FAST_WARNING = (
    "a sphere hit the substrate at more than a tenth of its shear wave speed: the substrate is "
    "taken as quasi-static, and waves that carry energy away are left out"
)
WIDE_WARNING = (
    "a contact with the substrate is wider than 0.3 of its sphere's radius: strains are not small"
)


class Simulation:
    """A scene with its fields, ready to run.

    dt: s; None takes the stable step (``dt_reason`` says what sets it). driver: "serial",
    "parallel" or "auto", the faster of the two; the results are the same bits. max_overlap: share
    of the smaller radius beyond which an overlap stops the run. Raises ``InputError``.
    """

    def __init__(
        self,
        scene: Scene,
        dt: float | None = None,
        *,
        driver: str = "auto",
        max_overlap: float = 0.5,
    ):
        backend.start()
        self.scene, self.steps = scene, 0
        self.warnings: dict[str, int] = {}
        spheres, materials = scene.spheres, scene.materials
        place = {material: index for index, material in enumerate(materials)}
        self._density = np.array([material.density for material in spheres.materials])
        self._mass = self._density[spheres.material_index] * 4 / 3 * math.pi * spheres.radius**3
        self._material = np.array([place[m] for m in spheres.materials])[spheres.material_index]

        builder = ti.FieldsBuilder()
        self._particles = Particles(spheres, self._mass, self._material, builder)
        self._boundaries = Boundaries(scene, self._particles, builder)
        self._coefficients = {
            slot: Coefficients(scene.law, slot, materials) for slot in scene.law.parts()
        }
        for coefficients in self._coefficients.values():
            builder.dense(ti.ij, len(materials)).place(coefficients.table)
        self._reference, self._gravity = ti.Vector.field(3, real), ti.Vector.field(3, real)
        builder.dense(ti.i, spheres.count).place(self._reference)
        builder.dense(ti.i, 1).place(self._gravity)
        self._skin_field, self._deepest = ti.field(real), ti.field(real)
        self._step, self._time_step, self._flags = (
            ti.field(ti.i64),
            ti.field(real),
            ti.field(ti.i32),
        )
        builder.place(self._skin_field, self._deepest, self._step, self._time_step)
        builder.dense(ti.i, 3).place(self._flags)
        self._soil = place[scene.substrate.material] if scene.substrate else -1
        self._exchange = None
        self._ground = ground_of(scene.substrate) if scene.substrate else None
        if scene.substrate and scene.substrate.exchange != "none":
            self._exchange = Exchange(
                scene.substrate,
                self._particles,
                scene.law,
                self._coefficients["normal"],
                self._soil,
                self._flags,
                builder,
            )
        self._trees = [builder.finalize()]
        self._fill(materials, place, max_overlap)

        stable = time_step.stable_time_step(scene, self._coefficients["normal"])
        self.dt, self.dt_reason = self._choose_step(dt, stable)
        self._time_step[None] = self.dt
        self._skin = Skin(spheres.radius)
        self._pace = Pace(spheres.count, backend.THREADS, driver)
        self._extent = np.maximum(np.ptp(spheres.position, axis=0), 2 * spheres.radius.max())
        self._grid = Grid(self._particles, self._set_skin(), self._extent)
        self._trees.append(self._grid.tree)
        self._lost, self._rebuilds, self._memo = 0.0, 0, {}
        self._make_list(CONTACTS_PER_PARTICLE * spheres.count + 64)
        weakref.finalize(self, _destroy, self._trees)
        self._rebuild()
        self._drivers.evaluate(0.0)
        self._drivers.note_pushes()
        self._first_energy = self._total_energy()
        self._keep_good_state()

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
        chunk = max(1, int(STEPS_PER_CHUNK / self.scene.spheres.count))
        self._outcome = "running"
        with interruptible() as asked_to_stop:
            try:
                for output in outputs:
                    output.start(self)
                for output in schedule.due(self.steps):
                    output.write(self)
                while self.steps < last and not asked_to_stop.is_set():
                    limit = min(chunk, last - self.steps)
                    self._advance(schedule.steps_to_next(self.steps, limit))
                    for output in schedule.due(self.steps):
                        output.write(self)
                self._outcome = "interrupted" if asked_to_stop.is_set() else "finished"
            except SimulationStopped as stop:
                self._outcome = f"stopped: {stop}"
                raise
            finally:
                for output in outputs:
                    output.finish(self)
        if self._outcome == "interrupted":
            raise KeyboardInterrupt

    def _advance(self, steps: int) -> None:
        self._keep_good_state()
        self._memo.clear()
        self._drivers.begin()
        left = steps - 1
        while True:
            self._answer()
            self._solve_on_host()
            if left == 0:
                break
            left -= self._make_steps(left)
        self._drivers.evaluate(self.dt)
        self._drivers.finish()
        self.steps += steps
        self._answer()
        self._watch()

    def _make_steps(self, most: int) -> int:
        """As many steps as can be made before the host is needed, at most ``most``."""
        if self._exchange is not None and self._exchange.hosted:
            most = 1
        return self._pace.advance(
            most, {"serial": self._drivers.serial, "parallel": self._drivers.loop}
        )

    def _solve_on_host(self) -> None:
        if self._exchange is not None and self._exchange.hosted:
            self._exchange.update_on_host()

    def _answer(self) -> None:
        """Do what the kernels called the host for."""
        stale, deep, unsolved = self._flags.to_numpy()
        if deep:
            records = self.contacts()
            row, why = guards.describe_deepest(
                records, self.scene.spheres.radius, float(self._deepest[None])
            )
            self._stop(why, row)
        if unsolved:
            self._stop(
                "the contacts with the substrate found no equilibrium. Try a smaller time step or "
                "a larger residual",
                None,
            )
        if stale:
            self._rebuild()

    def _stop(self, why: str, row: int | None) -> None:
        when = int(self._step[None]) * self.dt
        good = self._good
        self._particles.write(good["position"], good["velocity"], good["omega"])
        self._boundaries.write(good["motion"])
        self.steps = good["step"]
        self._step[None] = self.steps
        self._flags.fill(0)
        self._memo.clear()
        self._rebuild(remember=False)
        self._drivers.evaluate(0.0)
        raise SimulationStopped(f"at t = {when:.6g} s {why}.", row, good)

    def _keep_good_state(self) -> None:
        state = self._particles.read()
        self._good = {
            "time": self.time,
            "step": self.steps,
            "position": state["position"],
            "velocity": state["velocity"],
            "omega": state["omega"],
            "motion": self._boundaries.read(),
        }

    # -- lists -----------------------------------------------------------------------------------

    def _rebuild(self, remember: bool = True) -> None:
        """Make the contact list anew; what the contacts remember goes along."""
        row = guards.first_offender(self._particles, self.dt)
        if row >= 0:
            self._stop(guards.describe_offender(self._particles, row, self.dt), row)
        if self._skin.rebuilt(int(self._step[None])):
            self._grid.cell_size[None] = self._set_skin()
        self._lost += self._energy.take_loss()
        self._neighbors.save(remember)
        self._grid.sort()
        if self._particles.count > REORDER_ABOVE and self._rebuilds % REORDER_EVERY == 0:
            self._particles.reorder(self._grid.particle)
            if self._exchange is not None:
                self._exchange.reorder(self._grid.particle)
            self._grid.number_in_order()
        total = self._neighbors.count()
        if total > self._list.capacity:
            self._make_list(int(GROWTH * total))
            self._neighbors.count()
        self._neighbors.fill()
        if self._boundaries.any_moves:
            self._boundaries.enrol(self._list)
        if self._exchange is not None:
            self._exchange.enrol(self._list)
        self._flags[STALE] = 0
        self._rebuilds += 1

    def _make_list(self, capacity: int) -> None:
        """A contact list of ``capacity``, and the kernels that work on it."""
        history = history_of(self.scene.law)
        old = getattr(self, "_list", None)
        self._list = ContactList(self._particles.count, capacity, history, self._dissipates())
        self._trees.append(self._list.tree)
        if old is not None:
            self._list.inherit(old)
        self._neighbors = Neighbors(
            self._particles,
            self._boundaries,
            self._list,
            self._grid,
            self._reference,
            self._skin_field,
            self._soil >= 0,
        )
        self._forces = Forces(
            self.scene.law,
            self._coefficients,
            self._particles,
            self._boundaries,
            self._list,
            self._exchange,
            self._soil,
            self._flags,
            self._deepest,
        )
        verlet = Verlet(
            self._particles,
            self._reference,
            self._skin_field,
            self._gravity,
            self._flags,
            rotates=self.scene.law.tangential is not None,
        )
        self._drivers = Drivers(
            self._forces,
            verlet,
            self._boundaries,
            self._exchange,
            self._step,
            self._time_step,
            self._flags,
        )
        self._energy = Energy(self._forces, self._exchange, self._boundaries)
        if old is not None:
            self._trees.remove(old.tree)
            old.tree.destroy()

    def _dissipates(self) -> bool:
        law, names = self.scene.law, [material.name for material in self.scene.materials]
        elastic = all(law.between("normal", a, b).restitution == 1 for a in names for b in names)
        return law.tangential is not None or not elastic

    def _set_skin(self) -> float:
        """Put the skin's width in force; returns the cell size that goes with it."""
        self._skin_field[None] = self._skin.width
        return best_cell_size(
            self.scene.spheres.radius, self._skin.width, float(np.prod(self._extent))
        )

    # -- setting up ------------------------------------------------------------------------------

    def _fill(self, materials: Sequence[Material], place: dict, max_overlap: float) -> None:
        self._particles.fill()
        self._boundaries.fill(place)
        for coefficients in self._coefficients.values():
            coefficients.fill()
        if self._exchange is not None:
            self._exchange.fill()
        self._gravity[0] = self.scene.gravity
        self._deepest[None] = max_overlap

    def _choose_step(self, dt: float | None, stable: time_step.StableStep) -> tuple[float, str]:
        if dt is None:
            return stable.value, stable.reason
        if problem := number_problem("dt", dt, Range("s", "time step", above=0)):
            raise InputError([problem])
        if dt > stable.value:
            self._warn(
                "time_step",
                f"dt = {dt:.3g} s is beyond the stable step of {stable.value:.3g} s, which is "
                f"{stable.reason}",
            )
        return float(dt), f"given; the stable step is {stable.value:.3g} s, {stable.reason}"

    def _warn(self, name: str, message: str, count: int = 1) -> None:
        """Warn once of each kind, and keep the count."""
        if name not in self.warnings:
            warnings.warn(message, RuntimeWarning, stacklevel=3)
        self.warnings[name] = count

    def _watch(self) -> None:
        """Warn where the substrate's assumptions fail."""
        if self._exchange is None:
            return
        fast, wide = self._exchange.counts()
        if fast > self.warnings.get("fast_impacts", 0):
            self._warn("fast_impacts", FAST_WARNING, fast)
        if wide > self.warnings.get("wide_contacts", 0):
            self._warn("wide_contacts", WIDE_WARNING, wide)

    # -- looking ---------------------------------------------------------------------------------

    @property
    def particles(self) -> ParticleState:
        """The spheres now, in the order given."""
        return self._once("particles", self._particle_state)

    def contacts(self) -> np.ndarray:
        """The touching contacts now; see :func:`taichi_dem.views.contact_records`."""
        return self._once(
            "contacts",
            lambda: contact_records(self._list, self._particles, self._boundaries, self.particles),
        )

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
        balance error: what is there and was lost, less what was there at first and was put in."""
        parts = self._energy_parts()
        return {**parts, "balance_error": _total(parts) - self._first_energy}

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
        """What ``summary.json`` says beside what the clock says."""
        return {
            "outcome": self._outcome,
            "driver": self._pace.driver,
            "threads": backend.THREADS,
            "precision": backend.PRECISION,
            "rebuilds": self._rebuilds,
            "skin_m": self._skin.width,
        }

    def _once(self, name: str, make: Any) -> Any:
        if name not in self._memo:
            self._memo[name] = make()
        return self._memo[name]

    def _particle_state(self) -> ParticleState:
        state = self._particles.read()
        state["force"] += self._mass[:, None] * np.array(self.scene.gravity)
        return ParticleState(
            **state, radius=self.scene.spheres.radius, mass=self._mass, material=self._material
        )

    def _substrate_state(self) -> SubstrateState:
        records = self.contacts()
        records = records[records["j"] == SUBSTRATE]
        rows = records["i"]
        force, expansion = records["force"][:, 2], np.zeros(len(rows))
        slope = np.zeros((len(rows), 2))
        if self._exchange is not None:
            force, expansion, slope = (values[rows] for values in self._exchange.read())
        return SubstrateState(
            particle=rows,
            position=self.particles.position[rows, :2],
            force=force,
            expansion=expansion,
            slope=slope,
            contact_radius=np.sqrt(self.scene.spheres.radius[rows] * records["overlap"]),
            ground=self._ground,
        )

    def _boundary_states(self) -> list[BoundaryState]:
        records = self.contacts()
        states = []
        for b in range(self._boundaries.count):
            mine = records[records["j"] == FIRST_FACE - b]
            position, velocity = self._boundaries.state(b)
            torque = np.cross(mine["position"] - position, -mine["force"]).sum(axis=0)
            states.append(BoundaryState(-mine["force"].sum(axis=0), torque, position, velocity))
        return states

    def _energy_parts(self) -> dict[str, float]:
        return self._once(
            "energy", lambda: self._energy.parts(np.array(self.scene.gravity), self._lost)
        )

    def _total_energy(self) -> float:
        return _total(self._energy_parts())


def _total(parts: dict[str, float]) -> float:
    return sum(parts.values()) - 2 * parts["external_work"]


def _steps_asked(duration: float | None, steps: int | None, dt: float) -> int:
    if (duration is None) == (steps is None):
        raise InputError([Problem("duration", None, "give either duration (s) or steps")])
    if steps is not None:
        if isinstance(steps, bool) or not isinstance(steps, int) or steps < 0:
            raise InputError([Problem("steps", steps, "must be a whole number >= 0")])
        return steps
    if problem := number_problem("duration", duration, Range("s", "simulated time", at_least=0)):
        raise InputError([problem])
    return math.ceil(duration / dt * (1 - 1e-12))


def _destroy(trees: list) -> None:
    for tree in trees:
        tree.destroy()
