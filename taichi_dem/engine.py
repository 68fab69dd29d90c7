"""The fields of a scene and the loop that advances them: what a step does, in order."""

import time
import weakref
from collections.abc import Mapping
from typing import Any

import numpy as np

from halfspace import backend
from taichi_dem import guards
from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import ContactList
from taichi_dem.control import OVERPRESSED, STALE, TOO_DEEP, UNSOLVED, Control
from taichi_dem.creep import Creep
from taichi_dem.drivers import Drivers
from taichi_dem.effects import Effects
from taichi_dem.energy import Energy
from taichi_dem.exchange import Exchange
from taichi_dem.expansion_newton import ImplicitExpansions
from taichi_dem.expansions import Expansions
from taichi_dem.forces import Coefficients, Forces
from taichi_dem.geometry import Geometry
from taichi_dem.grid import Grid, best_cell_size
from taichi_dem.guards import SimulationStopped
from taichi_dem.hosted import NO_EQUILIBRIUM, HostedExchange
from taichi_dem.integrate import Verlet
from taichi_dem.joint import JointExpansions
from taichi_dem.lagged import LaggedWatch
from taichi_dem.meeting import Meeting
from taichi_dem.neighbors import Neighbors
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
REMEMBERED = 200_000  # particles: what the contacts of more remember would take too much to keep


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
        self.scene, self.time_step, self._coefficients = scene, time_step, coefficients
        self.effects = effects
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
        self._soil = place[scene.substrate.material] if scene.substrate else -1
        self.exchange = self._make_exchange(builder)
        self._hosted = None
        if self.exchange is not None and scene.substrate is not None:
            self._hosted = HostedExchange(self.exchange, scene.substrate.relaxation)
        self.lag = None
        if self.exchange is not None and self.exchange.lagged:
            self.lag = LaggedWatch(self.exchange)
        self.sleep = Sleep(self.particles, self.boundaries, builder) if effects.sleep else None
        self._trees = [builder.finalize()]
        weakref.finalize(self, _destroy, self._trees)
        self.control.fill(time_step, scene.gravity, max_overlap)
        self.particles.fill(spheres)
        self.boundaries.fill(place)
        for table in coefficients.values():
            table.fill()
        if self.exchange is not None:
            self.exchange.fill()

        self._smallest = float(spheres.radius.min())
        self.skin = Skin(spheres.radius, skin)
        self.pace = Pace(spheres.count, driver, self.meeting.assembles)
        self._extent = np.maximum(np.ptp(spheres.position, axis=0), 2 * spheres.radius.max())
        period = scene.period or ()
        self._extent[: len(period)] = period
        self.grid = Grid(self.particles, self._set_skin(), self._extent, period)
        self._trees.append(self.grid.tree)
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
        if self._hosted is not None:
            self._hosted.restart()
        if self.lag is not None:
            self.lag.restart()
        if self.sleep is not None:
            self.sleep.wake_all(0)
        self.skin.restart()
        self.grid.cell_size[None] = self._set_skin()
        self.energy.loss(True)
        self.lost, self.rebuilds = 0.0, 0
        self._start()

    def _start(self) -> None:
        """Contacts and forces of a state that no step has led to."""
        self._keep_good_state()
        self._stop_at_nonsense()
        self.rebuild(remember=False)
        self._solve_on_host(0.0)
        self._note_stored()
        self.drivers.evaluate(0.0)
        self.drivers.note_pushes()
        self._guard()  # forces belong to their list: a new one waits for the next step
        self.listing = 0.0  # s of wall time that making lists has taken since

    @property
    def step(self) -> int:
        """Steps made since the start."""
        return int(self.control.step[None])

    # -- a step ----------------------------------------------------------------------------------

    def advance(self, steps: int) -> None:
        """Make ``steps`` >= 1 steps of velocity Verlet: half kick, drift, forces, half kick."""
        self._keep_good_state()
        step = self.step + 1
        last, diverges = step + steps - 1, False
        self.drivers.begin()
        while True:
            self._answer()
            if step >= self.skin.review:
                self.rebuild()
            until = min(last, self.skin.review)
            if self.lag is not None:
                diverges = self._found_to_diverge(self.lag, step)
                until = min(until, self.lag.next)
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
        if self.lag is not None and diverges:
            self._keep_good_state()
            raise SimulationStopped(self._at_present(self.lag.reason()), None, self._good)

    def _make_steps(self, most: int) -> int:
        """As many steps as can be made before the host is needed, at most ``most``."""
        if self._host is not None:
            most = min(most, self._host.steps_to_next(self.step))
        drivers = self.drivers
        ways = {"serial": drivers.serial, "team": drivers.team, "parallel": drivers.loop}
        made = self.pace.advance(most, ways)
        self._let_dents_be(made - 1)  # the first of the steps has been seen to
        return made

    @property
    def creep(self) -> Creep | None:
        """What a ground that creeps remembers."""
        return None if self._hosted is None else self._hosted.creep

    @property
    def _host(self) -> HostedExchange | None:
        """Who solves for the contacts with the substrate, if they are too many for the kernel."""
        hosted = self._hosted
        return hosted if hosted is not None and hosted.exchange.hosted else None

    def _found_to_diverge(self, lag: LaggedWatch, step: int) -> bool:
        """Whether a lagged exchange is to be stopped at this step, where its state is still sound:
        so that it depends on no clock where that is."""
        if step < lag.next:
            return False
        lag.look(step)
        return lag.diverges and not self.scene.substrate.force_lagged  # type: ignore[union-attr]

    def _solve_on_host(self, time_step: float) -> None:
        if self._host is not None:
            together = self.exchange is not None and self.exchange.together
            settle = self.drivers.settle if together else None
            self._host.update(self.contacts, time_step, settle)
        elif time_step > 0:
            self._let_dents_be(1)

    def _let_dents_be(self, steps: int) -> None:
        """They recover, step by step, so that it does not matter how many are made at once."""
        if self.creep is not None:
            for _ in range(steps):
                self.creep.wait(self.time_step)

    def _note_stored(self) -> None:
        """What the surface holds; the solve in the kernel says so at every step."""
        if self._host is not None or self.creep is not None:
            self._hosted.note_energy()  # type: ignore[union-attr]

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
            records = self.records()
            row, why = guards.describe_deepest(
                records, self.scene.spheres.radius, float(self.control.deepest[None])
            )
            self._stop(why, row)
        if reasons & 1 << OVERPRESSED:
            self._stop(*guards.describe_overpressed(self.records()))
        if reasons & 1 << UNSOLVED:
            self._stop(self._unsolved(), None)
        return reasons

    def _unsolved(self) -> str:
        """Why the exchange has called for a stop."""
        exchange = self.exchange
        if exchange is not None and exchange.extrapolates and exchange.between.lost:
            return exchange.between.reason()
        return NO_EQUILIBRIUM if self._host is None else self._host.trouble

    def _stop_at_nonsense(self) -> None:
        step, smallest = self.time_step, self._smallest
        found = guards.first_offender(self.particles, self.boundaries, step, smallest)
        if found >= 0:
            self._stop(guards.describe_offender(self.particles, found, step), found)
        if found < -1:
            b = -2 - found
            speed = self.boundaries.motion[b].speed
            self._stop(guards.describe_boundary(b, speed, step, smallest), None)

    def _stop(self, why: str, row: int | None) -> None:
        message = self._at_present(why)
        good = self._good
        self.particles.write(good["position"], good["velocity"], good["omega"])
        self.boundaries.write(good["motion"])
        self.control.step[None] = good["step"]
        if self.exchange is not None:
            self.exchange.forget()
        if self.creep is not None:
            self.creep.restore(good["creep"])
        if self.lag is not None:
            self.lag.restore(good["lag"])
        if self.sleep is not None:
            self.sleep.wake_all(good["step"])
        self.skin.start_again(good["step"])
        self.rebuild(remember=False, filed=good["contacts"])
        self._solve_on_host(0.0)
        self.drivers.evaluate(0.0)
        if good["contacts"] is not None:  # which forces at rest have changed
            self.rebuild(remember=False, filed=good["contacts"])
            self.particles.write_load(good["force"], good["torque"])
        self.control.flags.fill(0)
        self.lost = good["lost"] - self.energy.loss(False)
        raise SimulationStopped(message, row, good)

    def _at_present(self, why: str) -> str:
        return f"at t = {self.step * self.time_step:.6g} s {why}."

    def _keep_good_state(self) -> None:
        state, contacts = self.particles.read(), self._contacts_on_file()
        if contacts is None:  # forces are found anew
            del state["force"], state["torque"]
        self._good: dict[str, Any] = {
            "time": self.step * self.time_step,
            "step": self.step,
            **state,
            "motion": self.boundaries.read(),
            "lost": self.lost + self.energy.loss(False),
            "creep": None if self.creep is None else self.creep.save(),
            "lag": None if self.lag is None else self.lag.save(),
            "contacts": contacts,
        }

    def _contacts_on_file(self) -> tuple[np.ndarray, np.ndarray] | None:
        """What contacts remember, which friction, rolling, yielding or adhesion make them do; None
        at the start, where they only know what their forces at rest tell them."""
        remembers = self.effects.history or self.effects.adhesion
        if not remembers or self.step == 0 or self.particles.count > REMEMBERED:
            return None
        self.neighbors.save(True)
        return self.contacts.filed()

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
            if self.exchange is not None:
                self.exchange.reorder(self.grid.particle)
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
        if self.exchange is not None:
            self.exchange.enrol(self.contacts)
        self.control.flags[STALE] = 0
        self.rebuilds += 1
        self.listing += time.perf_counter() - began

    def _make_list(self, capacity: int) -> None:
        """A contact list of ``capacity``, and the kernels that work on it."""
        old, spread = getattr(self, "contacts", None), getattr(self, "expansions", None)
        self.contacts = ContactList(self.particles.count, capacity, self.effects)
        self._trees.append(self.contacts.tree)
        if old is not None:
            self.contacts.inherit(old)
        self.neighbors = Neighbors(
            self.particles,
            self.boundaries,
            self.contacts,
            self.grid,
            self.control,
            self._soil >= 0,
            self.effects,
        )
        self.expansions = self._make_expansions()
        self.forces = Forces(
            self.scene.law,
            self.effects,
            self._coefficients,
            self.particles,
            self.boundaries,
            self.contacts,
            self.exchange,
            self._soil,
            self.control,
            self.expansions,
        )
        verlet = Verlet(self.particles, self.control, self.effects.rotation)
        self.drivers = Drivers(
            self.forces,
            verlet,
            self.boundaries,
            self.exchange,
            self.control,
            self.meeting,
            self.sleep,
        )
        self.energy = Energy(self.forces, self.exchange, self.boundaries)
        if old is not None:
            for tree in (old.tree, *([spread.tree] if spread else [])):
                self._trees.remove(tree)
                tree.destroy()

    def _make_expansions(self) -> Expansions | None:
        """What a surface law computes with on the present list."""
        law = self.scene.law
        if law.surface is None:
            return None
        table = self._coefficients["surface"].table
        geometry = Geometry(self.particles, self.boundaries, self._soil)
        held = self.effects.reach
        given = (law.surface, table, geometry, self.contacts, self.control, held)
        if law.surface.lagged:
            made = Expansions(*given)
        else:
            needs: dict[str, Any] = {
                "normal": law.normal,
                "normal_table": self._coefficients["normal"].table,
                "pairs": self._pairs,
            }
            if self.exchange is None:
                made = ImplicitExpansions(*given, **needs)
            else:
                made = JointExpansions(*given, **needs, exchange=self.exchange)
        self._trees.append(made.tree)
        return made

    def _set_skin(self) -> float:
        """Put the skin's width in force; returns the cell size that goes with it."""
        self.control.skin[None] = self.skin.width
        return best_cell_size(
            self.scene.spheres.radius, self.skin.width, float(np.prod(self._extent))
        )

    def _make_exchange(self, builder: "ti.FieldsBuilder") -> Exchange | None:
        substrate = self.scene.substrate
        if substrate is None or substrate.exchange == "none":
            return None
        return Exchange(
            substrate,
            self.scene.period,
            self.particles,
            self.scene.law,
            self.effects,
            self._coefficients["normal"],
            self._soil,
            self.scene.materials,
            self.control,
            builder,
        )

    # -- looking ---------------------------------------------------------------------------------

    def doubts(self) -> dict[str, int]:
        """How often so far what the substrate's model assumes did not hold, by name."""
        counts = {} if self.exchange is None else self.exchange.counts()
        return counts if self.lag is None else {**counts, "lagged_exchange": self.lag.risky}

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
        self._note_stored()
        in_dents = 0.0 if self._hosted is None else self._hosted.in_dents
        return self.energy.parts(np.array(self.scene.gravity), self.lost, in_dents)


def _destroy(trees: list[Any]) -> None:
    for tree in trees:
        tree.destroy()
