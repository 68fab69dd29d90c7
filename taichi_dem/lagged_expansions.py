"""Expansions by the forces of the step before.

What two contacts do to each other shares its square root and its quotient, which take half of the
time: each pair is looked at once, eight side by side.
"""

from taichi_dem.blocks import block_field
from taichi_dem.expansions import Expansions
from taichi_dem.types import real, ti, vec2, vec3

SHIFT = 3
LANES = 1 << SHIFT  # places of a block, side by side in the processor's vectors
POINT = 1e-9  # radius of a contact that has none, over its distance from the centre
lanes = ti.types.vector(LANES, real)
# Contacts side by side, and one of them that acts on all of those.
Places = ti.types.struct(x=lanes, y=lanes, z=lanes, depth=lanes, square=lanes, load=lanes)
Place = ti.types.struct(x=real, y=real, z=real, depth=real, square=real, load=real)


@ti.data_oriented
class LaggedExpansions(Expansions):
    """As ``Expansions``, with the contacts of each particle in blocks of its own.

    swollen   of each contact, what the radii of its bodies have grown by, m
    inward_x, _y, _z  of each place in a block, the unit vector from the contact to the centre
    depth     of each, the distance between the two, m
    square    of each, that of the contact's radius, m2, but never nothing
    load      of each, the force there, N
    sum       of each, load times shape of those looked at so far, N/m
    """

    implicit = False

    def place_more(self, builder: "ti.FieldsBuilder") -> None:
        self.swollen = ti.Vector.field(2, real)
        builder.dense(ti.i, self.contacts.capacity).place(self.swollen)
        blocks = 1 + (2 * self.contacts.capacity + (LANES - 1) * self.particles.count) // LANES
        for name in "inward_x inward_y inward_z depth square load sum".split():
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
        load = self.contacts.history[entry >> 1].normal_force
        self.put(i, number, inward, depth, ti.max(square, (POINT * depth) ** 2), load)

    @ti.func
    def put(self, i, number, inward, depth, square, load):
        block, lane = self.block(i) + (number >> SHIFT), number & (LANES - 1)
        self.inward_x[block, lane], self.inward_y[block, lane] = inward[0], inward[1]
        self.inward_z[block, lane], self.depth[block, lane] = inward[2], depth
        self.square[block, lane], self.load[block, lane] = square, load
        self.sum[block, lane] = 0.0

    @ti.func
    def update(self, i):
        """Expansions of particle ``i`` for the next step, by the forces of this one."""
        number, first = self.gather(i), 0
        for place in range(number, (number + LANES - 1) & -LANES):
            self.put(i, place, vec3(0.0), 1.0, 1.0, 0.0)  # unloaded, and far from all others
        while first < number:
            raised = self.raised(i, first, number)
            for lane in ti.static(range(LANES)):
                if first + lane < number:
                    entry = self.entry[self.contacts.incidence_start[i] + first + lane]
                    self.contacts.history[entry >> 1].expansion[entry & 1] = raised[lane]
            first += LANES

    @ti.func
    def raised(self, i, first, number):
        """By what all ``number`` contacts of particle ``i`` raise those of the block from its
        ``first`` on, which look at each other and at all that come later."""
        k, begin = self.bulk(i), self.block(i)
        block = begin + (first >> SHIFT)
        own = self.turned(block, 0)
        answer = lanes(0.0)
        for lane in ti.static(range(LANES)):
            answer[lane] = self.sum[block, lane]
        for turn in ti.static(range(1, LANES // 2 + 1)):
            if first + turn < number:  # or there is no such pair
                other = self.turned(block, turn)
                on_own, on_other = self.shapes(k, own, other)
                answer += other.load * on_own
                if ti.static(2 * turn < LANES):  # else the same pairs, the other way round
                    back = own.load * on_other
                    for lane in ti.static(range(LANES)):
                        answer[lane] += back[(lane - turn) % LANES]
        for b in range(first + LANES, number):
            there, place = begin + (b >> SHIFT), b & (LANES - 1)
            other = self.one(there, place)
            on_own, on_other = self.shapes(k, own, other)
            answer += other.load * on_own
            so_far = self.sum[there, place]  # nobody else's: += would be atomic
            self.sum[there, place] = so_far + (own.load * on_other).sum()
        return -k.compliance * answer

    @ti.func
    def shapes(self, k, own, other):
        """Of the load at each on the other place."""
        cosine = own.x * other.x + own.y * other.y + own.z * other.z
        least_square = ti.select(own.square > other.square, own.square, other.square)
        return self.law.published(k, cosine, own.depth, other.depth, least_square)

    @ti.func
    def one(self, block, lane):
        return Place(
            x=self.inward_x[block, lane],
            y=self.inward_y[block, lane],
            z=self.inward_z[block, lane],
            depth=self.depth[block, lane],
            square=self.square[block, lane],
            load=self.load[block, lane],
        )

    @ti.func
    def turned(self, block, turn: ti.template()):
        """The contacts of a block, each ``turn`` lanes before its own."""
        x, y, z = lanes(0.0), lanes(0.0), lanes(0.0)
        depth, square, load = lanes(0.0), lanes(0.0), lanes(0.0)
        for lane in ti.static(range(LANES)):
            at = ti.static((lane + turn) % LANES)
            x[lane], y[lane] = self.inward_x[block, at], self.inward_y[block, at]
            z[lane], depth[lane] = self.inward_z[block, at], self.depth[block, at]
            square[lane], load[lane] = self.square[block, at], self.load[block, at]
        return Places(x=x, y=y, z=z, depth=depth, square=square, load=load)
