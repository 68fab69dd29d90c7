"""The fields of a scene and the loop that advances them: what a step does, in order."""

import time
import weakref
from collections.abc import Mapping
from typing import Any

import numpy as np

from halfspace import backend
from taichi_dem import guards
from taichi_dem.boundaries import Boundaries
from taichi_dem.coefficients import Coefficients
from taichi_dem.control import OVERPRESSED, STALE, TOO_DEEP, UNSOLVED, Control
from taichi_dem.effects import Effects
from taichi_dem.good_state import GoodState
from taichi_dem.grid import Grid, best_cell_size
from taichi_dem.ground import Ground
from taichi_dem.guards import SimulationStopped
from taichi_dem.meeting import Meeting
from taichi_dem.on_list import OnList, Standing
from taichi_dem.pace import Pace, Skin
from taichi_dem.particles import Particles
from taichi_dem.scene import Scene, Spheres
from taichi_dem.sleep import Sleep
from taichi_dem.types import ti
from taichi_dem.views import ParticleState, contact_records

CONTACTS_PER_PARTICLE = 4  # of the first list; it regrows
SPARE_CONTACTS = 2000  # on top: they cost nothing, and few spheres never need to search twice
PAIRS_PER_PARTICLE = 60  # of its contacts; likewise
GROWTH = 1.3
REORDER_ABOVE = 300  # particles: fewer are close together in the cache in any order
REORDER_EVERY = 8  # rebuilds


