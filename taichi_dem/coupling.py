"""The coupled solve for up to a few thousand contacts, inside a kernel.

The same equations as ``halfspace.solve``: the effective overlaps d and points of contact x + c of
contacts with overlaps delta over the undeformed surface satisfy

    d + w(H(d), x + c) + c^2/(2R) = delta,    c = R grad(-w).

With the model of the surface that follows its kept matrix (:mod:`taichi_dem.coupled_contacts`) they
are solved for the next guess, by semismooth Newton: its step s solves (I + C K) s = -defect,
K = H'(d), by conjugate gradients in the inner product of K: nothing is divided by a stiffness that
may vanish, and open contacts follow without a case of their own.  Then w is evaluated there.  The
defect falls a hundredfold or so from one evaluation to the next; and as the first model of a step
knows w of the last one, and how it drifted from its models before, one evaluation is mostly enough.

The way through is cut where sums are shared out in blocks: ``begin``, then ``share`` of all
``blocks`` and ``proceed`` in turn, until the ``phase`` is DONE.
"""

import math

from taichi_dem.contacts.contact import disagreement
from taichi_dem.coupled_contacts import (
    DIRECTION,
    DONE,
    EVALUATE,
    MODEL,
    RENEW,
    START,
    CoupledContacts,
)
from taichi_dem.pair_sums import of
from taichi_dem.types import real, ti

MOST_EVALUATIONS = 40
MOST_STEPS = 20  # of Newton, between two evaluations
MODEL_ERROR = 3e-3  # of the defect: the model is not solved further than it is right
ENOUGH = 0.7  # of what is asked for: as far the model is solved, and a step of it
STRAIGHT = 0.1  # of what counts as solved: a law that bends by less over a step is straight
SLOW = 0.3  # a defect that falls by less calls for a new matrix


