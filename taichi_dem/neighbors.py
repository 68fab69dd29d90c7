"""The Verlet list: who can touch whom until somebody has moved by half the skin.

Of two spheres the larger looks for the smaller (of equals, the later id for the earlier): a large
one finds its many small partners, and no small one has to look far.
"""

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART, FIRST_FACE, HELD, SUBSTRATE, ContactList
from taichi_dem.control import Control
from taichi_dem.grid import Grid
from taichi_dem.particles import Particles
from taichi_dem.types import ti

SERIAL_BELOW = 1000  # particles: waking the threads would cost more than they save


@ti.data_oriented
class Neighbors:
    """Builds ``contacts`` from where the particles are, carrying their history over."""

    def __init__(
        self,
        particles: Particles,
        boundaries: Boundaries,
        contacts: ContactList,
        grid: Grid,
        control: Control,
        has_substrate: bool,
    ):
        self.particles, self.boundaries = particles, boundaries
        self.contacts, self.grid = contacts, grid
        self.control, self.has_substrate = control, has_substrate
        self.walls = boundaries.face_count
        self.serial = particles.count < SERIAL_BELOW
        self.room = 2 * contacts.capacity // particles.count

    # -- history ---------------------------------------------------------------------------------

    @ti.kernel
    def save(self, remember: ti.i32):
        """File every contact's history under the ids of its bodies, before anything moves (or,
        unless it is to ``remember``, file nothing)."""
        for i in range(self.particles.count):
            row = self.particles.spin[i].id
            self.contacts.old_start[row] = self.contacts.start[i]
            self.contacts.old_end[row] = self.contacts.start[i + 1] * remember
        for p in range(self.contacts.start[self.particles.count]):
            self.contacts.old_partner[p] = self.name_of(self.contacts.ends[p].j)
            self.contacts.old_touching[p] = self.contacts.touching[p]
            if ti.static(self.contacts.has_history):
                self.contacts.old_history[p] = self.contacts.history[p]

    @ti.func
    def name_of(self, j):
        """What a body is called whatever the order: the id of a particle, the number of a wall."""
        name = j
        if j >= 0:
            name = self.particles.spin[j].id
        return name

    @ti.func
    def recall(self, p):
        """What is on file for contact ``p``, or nothing."""
        row = self.particles.spin[self.contacts.ends[p].i].id
        partner = self.name_of(self.contacts.ends[p].j)
        self.contacts.touching[p] = APART
        if ti.static(self.contacts.has_history):
            self.contacts.history[p] = self.contacts.History()
        for old in range(self.contacts.old_start[row], self.contacts.old_end[row]):
            if self.contacts.old_partner[old] == partner:
                if self.contacts.old_touching[old] != APART:
                    self.contacts.touching[p] = HELD
                if ti.static(self.contacts.has_history):
                    self.contacts.history[p] = self.contacts.old_history[old]

    # -- search ----------------------------------------------------------------------------------

    @ti.kernel
    def count(self) -> ti.i32:
        """Where each particle's contacts will start; returns how many there are.

        What is found is kept in the incidence list, which is not needed before the end of
        :meth:`fill`; only a particle with more partners than its share of it searches again there.
        """
        ti.loop_config(serialize=self.serial)
        for i in range(self.particles.count):
            self.contacts.start[i] = self.search(
                i, self.contacts.incidence, i * self.room, self.room
            )
        total = 0
        ti.loop_config(serialize=True)
        for i in range(self.particles.count):
            own = self.contacts.start[i]
            self.contacts.start[i] = total
            total += own
        self.contacts.start[self.particles.count] = total
        return total

    @ti.kernel
    def fill(self):
        """List the contacts, recall their history, and say for each particle which it is in."""
        ti.loop_config(serialize=self.serial)
        for i in range(self.particles.count):
            first, end = self.contacts.start[i], self.contacts.start[i + 1]
            self.particles.reference[i] = self.particles.body[i].position
            if end - first > self.room:
                self.search(i, self.contacts.ends.j, first, end - first)
            else:
                for p in range(first, end):
                    self.contacts.ends[p].j = self.contacts.incidence[i * self.room + p - first]
            for p in range(first, end):
                self.contacts.ends[p].i = i
                self.recall(p)
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.incident()
        ti.loop_config(serialize=self.serial)
        for i in range(self.particles.count):
            self.sort_incident(i)

    @ti.func
    def search(self, i, found: ti.template(), first, room):
        """Count the partners of ``i``, and write the first ``room`` of them from ``first`` on."""
        body, skin = self.particles.body[i], self.control.skin[None]
        mask = ti.Vector(self.grid.mask)
        reach = ti.cast(ti.ceil((2 * body.radius + skin) / self.grid.cell_size[None]), ti.i32)
        corner = self.grid.cell[i] - reach
        width = ti.min(2 * reach + 1, mask + 1)  # each cell once, however small the grid
        number = 0
        for x in range(width[0]):
            for y in range(width[1]):
                for z in range(width[2]):
                    cell = (corner + ti.Vector([x, y, z])) & mask
                    population = self.grid.population[cell]
                    end = self.grid.end[cell]
                    for s in range(end - population, end):
                        j = self.grid.particle[s]
                        other = self.particles.body[j]
                        apart = body.position - other.position
                        limit = body.radius + other.radius + skin
                        if apart.dot(apart) < limit * limit and self.looks_for(i, j):
                            if number < room:
                                found[first + number] = j
                            number += 1
        for wall in range(self.walls):
            if self.height_above(wall, body.position) < body.radius + skin:
                if number < room:
                    found[first + number] = FIRST_FACE - wall
                number += 1
        if ti.static(self.has_substrate):
            if body.position[2] < body.radius + skin:
                if number < room:
                    found[first + number] = SUBSTRATE
                number += 1
        return number

    @ti.func
    def looks_for(self, i, j):
        """Whether ``i`` is the one of the two that finds the other."""
        mine, other = self.particles.body[i].radius, self.particles.body[j].radius
        return other < mine or (
            other == mine and self.particles.spin[j].id < self.particles.spin[i].id
        )

    @ti.func
    def height_above(self, wall, position):
        face = self.boundaries.face[wall]
        return (position - face.point).dot(face.normal)

    # -- who is in which contact -----------------------------------------------------------------

    @ti.func
    def incident(self):
        """The incidence list, by counting."""
        n = self.particles.count
        for i in range(n + 1):
            self.contacts.incidence_start[i] = 0
        for p in range(self.contacts.start[n]):
            self.contacts.incidence_start[self.contacts.ends[p].i] += 1
            if self.contacts.ends[p].j >= 0:
                self.contacts.incidence_start[self.contacts.ends[p].j] += 1
        total = 0
        for i in range(n + 1):
            total += self.contacts.incidence_start[i]
            self.contacts.incidence_start[i] = total
        for p in range(self.contacts.start[n]):
            self.enter(self.contacts.ends[p].i, 2 * p)
            if self.contacts.ends[p].j >= 0:
                self.enter(self.contacts.ends[p].j, 2 * p + 1)

    @ti.func
    def enter(self, i, entry):
        """Starts are the ends of their range at first, and move down as it fills."""
        place = self.contacts.incidence_start[i] - 1
        self.contacts.incidence_start[i] = place
        self.contacts.incidence[place] = entry

    @ti.func
    def partner(self, entry):
        ends, name = self.contacts.ends[entry >> 1], 0
        if entry & 1 == 1:
            name = self.name_of(ends.i)
        else:
            name = self.name_of(ends.j)
        return name

    @ti.func
    def sort_incident(self, i):
        """Insertion sort by the partner's name: the order of summation is the scene's own."""
        incidence = ti.static(self.contacts.incidence)
        starts = ti.static(self.contacts.incidence_start)
        for q in range(starts[i] + 1, starts[i + 1]):
            entry = incidence[q]
            name, place = self.partner(entry), q
            while place > starts[i] and self.partner(incidence[place - 1]) > name:
                incidence[place] = incidence[place - 1]
                place -= 1
            incidence[place] = entry
