"""What the surfaces of the spheres rise by where others press on them: what every exchange needs.

Each contact has two entries, 2 p for its first body and 2 p + 1 for its second, as in the list of
incidences.  Only contacts within ``control.reach`` are looked at: those that an expansion could
close.
"""

import math
from typing import Any

from taichi_dem.contact_list import ContactList
from taichi_dem.control import STALE, Control
from taichi_dem.geometry import Geometry
from taichi_dem.types import real, ti, vec2, vec3

SPARE = 1.2  # reach by the largest expansions that occurred
USED = 0.9  # of the reach: beyond, the list is made anew, with more
LEAST_REACH = 0.02  # of the skin


@ti.data_oriented
class Expansions:
    """Fields of the contacts on one list; ``law`` is a ``MultiContact``, and contacts are held as
    far as ``held`` (m) past zero overlap.

    largest            m, sum of the sizes of both expansions of a contact, since the last list
    overlap, normal    of each contact, over undeformed surfaces; -inf beyond reach
    count              contacts within reach of each particle, its places from incidence_start on
    entry              of each place
    """

    implicit: bool

    def __init__(
        self,
        law: Any,
        table: Any,
        geometry: Geometry,
        contacts: ContactList,
        control: Control,
        held: float,
    ):
        self.held_reach, self.adhesion = held, held > 0
        self.law, self.table, self.geometry = law, table, geometry
        self.particles, self.contacts, self.control = geometry.particles, contacts, control
        builder = ti.FieldsBuilder()
        self.largest = ti.field(real)
        builder.place(self.largest)
        self.overlap, self.normal = ti.field(real), ti.Vector.field(3, real)
        self.radius = ti.field(real)
        for field in (self.overlap, self.normal, self.radius):
            builder.dense(ti.i, contacts.capacity).place(field)
        self.entry = ti.field(ti.i32)
        builder.dense(ti.i, 2 * contacts.capacity).place(self.entry)
        self.count = ti.field(ti.i32)
        builder.dense(ti.i, self.particles.count).place(self.count)
        self.place_more(builder)
        self.tree = builder.finalize()

    def place_more(self, builder: "ti.FieldsBuilder") -> None:
        """Fields of a way to solve."""
        raise NotImplementedError

    def enrol(self) -> int:
        """The list was made anew; returns how many pairs of contacts there must be room for."""
        return 0

    def review(self) -> None:
        """Look as far as expansions have reached since the last list, and some more."""
        least = LEAST_REACH * self.control.skin[None]
        self.control.reach[None] = max(SPARE * self.largest[None], least)
        self.largest[None] = 0.0

    @ti.func
    def note(self, p, met):
        """Keep where the bodies of contact ``p`` are; whether they are within reach."""
        near = met.overlap > -(self.control.reach[None] + self.held_reach)
        if not near and self.overlap[p] > -math.inf:
            self.contacts.history[p].expansion = vec2(0.0)
        self.overlap[p] = met.overlap if near else -math.inf
        self.normal[p] = met.normal
        self.radius[p] = met.effective_radius
        return near

    @ti.func
    def of(self, p):
        """The expansions of the first and the second body of contact ``p``, m."""
        return self.contacts.history[p].expansion

    @ti.func
    def trust(self):
        """How far this step's expansions are to be remembered in place of the expected ones."""
        return 1.0

    @ti.func
    def energy(self, p):
        """-F e / 2 of contact ``p``, J."""
        history = self.contacts.history[p]
        return -0.5 * history.normal_force * (history.expansion[0] + history.expansion[1])

    @ti.func
    def lateral_force(self, p):
        """What acts on the first body of contact ``p`` beside the laws' forces, N."""
        return vec3(0.0)

    @ti.func
    def gather(self, i):
        """Find the contacts of particle ``i`` within reach; those that stand alone are none."""
        base, number = self.contacts.incidence_start[i], 0
        radius = self.particles.body[i].radius
        for q in range(base, self.contacts.incidence_start[i + 1]):
            entry = self.contacts.incidence[q]
            p = entry >> 1
            overlap = self.overlap[p]
            if overlap > -math.inf:
                self.entry[base + number] = entry
                inward = self.normal[p] * ti.cast(1 - 2 * (entry & 1), real)
                square = self.radius[p] * ti.max(overlap, 0.0)
                self.lay(i, number, inward, radius - 0.5 * overlap, square)
                number += 1
        if number == 1:
            self.rest(self.entry[base])
            number = 0
        self.count[i] = number
        return number

    @ti.func
    def lay(self, i, number, inward, depth, square):
        """Note what a way to solve needs of a contact of particle ``i`` from which the unit vector
        ``inward`` points to the centre, in the distance ``depth``, m; ``square`` is that of its
        radius, m2, and ``number`` counts the contacts noted before."""

    @ti.func
    def rest(self, entry):
        """An entry whose body is not pressed elsewhere."""
        self.contacts.history[entry >> 1].expansion[entry & 1] = 0.0

    @ti.func
    def bulk(self, i):
        """The coefficients of the law for particle ``i``."""
        material = self.particles.spin[i].material
        return self.table[material, material]

    @ti.func
    def watch(self, expansion):
        """Have the list made anew before the expansions of a contact close a gap that is not on
        it.  (Where there is a gap they are no larger than where others press.)"""
        both = ti.abs(expansion[0]) + ti.abs(expansion[1])
        ti.atomic_max(self.largest[None], both)
        if not (both < USED * self.control.reach[None]):
            self.control.raise_flag(STALE)
