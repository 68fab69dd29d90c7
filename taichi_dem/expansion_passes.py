"""What each sphere has to do in a pass of the solve for expansions (:mod:`expansion_newton`): all
that is done for many at once, each with its own contacts or with those that it looks for."""

import math
from typing import Any

from taichi_dem.contact_list import APART
from taichi_dem.contacts.contact import (
    at_rest,
    disagreement,
    force_while_solved,
    hold_while_solved,
)
from taichi_dem.reciprocal import ReciprocalExpansions
from taichi_dem.types import real, ti, vec2, vec3


@ti.data_oriented
class ExpansionPasses(ReciprocalExpansions):
    """As ``ReciprocalExpansions``, with the overlaps that forces and expansions leave.

    near       contacts within reach of each particle's own, from start on; near_count of them
    partner    of each contact, the material of its second body
    effective  of each contact, D, m; tangent, N/m, K at that
    remainder, direction, step  of each contact, m: of the conjugate gradients
    sums       of each particle: what a pass finds out, the largest of one number, sums of two
    held       of each contact, whether it is to hold; opening, m, where its force ends (absent
               unless contacts adhere)
    rise       is what a direction raises, too, while the solve goes on
    turn, length, share, scale  that a pass is told: what is added of the last direction, how far to
               go along it and along a step, and the deepest overlap, m
    """

    def __init__(self, *of_expansions: Any, normal: Any, normal_table: Any, pairs: int):
        self.normal_law, self.normal_table = normal, normal_table
        super().__init__(*of_expansions, pairs=pairs)

    def place_more(self, builder: "ti.FieldsBuilder") -> None:
        super().place_more(builder)
        capacity, particles = self.contacts.capacity, self.particles.count
        for name in "effective tangent remainder direction step".split():
            setattr(self, name, ti.field(real))
            builder.dense(ti.i, capacity).place(getattr(self, name))
        if self.adhesion:
            self.held, self.opening = ti.field(ti.i32), ti.field(real)
            for field in (self.held, self.opening):
                builder.dense(ti.i, capacity).place(field)
        self.near, self.partner = ti.field(ti.i32), ti.field(ti.i32)
        for field in (self.near, self.partner):
            builder.dense(ti.i, capacity).place(field)
        self.near_count, self.sums = ti.field(ti.i32), ti.Vector.field(3, real)
        for field in (self.near_count, self.sums):
            builder.dense(ti.i, particles).place(field)
        self.turn, self.length = ti.field(real), ti.field(real)
        self.share, self.scale = ti.field(real), ti.field(real)
        builder.place(self.turn, self.length, self.share, self.scale)

    @ti.func
    def meet(self, i):
        """Geometry of the contacts within reach, and the overlaps that the past lets expect."""
        number, first, deepest = 0, self.contacts.start[i], 0.0
        for p in range(first, self.contacts.start[i + 1]):
            j = self.contacts.ends[p].j
            touched = self.contacts.touching[p] != APART
            if ti.static(self.adhesion):
                self.held[p] = 0
            met = self.geometry.encounter(i, j, self.control.reach[None], touched)
            if self.note(p, met):
                self.near[first + number] = p
                number += 1
                self.partner[p] = met.material
                self.separation[p] = math.inf
                if j >= 0:
                    reached = self.particles.body[i].radius + self.particles.body[j].radius
                    self.separation[p] = reached - met.overlap
                else:
                    self.rest(2 * p + 1)  # nobody's, after that of another contact
                self.effective[p] = met.overlap + self.expected(p) + self.lent(p, i, j)
                if ti.static(self.adhesion):
                    self.settle(p, i, touched)
                most = ti.max(met.overlap, self.effective[p])
                deepest = ti.max(deepest, most - self.opens_at(p))
        self.near_count[i] = number
        self.sums[i] = vec3(deepest, 0.0, 0.0)

    @ti.func
    def settle(self, p, i, touched):
        """Decide whether contact ``p`` holds, and where its force ends."""
        contact, history = at_rest(self.effective[p], self.radius[p], 1.0), self.contacts.history[p]
        k = self.normal_table[self.particles.spin[i].material, self.partner[p]]
        held, opening = hold_while_solved(
            self.normal_law.holds, self.normal_law.opening, contact, k, history, touched
        )
        self.held[p], self.opening[p] = held, opening

    @ti.func
    def is_held(self, p):
        """Whether contact ``p`` has been found to be in contact."""
        return self.held[p] != 0

    @ti.func
    def opens_at(self, p):
        """The effective overlap at which the force of contact ``p`` ends."""
        opening = 0.0
        if ti.static(self.adhesion):
            opening = self.opening[p]
        return opening

    @ti.func
    def expected(self, p):
        """The sum of expansions that the past steps lead one to expect."""
        return self.law.expected(self.contacts.history[p])

    @ti.func
    def lent(self, p, i, j):
        """What else a contact that has just been met is expected to rise by."""
        return 0.0

    @ti.func
    def press(self, i):
        """Force and tangent at the effective overlaps; motion and memory are left as they are."""
        material, first = self.particles.spin[i].material, self.contacts.start[i]
        for place in range(first, first + self.near_count[i]):
            p = self.near[place]
            answer, overlap = vec2(0.0), self.effective[p]
            closed = overlap > self.opens_at(p)
            if ti.static(self.adhesion):
                closed = closed and self.held[p] != 0
            if closed:
                contact, history = at_rest(overlap, self.radius[p], 1.0), self.contacts.history[p]
                k = self.normal_table[material, self.partner[p]]
                answer = force_while_solved(self.normal_law.force, contact, k, history)
            self.force[p], self.tangent[p] = answer[0], answer[1]

    @ti.func
    def spread(self, i, direction):
        """rise = M force, or M K of the next ``direction``, of whose curvature the particle then
        adds its part."""
        base, at = self.contacts.incidence_start[i], self.first_pair[i]
        for a in range(base, base + self.count[i]):
            p = self.entry[a] >> 1
            load, own = self.force[p], 0.0
            if direction:
                load = self.tangent[p] * self.next_direction(p)
            self.load[a] = load
            for b in range(base, a):
                influence = self.influence[at]
                own += influence * self.load[b]
                self.answer[b] = self.answer[b] + influence * load
                at += 1
            self.answer[a] = own
        curvature = 0.0
        for a in range(base, base + self.count[i]):
            self.rise[self.entry[a]] = self.answer[a]
            curvature -= self.load[a] * self.answer[a]
        if direction:
            first = self.contacts.start[i]
            for place in range(first, first + self.near_count[i]):
                p = self.near[place]
                curvature += self.tangent[p] * self.next_direction(p) ** 2
        self.sums[i] = vec3(0.0, curvature, 0.0)

    @ti.func
    def risen(self, p):
        return self.rise[2 * p] + self.rise[2 * p + 1]

    @ti.func
    def answers(self, p):
        """What a direction raises."""
        return self.risen(p)

    @ti.func
    def weigh(self, i):
        """How far the overlaps are from what the forces make of them."""
        error, product, first = 0.0, 0.0, self.contacts.start[i]
        for place in range(first, first + self.near_count[i]):
            p = self.near[place]
            reached, opening = self.overlap[p] + self.risen(p), self.opens_at(p)
            if self.effective[p] <= opening and reached <= opening:
                self.effective[p] = reached  # open, and stays open: solved outright
            defect = self.effective[p] - reached
            error = ti.max(error, disagreement(self.effective[p], reached, opening))
            product += self.tangent[p] * defect * defect
            self.remainder[p], self.direction[p], self.step[p] = -defect, 0.0, 0.0
        self.sums[i] = vec3(error, product, 0.0)

    @ti.func
    def next_direction(self, p):
        return self.remainder[p] + self.turn[None] * self.direction[p]

    @ti.func
    def advance(self, i):
        """Go along the direction as far as pays."""
        left, product, first = 0.0, 0.0, self.contacts.start[i]
        for place in range(first, first + self.near_count[i]):
            p = self.near[place]
            direction = self.next_direction(p)
            remainder = self.remainder[p] - self.length[None] * (direction - self.answers(p))
            self.direction[p], self.remainder[p] = direction, remainder
            self.step[p] = self.step[p] + self.length[None] * direction
            if self.tangent[p] > 0.0:
                left = ti.max(left, ti.abs(remainder))
            product += self.tangent[p] * remainder * remainder
        self.sums[i] = vec3(left, product, 0.0)

    @ti.func
    def make_step(self, i):
        """Change the overlaps, and the forces with them."""
        first = self.contacts.start[i]
        for place in range(first, first + self.near_count[i]):
            p = self.near[place]
            step = self.step[p]
            if self.tangent[p] <= 0.0:
                step += self.remainder[p]
            most = ti.max(self.effective[p], self.overlap[p]) + self.scale[None]
            self.effective[p] = ti.min(self.effective[p] + self.share[None] * step, most)
