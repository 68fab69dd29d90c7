"""The substrate at every step: contacts out, expansion and slope in.

A few hundred contacts are solved inside the step's own kernel (:mod:`taichi_dem.coupling`); more go
to :mod:`halfspace` through the host.  Which of the two is a matter of their number alone, so both
drivers do the same.
"""

import math

import numpy as np

import halfspace
from taichi_dem.contact_list import APART, SUBSTRATE, ContactList, history_type
from taichi_dem.contacts.contact import at_rest
from taichi_dem.control import UNSOLVED, Control
from taichi_dem.coupling import CoupledSolve
from taichi_dem.effects import Effects
from taichi_dem.particles import Particles
from taichi_dem.scene import Substrate
from taichi_dem.types import PRECISION, real, ti, vec2, vec3

IN_KERNEL_CONTACTS = 1024  # their influence matrix takes 8 MB
ROUND_OFF = 1e-14 if PRECISION == "double" else 1e-5  # no residual can be asked to be smaller
PAST = 4  # displacements kept: the next one is extrapolated from them by a cubic
FAST_IMPACT = 0.1  # of the substrate's shear wave speed: beyond, it is not quasi-static
WIDE_CONTACT = 0.3  # contact radius over sphere radius: beyond, strains are not small
HELD_BEYOND = 2.0  # times its opening: as far a contact holds that opens while others are solved

Ground = ti.types.struct(
    expansion=real,  # what the surface under the contact has risen by the others' forces, m
    slope=vec2,  # the gradient of that
    force=real,  # elastic, N
    past=ti.types.vector(PAST, real),  # displacements of the last steps, latest first, m
    age=ti.i32,  # how many of them there are
    touched=ti.i32,
)


def ground_of(substrate: Substrate) -> halfspace.HalfSpace:
    """The half-space that a scene's substrate stands for."""
    material = substrate.material
    return halfspace.HalfSpace(
        material.youngs_modulus,
        material.poissons_ratio,
        tolerance=substrate.tolerance,
        coupling=substrate.coupling,
    )


