"""Three drivers over the same functions: one serial task of many steps, a team of threads that stay
together for as many, or parallel loops.

All give the same bits, so which one runs may be decided by a stopwatch.  A step between two forces
is: surface, contacts, boundaries, particles; a run begins with a half kick and a drift and ends
with forces and a half kick.
"""

from typing import Any

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART
from taichi_dem.control import STALE, Control
from taichi_dem.expansion_newton import DONE
from taichi_dem.forces import Forces
from taichi_dem.integrate import Verlet
from taichi_dem.meeting import CALLED, MADE, TASK, Meeting
from taichi_dem.types import ti


@ti.data_oriented
class Drivers:
    """Kernels that move a simulation on; ``exchange`` is the coupled substrate or None, of which
    nothing is compiled here if it is always solved for on the host; ``sleep`` says who sleeps, or
    is None."""

    def __init__(
        self,
        forces: Forces,
        verlet: Verlet,
        boundaries: Boundaries,
        exchange: Any,
        control: Control,
        meeting: Meeting,
        sleep: Any = None,
    ):
        self.meeting = meeting
        self.sleep, self.sleeps = sleep, sleep is not None
        self.forces, self.verlet, self.boundaries = forces, verlet, boundaries
        self.exchange = exchange
        self.particles, self.contacts = forces.particles, forces.contacts
        self.control = control
        self.moves = boundaries.any_moves
        self.expansions = forces.expansions
        self.solves = forces.spreads and self.expansions.implicit
        self.lags = forces.spreads and not self.expansions.implicit
        # (Which may be part of what the expansions solve.)
        self.has_exchange = exchange is not None and exchange.in_kernel and not self.solves

    # -- the parts of a step ---------------------------------------------------------------------
    # (A loop at the root of a kernel runs in parallel, also one that comes from a function: what
    # must be serial stands inside something else.)

    @ti.func
    def surface(self):
        if ti.static(self.has_exchange):
            self.exchange.begin()
            while self.exchange.calls() != 0:
                for block in range(self.exchange.blocks()):
                    self.exchange.share(block)
                self.exchange.proceed(self.contacts)

    @ti.func
    def settle_expansions(self):
        """The passes of the expansions, in one thread."""
        if ti.static(self.solves):
            self.expansions.begin()
            while self.expansions.phase[None] != DONE:
                for unit in range(self.expansions.units()):
                    self.expansions.work(unit)
                self.expansions.decide()

    @ti.func
    def settle_boundaries(self):
        if ti.static(self.moves):
            for b in range(self.boundaries.count):
                if self.boundaries.motion[b].moves != 0:
                    push = self.boundaries.push_on(b, self.contacts)
                    self.boundaries.settle(b, push, self.control.time_step[None])

    @ti.func
    def carry_boundaries(self):
        self.control.step[None] += 1
        if ti.static(self.moves):
            for b in range(self.boundaries.count):
                self.boundaries.kick(b, self.control.time_step[None])
            time = ti.cast(self.control.step[None], ti.f64) * self.control.time_step[None]
            gone = self.boundaries.drift(time, self.control.time_step[None])
            if not (gone < 0.5 * self.control.skin[None]):
                self.control.raise_flag(STALE)

    @ti.func
    def evaluate_contact(self, p, time_step):
        """Contact ``p``, unless all of it sleeps."""
        if ti.static(self.sleeps):
            i, j = self.contacts.ends[p].i, self.contacts.ends[p].j
            if self.sleep.concerns(i, j):
                self.forces.evaluate(p, time_step)
                if self.contacts.touching[p] != APART:
                    self.sleep.touch(i, j)
        else:
            self.forces.evaluate(p, time_step)

    @ti.func
    def move(self, i):
        """Particle ``i`` over a step, unless it sleeps."""
        if ti.static(self.sleeps):
            if self.sleep.rouse(i):
                self.stride(i)
        else:
            self.stride(i)

    @ti.func
    def stride(self, i):
        """The second half kick of a step, the first of the next, and its drift."""
        time_step = self.control.time_step[None]
        force, torque = self.forces.gather(i)
        if ti.static(self.lags):
            self.expansions.update(i)
        self.verlet.stride(i, force, torque, time_step)

    # -- the drivers -----------------------------------------------------------------------------

    @ti.kernel
    def serial(self, steps: ti.i32) -> ti.i32:
        """At most ``steps`` steps in one task; returns how many were made before the host is
        needed."""
        made, time_step = 0, self.control.time_step[None]
        while made < steps and self.control.calls_host() == 0:
            self.surface()
            self.settle_expansions()
            for p in range(self.contacts.start[self.particles.count]):
                self.evaluate_contact(p, time_step)
            self.settle_boundaries()
            self.carry_boundaries()
            for i in range(self.particles.count):
                self.move(i)
            made += 1
        return made

    @ti.kernel
    def parallel(self) -> ti.i32:
        """One step in parallel loops, after the surface's; returns whether the host is needed."""
        for p in range(self.contacts.start[self.particles.count]):
            self.evaluate_contact(p, self.control.time_step[None])
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.settle_boundaries()
            self.carry_boundaries()
        for i in range(self.particles.count):
            self.move(i)
        return self.control.calls_host()

    @ti.kernel
    def begin_passes(self):
        """What comes before the passes of the expansions."""
        self.surface()
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
        """The share of one member: its particles, and the contacts that these look for."""
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
            for p in range(first, last):
                self.evaluate_contact(p, time_step)
            if self.meeting.last_to_arrive():
                self.settle_boundaries()
                self.carry_boundaries()
                self.meeting.release()
            met += 1
            self.meeting.wait(met)
            for i in range(low, high):
                self.move(i)
            made += 1
            if self.meeting.last_to_arrive():
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
            if ti.static(self.sleeps):
                if self.sleep.is_awake(i):
                    self.set_out(i)
            else:
                self.set_out(i)
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.carry_boundaries()

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
            self.surface()

    @ti.kernel
    def _evaluate(self, time_step: ti.f64):
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.settle_expansions()
        for p in range(self.contacts.start[self.particles.count]):
            self.evaluate_contact(p, time_step)
        for i in range(self.particles.count):
            force, torque = self.forces.gather(i)
            if ti.static(self.lags):
                self.expansions.update(i)
            if ti.static(self.sleeps):
                self.sleep.rouse(i)
            self.particles.load[i].force = force
            self.particles.load[i].torque = torque

    @ti.kernel
    def finish(self):
        """Second half kick, with the forces of the present state."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.settle_boundaries()
        for i in range(self.particles.count):
            if ti.static(self.sleeps):
                if self.sleep.is_awake(i):
                    self.kick(i)
            else:
                self.kick(i)

    @ti.func
    def set_out(self, i):
        """The first half kick of a run, and the drift."""
        self.kick(i)
        self.verlet.drift(i, self.control.time_step[None])

    @ti.func
    def kick(self, i):
        """Half a kick, by the load on record."""
        load = self.particles.load[i]
        self.verlet.kick(i, load.force, load.torque, self.control.time_step[None])

    @ti.kernel
    def note_pushes(self):
        """The boundaries' forces of a state that no step has led to."""
        if ti.static(self.moves):
            for b in range(self.boundaries.count):
                self.boundaries.motion[b].push = self.boundaries.push_on(b, self.contacts)
