"""Expansions, forces and an elastic substrate that agree with each other, at every step.

To what the spheres' own surfaces rise by comes what the substrate sinks by, w and its tilt
(:mod:`taichi_dem.coupling`), under every contact k with it; all contacts together satisfy

    D - d - M F(D) + [w + c^2/(2R)](F(D)) = 0,    c = R grad(-w) and w = 0 but for the substrate's.

Both have an energy, -F M F/2 and F.w - E_c, so their sum has, and the forces that its derivative
adds are those that each adds alone.

w is summed exactly, which is dear, and between two sums followed by the substrate's kept matrix C:
w_known + C (F - F_known).  Newton's steps solve (1 - M K + C K) s = -defect by conjugate gradients,
as for the expansions alone: each of its products with M is followed by one with C, on the contacts
with the substrate.  The passes over blocks of these stand between the passes over particles.

(Loops count by themselves, for the sake of the time that the kernel takes to load.)
"""

import math
from typing import Any

from taichi_dem.contact_list import SUBSTRATE
from taichi_dem.control import UNSOLVED
from taichi_dem.coupled_contacts import RENEW as RENEW_MATRIX
from taichi_dem.coupling import ENOUGH, MODEL_ERROR, MOST_EVALUATIONS, SLOW
from taichi_dem.exchange import Exchange
from taichi_dem.expansion_newton import (
    ADVANCE,
    DONE,
    MATCH,
    MEET,
    RAISE,
    SPREAD,
    TILT,
    WEIGH,
    ImplicitExpansions,
)
from taichi_dem.pair_sums import of
from taichi_dem.types import real, ti, vec2

RENEW, APPLY, EVALUATE = range(TILT + 1, TILT + 4)  # the passes over blocks
SMALL = 1e-7  # of the deepest overlap: as far a model in single precision can be solved


