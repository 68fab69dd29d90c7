"""Expansions and forces that agree with each other, at every step.

With d the overlaps over undeformed surfaces, F the forces and M what they raise on the spheres, the
effective overlaps D of all contacts satisfy

    D - d - M F(D) = 0

by semismooth Newton.  Its step s solves (1 - M K) s = d + M F - D, K = F'(D), by conjugate
gradients in the inner product of K, in which the matrix is symmetric.  Where it is no longer
positive the spheres give way: beyond, there is no equilibrium.

The work is cut into passes over the particles, each with its contacts or with those that it looks
for; between two passes one thread adds up and decides what comes next.  So it runs in any driver,
with the same bits.
"""

import math
from typing import Any

from taichi_dem.contact_list import APART
from taichi_dem.contacts.contact import at_rest
from taichi_dem.contacts.multicontact import SHARE
from taichi_dem.control import OVERPRESSED
from taichi_dem.exchange import HELD_BEYOND
from taichi_dem.reciprocal import ReciprocalExpansions
from taichi_dem.types import real, ti, vec2, vec3

DONE, MEET, MATCH, WEIGH, SPREAD, ADVANCE, STEP, RAISE, TILT = range(9)  # the passes
FORCING = 0.02  # how far a Newton step is solved, as a share of the error
MOST_ROUNDS = 200  # of conjugate gradients in a step


@ti.data_oriented
class ImplicitExpansions(ReciprocalExpansions):
    """As ``ReciprocalExpansions``, solved together with the forces.

    near       contacts within reach of each particle's own, from start on; near_count of them
    sums       of each particle: what a pass finds out, the largest of one number, sums of two
    held       of each contact, whether it is to hold; opening, m, where its force ends (absent
               unless contacts adhere)
    rise       is what a direction raises, too, while the solve goes on
    """

    implicit = True

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
        self.phase, self.rounds, self.made = ti.field(ti.i32), ti.field(ti.i32), ti.field(ti.i32)
        self.goal, self.aim, self.error = ti.field(real), ti.field(real), ti.field(real)
        self.product, self.length, self.share = ti.field(real), ti.field(real), ti.field(real)
        self.scale, self.turn = ti.field(real), ti.field(real)
        self.passes = ti.field(ti.i64)
        builder.place(self.phase, self.rounds, self.made, self.passes)
        builder.place(self.goal, self.aim, self.error, self.product, self.length)
        builder.place(self.share, self.scale, self.turn)

    # -- the passes of one particle --------------------------------------------------------------

    @ti.func
    def units(self):
        """How many shares the present pass has."""
        return self.particles.count

    @ti.func
    def work(self, unit):
        """One share of the present pass."""
        self.treat(unit)

    @ti.func
    def treat(self, i):
        """The share of particle ``i`` in the present pass."""
        phase = self.phase[None]
        if phase == MEET:
            self.meet(i)
        elif phase == MATCH:
            self.match(i)
        elif phase == WEIGH:
            self.weigh(i)
        elif phase == ADVANCE:
            self.advance(i)
        elif phase == STEP:
            self.make_step(i)
        elif phase == TILT:
            self.tilt(i)
        # Once each, for what is called in several places is compiled as often.
        if (phase == MEET) | (phase == STEP):
            self.press(i)
        if (phase == MATCH) | (phase == RAISE) | (phase == SPREAD):
            self.spread(i, phase == SPREAD)

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
        """Decide whether contact ``p`` holds, and where its force ends: while forces are solved for
        none jumps, so that there is an equilibrium."""
        contact = at_rest(self.effective[p], self.radius[p], 1.0)
        k = self.normal_table[self.particles.spin[i].material, self.partner[p]]
        history, held, opening = self.contacts.history[p], contact.overlap > 0.0, 0.0
        if touched:
            held = self.normal_law.holds(contact, k, history) != 0
        if held:
            opening = HELD_BEYOND * self.normal_law.opening(contact, k)
        self.held[p], self.opening[p] = ti.cast(held, ti.i32), opening

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
    def trust(self):
        return SHARE if self.made[None] == 0 else 1.0

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
                history = self.contacts.history[p]
                normal = self.normal_law.force(
                    at_rest(overlap, self.radius[p], 1.0),
                    self.normal_table[material, self.partner[p]],
                    history,
                )
                # Where a law softens, its force is held while the others adapt.
                answer = vec2(normal.elastic, ti.max(normal.stiffness, 0.0))
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
            wrong = ti.abs(ti.max(self.effective[p], opening) - ti.max(reached, opening))
            if not (ti.abs(defect) < math.inf):  # not-a-number must not pass for solved
                wrong = math.inf
            error = ti.max(error, wrong)
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

    # -- between two passes ----------------------------------------------------------------------

    @ti.func
    def begin(self):
        """Start on the present state."""
        self.phase[None], self.made[None], self.share[None] = MEET, 0, 1.0

    @ti.func
    def total(self):
        """What the particles have found, added up in their order: the largest and two sums."""
        total = vec3(0.0)
        for i in range(self.particles.count):
            sums = self.sums[i]
            total[0] = ti.max(total[0], sums[0])
            total[1] += sums[1]
        return total

    @ti.func
    def decide(self):
        """Which pass comes next."""
        phase = self.phase[None]
        self.passes[None] += 1
        if phase == MEET:
            self.scale[None] = self.total()[0]
            self.goal[None] = self.law.residual * self.scale[None]
            self.phase[None] = MATCH
        elif (phase == MATCH) | (phase == RAISE):
            self.phase[None] = WEIGH
        elif phase == WEIGH:
            self.judge()
        elif phase == SPREAD:
            self.find_length(self.total()[1])
        else:
            self.go_on(phase)

    @ti.func
    def go_on(self, phase):
        """After the passes that end alike with and without a substrate."""
        if phase == ADVANCE:
            self.turn_on()
        elif phase == STEP:
            self.phase[None] = RAISE
        else:
            self.phase[None] = DONE

    @ti.func
    def find_length(self, curvature):
        """How far to go along a direction of that ``curvature``; where it is not positive, keep
        what there is."""
        self.length[None] = self.product[None] / ti.select(curvature > 0.0, curvature, 1.0)
        self.phase[None] = ADVANCE if curvature > 0.0 else STEP

    @ti.func
    def turn_on(self):
        """After a round: into the next direction, or take the step."""
        found = self.total()
        self.rounds[None] += 1
        self.turn[None] = found[1] / self.product[None]
        self.product[None] = found[1]
        more = found[0] > self.aim[None] and found[1] > 0.0
        self.phase[None] = SPREAD if more and self.rounds[None] < MOST_ROUNDS else STEP

    @ti.func
    def judge(self):
        """Whether the overlaps are good enough, and how to go on if not."""
        found = self.total()
        if found[0] <= self.goal[None]:
            self.phase[None] = TILT
        elif self.made[None] == self.law.iterations:
            self.control.raise_flag(OVERPRESSED)
            self.phase[None] = TILT
        else:
            self.begin_newton_step(found)

    @ti.func
    def begin_newton_step(self, found):
        """Solve for one from here, where an error and a product have been ``found``."""
        error = found[0]
        better = self.made[None] == 0 or error < self.error[None]
        self.share[None] = 1.0 if better else 0.5  # a full step may overshoot across a kink
        self.error[None] = error
        self.made[None] += 1
        self.rounds[None], self.turn[None] = 0, 0.0
        self.product[None] = found[1]
        self.aim[None] = ti.max(FORCING * error, 0.5 * self.goal[None])
        self.phase[None] = SPREAD if found[1] > 0.0 else STEP
