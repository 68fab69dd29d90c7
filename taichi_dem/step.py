"""A step, part by part: what every driver calls, in an order that all of them keep.

Between two forces it is: surface, contacts, boundaries, particles.  A run begins with a half kick
and a drift and ends with forces and a half kick.
"""

from typing import Any

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART
from taichi_dem.control import STALE, Control
from taichi_dem.expansion_newton import DONE
from taichi_dem.forces import Forces
from taichi_dem.integrate import Verlet
from taichi_dem.types import ti


@ti.data_oriented
class Step:
    """Functions for kernels; ``exchange`` is the coupled substrate or None, of which nothing is
    compiled here if it is always solved for on the host; ``sleep`` says who sleeps, or is None.

    (A loop at the root of a kernel runs in parallel, also one that comes from a function: what must
    be serial stands inside something else.)
    """

    def __init__(
        self,
        forces: Forces,
        verlet: Verlet,
        boundaries: Boundaries,
        exchange: Any,
        control: Control,
        sleep: Any = None,
    ):
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

    @ti.func
    def load(self, i):
        """Put the force and torque on particle ``i`` on record."""
        force, torque = self.forces.gather(i)
        if ti.static(self.lags):
            self.expansions.update(i)
        if ti.static(self.sleeps):
            self.sleep.rouse(i)
        self.particles.load[i].force = force
        self.particles.load[i].torque = torque

    @ti.func
    def set_out(self, i):
        """The first half kick of a run, and the drift, unless particle ``i`` sleeps."""
        if ti.static(self.sleeps):
            if self.sleep.is_awake(i):
                self.kick(i)
                self.verlet.drift(i, self.control.time_step[None])
        else:
            self.kick(i)
            self.verlet.drift(i, self.control.time_step[None])

    @ti.func
    def arrive(self, i):
        """The last half kick of a run, unless particle ``i`` sleeps."""
        if ti.static(self.sleeps):
            if self.sleep.is_awake(i):
                self.kick(i)
        else:
            self.kick(i)

    @ti.func
    def kick(self, i):
        """Half a kick, by the load on record."""
        load = self.particles.load[i]
        self.verlet.kick(i, load.force, load.torque, self.control.time_step[None])
