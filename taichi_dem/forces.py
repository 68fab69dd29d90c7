"""The force kernel, composed from a scene's laws: what is absent is not compiled.

Two functions make a step: :meth:`Forces.evaluate` for each contact, :meth:`Forces.gather` for each
particle.  Walls and spheres differ in their geometry alone; every law is called in one place.
"""

from collections.abc import Mapping
from typing import Any

from taichi_dem.boundaries import Boundaries
from taichi_dem.coefficients import Coefficients
from taichi_dem.contact_list import APART, FIRST_FACE, SUBSTRATE, TOUCHING, ContactList
from taichi_dem.contacts.contact import at_rest, meet
from taichi_dem.contacts.law import Law
from taichi_dem.control import TOO_DEEP, Control
from taichi_dem.effects import Effects
from taichi_dem.geometry import Geometry
from taichi_dem.particles import Particles
from taichi_dem.types import ti, vec2, vec3


@ti.data_oriented
class Forces:
    """Contact forces of ``particles`` under ``law``; ``substrate`` is the coupled one or None,
    ``substrate_material`` the index of its material, -1 where the scene has none; ``expansions``
    are those of a surface law or None."""

    def __init__(
        self,
        law: Law,
        effects: Effects,
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
        self.normal, self.tangential, self.rolling = law.normal, law.tangential, law.rolling
        self.normal_table = coefficients["normal"].table
        self.rubs, self.rolls = effects.friction, effects.rolling
        self.adhesion, self.plastic = effects.adhesion, effects.plastic
        self.asks_reach = "inverse_reach" in effects.asks_for
        self.asks_spin = "relative_spin" in effects.asks_for
        self.asks_inertia = contacts.shares_inertia
        if self.rubs:
            self.tangential_table = coefficients["tangential"].table
        self.winds = self.rolls and bool(law.rolling.history)
        if self.rolls:
            self.rolling_table = coefficients["rolling"].table
        self.geometry = Geometry(particles, boundaries, substrate_material)
        self.coupled = substrate is not None
        self.substrate, self.substrate_material = substrate, substrate_material
        self.control = control
        self.surface, self.spreads = law.surface, expansions is not None
        self.expansions = expansions
        self.settles = self.adhesion and self.spreads and expansions.implicit

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
                if ti.static(self.substrate.extrapolates):
                    self.substrate.between.carry(p, self.contacts)
                overlap += self.substrate.ground[i].expansion
        if ti.static(self.spreads):
            if self.expansions.note(p, met):
                expansion = self.expansions.of(p)
                overlap += expansion[0] + expansion[1]
                self.expansions.watch(expansion)
                if ti.static(self.surface.lagged):
                    met.effective_radius = self.expansions.swell(p, met)

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
            if ti.static(self.asks_reach):
                if j >= 0:
                    own = self.particles.body[i].radius
                    contact.inverse_reach = 1.0 / (own + met.partner_radius)
            if ti.static(self.asks_spin):
                contact.relative_spin = spin.omega - met.partner_omega
            if ti.static(self.asks_inertia):
                contact.rolling_inertia = self.shared_inertia(i, j, touched)
            if self.is_closed(p, contact, touched, spin.material, met.material):
                lateral = vec3(0.0)
                if ti.static(self.coupled):
                    if j == SUBSTRATE:
                        lateral = self.substrate.lateral_force(i)
                if ti.static(self.spreads):
                    lateral += self.expansions.lateral_force(p)
                self.apply_laws(p, contact, met.velocity, lateral, spin.material, met.material)
                if overlap > self.control.deepest[None] * met.smaller:
                    self.control.raise_flag(TOO_DEEP)
            else:
                self.open(p, contact, met.velocity)

    @ti.func
    def is_closed(self, p, contact, touched, first, second):
        """Whether a contact is made, or still held, by materials ``first`` and ``second``."""
        closed = contact.overlap > 0.0
        if ti.static(self.adhesion):
            if touched and not closed:
                history = self.contacts.History()
                if ti.static(self.contacts.has_history):
                    history = self.contacts.history[p]
                k = self.normal_table[first, second]
                closed = self.normal.holds(contact, k, history) != 0
            if ti.static(self.coupled):  # settled before its forces were solved for
                if self.contacts.ends[p].j == SUBSTRATE:
                    closed = self.substrate.is_held(self.contacts.ends[p].i)
            if ti.static(self.settles):
                closed = self.expansions.is_held(p)
        return closed

    @ti.func
    def shared_inertia(self, i, j, touched):
        """I of 1/I = n_i/I_i + n_j/I_j; a contact that has just been made counts among the n."""
        radius = self.particles.body[i].radius
        mobility = self.shared_mobility(i, touched)
        if j >= 0:
            ratio = radius / self.particles.body[j].radius
            mobility += ratio * ratio * self.shared_mobility(j, touched)
        return 0.4 * radius * radius / mobility

    @ti.func
    def shared_mobility(self, i, touched):
        """n/m."""
        number = self.contacts.number[i]
        if not touched:
            number += 1
        return number * self.particles.body[i].inverse_mass

    @ti.func
    def apply_laws(self, p, contact, velocity, lateral, first, second):
        """Every law of the scene, on a contact of materials ``first`` and ``second`` whose centres
        move at ``velocity``; ``lateral`` is the force of a tilted surface."""
        history = self.contacts.History()
        if ti.static(self.contacts.has_history):
            history = self.contacts.history[p]
        normal = self.normal.force(contact, self.normal_table[first, second], history)
        push, friction, torque = normal.total * contact.normal + lateral, vec3(0.0), vec3(0.0)
        if ti.static(self.rubs):
            friction = self.tangential.force(
                contact, normal, self.tangential_table[first, second], history
            )
        if ti.static(self.rolls):
            torque = self.rolling.torque(
                contact, normal, self.rolling_table[first, second], history
            )
        if ti.static(self.contacts.dissipates):
            drag = normal.elastic - normal.total
            self.book(p, contact, velocity, push, drag, friction, torque)
        if ti.static(self.spreads):
            self.surface.remember(normal, self.expansions.trust(), history)
        if ti.static(self.contacts.has_history):
            self.contacts.history[p] = history
        self.contacts.result[p].force = push + friction
        if ti.static(self.rubs):
            self.contacts.result[p].couple = contact.normal.cross(friction)
        if ti.static(self.rolls):
            self.contacts.result[p].torque = torque
        self.contacts.result[p].half_overlap = 0.5 * contact.overlap
        if ti.static(self.plastic):
            if contact.time_step == 0.0 and self.contacts.touching[p] == APART:
                self.take_as_given(p)
        self.contacts.touching[p] = TOUCHING

    @ti.func
    def open(self, p, contact, velocity):
        """A contact ends, and forgets; what its springs still held is lost."""
        if ti.static(self.contacts.dissipates):
            self.book(p, contact, velocity, vec3(0.0), 0.0, vec3(0.0), vec3(0.0))
        if ti.static(self.contacts.has_history):
            self.contacts.history[p] = self.contacts.History()
        self.contacts.touching[p] = APART

    @ti.func
    def book(self, p, contact, velocity, push, drag, friction, torque):
        """The work of dashpot, friction and rolling over the step that led here, by the trapezoidal
        rule that makes Verlet's own work exact: mean force of the two ends, velocity between them.
        Of plastic laws, whose elastic force keeps some of its work, all work of the contact."""
        push_before, drag_before, friction_before = vec3(0.0), 0.0, vec3(0.0)
        torque_before = vec3(0.0)
        if self.contacts.touching[p] == TOUCHING:
            before = self.contacts.result[p]
            if ti.static(self.rubs):
                friction_before = before.couple.cross(contact.normal)
            if ti.static(self.rolls):
                torque_before = before.torque
            if ti.static(self.plastic):
                push_before = before.force - friction_before
            else:
                drag_before = before.drag
        power = 0.0
        if ti.static(self.plastic):
            power = -(push_before + push).dot(velocity)
        else:
            power = (drag_before + drag) * contact.normal_velocity
            self.contacts.result[p].drag = drag
        power -= (friction_before + friction).dot(contact.tangential_velocity)
        if ti.static(self.rolls):
            power -= (torque_before + torque).dot(contact.relative_spin)
        lost = self.contacts.lost[p]  # (+= would be atomic)
        self.contacts.lost[p] = lost + 0.5 * contact.time_step * power

    @ti.func
    def stored(self, p):
        """Elastic energy of a touching contact, J: normal, tangential, rolling."""
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
        history, energy = self.contacts.History(), vec3(0.0)
        if ti.static(self.contacts.has_history):
            history = self.contacts.history[p]
        contact = at_rest(2.0 * self.contacts.result[p].half_overlap, radius, 1.0)
        own = self.particles.spin[i].material
        energy[0] = self.normal.energy(contact, self.normal_table[own, material], history)
        if ti.static(self.rubs):
            energy[1] = self.tangential.energy(history)
        if ti.static(self.winds):
            energy[2] = self.rolling.energy(contact, self.rolling_table[own, material], history)
        return energy

    @ti.func
    def take_as_given(self, p):
        """What a plastic contact holds of which no step has been booked was put in before."""
        energy = self.stored(p)
        self.contacts.lost[p] += energy[0]
        if ti.static(self.coupled):
            if self.contacts.ends[p].j == SUBSTRATE:
                self.contacts.lost[p] += self.substrate.stored(self.contacts.ends[p].i)
        if ti.static(self.spreads):
            self.contacts.lost[p] += self.expansions.energy(p)

    @ti.func
    def gather(self, i):
        """Force and torque on particle ``i``, summed in the order of its partners' ids."""
        force, torque, radius = vec3(0.0), vec3(0.0), self.particles.body[i].radius
        number = 0
        for q in range(self.contacts.incidence_start[i], self.contacts.incidence_start[i + 1]):
            entry = self.contacts.incidence[q]
            p = entry >> 1
            if self.contacts.touching[p] != APART:
                number += 1
                sign = 1.0 - 2.0 * (entry & 1)
                force += sign * self.contacts.result[p].force
                if ti.static(self.rubs):
                    arm = radius - self.contacts.result[p].half_overlap
                    if ti.static(self.spreads):
                        arm += self.contacts.history[p].expansion[entry & 1]
                    torque -= arm * self.contacts.result[p].couple
                if ti.static(self.rolls):
                    torque += sign * self.contacts.result[p].torque
        if ti.static(self.asks_inertia):
            self.contacts.number[i] = number
        return force, torque
