"""Expansions that an energy belongs to: the reciprocal influences of the contacts of each sphere on
each other, and the forces by which these change as the contacts move."""

from typing import Any

from taichi_dem.expansions import Expansions
from taichi_dem.types import real, ti, vec3


@ti.data_oriented
class ReciprocalExpansions(Expansions):
    """As ``Expansions``, with room for ``pairs`` of contacts.

    influence   M of each particle, one triangle after the other; those of i from first_pair[i] on
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
        self.influence, self.first_pair = ti.field(real), ti.field(ti.i32)
        builder.dense(ti.i, self.pairs).place(self.influence)
        builder.dense(ti.i, particles).place(self.first_pair)

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
    def match(self, i):
        """M of the particle."""
        number, base = self.gather(i), self.contacts.incidence_start[i]
        k, at = self.bulk(i), self.first_pair[i]
        for a in range(base, base + number):
            for b in range(base, a):
                curvature = 0.5 * (self.curvature[a] + self.curvature[b])
                s = self.law.half_sine(
                    self.inward[a].dot(self.inward[b]),
                    curvature,
                    ti.max(self.least[a], self.least[b]),
                )
                influence = 0.0
                if s > 0.0:
                    influence = -curvature * self.law.shape(k, s)[0]
                self.influence[at] = influence
                at += 1

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
        base, number, k = self.contacts.incidence_start[i], self.count[i], self.bulk(i)
        for a in range(base, base + number):
            self.pull[self.entry[a]] = vec3(0.0)
            self.load[a] = self.force[self.entry[a] >> 1]
        for a in range(base, base + number):
            for b in range(base, a):
                if self.load[a] != 0.0 and self.load[b] != 0.0:
                    self.tilt_pair(k, a, b)
        for a in range(base, base + number):
            entry = self.entry[a]
            self.contacts.history[entry >> 1].expansion[entry & 1] = self.rise[entry]

    @ti.func
    def tilt_pair(self, k, a, b):
        """The derivative of F_a M_ab F_b by the places of the two contacts."""
        inward_a, inward_b = self.inward[a], self.inward[b]
        cosine = inward_a.dot(inward_b)
        inverse_a, inverse_b = self.curvature[a], self.curvature[b]
        curvature = 0.5 * (inverse_a + inverse_b)
        least = ti.max(self.least[a], self.least[b])
        s = self.law.half_sine(cosine, curvature, least)
        shape = self.law.shape(k, s)
        loads = self.load[a] * self.load[b]
        cut = 2.0 * s <= curvature * least * (1.0 + 1e-12)
        by_cosine = ti.select(cut, 0.0, -curvature * shape[2]) * loads
        by_curvature = -0.5 * (shape[0] + ti.select(cut, s * shape[1], 0.0)) * loads
        # d(1/a)/d(overlap) = 1/(2 a^2)
        deeper_a = 0.5 * by_curvature * inverse_a * inverse_a
        deeper_b = 0.5 * by_curvature * inverse_b * inverse_b
        if cut:  # the wider contact decides: d least/d(overlap) = R* / (2 least)
            wider = -0.5 * curvature * curvature * shape[1] * loads
            if self.least[a] >= self.least[b]:
                deeper_a += wider * 0.5 * self.radius[self.entry[a] >> 1] / least
            else:
                deeper_b += wider * 0.5 * self.radius[self.entry[b] >> 1] / least
        turn_a = by_cosine / self.separation[self.entry[a] >> 1]
        turn_b = by_cosine / self.separation[self.entry[b] >> 1]
        self.pull[self.entry[a]] += deeper_a * inward_a - turn_a * (inward_b - cosine * inward_a)
        self.pull[self.entry[b]] += deeper_b * inward_b - turn_b * (inward_a - cosine * inward_b)