class Engine:
    """Owns the fields of ``scene`` and moves them on by whole steps of ``time_step`` (s).

    Raises ``SimulationStopped`` when a guard finds nonsense, after going back to where the spheres
    and boundaries last were in good order, with what the contacts remembered then.
    """

    def __init__(
        self,
        scene: Scene,
        effects: Effects,
        coefficients: Mapping[str, Coefficients],
        time_step: float,
        driver: str,
        max_overlap: float,
        skin: float | None = None,
    ):
        self.scene, self.time_step, self.effects = scene, time_step, effects
        spheres, materials = scene.spheres, scene.materials
        place = {material: index for index, material in enumerate(materials)}
        self.mass = spheres.mass
        self._place = place
        self.material = np.array([place[m] for m in spheres.materials])[spheres.material_index]

        builder = ti.FieldsBuilder()
        self.control = Control(builder)
        self.meeting = Meeting(backend.THREADS, builder)
        self.particles = Particles(spheres, self.mass, self.material, builder)
        self.boundaries = Boundaries(scene, self.particles, builder)
        for table in coefficients.values():
            table.place(builder)
        self.ground = Ground(
            scene.substrate,
            scene.period,
            self.particles,
            effects.law,
            effects,
            coefficients["normal"],
            materials,
            self.control,
            builder,
        )
        self.exchange = self.ground.exchange
        self.sleep = Sleep(self.particles, self.boundaries, builder) if effects.sleep else None
        self._trees = [builder.finalize()]
        weakref.finalize(self, _destroy, self._trees)
        self.control.fill(time_step, scene.gravity, max_overlap)
        self.particles.fill(spheres)
        self.boundaries.fill(place)
        for table in coefficients.values():
            table.fill()
        self.ground.fill()

        self._smallest = float(spheres.radius.min())
        self.skin = Skin(spheres.radius, skin)
        self.pace = Pace(spheres.count, driver, self.meeting.assembles)
        self._extent = np.maximum(np.ptp(spheres.position, axis=0), 2 * spheres.radius.max())
        period = scene.period or ()
        self._extent[: len(period)] = period
        self.grid = Grid(self.particles, self._set_skin(), self._extent, period)
        self._trees.append(self.grid.tree)
        self._standing = Standing(
            scene,
            effects,
            coefficients,
            self.control,
            self.meeting,
            self.particles,
            self.boundaries,
            self.grid,
            self.exchange,
            self.sleep,
        )
        self.lost, self.rebuilds, self.listing = 0.0, 0, 0.0
        self._pairs = PAIRS_PER_PARTICLE * spheres.count + 64
        self._listed = False  # nothing, so far
        self._make_list(CONTACTS_PER_PARTICLE * spheres.count + SPARE_CONTACTS)
        self._start()

    def restart(self, spheres: Spheres, time_step: float, motion: np.ndarray | None = None) -> None:
        """Go back to step 0 with ``spheres``, the scene's in another place and motion; without new
        kernels. ``motion``: that of the boundaries, if not as in the scene."""
        self.time_step = time_step
        self.control.restart(time_step)
        self.particles.fill(spheres)
        self.boundaries.fill(self._place)
        if motion is not None:
            self.boundaries.write(motion)
        self.ground.restart()
        if self.sleep is not None:
            self.sleep.wake_all(0)
        self.skin.restart()
        self.grid.cell_size[None] = self._set_skin()
        self.energy.loss(True)
        self.lost, self.rebuilds = 0.0, 0
        self._start()

    def _start(self) -> None:
        """Contacts and forces of a state that no step has led to."""
        self.good = GoodState(self)
        self._stop_at_nonsense()
        self.rebuild(remember=False)
        self.evaluate_at_rest()
        self.drivers.note_pushes()
        self._guard()  # forces belong to their list: a new one waits for the next step
        self.listing = 0.0  # s of wall time that making lists has taken since

    def evaluate_at_rest(self) -> None:
        """Forces of the present state, of which no step is known that has led to it."""
        self._solve_on_host(0.0)
        self.ground.note_stored()
        self.drivers.evaluate(0.0)

    @property
    def step(self) -> int:
        """Steps made since the start."""
        return int(self.control.step[None])

    # -- a step ----------------------------------------------------------------------------------

    def advance(self, steps: int) -> None:
        """Make ``steps`` >= 1 steps of velocity Verlet: half kick, drift, forces, half kick."""
        self.good.keep(self)
        step = self.step + 1
        last = step + steps - 1
        self.drivers.begin()
        while True:
            self._answer()
            if step >= self.skin.review:
                self.rebuild()
            diverges = self.ground.found_to_diverge(step)
            until = min(last, self.skin.review, self.ground.next_look)
            if self.sleep is not None:
                if step >= self.sleep.next:
                    self.lost += self.sleep.look(step, self.forces)
                until = min(until, self.sleep.next)
            self._solve_on_host(self.time_step)
            if step == last or diverges:
                break
            step += self._make_steps(until - step)
        self.drivers.evaluate(self.time_step)
        self.drivers.finish()
        self._guard()
        self._stop_at_nonsense()
        if diverges:
            self.good.keep(self)
            assert self.ground.lag is not None
            raise SimulationStopped(
                self._at_present(self.ground.lag.reason()), None, self.good.known
            )

    def _make_steps(self, most: int) -> int:
        """As many steps as can be made before the host is needed, at most ``most``."""
        most, drivers = self.ground.steps_alone(self.step, most), self.drivers
        ways = {"serial": drivers.serial, "team": drivers.team, "parallel": drivers.loop}
        made = self.pace.advance(most, ways)
        self.ground.let_dents_be(
            made - 1, self.time_step
        )  # the first of the steps has been seen to
        return made

    def _solve_on_host(self, time_step: float) -> None:
        self.ground.solve(self.contacts, time_step, self.drivers.settle)

    def _answer(self) -> None:
        """Do what the kernels called the host for."""
        if self._guard() & 1 << STALE:
            self.rebuild()

    def _guard(self) -> int:
        """Stop where a kernel found a reason to; what else the host was called for."""
        reasons = self.control.reasons()
        if reasons & (1 << TOO_DEEP | 1 << UNSOLVED | 1 << OVERPRESSED):
            self._stop_at_nonsense()  # which may be behind either
        if reasons & 1 << TOO_DEEP:
            radius, limit = self.scene.spheres.radius, float(self.control.deepest[None])
            self._stop(*guards.too_deep(self.records(), radius, limit))
        if reasons & 1 << OVERPRESSED:
            self._stop(*guards.overpressed(self.records()))
        if reasons & 1 << UNSOLVED:
            self._stop(self.ground.trouble, None, self.ground.setting_behind)
        return reasons

    def _stop_at_nonsense(self) -> None:
        boundaries, step, smallest = self.boundaries, self.time_step, self._smallest
        if found := guards.nonsense(self.particles, boundaries, step, smallest):
            self._stop(*found)

    def _stop(self, why: str, row: int | None, setting: guards.Setting | None = None) -> None:
        message = self._at_present(why)
        self.good.restore(self)
        raise SimulationStopped(message, row, self.good.known, setting)

    def _at_present(self, why: str) -> str:
        return f"at t = {self.step * self.time_step:.6g} s {why}."

    # -- lists -----------------------------------------------------------------------------------

    def rebuild(self, remember: bool = True, filed: Any = None) -> None:
        """Make the contact list anew; what the contacts remember goes along, or what was
        ``filed``."""
        began = time.perf_counter()
        if remember:
            self._stop_at_nonsense()
        if self.skin.rebuilt(self.step):
            self.grid.cell_size[None] = self._set_skin()
        self.lost += self.energy.loss(True)
        if self._listed:
            self.neighbors.save(remember)
        self._listed = True
        if filed is not None:
            self.contacts.put_on_file(filed)
        if self.expansions is not None:
            self.expansions.review()
        self.grid.sort()
        if self.particles.count > REORDER_ABOVE and self.rebuilds % REORDER_EVERY == 0:
            self.particles.reorder(self.grid.particle)
            self.ground.reorder(self.grid.particle)
            if self.sleep is not None:
                self.sleep.reorder(self.grid.particle)
            self.grid.number_in_order()
        total = self.neighbors.count()
        if total > self.contacts.capacity:
            self._make_list(int(GROWTH * total))
            self.neighbors.count()
        self.neighbors.fill()
        if self.expansions is not None and (pairs := self.expansions.enrol()) > self._pairs:
            self._pairs = int(GROWTH * pairs)
            self._make_list(self.contacts.capacity)
            self.neighbors.count()
            self.neighbors.fill()
            self.expansions.enrol()
        if self.boundaries.any_moves:
            self.boundaries.enrol(self.contacts)
        self.ground.enrol(self.contacts)
        self.control.flags[STALE] = 0
        self.rebuilds += 1
        self.listing += time.perf_counter() - began

    def _make_list(self, capacity: int) -> None:
        """A contact list of ``capacity``, and what works on it."""
        old = getattr(self, "_on_list", None)
        new = self._on_list = OnList(self._standing, capacity, self._pairs)
        self.contacts, self.neighbors, self.expansions = new.contacts, new.neighbors, new.expansions
        self.forces, self.drivers, self.energy = new.forces, new.drivers, new.energy
        self._trees.extend(new.trees())
        if old is not None:
            self.contacts.inherit(old.contacts)
            for tree in old.trees():
                self._trees.remove(tree)
                tree.destroy()

    def _set_skin(self) -> float:
        """Put the skin's width in force; returns the cell size that goes with it."""
        self.control.skin[None] = self.skin.width
        return best_cell_size(
            self.scene.spheres.radius, self.skin.width, float(np.prod(self._extent))
        )

    # -- looking ---------------------------------------------------------------------------------

    def particle_state(self) -> ParticleState:
        """The spheres now, in the user's order."""
        state = self.particles.read()
        state["force"] += self.mass[:, None] * np.array(self.scene.gravity)
        return ParticleState(
            **state, radius=self.scene.spheres.radius, mass=self.mass, material=self.material
        )

    def records(self) -> np.ndarray:
        """The touching contacts now."""
        return contact_records(
            self.contacts, self.particles, self.boundaries, self.particle_state(), self.scene.period
        )

    def energy_parts(self) -> dict[str, float]:
        """Where the energy is now, J."""
        self.ground.note_stored()
        gravity = np.array(self.scene.gravity)
        return self.energy.parts(gravity, self.lost, self.ground.in_dents)


def _destroy(trees: list[Any]) -> None:
    for tree in trees:
        tree.destroy()
