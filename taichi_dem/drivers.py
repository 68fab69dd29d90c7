"""Three drivers over the same functions: one serial task of many steps, a team of threads that stay
together for as many, or parallel loops.

All give the same bits, so which one runs may be decided by a stopwatch.  What they call is in
:mod:`taichi_dem.step`.
"""

from taichi_dem.expansion_newton import DONE
from taichi_dem.meeting import CALLED, MADE, TASK, Meeting
from taichi_dem.step import Step
from taichi_dem.types import ti


@ti.data_oriented
class Drivers:
    """Kernels that move a simulation on, ``step`` by step."""

    def __init__(self, step: Step, meeting: Meeting):
        self.step, self.meeting = step, meeting
        self.particles, self.contacts, self.control = step.particles, step.contacts, step.control
        self.exchange, self.has_exchange = step.exchange, step.has_exchange
        self.expansions, self.solves = step.expansions, step.solves

    # -- many steps ------------------------------------------------------------------------------

    @ti.kernel
    def serial(self, steps: ti.i32) -> ti.i32:
        """At most ``steps`` steps in one task; returns how many were made before the host is
        needed."""
        made, time_step = 0, self.control.time_step[None]
        while made < steps and self.control.calls_host() == 0:
            self.step.surface()
            self.step.settle_expansions()
            for p in range(self.contacts.start[self.particles.count]):
                self.step.evaluate_contact(p, time_step)
            self.step.settle_boundaries()
            self.step.carry_boundaries()
            for i in range(self.particles.count):
                self.step.move(i)
            made += 1
        return made

    @ti.kernel
    def parallel(self) -> ti.i32:
        """One step in parallel loops, after the surface's; returns whether the host is needed."""
        for p in range(self.contacts.start[self.particles.count]):
            self.step.evaluate_contact(p, self.control.time_step[None])
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.step.settle_boundaries()
            self.step.carry_boundaries()
        for i in range(self.particles.count):
            self.step.move(i)
        return self.control.calls_host()

    @ti.kernel
    def begin_passes(self):
        """What comes before the passes of the expansions."""
        self.step.surface()
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.expansions.begin()

    @ti.kernel
    def make_pass(self) -> ti.i32:
        """One pass in a parallel loop; returns which comes next."""
        for unit in range(self.expansions.units()):
            self.expansions.work(unit)
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.expansions.decide()
        return self.expansions.phase[None]

    def settle(self) -> None:
        """The passes of the expansions, in parallel loops."""
        self.begin_passes()
        while self.make_pass() != DONE:
            pass

    def loop(self, steps: int) -> int:
        """As :meth:`serial`, in parallel loops."""
        for made in range(1, steps + 1):
            self.find_surface()
            if self.solves:
                self.settle()
            if self.parallel() != 0:
                return made
        return steps

    @ti.kernel
    def team(self, steps: ti.i32) -> ti.i32:
        """As :meth:`serial`, by threads that meet between the halves of a step."""
        self.meeting.open()
        self.call_step(0, steps)
        for place in range(TASK * self.meeting.members):
            if place % TASK == 0:
                self.work(place // TASK, steps)
        return self.meeting.number[MADE]

    @ti.func
    def work(self, member, steps):
        """The share of one member: its particles, and the contacts that these look for.

        In a large bed a particle moves as soon as all its contacts have been seen to, while what
        they do is still in the caches; in the second half those that others have contacts with."""
        n, members = self.particles.count, ti.static(self.meeting.members)
        low, high = n * member // members, n * (member + 1) // members
        first, last = self.contacts.start[low], self.contacts.start[high]
        made, met, time_step = 0, 0, self.control.time_step[None]
        while self.meeting.look(CALLED) > made:
            if ti.static(self.has_exchange):
                while self.exchange.calls() != 0:
                    block = member
                    while block < self.exchange.blocks():
                        self.exchange.share(block)
                        block += members
                    if self.meeting.last_to_arrive():
                        self.exchange.proceed(self.contacts)
                        self.meeting.release()
                    met += 1
                    self.meeting.wait(met)
            if ti.static(self.solves):
                while self.expansions.phase[None] != DONE:
                    units = self.expansions.units()
                    for unit in range(units * member // members, units * (member + 1) // members):
                        self.expansions.work(unit)
                    if self.meeting.last_to_arrive():
                        self.expansions.decide()
                        self.meeting.release()
                    met += 1
                    self.meeting.wait(met)
            made += 1
            p = first
            for half in range(2):
                for i in range(low, high):
                    while p < self.contacts.needed(i, last):
                        self.step.evaluate_contact(p, time_step)
                        p += 1
                    if self.contacts.lie_within(i, first, last) == (half == 0):
                        self.step.move(i)
                if self.meeting.last_to_arrive():
                    if half == 0:
                        self.step.settle_boundaries()
                        self.step.carry_boundaries()
                    else:
                        self.call_step(made, steps)
                    self.meeting.release()
                met += 1
                self.meeting.wait(met)

    @ti.func
    def call_step(self, made, steps):
        """Call for one more step, unless enough are made or the host is needed."""
        self.meeting.number[MADE] = made
        if made < steps and self.control.calls_host() == 0:
            if ti.static(self.has_exchange):
                self.exchange.begin()
            if ti.static(self.solves):
                self.expansions.begin()
            self.meeting.call()

    # -- the ends of a run -----------------------------------------------------------------------

    @ti.kernel
    def begin(self):
        """First half kick and drift, with the forces of the present state."""
        for i in range(self.particles.count):
            self.step.set_out(i)
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.step.carry_boundaries()

    def evaluate(self, time_step: float) -> None:
        """Forces of the present state, ``time_step`` after the last ones (0: of a state at rest
        in its history)."""
        self.find_surface()
        self._evaluate(time_step)

    def find_surface(self) -> None:
        """What the substrate does to its contacts; by a kernel of its own, as it is long."""
        if self.has_exchange:
            self._find_surface()

    @ti.kernel
    def _find_surface(self):
        for _ in range(1):
            self.step.surface()

    @ti.kernel
    def _evaluate(self, time_step: ti.f64):
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.step.settle_expansions()
        for p in range(self.contacts.start[self.particles.count]):
            self.step.evaluate_contact(p, time_step)
        for i in range(self.particles.count):
            self.step.load(i)

    @ti.kernel
    def finish(self):
        """Second half kick, with the forces of the present state."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.step.settle_boundaries()
        for i in range(self.particles.count):
            self.step.arrive(i)

    @ti.kernel
    def note_pushes(self):
        """The boundaries' forces of a state that no step has led to."""
        boundaries = self.step.boundaries
        if ti.static(self.step.moves):
            for b in range(boundaries.count):
                boundaries.motion[b].push = boundaries.push_on(b, self.contacts)
