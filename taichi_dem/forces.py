"""The force kernel, composed from a scene's laws: what is absent is not compiled.

Two functions make a step: :meth:`Forces.evaluate` for each contact, :meth:`Forces.gather` for each
particle.  Walls and spheres differ in their geometry alone; every law is called in one place.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART, FIRST_FACE, HELD, SUBSTRATE, TOUCHING, ContactList
from taichi_dem.contacts.contact import at_rest, meet
from taichi_dem.contacts.law import Law
from taichi_dem.control import TOO_DEEP, Control
from taichi_dem.geometry import Geometry
from taichi_dem.material import Material
from taichi_dem.particles import Particles
from taichi_dem.types import real, ti, vec2, vec3


def history_of(law: Law) -> dict[str, Any]:
    """What the contacts must remember: the union of what the laws declare."""
    return {name: kind for part in law.parts().values() for name, kind in part.history}


class Coefficients:
    """Per pair of materials, the numbers that one law computes with."""

    def __init__(self, law: Law, slot: str, materials: Sequence[Material]):
        self._law, self._slot, self._materials = law, slot, materials
        names = getattr(law, slot).coefficient_names
        self.table = ti.Struct.field(dict.fromkeys(names, real))

    def between(self, a: Material, b: Material) -> Mapping[str, float]:
        """The coefficients of materials ``a`` and ``b``."""
        return self._law.between(self._slot, a.name, b.name).coefficients(a, b)

    def fill(self) -> None:
        """Write the table, after it has been placed."""
        for row, a in enumerate(self._materials):
            for column, b in enumerate(self._materials):
                self.table[row, column] = dict(self.between(a, b))


@ti.data_oriented
class Forces:
    """Contact forces of ``particles`` under ``law``; ``substrate`` is the coupled one or None,
    ``substrate_material`` the index of its material, -1 where the scene has none; ``expansions``
    are those of a surface law or None."""

    def __init__(
        self,
        law: Law,
        coefficients: Mapping[str, Coefficients],
        particles: Particles,
        boundaries: Boundaries,
        contacts: ContactList,
        substrate: Any,
        substrate_material: int,
        control: Control,
        expansions: Any = None,
    ):
        self.particles, self.boundaries, self.contacts = particles, boundaries, contacts
        self.normal, self.tangential = law.normal, law.tangential
        self.normal_table = coefficients["normal"].table
        self.rubs = law.tangential is not None
        if self.rubs:
            self.tangential_table = coefficients["tangential"].table
        self.geometry = Geometry(particles, boundaries, substrate_material)
        self.coupled = substrate is not None
        self.substrate, self.substrate_material = substrate, substrate_material
        self.control = control
        self.surface, self.spreads = law.surface, expansions is not None
        self.expansions = expansions

    @ti.func
    def evaluate(self, p, time_step):
        """Force, couple and history of contact ``p``."""
        i, j = self.contacts.ends[p].i, self.contacts.ends[p].j
        spin = self.particles.spin[i]
        touched = self.contacts.touching[p] != APART
        reach = 0.0
        if ti.static(self.spreads):
            reach = self.control.reach[None]
        met = self.geometry.encounter(i, j, reach, touched)
        overlap, expansion = met.overlap, vec2(0.0)
        if ti.static(self.coupled):
            if j == SUBSTRATE:
                overlap += self.substrate.ground[i].expansion
        if ti.static(self.spreads):
            if self.expansions.note(p, met):
                expansion = self.expansions.of(p)
                overlap += expansion[0] + expansion[1]
                self.expansions.watch(expansion)

        if overlap > 0.0 or touched:
            arm = self.particles.body[i].radius - 0.5 * overlap
            partner_arm = met.partner_radius - 0.5 * overlap
            if ti.static(self.spreads):
                arm += expansion[0]
                partner_arm += expansion[1]
            contact = meet(
                met.normal,
                overlap,
                met.velocity,
                arm * spin.omega + partner_arm * met.partner_omega,
                0.5 * (spin.omega + met.partner_omega).dot(met.normal),
                met.effective_radius,
                met.effective_mass,
                time_step,
            )
            if overlap > 0.0:
                self.apply_laws(p, contact, spin.material, met.material)
                if ti.static(self.coupled):
                    if j == SUBSTRATE:
                        self.contacts.result[p].force += self.substrate.lateral_force(i)
                if overlap > self.control.deepest[None] * met.smaller:
                    self.control.raise_flag(TOO_DEEP)
            else:
                self.open(p, contact)

    @ti.func
    def apply_laws(self, p, contact, first, second):
        """Every law of the scene, on a contact of materials ``first`` and ``second``."""
        history = self.contacts.History()
        if ti.static(self.contacts.has_history):
            history = self.contacts.history[p]
        normal = self.normal.force(contact, self.normal_table[first, second], history)
        force, friction = normal.total * contact.normal, vec3(0.0)
        if ti.static(self.rubs):
            friction = self.tangential.force(
                contact, normal, self.tangential_table[first, second], history
            )
            force += friction
        if ti.static(self.contacts.dissipates):
            self.book(p, contact, normal.elastic - normal.total, friction)
        if ti.static(self.spreads):
            self.surface.remember(normal, history)
            force += self.expansions.lateral_force(p)
        if ti.static(self.contacts.has_history):
            self.contacts.history[p] = history
        self.contacts.result[p].force = force
        self.contacts.result[p].couple = contact.normal.cross(friction)
        self.contacts.result[p].half_overlap = 0.5 * contact.overlap
        self.contacts.touching[p] = TOUCHING

    @ti.func
    def open(self, p, contact):
        """A contact ends, and forgets; what its spring still held is lost."""
        if ti.static(self.contacts.dissipates):
            self.book(p, contact, 0.0, vec3(0.0))
        if ti.static(self.contacts.has_history):
            self.contacts.history[p] = self.contacts.History()
        self.contacts.touching[p] = APART

    @ti.func
    def book(self, p, contact, drag, friction):
        """The work of dashpot and friction over the step that led here, by the trapezoidal rule
        that makes Verlet's own work exact: mean force of the two ends, velocity between them."""
        drag_before, friction_before = 0.0, vec3(0.0)
        if self.contacts.touching[p] == HELD:  # forces are not carried over: take these
            drag_before, friction_before = drag, friction
        elif self.contacts.touching[p] == TOUCHING:
            drag_before = self.contacts.result[p].drag
            friction_before = self.contacts.result[p].couple.cross(contact.normal)
        power = (drag_before + drag) * contact.normal_velocity - (friction_before + friction).dot(
            contact.tangential_velocity
        )
        self.contacts.lost[p] += 0.5 * contact.time_step * power
        self.contacts.result[p].drag = drag

    @ti.func
    def stored(self, p):
        """Elastic energy of a touching contact, normal and tangential, J."""
        i, j = self.contacts.ends[p].i, self.contacts.ends[p].j
        body = self.particles.body[i]
        radius, material = body.radius, 0
        if j >= 0:
            other = self.particles.body[j].radius
            radius *= other / (body.radius + other)
            material = self.particles.spin[j].material
        elif j == SUBSTRATE:
            material = self.substrate_material
        else:
            material = self.boundaries.face[FIRST_FACE - j].material
        history, energy = self.contacts.History(), vec2(0.0)
        if ti.static(self.contacts.has_history):
            history = self.contacts.history[p]
        contact = at_rest(2.0 * self.contacts.result[p].half_overlap, radius, 1.0)
        k = self.normal_table[self.particles.spin[i].material, material]
        energy[0] = self.normal.energy(contact, k, history)
        if ti.static(self.rubs):
            energy[1] = self.tangential.energy(history)
        return energy

    @ti.func
    def gather(self, i):
        """Force and torque on particle ``i``, summed in the order of its partners' ids."""
        force, torque, radius = vec3(0.0), vec3(0.0), self.particles.body[i].radius
        for q in range(self.contacts.incidence_start[i], self.contacts.incidence_start[i + 1]):
            entry = self.contacts.incidence[q]
            p = entry >> 1
            if self.contacts.touching[p] != APART:
                if entry & 1 == 1:
                    force -= self.contacts.result[p].force
                else:
                    force += self.contacts.result[p].force
                if ti.static(self.rubs):
                    arm = radius - self.contacts.result[p].half_overlap
                    if ti.static(self.spreads):
                        arm += self.contacts.history[p].expansion[entry & 1]
                    torque -= arm * self.contacts.result[p].couple
        return force, torque
