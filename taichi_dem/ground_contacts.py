"""The contacts with the substrate, whoever solves for them: geometry, law, past."""

from collections.abc import Sequence

import numpy as np

from taichi_dem.contact_list import APART, history_type
from taichi_dem.contacts.contact import at_rest, force_while_solved, hold_while_solved
from taichi_dem.contacts.elasticity import effective_youngs_modulus
from taichi_dem.control import Control
from taichi_dem.doubts import Doubts
from taichi_dem.effects import Effects
from taichi_dem.ground_past import PAST, ground_type
from taichi_dem.material import Material
from taichi_dem.particles import Particles
from taichi_dem.past import best, extrapolated, judged, shifted
from taichi_dem.substrate import Substrate
from taichi_dem.types import real, ti, vec2, vec3


@ti.data_oriented
class GroundContacts:
    """Fields of the substrate's contacts, one at most for each particle.

    ground    by particle, what the substrate keeps of it
    members   the particles near the surface, in the order of their ids
    entry     the contact of each member
    history   what that remembers, as it was before the step (absent if nothing)
    held      by particle, whether it is in contact (absent unless contacts adhere)
    softness  by material, 3/(4 E*), 1/Pa
    """

    def __init__(
        self,
        substrate: Substrate,
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
        self._soil, self._materials = substrate.material, materials
        self.lagged, self.finite = substrate.exchange == "lagged", substrate.coupling == "finite"
        self.extrapolates = substrate.exchange_every > 1
        self.spreads = law.surface is not None
        self.has_history, self.adhesion = bool(effects.history), effects.adhesion
        self.doubts = Doubts(substrate, builder)

        n = particles.count
        self.Ground = ground_type(self.finite, self.extrapolates, self.spreads)
        self.ground, self._sorted_ground = self.Ground.field(), self.Ground.field()
        self.members, self.entry = ti.field(ti.i32), ti.field(ti.i32)
        fields = [self.ground, self._sorted_ground, self.members, self.entry]
        self.History = history_type(effects)
        if self.has_history:
            self.history = self.History.field()
            fields.append(self.history)
        if self.adhesion:
            self.held = ti.field(ti.i32)
            fields.append(self.held)
        for field in fields:
            builder.dense(ti.i, n).place(field)
        self.softness = ti.field(real)
        builder.dense(ti.i, len(materials)).place(self.softness)

    def fill(self) -> None:
        """Write the constants, after the fields have been placed."""
        self.doubts.fill()
        for k, material in enumerate(self._materials):
            self.softness[k] = 0.75 / effective_youngs_modulus(material, self._soil)

    @ti.kernel
    def reorder(self, order: ti.template()):
        """Follow the particles into the order of the cells."""
        for s in range(self.particles.count):
            self._sorted_ground[s] = self.ground[order[s]]
        for s in range(self.particles.count):
            self.ground[s] = self._sorted_ground[s]

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
        sees what the contact remembered before the step, and does not change it."""
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
            closed = self.is_held(i)
        if closed:
            contact, k = self.alone(i, overlap), self.coefficients(i)
            answer = force_while_solved(self.normal.force, contact, k, history)
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
        """Take over what the contact of member ``k`` remembers, and decide whether it holds.
        Returns the effective overlap at which its force ends."""
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
        contact, k = self.alone(i, overlap), self.coefficients(i)
        held, opening = hold_while_solved(
            self.normal.holds, self.normal.opening, contact, k, history, touching != APART
        )
        self.held[i] = held
        return opening

    @ti.func
    def is_held(self, i):
        """Whether particle ``i`` has been found to be in contact."""
        return self.held[i] != 0

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
    def squared_radius(self, i, depth):
        """Of the contact of particle ``i`` that is ``depth`` (m) deep, m2."""
        square = self.particles.body[i].radius * depth
        if ti.static(self.adhesion):  # it pulls itself wider, also where it is not deep at all
            radius = 0.0
            if self.is_held(i):
                history, contact, k = self.History(), self.alone(i, depth), self.coefficients(i)
                punch = self.normal.force(contact, k, history).area_stiffness  # 2 E* a
                radius = 2.0 / 3.0 * self.softness[self.particles.spin[i].material] * punch
            square = radius * radius
        return square

    @ti.func
    def expected(self, i):
        """The displacement that the past steps lead one to expect."""
        ground = self.ground[i]
        return extrapolated(ground.past, best(ground.missed, ground.age))

    @ti.func
    def expected_shift(self, i):
        """Likewise the point of contact."""
        ground = self.ground[i]
        slope = ground.slope
        if ti.static(not self.lagged):
            number = best(ground.missed, ground.age)
            slope[0] = extrapolated(ground.past_x, number)
            slope[1] = extrapolated(ground.past_y, number)
        return self.particles.body[i].radius * slope

    @ti.func
    def receive(self, i, depth, expansion, sunk, force, slope):
        """Keep what came back for particle ``i``, and watch the assumptions; ``depth`` is how deep
        the contact is, ``sunk`` what -``expansion`` is to within the residual."""
        ground, touched = self.ground[i], 0
        if ti.static(not self.lagged):
            ground.missed = judged(ground.missed, ground.past, ground.age, sunk)
        ground.past = shifted(ground.past, sunk)
        if ti.static(self.finite):
            ground.past_x = shifted(ground.past_x, slope[0])
            ground.past_y = shifted(ground.past_y, slope[1])
        ground.age = ti.min(ground.age + 1, PAST)
        ground.expansion, ground.force, ground.slope = expansion, force, slope
        closed = self.overlap(i) + expansion > 0.0
        if ti.static(self.adhesion):
            closed = self.is_held(i)
        if closed:
            square = self.squared_radius(i, depth)
            touched = self.doubts.about(self.particles.body[i], square, ground.touched)
        ground.touched = touched
        self.ground[i] = ground

    @ti.func
    def watch_neighbours(self, i, nearest):
        """Points that are too close for that; ``nearest``: squared distance, m2."""
        if ti.static(not self.finite):
            ground = self.ground[i]
            square = self.squared_radius(i, self.overlap(i) + ground.expansion)
            touched = self.doubts.about_neighbours(square, nearest, ground.touched)
            self.ground[i].touched = touched

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