@ti.data_oriented
class CoupledSolve(CoupledContacts):
    """As ``CoupledContacts``, in equilibrium with the surface."""

    def __init__(self, capacity: int, modulus: float, finite: bool, builder: "ti.FieldsBuilder"):
        super().__init__(capacity, modulus, finite, builder)
        self.rounds, self.steps = ti.field(ti.i32), ti.field(ti.i32)
        builder.place(self.rounds, self.steps)
        for name in "goal scale error model_goal model_error product length".split():
            setattr(self, name, ti.field(real))
            builder.place(getattr(self, name))
        for name in "step remainder direction image".split():
            setattr(self, name, ti.field(real))
            builder.dense(ti.i, capacity).place(getattr(self, name))

    # -- the way through -------------------------------------------------------------------------

    @ti.func
    def proceed(self, law: ti.template()) -> ti.i32:
        """Go on after all blocks are done; returns 0 if no equilibrium is to be found.

        (Every part stands here once: all of this is compiled into every driver.)"""
        solved, newton, load, model, evaluation = 1, 0, 0, 0, 0
        phase = self.phase[None]
        if phase == START:
            self.start()
            load = 1
        elif phase == RENEW:
            self.renewed()
            model = 1
        elif phase == MODEL:
            evaluation = self.check_model()
            newton = 1 - evaluation
        elif phase == DIRECTION:
            load = self.conjugate()
            if load != 0:
                self.take_step()
        elif phase == EVALUATE:
            solved = self.judge()
            newton = ti.cast(self.phase[None] == MODEL, ti.i32)
        if newton != 0:
            load = 1 - self.start_newton()
            if load != 0:
                self.take_step()
        if load != 0:
            self.load(law)
            if phase == DIRECTION:
                evaluation = self.trust_step()
            model = ti.cast(self.phase[None] == MODEL, ti.i32) * (1 - evaluation)
        if model != 0:
            k = 0
            while k < self.count[None]:
                self.loaded[k] = self.force[k] - self.known[k]
                k += 1
        if model != 0 or self.phase[None] == DIRECTION:
            self.sums.gather_loads(self.loaded)
        if evaluation != 0:
            self.call_evaluation()
        return solved

    @ti.func
    def start(self):
        """From the caller's guess to the first model."""
        scale = 0.0
        k = 0
        while k < self.count[None]:
            scale = ti.max(scale, self.overlap[k] - self.opening[k])
            if self.effective[k] > self.opening[k]:
                scale = ti.max(scale, -self.opening[k])
            self.meet(k)
            if self.live[k] == 0:
                self.effective[k], self.defect[k] = self.overlap[k], 0.0
            self.keep_up(k, self.anchored[k] == 0)
            k += 1
        self.scale[None], self.goal[None] = scale, self.residual[None] * scale
        self.tries[None], self.error[None] = 0, math.inf
        self.begin_model(0.0)

    # -- against the truth -----------------------------------------------------------------------

    @ti.func
    def miss(self, k, reached):
        """Note the defect of a live contact; returns how much of it counts."""
        error, opening = 0.0, self.opening[k]
        if self.live[k] != 0:
            if self.effective[k] <= opening and reached <= opening:
                self.effective[k] = reached  # open, and stays open: solved outright
            self.defect[k] = self.effective[k] - reached
            error = disagreement(self.effective[k], reached, opening)
        return error

    @ti.func
    def judge(self) -> ti.i32:
        """After an evaluation: done, or on to the model; returns 0 if it is hopeless."""
        error, before = 0.0, self.error[None]
        k = 0
        while k < self.count[None]:
            error = ti.max(error, self.miss(k, self.reached(k)))
            if ti.static(self.finite):
                if self.force[k] != 0.0:
                    error = ti.max(error, self.tilt(k))
            k += 1
        self.error[None] = error
        self.tries[None] += 1
        solved = 1
        if error <= self.goal[None]:
            self.phase[None] = DONE
        elif self.tries[None] >= MOST_EVALUATIONS:
            self.phase[None], solved = DONE, 0
        else:
            k = 0
            while k < self.count[None]:
                self.keep_up(k, error > SLOW * before)
                self.improve(k)
                k += 1
            self.begin_model(MODEL_ERROR * error)
        return solved

    # -- on the model ----------------------------------------------------------------------------

    @ti.func
    def begin_model(self, goal):
        self.model_goal[None] = ti.max(goal, ENOUGH * self.goal[None])
        self.model_error[None], self.steps[None], self.length[None] = math.inf, 0, 1.0
        self.phase[None] = MODEL
        if self.stale[None] != 0:
            self.phase[None] = RENEW

    @ti.func
    def check_model(self) -> ti.i32:
        """Whether the model is solved, and the truth to be asked again."""
        error, before, solved = 0.0, self.model_error[None], 0
        self.products[None] += 1
        k = 0
        while k < self.count[None]:
            error = ti.max(error, self.miss(k, self.base[k] - of(self.sums.image, k)))
            k += 1
        self.model_error[None] = error
        if error <= self.model_goal[None] or self.steps[None] >= MOST_STEPS:
            solved = 1
            self.note_gain()
        else:  # across a kink of the law a full step may overshoot
            self.length[None] = 1.0 if error < before else 0.5
        return solved

    @ti.func
    def start_newton(self) -> ti.i32:
        """(I + C K) step = -defect: the first direction; returns 0 if nothing is stiff."""
        product = 0.0
        k = 0
        while k < self.count[None]:
            self.step[k] = 0.0
            self.remainder[k] = -self.defect[k]
            self.direction[k] = -self.defect[k]
            self.loaded[k] = self.tangent[k] * self.direction[k]
            product += self.tangent[k] * self.defect[k] * self.defect[k]
            k += 1
        self.product[None], self.rounds[None], self.phase[None] = product, 0, DIRECTION
        return ti.cast(product > 0.0, ti.i32)

    @ti.func
    def conjugate(self) -> ti.i32:
        """One round of conjugate gradients; returns whether it was the last."""
        curvature, before = 0.0, self.product[None]
        self.products[None] += 1
        k = 0
        while k < self.count[None]:
            self.image[k] = 0.0
            if self.live[k] != 0:
                self.image[k] = of(self.sums.image, k) + self.direction[k]
            curvature += self.loaded[k] * self.image[k]
            k += 1
        product, left = 0.0, 0.0
        if curvature > 0.0:  # or contacts are closer than their size: keep what there is
            length = before / curvature
            k = 0
            while k < self.count[None]:
                self.step[k] = self.step[k] + length * self.direction[k]
                self.remainder[k] = self.remainder[k] - length * self.image[k]
                if self.tangent[k] > 0.0:
                    left = ti.max(left, ti.abs(self.remainder[k]))
                product += self.tangent[k] * self.remainder[k] * self.remainder[k]
                k += 1
        self.rounds[None] += 1
        done = ti.cast(left <= ENOUGH * self.model_goal[None], ti.i32)
        if not product > 0.0 or self.rounds[None] > 2 * self.count[None] + 2:
            done = 1
        if done == 0:
            k = 0
            while k < self.count[None]:
                self.direction[k] = self.remainder[k] + (product / before) * self.direction[k]
                self.loaded[k] = self.tangent[k] * self.direction[k]
                k += 1
            self.product[None] = product
        return done

    @ti.func
    def take_step(self):
        """d after the step of Newton, and the forces it reckons with."""
        k = 0
        while k < self.count[None]:
            if self.tangent[k] <= 0.0:
                self.step[k] = self.step[k] + self.remainder[k]
            before, step = self.effective[k], self.length[None] * self.step[k]
            ceiling = ti.max(before, self.overlap[k]) + self.scale[None]
            self.effective[k] = ti.min(before + step, ceiling)
            self.loaded[k] = self.force[k] + self.tangent[k] * step
            self.image[k] = self.tangent[k]
            k += 1
        self.steps[None] += 1
        self.phase[None] = MODEL

    @ti.func
    def trust_step(self) -> ti.i32:
        """Whether the law was so straight over a whole step that the model need not be asked what
        it makes of it."""
        trusted = ti.cast(self.length[None] == 1.0, ti.i32)
        k = 0
        while k < self.count[None]:
            stiffness = ti.max(self.image[k], self.tangent[k])
            if not ti.abs(self.force[k] - self.loaded[k]) <= STRAIGHT * self.goal[None] * stiffness:
                trusted = 0
            k += 1
        if trusted != 0:
            k = 0
            while k < self.count[None]:
                left = ti.select(self.image[k] > 0.0, self.remainder[k], 0.0)
                self.gain[k] = self.gain[k] + (self.base[k] - self.effective[k] - left)
                k += 1
        return trusted
