"""Expansions by the forces of the step before."""

from taichi_dem.blocks import block_field
from taichi_dem.expansions import Expansions
from taichi_dem.types import real, ti, vec2

SHIFT = 2
LANES = 1 << SHIFT  # places of a block, side by side in the processor's vectors
POINT = 1e-9  # radius of a contact that has none, over its distance from the centre
lanes = ti.types.vector(LANES, real)


@ti.data_oriented
class LaggedExpansions(Expansions):
    """As ``Expansions``, with the contacts of each particle in blocks of its own.

    swollen   of each contact, what the radii of its bodies have grown by, m
    inward_x, _y, _z  of each place in a block, the unit vector from the contact to the centre
    depth     of each, the distance between the two, m
    square    of each, that of the contact's radius, m2, but never nothing
    load      of each, the force there, N
    """

    implicit = False

    def place_more(self, builder: "ti.FieldsBuilder") -> None:
        self.swollen = ti.Vector.field(2, real)
        builder.dense(ti.i, self.contacts.capacity).place(self.swollen)
        blocks = 1 + (2 * self.contacts.capacity + (LANES - 1) * self.particles.count) // LANES
        for name in "inward_x inward_y inward_z depth square load".split():
            setattr(self, name, block_field(builder, blocks, LANES))

    @ti.func
    def block(self, i):
        """The first block of particle ``i``: so many have room for all contacts of those before."""
        return (self.contacts.incidence_start[i] + (LANES - 1) * i) >> SHIFT

    @ti.func
    def swell(self, p, met):
        """Note by what the radii of the bodies of contact ``p`` have grown in all but its overlap;
        returns R* with that."""
        ends, radius, swollen = self.contacts.ends[p], met.effective_radius, vec2(0.0)
        if ends.j >= 0:
            expansion = self.contacts.history[p].expansion
            later = self.particles.spin[ends.j].id > self.particles.spin[ends.i].id
            swollen = vec2(ti.select(later, 0.0, expansion[0]), ti.select(later, expansion[1], 0.0))
            own = self.particles.body[ends.i].radius + swollen[0]
            other = met.partner_radius + swollen[1]
            radius = own * other / (own + other)
        self.swollen[p] = swollen
        return radius

    @ti.func
    def lay(self, i, number, inward, depth, square):
        entry = self.entry[self.contacts.incidence_start[i] + number]
        swollen = self.swollen[entry >> 1]
        more = 0.5 * (swollen[0] - swollen[1])
        depth += ti.select((entry & 1) == 0, more, -more)
        block, lane = self.block(i) + (number >> SHIFT), number & (LANES - 1)
        self.inward_x[block, lane], self.inward_y[block, lane] = inward[0], inward[1]
        self.inward_z[block, lane], self.depth[block, lane] = inward[2], depth
        self.square[block, lane] = ti.max(square, (POINT * depth) ** 2)
        self.load[block, lane] = self.contacts.history[entry >> 1].normal_force

    @ti.func
    def update(self, i):
        """Expansions of particle ``i`` for the next step, by the forces of this one."""
        number, first = self.gather(i), 0
        while first < number:
            raised = self.raised(i, first, number)
            for lane in ti.static(range(LANES)):
                if first + lane < number:
                    entry = self.entry[self.contacts.incidence_start[i] + first + lane]
                    self.contacts.history[entry >> 1].expansion[entry & 1] = raised[lane]
            first += LANES

    @ti.func
    def raised(self, i, first, number):
        """By what all ``number`` contacts of particle ``i`` raise those from its ``first`` on that
        lie side by side."""
        k, begin = self.bulk(i), self.block(i)
        own, answer, block = lanes(0.0), lanes(0.0), begin + (first >> SHIFT)
        x, y, z, depth, square = lanes(0.0), lanes(0.0), lanes(0.0), lanes(0.0), lanes(0.0)
        for lane in ti.static(range(LANES)):
            x[lane], y[lane] = self.inward_x[block, lane], self.inward_y[block, lane]
            z[lane], depth[lane] = self.inward_z[block, lane], self.depth[block, lane]
            square[lane], own[lane] = self.square[block, lane], lane
        for b in range(number):
            there, place = begin + (b >> SHIFT), b & (LANES - 1)
            load = self.load[there, place]
            if load != 0.0:
                cosine = x * self.inward_x[there, place]
                cosine += y * self.inward_y[there, place]
                cosine += z * self.inward_z[there, place]
                least = self.square[there, place]
                least_square = ti.select(square > least, square, least)
                other = self.depth[there, place]
                shape = self.law.published(k, cosine, depth, other, least_square)
                apart = own - ti.cast(b - first, real)
                answer += ti.select(apart * apart < 0.5, 0.0, load * shape)  # not by itself
        return -k.compliance * answer
