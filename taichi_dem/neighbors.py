"""The Verlet list: who can touch whom until somebody has moved by half the skin.

Of two spheres the larger looks for the smaller (of equals, the later id for the earlier): a large
one finds its many small partners, and no small one has to look far.
"""

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART, FIRST_FACE, SUBSTRATE, TOUCHING, ContactList
from taichi_dem.control import Control
from taichi_dem.effects import Effects
from taichi_dem.geometry import nearest_image
from taichi_dem.grid import BLOCK, Grid
from taichi_dem.particles import Particles
from taichi_dem.types import ti


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
        effects: Effects,
    ):
        self.particles, self.boundaries = particles, boundaries
        self.contacts, self.grid = contacts, grid
        self.control, self.has_substrate = control, has_substrate
        self.walls = boundaries.face_count
        self.room = contacts.room
        self.adhesion, self.reach = effects.adhesion, effects.reach
        self._crowded = False

    # -- history ---------------------------------------------------------------------------------

    @ti.kernel
    def save(self, remember: ti.i32):
        """File what the touching contacts remember under the ids of their bodies, before anything
        moves (or, unless it is to ``remember``, file nothing)."""
        ti.loop_config(serialize=self.particles.few)
        for i in range(self.particles.count):
            filed = self.contacts.start[i]
            row = self.particles.spin[i].id
            self.contacts.old_start[row] = filed
            for p in range(filed, self.contacts.start[i + 1]):
                if self.contacts.touching[p] != APART and remember != 0:
                    self.contacts.old_partner[filed] = self.name_of(self.contacts.ends[p].j)
                    if ti.static(self.contacts.has_history):
                        self.contacts.old_history[filed] = self.contacts.history[p]
                    if ti.static(self.contacts.recalls):  # their work is a trapezoid's
                        for result, filed_result in ti.static(self.contacts.recalled):
                            filed_result[filed] = result[p]
                    filed += 1
            self.contacts.old_end[row] = filed

    @ti.func
    def name_of(self, j):
        """What a body is called whatever the order: the id of a particle, the number of a wall."""
        name = j
        if j >= 0:
            name = self.particles.spin[j].id
        return name

    @ti.func
    def recall(self, p, j, first, end):
        """What is on file from ``first`` to ``end`` for contact ``p`` with ``j``, if anything."""
        touching, found = APART, first
        if first < end:
            partner = self.name_of(j)
            while found < end and self.contacts.old_partner[found] != partner:
                found += 1
            if found < end:
                touching = TOUCHING
                if ti.static(self.contacts.recalls):
                    for result, filed_result in ti.static(self.contacts.recalled):
                        result[p] = filed_result[found]
        self.contacts.touching[p] = touching
        if ti.static(self.contacts.has_history):
            if touching == APART:
                self.contacts.history[p] = self.contacts.History()
            else:
                self.contacts.history[p] = self.contacts.old_history[found]

    # -- search ----------------------------------------------------------------------------------

    def count(self) -> int:
        """Where each particle's contacts will start; returns how many there are."""
        total, most = self._count()
        self._crowded = most > self.room
        return total

    def fill(self) -> None:
        """List the contacts, recall their history, and say for each particle which it is in."""
        if self._crowded:
            self._search_again()
        self._fill()

    @ti.kernel
    def _count(self) -> ti.types.vector(2, ti.i32):
        """How many contacts there are in all, and of one particle at most; those for which there is
        ``room`` are kept."""
        ti.loop_config(serialize=self.particles.few)
        for s in range(self.particles.count):
            i = self.grid.particle[s]
            self.contacts.start[i] = self.search(
                s, i, self.contacts.found, i * self.room, self.room
            )
        total, most = 0, 0
        ti.loop_config(serialize=True)
        for i in range(self.particles.count):
            own = self.contacts.start[i]
            self.contacts.incidence_start[i] = own
            self.contacts.start[i] = total
            total += own
            most = ti.max(most, own)
        self.contacts.start[self.particles.count] = total
        return ti.Vector([total, most])

    @ti.kernel
    def _search_again(self):
        """For particles with more partners than there was room for."""
        ti.loop_config(serialize=self.particles.few)
        for s in range(self.particles.count):
            i = self.grid.particle[s]
            first, end = self.contacts.start[i], self.contacts.start[i + 1]
            if end - first > self.room:
                self.search(s, i, self.contacts.ends.j, first, end - first)

    @ti.kernel
    def _fill(self):
        ti.loop_config(serialize=self.particles.few)
        for s in range(self.particles.count):
            i = self.grid.particle[s]
            first, end = self.contacts.start[i], self.contacts.start[i + 1]
            self.particles.reference[i] = self.particles.body[i].position
            p = first
            while p < end and end - first <= self.room:
                self.contacts.ends[p].j = self.contacts.found[i * self.room + p - first]
                p += 1
            row = self.particles.spin[i].id
            filed, filed_end = self.contacts.old_start[row], self.contacts.old_end[row]
            p = first
            while p < end:
                self.contacts.ends[p].i = i
                j = self.contacts.ends[p].j
                self.recall(p, j, filed, filed_end)
                if j >= 0:
                    ti.atomic_add(self.contacts.incidence_start[j], 1)
                p += 1
        total = 0
        ti.loop_config(serialize=True)
        for i in range(self.particles.count):
            total += self.contacts.incidence_start[i]
            self.contacts.incidence_start[i] = total
        self.contacts.incidence_start[self.particles.count] = total
        ti.loop_config(serialize=self.particles.few)
        for i in range(self.particles.count):
            self.enter(i)
        ti.loop_config(serialize=self.particles.few)
        for i in range(self.particles.count):
            self.sort_incident(i)
            if ti.static(self.contacts.outgrows_caches):
                self.note_extent(i)
            if ti.static(self.contacts.shares_inertia):
                self.contacts.number[i] = self.contacts.count_touching(i)

    @ti.func
    def search(self, s, i, found: ti.template(), first, room):
        """Count the partners of ``i``, which is at place ``s`` in the cells, and write the first
        ``room`` of them from ``first`` on."""
        near, ranks = ti.static(self.grid.near, self.grid.rank)
        skin = self.control.skin[None] + self.control.reach[None]
        if ti.static(self.adhesion):
            skin += self.reach
        position, radius, rank = near[s].position, near[s].radius, ranks[s]
        mask, cells = ti.Vector(self.grid.mask), self.grid.cells()
        reach = ti.cast(ti.ceil((2 * radius + skin) / self.grid.cell_size[None]), ti.i32)
        corner = self.grid.cell[i] - reach
        width = ti.min(2 * reach + 1, cells)  # each cell once, however small the grid
        own = radius + skin
        number, z, left = 0, corner[2], width[2]
        while left > 0:  # a row of cells along z lies in one piece as far as its block goes
            z &= mask[2]
            piece = ti.min(left, BLOCK[2] - z % BLOCK[2])
            for x in range(corner[0], corner[0] + width[0]):
                for y in range(corner[1], corner[1] + width[1]):
                    low = ti.Vector([self.grid.slot(0, x, cells), self.grid.slot(1, y, cells), z])
                    begin = self.grid.end[low] - self.grid.population[low]
                    for t in range(begin, self.grid.end[low + ti.Vector([0, 0, piece - 1])]):
                        apart = nearest_image(position - near[t].position, self.grid.period)
                        limit = own + near[t].radius
                        # A guess is cheaper than a branch: what does not count is overwritten.
                        if number < room:
                            found[first + number] = self.grid.particle[t]
                        number += (apart.dot(apart) < limit * limit) & (ranks[t] < rank)
            z += piece
            left -= piece
        for wall in range(self.walls):
            if self.height_above(wall, position) < own:
                if number < room:
                    found[first + number] = FIRST_FACE - wall
                number += 1
        if ti.static(self.has_substrate):
            near_ground = position[2] < own
            if ti.static(self.adhesion):  # also one that is held where the others pull it up
                near_ground |= self.was_on_substrate(i)
            if near_ground:
                if number < room:
                    found[first + number] = SUBSTRATE
                number += 1
        return number

    @ti.func
    def was_on_substrate(self, i):
        """Whether ``i`` has a contact with the substrate on file, which is the last of its own."""
        row = self.particles.spin[i].id
        first, end = self.contacts.old_start[row], self.contacts.old_end[row]
        found = False
        if first < end:
            found = self.contacts.old_partner[end - 1] == SUBSTRATE
        return found

    @ti.func
    def height_above(self, wall, position):
        face = self.boundaries.face[wall]
        return (position - face.point).dot(face.normal)

    # -- who is in which contact -----------------------------------------------------------------

    @ti.func
    def enter(self, i):
        """Note the contacts of ``i`` with its partners and with itself.  Starts are the ends of
        their range at first, and move down as it fills, in the order in which the threads come."""
        notes, names, starts = ti.static(
            self.contacts.found, self.contacts.name, self.contacts.incidence_start
        )
        first, end = self.contacts.start[i], self.contacts.start[i + 1]
        own, own_name = ti.atomic_sub(starts[i], end - first) - (end - first), self.name_of(i)
        for p in range(first, end):
            j = self.contacts.ends[p].j
            notes[own + p - first], names[own + p - first] = 2 * p, self.name_of(j)
            if j >= 0:
                place = ti.atomic_sub(starts[j], 1) - 1
                notes[place], names[place] = 2 * p + 1, own_name

    @ti.func
    def note_extent(self, i):
        """Note the earliest and the latest contact of ``i`` on the list."""
        earliest, latest = self.contacts.capacity, -1
        for q in range(self.contacts.incidence_start[i], self.contacts.incidence_start[i + 1]):
            p = self.contacts.incidence[q] >> 1
            earliest, latest = ti.min(earliest, p), ti.max(latest, p)
        self.contacts.earliest[i], self.contacts.latest[i] = earliest, latest

    @ti.func
    def sort_incident(self, i):
        """Sort the notes by the partner's name: the order of summation is the scene's own.  (Each
        is put in its place by counting those before it: no branch to mispredict.)"""
        names = ti.static(self.contacts.name)
        first, end = self.contacts.incidence_start[i], self.contacts.incidence_start[i + 1]
        for q in range(first, end):
            place, name = first, names[q]
            other = first
            while other < end:
                place += names[other] < name
                other += 1
            self.contacts.incidence[place] = self.contacts.found[q]
