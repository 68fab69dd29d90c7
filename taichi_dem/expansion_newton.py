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

from taichi_dem.contacts.multicontact import SHARE
from taichi_dem.control import OVERPRESSED
from taichi_dem.expansion_passes import ExpansionPasses
from taichi_dem.types import real, ti, vec3

DONE, MEET, MATCH, WEIGH, SPREAD, ADVANCE, STEP, RAISE, TILT = range(9)  # the passes
FORCING = 0.02  # how far a Newton step is solved, as a share of the error
MOST_ROUNDS = 200  # of conjugate gradients in a step


@ti.data_oriented
class ImplicitExpansions(ExpansionPasses):
    """As ``ExpansionPasses``, solved together with the forces.

    phase    the present pass; passes, how many there have been
    made     steps of Newton so far; rounds, of conjugate gradients in this one
    goal     the error that counts as solved, m; aim, that to which a step is solved
    error    of the overlaps before this step, m
    product  of what is left of the step with itself, in the inner product of K
    """

    implicit = True

    def place_more(self, builder: "ti.FieldsBuilder") -> None:
        super().place_more(builder)
        self.phase, self.rounds, self.made = ti.field(ti.i32), ti.field(ti.i32), ti.field(ti.i32)
        self.goal, self.aim, self.error = ti.field(real), ti.field(real), ti.field(real)
        self.product, self.passes = ti.field(real), ti.field(ti.i64)
        builder.place(self.phase, self.rounds, self.made, self.passes)
        builder.place(self.goal, self.aim, self.error, self.product)

    @ti.func
    def trust(self):
        return SHARE if self.made[None] == 0 else 1.0

    # -- a pass ----------------------------------------------------------------------------------

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
        else:
            self.try_newton_step(found)

    @ti.func
    def try_newton_step(self, found):
        """:meth:`begin_newton_step`, unless there have been enough."""
        if self.made[None] == self.law.iterations:
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
