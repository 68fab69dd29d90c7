"""The substrate at every step: contacts out; expansion, slope and energy in.

Up to two thousand contacts or so on a half-space are solved inside the step's own kernel
(:mod:`taichi_dem.coupling`); more, and those on any other ground, go to :mod:`halfspace` through
the host (:mod:`taichi_dem.hosted`).  Which of the two depends on no driver.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

import halfspace
from taichi_dem.contact_list import APART, SUBSTRATE, ContactList, history_type
from taichi_dem.contacts.contact import at_rest
from taichi_dem.contacts.elasticity import effective_youngs_modulus
from taichi_dem.control import UNSOLVED, Control
from taichi_dem.coupling import DONE, START, CoupledSolve
from taichi_dem.effects import Effects
from taichi_dem.extrapolation import Extrapolation, course_members
from taichi_dem.material import Material
from taichi_dem.pair_sums import of
from taichi_dem.particles import Particles
from taichi_dem.periodic import Period
from taichi_dem.scene import Substrate
from taichi_dem.types import PRECISION, real, ti, vec2, vec3

IN_KERNEL_CONTACTS = 2048  # their matrix takes 16 MB
ROUND_OFF = 1e-14 if PRECISION == "double" else 1e-5  # no residual can be asked to be smaller
PAST = 4  # displacements kept: the next one is extrapolated from them by a cubic
DRIFTS = 3
FAST_IMPACT = 0.1  # of the substrate's shear wave speed: beyond, it is not quasi-static
WIDE_CONTACT = 0.3  # contact radius over sphere radius: beyond, strains are not small
HELD_BEYOND = 2.0  # times its opening: as far a contact holds that opens while others are solved
WIDE_FOR_LAYER = {"finite": 0.4, "point": 0.2}  # of its thickness: beyond, forces err by a percent
CLOSE_POINTS = 6.0  # contact radii: closer, a contact is not a point for its neighbours
TOUCHED, WIDE, CLOSE, OUTGROWN = 1, 2, 4, 8  # what has been noticed of a contact since it was made

past_values = ti.types.vector(PAST, real)
past_drifts = ti.types.vector(DRIFTS, real)


def ground_type(finite: bool, extrapolates: bool, spreads: bool) -> Any:
    """What the substrate keeps for a particle, whose own surface may rise, too (``spreads``)."""
    # bulge: what it has risen there by the sphere's other contacts, m
    more = {"bulge": real} if spreads else {}
    slopes = {"past_x": past_values, "past_y": past_values} if finite else {}
    return ti.types.struct(
        expansion=real,  # what the surface has risen, where the sphere touches it, by the others, m
        slope=vec2,  # the gradient of that
        force=real,  # elastic, N
        stored=real,  # in the surface, on account of this contact, J
        past=past_values,  # displacements of the last steps, latest first, m
        drift=past_drifts,  # what of their changes the solve's matrix does not explain, m
        drifts=ti.i32,  # how many of those there are
        **slopes,
        **(course_members() if extrapolates else {}),
        **more,
        age=ti.i32,  # how many of them there are
        anchor=vec3,  # x, y (m) and squared contact radius (m2) that the solve's matrix is for
        anchored=ti.i32,
        touched=ti.i32,
    )


def ground_of(substrate: Substrate, period: Period | None = None) -> halfspace.HalfSpace:
    """The half-space that the substrate of a scene with that period stands for."""
    material, layer = substrate.material, substrate.layer
    return halfspace.HalfSpace(
        material.youngs_modulus,
        material.poissons_ratio,
        tolerance=substrate.tolerance,
        coupling=substrate.coupling,
        period=period,
        layer=None if layer is None else halfspace.Layer(layer.thickness, layer.base),
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
        period: Period | None,
        particles: Particles,
        law,
        effects: Effects,
        coefficients,
        materials: Sequence[Material],
        control: Control,
        builder: "ti.FieldsBuilder",
    ):
        self.particles, self.control = particles, control
        self.normal, self.table = law.normal, coefficients.table
        self.material = materials.index(substrate.material)
        self.lagged, self.finite = substrate.exchange == "lagged", substrate.coupling == "finite"
        self.halfspace = ground_of(substrate, period)
        # Only there where every pair of contacts has one and the same simple kernel.
        self.in_kernel = substrate.homogeneous and period is None
        self.layered = substrate.layer is not None
        if self.layered:
            self._widest = WIDE_FOR_LAYER[substrate.coupling] * substrate.layer.thickness
        self.residual = max(substrate.residual, ROUND_OFF)
        self._soil, self._materials = substrate.material, materials

        self.spreads = law.surface is not None
        n = particles.count
        self.extrapolates = substrate.exchange_every > 1
        if self.extrapolates:
            self.between, self._every = Extrapolation(self, builder), substrate.exchange_every
        self.Ground = ground_type(self.finite, self.extrapolates, self.spreads)
        self.ground, self._sorted_ground = self.Ground.field(), self.Ground.field()
        self.members, self.entry = ti.field(ti.i32), ti.field(ti.i32)
        self.enrolled = ti.field(ti.i32)
        self.History = history_type(effects)
        self.has_history, self.adhesion = bool(effects.history), effects.adhesion
        self.together = self.spreads and not law.surface.lagged
        self.surface_residual = law.surface.residual if self.together else 0.0
        self.noticed = ti.field(ti.i64)
        self.softness = ti.field(real)  # by material: 3/(4 E*), 1/Pa
        self.wave_speed, self.on_host = ti.field(real), ti.field(ti.i32)
        fields = [self.ground, self._sorted_ground, self.members, self.entry, self.enrolled]
        if self.has_history:
            self.history = self.History.field()
            fields.append(self.history)
        if self.adhesion:
            self.held = ti.field(ti.i32)
            fields.append(self.held)
        for field in fields:
            builder.dense(ti.i, n).place(field)
        builder.dense(ti.i, len(self._doubts())).place(self.noticed)
        builder.dense(ti.i, len(materials)).place(self.softness)
        builder.place(self.wave_speed, self.on_host)
        most = IN_KERNEL_CONTACTS if self.in_kernel else 1
        self.solver = CoupledSolve(
            min(n, most), self.halfspace.modulus, self.finite, self.lagged, builder
        )

    def fill(self) -> None:
        """Write the constants, after the fields have been placed."""
        self.solver.fill(self.residual)
        self.wave_speed[None] = self._soil.shear_wave_speed
        self.enrolled.fill(-1)
        if self.extrapolates:
            self.between.every[None] = self._every
            self.between.forget()
        for k, material in enumerate(self._materials):
            self.softness[k] = 0.75 / effective_youngs_modulus(material, self._soil)

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
        self.hosted = self.count > (self.solver.capacity if self.in_kernel else 0)
        self.on_host[None] = int(self.hosted)

    @ti.kernel
    def _enrol(self, contacts: ti.template()) -> ti.i32:
        number, others = 0, 0
        ti.loop_config(serialize=True)
        for row in range(self.particles.count):
            i = self.particles.index_of[row]
            last = contacts.start[i + 1] - 1
            if last >= contacts.start[i] and contacts.ends[last].j == SUBSTRATE:
                self.members[number], self.entry[number] = i, last
                if self.enrolled[number] != row:
                    self.enrolled[number] = row
                    others = 1
                number += 1
            else:
                self.ground[i] = self.Ground()
        count = ti.min(number, self.solver.capacity)
        if others != 0:
            for k in range(count):
                self.solver.sums.moved[k] = 1
            self.solver.stale[None] = 1
        self.solver.count[None] = count
        return number

    def forget(self) -> None:
        """Start without a past, as for a state that no step has led to; to be enrolled anew."""
        self.ground.fill(0)
        self.enrolled.fill(-1)
        if self.extrapolates:
            self.between.forget()

    def restart(self) -> None:
        """:meth:`forget`, and count from zero again."""
        self.forget()
        self.noticed.fill(0)
        self.solver.applications[None] = 0
        if self.extrapolates:
            self.between.largest[None] = 0.0

    def counts(self) -> dict[str, int]:
        """How often so far the half-space's assumptions did not hold: impacts too fast, contacts
        too wide, points too close, contacts too wide for a layer; between two exchanges, contacts
        that swing far, or that are made by spheres which the last one did not know of."""
        return {name: int(self.noticed[k]) for k, name in enumerate(self._doubts())}

    def _doubts(self) -> list[str]:
        sparse = ["sparse_exchange", "unseen_contacts"] if self.extrapolates else []
        return ["fast_impacts", "wide_contacts", "close_points", "wide_for_layer", *sparse]

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

    # -- inside the step's kernel ----------------------------------------------------------------

    @ti.func
    def law(self, k, overlap):
        """Elastic force and tangent of contact ``k`` at an effective overlap, motion apart; it
        sees what the contact remembered before the step, and does not change it.  Where the law
        softens, its force is held while the others adapt."""
        history = self.History()
        if ti.static(self.has_history):
            history = self.history[k]
        return self.elastic(self.members[k], overlap, history)

    @ti.func
    def elastic(self, i, overlap, history):
        """:meth:`law` of particle ``i``."""
        answer = vec2(0.0)
        closed = overlap > 0.0
        if ti.static(self.adhesion):
            closed = self.held[i] != 0
        if closed:
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
        if ti.static(self.spreads):
            self.ground[i].bulge = self.expansion_of(i, p, contacts)
        if ti.static(self.has_history):
            self.history[k] = contacts.history[p]
        if ti.static(self.adhesion):
            overlap, history = self.overlap(i) - self.expected(i), self.History()
            if ti.static(self.has_history):
                history = self.history[k]
            opening = self.hold(i, overlap, history, contacts.touching[p])
        return opening

    @ti.func
    def hold(self, i, overlap, history, touching):
        """Decide whether the adhesive contact of particle ``i`` holds; returns its opening."""
        contact, table, opening = self.alone(i, overlap), self.coefficients(i), 0.0
        held = overlap > 0.0
        if touching != APART:
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
    def calls(self) -> ti.i32:
        """Whether blocks of the coupled solve are to be shared out."""
        return ti.atomic_or(self.solver.phase[None], 0) != DONE

    @ti.func
    def blocks(self):
        return self.solver.blocks()

    @ti.func
    def share(self, block):
        self.solver.share(block)

    @ti.func
    def begin(self):
        """Call for the coupled solve of a new step, if it is to have one."""
        calls = self.on_host[None] == 0
        if ti.static(self.extrapolates):
            calls = calls and self.between.due()
        if calls:
            self.solver.phase[None] = START

    @ti.func
    def proceed(self, contacts: ti.template()):
        """Go on with it after all blocks are done."""
        solver = self.solver
        if solver.phase[None] == START:
            for k in range(solver.count[None]):
                solver.opening[k] = self.settle(k, contacts)
                self.tell(k, self.members[k])
        if solver.proceed(self.law) == 0:
            self.control.raise_flag(UNSOLVED)
        if solver.phase[None] == DONE:
            for k in range(solver.count[None]):
                self.hear(k, self.members[k])
            if ti.static(self.extrapolates):
                self.note_course(solver.count[None])

    @ti.func
    def note_course(self, count):
        """What is to be extrapolated from, after an exchange; in one thread."""
        self.between.phase[None] = 0.0
        for k in range(count):
            self.between.note(k, self.members[k])
        if self.between.finish() == 0:
            self.control.raise_flag(UNSOLVED)

    @ti.func
    def tell(self, k, i):
        """Where particle ``i`` is now, and what its past lets expect."""
        solver, body, ground = self.solver, self.particles.body[i], self.ground[i]
        sums, anchor = solver.sums, ground.anchor
        sums.old_x[k], sums.old_y[k], sums.old_square[k] = anchor[0], anchor[1], anchor[2]
        solver.anchored[k] = ground.anchored
        solver.home_x[k], solver.home_y[k] = body.position[0], body.position[1]
        solver.radius[k], solver.overlap[k] = body.radius, self.overlap(i)
        solver.force[k] = ground.force
        if ti.static(self.extrapolates):  # that which the known displacement belongs to
            solver.force[k] = ground.solved
        solver.effective[k] = solver.overlap[k] - self.expected(i)
        drift = _extrapolated(ground.drift, ground.drifts)
        solver.base[k] = solver.overlap[k] - ground.past[0] - drift
        if ti.static(self.finite):
            solver.size[k] = self.size(i)
            shift = self.expected_shift(i)
            solver.shift_x[k], solver.shift_y[k] = shift[0], shift[1]

    @ti.func
    def hear(self, k, i):
        """What the coupled solve found for particle ``i``."""
        solver, sums, before = self.solver, self.solver.sums, self.ground[i].past[0]
        slope, force = vec2(of(sums.slope_x, k), of(sums.slope_y, k)), solver.force[k]
        sunk = solver.overlap[k] - solver.reached(k)  # by the sums, to rounding
        if solver.live[k] == 0:
            solver.effective[k] = solver.overlap[k] - sunk
        expansion = solver.effective[k] - solver.overlap[k]
        self.receive(i, self.overlap(i) + expansion, expansion, sunk, force, slope)
        ground = self.ground[i]
        if solver.live[k] != 0 and ground.age > 1:
            for step in ti.static(range(DRIFTS - 1, 0, -1)):
                ground.drift[step] = ground.drift[step - 1]
            ground.drift[0] = sunk - before - solver.gain[k]
            ground.drifts = ti.min(ground.drifts + 1, DRIFTS)
        else:
            ground.drifts = 0
        ground.anchor = vec3(sums.old_x[k], sums.old_y[k], sums.old_square[k])
        ground.anchored = solver.live[k]
        # f.(delta - c^2/(2R) - d) - E_c: where f.w - E_c would err by the residual, this does not.
        lost = solver.overlap[k] - of(sums.displacement, k) - solver.reached(k)
        apart = solver.overlap[k] - lost - solver.effective[k]
        ground.stored = force * (apart - 0.5 * of(sums.potential, k))
        self.ground[i] = ground
        self.watch_neighbours(i, of(sums.nearest, k))

    @ti.func
    def overlap(self, i):
        """Of particle ``i`` with the undeformed surface, m."""
        body = self.particles.body[i]
        overlap = body.radius - body.position[2]
        if ti.static(self.spreads):
            overlap += self.ground[i].bulge
        return overlap

    @ti.func
    def expansion_of(self, i, p, contacts: ti.template()):
        """What a surface law has found that particle ``i`` rises by at its contact ``p``, m."""
        body, expansion = self.particles.body[i], 0.0
        if body.radius - body.position[2] > -self.control.reach[None]:
            expansion = contacts.history[p].expansion[0]
        return expansion

    @ti.func
    def size(self, i):
        """3 R/(4 E*), m2/N: a^3 over the force on a Hertz contact."""
        return self.softness[self.particles.spin[i].material] * self.particles.body[i].radius

    @ti.func
    def expected(self, i):
        """The displacement that the past steps lead one to expect."""
        return _extrapolated(self.ground[i].past, self.ground[i].age)

    @ti.func
    def expected_shift(self, i):
        """Likewise the point of contact."""
        ground = self.ground[i]
        slope_x = _extrapolated(ground.past_x, ground.age)
        slope_y = _extrapolated(ground.past_y, ground.age)
        if ti.static(self.lagged):
            slope_x, slope_y = ground.slope[0], ground.slope[1]
        return self.particles.body[i].radius * vec2(slope_x, slope_y)

    @ti.func
    def receive(self, i, depth, expansion, sunk, force, slope):
        """Keep what came back for particle ``i``, and watch the assumptions; ``depth`` is how deep
        the contact is, ``sunk`` what -``expansion`` is to within the residual."""
        ground = self.ground[i]
        for step in ti.static(range(PAST - 1, 0, -1)):
            ground.past[step] = ground.past[step - 1]
        ground.past[0] = sunk
        if ti.static(self.finite):
            for step in ti.static(range(PAST - 1, 0, -1)):
                ground.past_x[step] = ground.past_x[step - 1]
                ground.past_y[step] = ground.past_y[step - 1]
            ground.past_x[0], ground.past_y[0] = slope[0], slope[1]
        ground.age = ti.min(ground.age + 1, PAST)
        ground.expansion, ground.force, ground.slope = expansion, force, slope
        self.ground[i] = ground
        body = self.particles.body[i]
        if self.overlap(i) + expansion > 0.0:
            if ground.touched == 0 and -body.velocity[2] > FAST_IMPACT * self.wave_speed[None]:
                self.noticed[0] += 1
            if depth > WIDE_CONTACT**2 * body.radius and ground.touched & WIDE == 0:
                self.noticed[1] += 1
                ground.touched |= WIDE
            if ti.static(self.layered):
                limit = ti.static(self._widest * self._widest)
                if depth * body.radius > limit and ground.touched & OUTGROWN == 0:
                    self.noticed[3] += 1
                    ground.touched |= OUTGROWN
            ground.touched |= TOUCHED
        else:
            ground.touched = 0
        self.ground[i] = ground

    @ti.func
    def watch_neighbours(self, i, nearest):
        """Points that are too close for that; ``nearest``: squared distance, m2."""
        if ti.static(not self.finite):
            body, ground = self.particles.body[i], self.ground[i]
            square = body.radius * (self.overlap(i) + ground.expansion)
            if nearest < CLOSE_POINTS**2 * square and ground.touched & CLOSE == 0:
                self.noticed[2] += 1
                self.ground[i].touched |= CLOSE

    @ti.func
    def stored(self, i):
        """Energy in the surface on account of the contact of particle ``i``, J."""
        return self.ground[i].stored

    @ti.func
    def lateral_force(self, i):
        """Contact ``i`` presses along the normal of a tilted surface: downhill, into the dents
        of its neighbours, -f grad e."""
        ground = self.ground[i]
        return -ground.force * vec3(ground.slope[0], ground.slope[1], 0.0)


@ti.func
def _extrapolated(past: ti.template(), age):
    """The next of ``age`` values, latest first, or of as many as are kept."""
    next_one = 0.0
    if age == 1:
        next_one = past[0]
    elif age == 2:
        next_one = 2.0 * past[0] - past[1]
    elif age >= 3:
        next_one = 3.0 * (past[0] - past[1]) + past[2]
    if ti.static(past.n >= 4):
        if age >= 4:
            next_one = 4.0 * (past[0] + past[2]) - 6.0 * past[1] - past[3]
    return next_one