@ti.data_oriented
class Exchange:
    """Fields of the substrate's contacts, one at most for each particle.

    members   the particles near the surface, in the order of their ids
    entry     the contact of each member
    history   what that remembers, as it was before the step (absent if nothing)
    held      by particle, whether it is in contact (absent unless contacts adhere)
    """

    def __init__(
        self,
        substrate: Substrate,
        particles: Particles,
        law,
        effects: Effects,
        coefficients,
        material: int,
        control: Control,
        builder: "ti.FieldsBuilder",
    ):
        self.particles, self.control = particles, control
        self.normal, self.table, self.material = law.normal, coefficients.table, material
        self.lagged = substrate.exchange == "lagged"
        self.halfspace = ground_of(substrate)
        self.residual = max(substrate.residual, ROUND_OFF)
        self._plan: halfspace.Plan | None = None  # of the host's sums, kept from step to step
        soil = substrate.material
        shear = soil.youngs_modulus / (2 * (1 + soil.poissons_ratio))
        self._wave_speed = math.sqrt(shear / soil.density)

        n = particles.count
        self.ground, self._sorted_ground = Ground.field(), Ground.field()
        self.members, self.entry = ti.field(ti.i32), ti.field(ti.i32)
        self.History = history_type(effects)
        self.has_history, self.adhesion = bool(effects.history), effects.adhesion
        self.fast_impacts, self.wide_contacts = ti.field(ti.i64), ti.field(ti.i64)
        self.wave_speed, self.on_host = ti.field(real), ti.field(ti.i32)
        builder.dense(ti.i, n).place(self.ground)
        builder.dense(ti.i, n).place(self._sorted_ground)
        builder.dense(ti.i, n).place(self.members, self.entry)
        if self.has_history:
            self.history = self.History.field()
            builder.dense(ti.i, n).place(self.history)
        if self.adhesion:
            self.held = ti.field(ti.i32)
            builder.dense(ti.i, n).place(self.held)
        builder.place(self.fast_impacts, self.wide_contacts, self.wave_speed, self.on_host)
        self.solver = CoupledSolve(min(n, IN_KERNEL_CONTACTS), self.halfspace.modulus, builder)

    def fill(self) -> None:
        """Write the constants, after the fields have been placed."""
        self.solver.fill(self.residual)
        self.wave_speed[None] = self._wave_speed

    @ti.kernel
    def reorder(self, order: ti.template()):
        """Follow the particles into the order of the cells."""
        for s in range(self.particles.count):
            self._sorted_ground[s] = self.ground[order[s]]
        for s in range(self.particles.count):
            self.ground[s] = self._sorted_ground[s]

    def enrol(self, contacts: ContactList) -> None:
        """Find the members after the contact list has been rebuilt, and who solves for them."""
        self.count = self._enrol(contacts)
        self.hosted = self.count > self.solver.capacity
        self.on_host[None] = int(self.hosted)

    @ti.kernel
    def _enrol(self, contacts: ti.template()) -> ti.i32:
        number = 0
        ti.loop_config(serialize=True)
        for row in range(self.particles.count):
            i = self.particles.index_of[row]
            last = contacts.start[i + 1] - 1
            if last >= contacts.start[i] and contacts.ends[last].j == SUBSTRATE:
                self.members[number], self.entry[number] = i, last
                number += 1
            else:
                self.ground[i] = Ground()
        self.solver.count[None] = ti.min(number, self.solver.capacity)
        return number

    def forget(self) -> None:
        """Start without a past, as for a state that no step has led to."""
        self.ground.fill(0)

    def restart(self) -> None:
        """:meth:`forget`, and count from zero again."""
        self.forget()
        for counter in (self.fast_impacts, self.wide_contacts, self.solver.applications):
            counter[None] = 0

    def counts(self) -> tuple[int, int]:
        """Impacts too fast and contacts too wide for the half-space, so far."""
        return int(self.fast_impacts[None]), int(self.wide_contacts[None])

    def read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Elastic force (n,), expansion (n,) and slope (n, 2) by particle, in the user's order."""
        n = self.particles.count
        arrays = np.empty(n), np.empty(n), np.empty((n, 2))
        self._read(*arrays)
        return arrays

    @ti.kernel
    def _read(
        self,
        force: ti.types.ndarray(),
        expansion: ti.types.ndarray(),
        slope: ti.types.ndarray(),
    ):
        for i in range(self.particles.count):
            row, ground = self.particles.spin[i].id, self.ground[i]
            force[row], expansion[row] = ground.force, ground.expansion
            for axis in ti.static(range(2)):
                slope[row, axis] = ground.slope[axis]

    # -- through the host ------------------------------------------------------------------------

    def update_on_host(self, contacts: ContactList) -> None:
        """As :meth:`update`, by ``halfspace``."""
        n = self.count
        position, overlap, expected, before = np.empty((n, 2)), *np.empty((3, n))
        opening = np.empty(n)
        self._send(n, contacts, position, overlap, expected, before, opening)
        self._plan = self._plan or self.halfspace.plan(position)
        if self.lagged:
            self._plan.refresh(position)
            effective = overlap - self._plan.apply(before)
            force = self._host_law(effective)[0]
            slope = self._plan.slope(force)
        else:
            try:
                result = halfspace.solve(
                    self.halfspace,
                    position,
                    overlap,
                    self._host_law,
                    residual=self.residual,
                    start=overlap - expected,
                    opening=opening,
                    plan=self._plan,
                )
            except halfspace.NotConverged as error:
                self.control.flags[UNSOLVED] = 1
                result = error.state
            effective, force, slope = result.overlap, result.force, result.slope
            self.solver.applications[None] += result.applications
        self._take(n, effective - overlap, force, slope)

    def _host_law(self, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        force, tangent = np.empty((2, len(overlap)))
        self._evaluate_law(len(overlap), np.ascontiguousarray(overlap), force, tangent)
        return force, tangent

    @ti.kernel
    def _send(
        self,
        n: ti.i32,
        contacts: ti.template(),
        position: ti.types.ndarray(),
        overlap: ti.types.ndarray(),
        expected: ti.types.ndarray(),
        before: ti.types.ndarray(),
        opening: ti.types.ndarray(),
    ):
        for k in range(n):
            i = self.members[k]
            opening[k] = self.settle(k, contacts)
            body = self.particles.body[i]
            position[k, 0], position[k, 1] = body.position[0], body.position[1]
            overlap[k] = body.radius - body.position[2]
            expected[k] = self.expected(i)
            before[k] = self.ground[i].force

    @ti.kernel
    def _evaluate_law(
        self,
        n: ti.i32,
        overlap: ti.types.ndarray(),
        force: ti.types.ndarray(),
        tangent: ti.types.ndarray(),
    ):
        for k in range(n):
            answer = self.law(k, overlap[k])
            force[k], tangent[k] = answer[0], answer[1]

    @ti.kernel
    def _take(
        self,
        n: ti.i32,
        expansion: ti.types.ndarray(),
        force: ti.types.ndarray(),
        slope: ti.types.ndarray(),
    ):
        ti.loop_config(serialize=True)
        for k in range(n):
            self.receive(self.members[k], expansion[k], force[k], vec2(slope[k, 0], slope[k, 1]))

    # -- inside the step's kernel ----------------------------------------------------------------

    @ti.func
    def law(self, k, overlap):
        """Elastic force and tangent of contact ``k`` at an effective overlap, motion apart; it
        sees what the contact remembered before the step, and does not change it.  Where the law
        softens, its force is held while the others adapt."""
        answer = vec2(0.0)
        i = self.members[k]
        closed = overlap > 0.0
        if ti.static(self.adhesion):
            closed = self.held[i] != 0
        if closed:
            history = self.History()
            if ti.static(self.has_history):
                history = self.history[k]
            normal = self.normal.force(self.alone(i, overlap), self.coefficients(i), history)
            answer = vec2(normal.elastic, ti.max(normal.stiffness, 0.0))
        return answer

    @ti.func
    def alone(self, i, overlap):
        """The contact of ``i`` with the substrate, motion apart."""
        body = self.particles.body[i]
        return at_rest(overlap, body.radius, 1.0 / body.inverse_mass)

    @ti.func
    def coefficients(self, i):
        return self.table[self.particles.spin[i].material, self.material]

    @ti.func
    def settle(self, k, contacts: ti.template()):
        """Take over what the contact of member ``k`` remembers, and decide whether it holds: while
        forces are solved for none jumps, so that there is an equilibrium.  Returns the effective
        overlap at which its force ends."""
        i, p, opening = self.members[k], self.entry[k], 0.0
        if ti.static(self.has_history):
            self.history[k] = contacts.history[p]
        if ti.static(self.adhesion):
            body = self.particles.body[i]
            overlap = body.radius - body.position[2] - self.expected(i)
            contact, table, history = self.alone(i, overlap), self.coefficients(i), self.History()
            if ti.static(self.has_history):
                history = self.history[k]
            held = overlap > 0.0
            if contacts.touching[p] != APART:
                held = self.normal.holds(contact, table, history) != 0
            self.held[i] = ti.cast(held, ti.i32)
            if held:
                opening = HELD_BEYOND * self.normal.opening(contact, table)
        return opening

    @ti.func
    def is_held(self, i):
        """Whether particle ``i`` has been found to be in contact."""
        return self.held[i] != 0

    @ti.func
    def stored(self, i):
        """Energy in the surface on account of the contact of particle ``i``, J."""
        return -0.5 * self.ground[i].force * self.ground[i].expansion

    @ti.func
    def update(self, contacts: ti.template()):
        """Expansions and slopes for where the particles are now."""
        for k in range(self.solver.count[None]):
            i = self.members[k]
            self.solver.opening[k] = self.settle(k, contacts)
            body = self.particles.body[i]
            self.solver.position[k] = vec2(body.position[0], body.position[1])
            self.solver.overlap[k] = body.radius - body.position[2]
            self.solver.effective[k] = self.solver.overlap[k] - self.expected(i)
            self.solver.force[k] = self.ground[i].force
        self.solver.influence_of_positions()
        if ti.static(self.lagged):
            self.lag()
        else:
            if self.solver.solve(self.law) == 0:
                self.control.raise_flag(UNSOLVED)
        self.solver.slopes()
        for k in range(self.solver.count[None]):
            self.receive(
                self.members[k],
                self.solver.effective[k] - self.solver.overlap[k],
                self.solver.force[k],
                self.solver.slope[k],
            )

    @ti.func
    def lag(self):
        """The surface as the last step's forces leave it."""
        self.solver.apply(self.solver.force, self.solver.displacement)
        for k in range(self.solver.count[None]):
            self.solver.effective[k] = self.solver.overlap[k] - self.solver.displacement[k]
            self.solver.force[k] = self.law(k, self.solver.effective[k])[0]

    @ti.func
    def expected(self, i):
        """The displacement that the past steps lead one to expect."""
        past, age = self.ground[i].past, self.ground[i].age
        expected = 0.0
        if age == 1:
            expected = past[0]
        elif age == 2:
            expected = 2.0 * past[0] - past[1]
        elif age == 3:
            expected = 3.0 * (past[0] - past[1]) + past[2]
        elif age >= 4:
            expected = 4.0 * (past[0] + past[2]) - 6.0 * past[1] - past[3]
        return expected

    @ti.func
    def receive(self, i, expansion, force, slope):
        """Keep what came back for particle ``i``, and watch the assumptions."""
        ground = self.ground[i]
        for step in ti.static(range(PAST - 1, 0, -1)):
            ground.past[step] = ground.past[step - 1]
        ground.past[0] = -expansion
        ground.age = ti.min(ground.age + 1, PAST)
        ground.expansion, ground.force, ground.slope = expansion, force, slope
        body = self.particles.body[i]
        overlap = body.radius - body.position[2] + expansion
        if overlap > 0.0:
            if ground.touched == 0 and -body.velocity[2] > FAST_IMPACT * self.wave_speed[None]:
                self.fast_impacts[None] += 1
            wide = overlap > WIDE_CONTACT**2 * body.radius
            if wide and ground.touched < 2:
                self.wide_contacts[None] += 1
            ground.touched = 2 if wide else ti.max(ground.touched, 1)
        else:
            ground.touched = 0
        self.ground[i] = ground

    @ti.func
    def lateral_force(self, i):
        """Contact ``i`` presses along the normal of a tilted surface: downhill, into the dents
        of its neighbours, -f grad e."""
        ground = self.ground[i]
        return -ground.force * vec3(ground.slope[0], ground.slope[1], 0.0)