@ti.data_oriented
class JointExpansions(ImplicitExpansions):
    """As ``ImplicitExpansions``, with the contacts of ``exchange``, a coupled substrate, whose
    scratch fields count overlaps from d + M F on.  A substrate that is solved for on the host is
    taken as given, and the two take turns (:mod:`taichi_dem.hosted`).

    given     of each contact, m: what the substrate adds to it; while a direction is looked at,
              what it adds to that
    exact     whether that is summed, or follows the matrix
    asked     the pass that waits for a product of the matrix
    truth     the error that counts as solved, m; ``goal`` is the model's
    """

    def __init__(self, *of_expansions: Any, exchange: Exchange, **of_implicit: Any):
        self.exchange, self.solver = exchange, exchange.solver
        super().__init__(*of_expansions, **of_implicit)

    def place_more(self, builder: "ti.FieldsBuilder") -> None:
        super().place_more(builder)
        self.given = ti.field(real)
        builder.dense(ti.i, self.contacts.capacity).place(self.given)
        self.exact, self.asked = ti.field(ti.i32), ti.field(ti.i32)
        self.truth, self.defect = ti.field(real), ti.field(real)
        builder.place(self.exact, self.asked, self.truth, self.defect)

    # -- the passes ------------------------------------------------------------------------------

    @ti.func
    def units(self):
        units = self.particles.count
        if self.phase[None] > TILT:
            units = self.exchange.blocks()
        return units

    @ti.func
    def work(self, unit):
        if self.phase[None] > TILT:
            self.exchange.share(unit)
        else:
            self.treat(unit)

    @ti.func
    def lent(self, p, i, j):
        lent = 0.0
        if j == SUBSTRATE:
            lent = -self.exchange.expected(i)
            if self.on_host():
                lent = self.exchange.ground[i].expansion
        self.given[p] = lent
        return lent

    @ti.func
    def risen(self, p):
        return self.rise[2 * p] + self.rise[2 * p + 1] + self.given[p]

    @ti.func
    def answers(self, p):
        answer = self.rise[2 * p] + self.rise[2 * p + 1]
        if not self.on_host():
            answer += self.given[p]
        return answer

    @ti.func
    def on_host(self):
        """Whether somebody else solves for the substrate, to be taken as given here."""
        return self.exchange.on_host[None] != 0

    # -- between two passes ----------------------------------------------------------------------

    @ti.func
    def decide(self):
        """Which pass comes next.  (Every part stands here once, for what is called in several
        places is compiled as often.)"""
        solver, phase, asks = self.solver, self.phase[None], 0
        self.passes[None] += 1
        if phase == MEET:
            self.meet_ground()
            self.phase[None] = MATCH
        elif ((phase == MATCH) | (phase == RAISE)) and self.on_host():
            self.phase[None] = WEIGH
        elif (phase == MATCH) | (phase == RAISE):
            k = 0
            while k < solver.count[None]:
                self.press_on_ground(k)
                solver.loaded[k] = solver.force[k] - solver.known[k]
                k += 1
            self.asked[None], asks = WEIGH, 1
        elif phase == SPREAD and self.on_host():
            self.find_length(self.total()[1])
        elif phase == SPREAD:
            k = 0
            while k < solver.count[None]:
                p = self.exchange.entry[k]
                solver.loaded[k] = 0.0
                if solver.live[k] != 0:
                    solver.loaded[k] = self.tangent[p] * self.next_direction(p)
                k += 1
            self.asked[None], asks = ADVANCE, 1
        elif phase == RENEW:
            solver.renewed()
            self.phase[None] = APPLY
        elif phase == APPLY:
            self.take_product()
        elif phase == EVALUATE:
            solver.tries[None] += 1
            self.exact[None] = 1
            k = 0
            while k < solver.count[None]:
                self.given[self.exchange.entry[k]] = solver.reached(k)
                k += 1
            self.phase[None] = WEIGH
        elif phase == WEIGH:
            asks = self.judge_all()
            self.asked[None] = WEIGH
        else:
            self.go_on(phase)
        if asks != 0:
            solver.sums.gather_loads(solver.loaded)
            self.phase[None] = RENEW if solver.stale[None] != 0 else APPLY
            solver.phase[None] = RENEW_MATRIX if solver.stale[None] != 0 else DONE
        if phase == WEIGH and self.phase[None] == TILT:
            self.tell_ground()

    @ti.func
    def meet_ground(self):
        """From what the contacts with the substrate were to the first model."""
        solver = self.solver
        self.scale[None] = self.total()[0]
        residual = ti.min(self.law.residual, solver.residual[None])
        self.truth[None] = residual * self.scale[None]
        self.goal[None] = ti.max(ENOUGH * self.truth[None], SMALL * self.scale[None])
        self.exact[None], self.defect[None], solver.tries[None] = 0, math.inf, 0
        if self.on_host():
            self.goal[None] = self.truth[None]
        k = 0
        while k < self.members():
            self.exchange.tell(k, self.exchange.members[k])
            solver.base[k] -= solver.overlap[k]
            solver.overlap[k] = 0.0
            solver.known[k], solver.gain[k] = solver.force[k], 0.0
            near = self.overlap[self.exchange.entry[k]] > -math.inf
            solver.live[k] = ti.cast(near, ti.i32)
            solver.place(k)
            solver.keep_up(k, solver.anchored[k] == 0)
            k += 1

    @ti.func
    def members(self):
        """How many contacts there are to solve for here."""
        return ti.select(self.on_host(), 0, self.solver.count[None])

    @ti.func
    def press_on_ground(self, k):
        solver = self.solver
        solver.force[k] = 0.0
        if solver.live[k] != 0:
            solver.force[k] = self.force[self.exchange.entry[k]]

    @ti.func
    def take_product(self):
        """What the matrix makes of the loads that it was asked about."""
        solver = self.solver
        solver.products[None] += 1
        solver.phase[None] = DONE
        curvature = self.total()[1]
        if self.asked[None] == WEIGH:
            k = 0
            while k < solver.count[None]:
                p = self.exchange.entry[k]
                self.given[p] = solver.base[k] - of(solver.sums.image, k)
                k += 1
            self.phase[None] = WEIGH
        else:
            k = 0
            while k < solver.count[None]:
                image = of(solver.sums.image, k)
                self.given[self.exchange.entry[k]] = -image
                curvature += solver.loaded[k] * image
                k += 1
            self.find_length(curvature)

    @ti.func
    def judge_all(self):
        """Whether all agree, and how to go on if not; returns whether by a model of what has been
        summed."""
        found, goes_on, solver = self.total(), 0, self.solver
        if self.exact[None] != 0:
            k = 0
            while k < solver.count[None]:
                if ti.static(self.exchange.finite):
                    if solver.force[k] != 0.0:
                        found[0] = ti.max(found[0], solver.tilt(k))
                k += 1
            if found[0] <= self.truth[None]:
                self.phase[None] = TILT
            elif solver.tries[None] >= MOST_EVALUATIONS:
                self.control.raise_flag(UNSOLVED)
                self.phase[None] = TILT
            else:
                self.learn(found[0])
                goes_on = 1
        elif found[0] <= self.goal[None] and self.on_host():
            self.phase[None] = TILT
        elif found[0] <= self.goal[None]:
            solver.note_gain()
            solver.call_evaluation()
            self.phase[None] = EVALUATE
        else:
            self.try_newton_step(found)
        return goes_on

    @ti.func
    def learn(self, error):
        """The model from here on, after a sum that was ``error`` away (m)."""
        solver = self.solver
        k = 0
        while k < solver.count[None]:
            solver.keep_up(k, error > SLOW * self.defect[None])
            solver.improve(k)
            solver.loaded[k] = 0.0
            k += 1
        self.defect[None] = error
        self.goal[None] = ti.max(MODEL_ERROR * error, ENOUGH * self.truth[None])
        self.exact[None], self.made[None] = 0, 0

    @ti.func
    def tell_ground(self):
        """What has been found, for the substrate to keep."""
        solver = self.solver
        k = 0
        while k < self.members():
            i, p, bulge = self.exchange.members[k], self.exchange.entry[k], 0.0
            if solver.live[k] != 0:
                bulge = self.rise[2 * p]
                solver.effective[k] = self.effective[p] - self.overlap[p] - bulge
            self.exchange.ground[i].bulge = bulge
            self.exchange.hear(k, i)
            risen = ti.max(self.exchange.ground[i].expansion, 0.0)
            self.watch(vec2(bulge, risen))
            k += 1
