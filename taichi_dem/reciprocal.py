"""Expansions that an energy belongs to: the reciprocal influences of the contacts of each sphere on
each other, and the forces by which these change as the contacts move."""

from typing import Any

from taichi_dem.expansions import Expansions
from taichi_dem.types import real, ti, vec3


@ti.data_oriented
class ReciprocalExpansions(Expansions):
    """As ``Expansions``, with room for ``pairs`` of contacts.

    influence   M of each particle, one triangle after the other; those of i from first_pair[i] on
    turning, deepening  derivatives of M by the cosine of the angle between the contacts, 0 where
                the distance is cut off, and by one of the two 1/a, that distance apart
    inward      of each place, the unit vector from the contact to the centre
    curvature   of each place, the inverse of the distance between the two, 1/m
    least       of each place, the contact radius, m
    load        of each place, the force there, N; answer, m, what the body's surface rises by
    cut         of each particle: pairs whose distance is cut off
    turned, deeper, wider  of each place, sums over the others of the sphere: force derivatives
    separation  of each contact: distance of the centres (m), infinite to a wall
    force       of each contact: elastic, N
    rise        of each entry, m: what the body's surface rises by
    pull        of each entry, N: the force on its body by which M changes as the contacts move
    """

    def __init__(self, *of_expansions: Any, pairs: int):
        self.pairs = pairs
        super().__init__(*of_expansions)

    def place_more(self, builder: "ti.FieldsBuilder") -> None:
        capacity, particles = self.contacts.capacity, self.particles.count
        self.separation, self.force = ti.field(real), ti.field(real)
        for field in (self.separation, self.force):
            builder.dense(ti.i, capacity).place(field)
        self.rise, self.pull = ti.field(real), ti.Vector.field(3, real)
        for field in (self.rise, self.pull):
            builder.dense(ti.i, 2 * capacity).place(field)
        self.inward = ti.Vector.field(3, real)
        builder.dense(ti.i, 2 * capacity).place(self.inward)
        for name in "curvature least load answer".split():
            setattr(self, name, ti.field(real))
            builder.dense(ti.i, 2 * capacity).place(getattr(self, name))
        self.turned, self.deeper = ti.Vector.field(3, real), ti.field(real)
        self.wider = ti.field(real)
        for field in (self.turned, self.deeper, self.wider):
            builder.dense(ti.i, 2 * capacity).place(field)
        self.influence, self.turning = ti.field(real), ti.field(real)
        self.deepening = ti.field(real)
        for field in (self.influence, self.turning, self.deepening):
            builder.dense(ti.i, self.pairs).place(field)
        self.first_pair, self.cut = ti.field(ti.i32), ti.field(ti.i32)
        for field in (self.first_pair, self.cut):
            builder.dense(ti.i, particles).place(field)

    def enrol(self) -> int:
        return self._lay_out()

    @ti.kernel
    def _lay_out(self) -> ti.i32:
        """Where each particle's triangle starts; returns the room for all."""
        total = 0
        ti.loop_config(serialize=True)
        for i in range(self.particles.count):
            end = self.contacts.incidence_start[i + 1]
            number = end - self.contacts.incidence_start[i]
            self.first_pair[i] = total
            total += number * (number - 1) // 2
        return total

    @ti.func
    def lay(self, i, number, inward, depth, square):
        place = self.contacts.incidence_start[i] + number
        self.inward[place] = inward
        self.curvature[place], self.least[place] = 1.0 / depth, ti.sqrt(square)

    @ti.func
    def match(self, i):
        """M of the particle, and its derivative by the cosine of the angle between two contacts."""
        number, base = self.gather(i), self.contacts.incidence_start[i]
        terms, at, cut = self.law.terms(self.bulk(i)), self.first_pair[i], 0
        for a in range(base, base + number):
            inward, inverse, wide = self.inward[a], self.curvature[a], self.least[a]
            for b in range(base, a):
                curvature = 0.5 * (inverse + self.curvature[b])
                least = ti.max(wide, self.least[b])
                free = self.law.half_sine(inward.dot(self.inward[b]))
                s = ti.max(free, 0.5 * curvature * least)
                shape = self.law.shape(terms, ti.select(s > 0.0, s, 1.0))
                self.influence[at] = -curvature * shape[0]
                self.deepening[at] = -0.5 * shape[0]
                self.turning[at] = -curvature * shape[2]
                if s > free:
                    self.turning[at] = 0.0
                    cut += 1
                at += 1
        self.cut[i] = cut

    @ti.func
    def lateral_force(self, p):
        return self.pull[2 * p] - self.pull[2 * p + 1]

    @ti.func
    def rest(self, entry):
        self.contacts.history[entry >> 1].expansion[entry & 1] = 0.0
        self.rise[entry] = 0.0
        self.pull[entry] = vec3(0.0)

    @ti.func
    def tilt(self, i):
        """Note the expansions, and the forces by which M changes as the contacts move."""
        base, number, at = self.contacts.incidence_start[i], self.count[i], self.first_pair[i]
        for a in range(base, base + number):
            load, inward = self.load[a], self.inward[a]
            turned, deeper = vec3(0.0), 0.0
            for b in range(base, a):
                loads = load * self.load[b]
                turning = loads * self.turning[at]
                turned += turning * self.inward[b]
                self.turned[b] = self.turned[b] + turning * inward
                by_depth = loads * self.deepening[at]
                deeper += by_depth
                self.deeper[b] = self.deeper[b] + by_depth
                at += 1
            self.turned[a], self.deeper[a], self.wider[a] = turned, deeper, 0.0
        if self.cut[i] > 0:
            self.widen(i)
        for a in range(base, base + number):
            entry, inward, turned = self.entry[a], self.inward[a], self.turned[a]
            across = turned - turned.dot(inward) * inward
            # d(1/a)/d(overlap) = 1/(2 a^2), and M goes with the mean of two 1/a
            deeper = 0.5 * self.curvature[a] ** 2 * self.deeper[a] + self.wider[a]
            self.pull[entry] = deeper * inward - across / self.separation[entry >> 1]
            self.contacts.history[entry >> 1].expansion[entry & 1] = self.rise[entry]

    @ti.func
    def widen(self, i):
        """What is added where the distance of two contacts is cut off at the radius of the wider:
        with the overlap that grows, and so does M with the mean of 1/a."""
        base, number, at = self.contacts.incidence_start[i], self.count[i], self.first_pair[i]
        terms = self.law.terms(self.bulk(i))
        for a in range(base, base + number):
            for b in range(base, a):
                loads = self.load[a] * self.load[b]
                if self.turning[at] == 0.0 and loads != 0.0:
                    curvature = 0.5 * (self.curvature[a] + self.curvature[b])
                    wide = b if self.least[a] < self.least[b] else a
                    least = self.least[wide]
                    slope = loads * self.law.shape(terms, 0.5 * curvature * least)[1]
                    by_curvature = -0.25 * slope * curvature * least
                    for c in ti.static((a, b)):
                        self.wider[c] += 0.5 * self.curvature[c] ** 2 * by_curvature
                    # d least/d(overlap) = R*/(2 least)
                    radius = self.radius[self.entry[wide] >> 1]
                    self.wider[wide] -= 0.25 * curvature**2 * slope * radius / least
                at += 1
