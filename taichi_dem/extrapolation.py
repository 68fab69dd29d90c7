"""The coupled ground between two exchanges, where it is solved for every few steps only.

What an exchange finds of a contact - expansion e, slope, stored energy - goes on at the rate of the
last two, and the contact's own law is evaluated with that at every step:

    e(t) = e_n + (t - t_n) (e_n - e_(n-1))/(t_n - t_(n-1)).

A contact that carried no load at one of the two has no rate yet: what was found is held.

One collective mode, with c = K C for contacts of stiffness K and mass m, swings with
w^2 = w_H^2/(1 + c), w_H^2 = K/m.  Over T between exchanges the line is late by
-s (s + T)/2 e'' + s (s + T) (2 s + T)/6 e''', s from 0 to T.  The first shifts the frequency; the
second, with e = -c/(1 + c) times the overlap, takes the share

    2 pi/3 (w_H T)^3 c/(1 + c)^2

of the energy in a period 2 pi/w_H, at most pi/6 (w_H T)^3; to modes of c < 0, in which neighbours
move against each other, it gives.  So no T is stable for those without damping, but what they get
falls by the cube: the phase w_H T is watched at every exchange.
"""

from typing import Any

from taichi_dem.doubts import STEEP, STEEP_PHASE, UNSEEN
from taichi_dem.types import real, ti, vec2

LOST_PHASE = 1.0  # rad: a third of its energy in each of its periods
NEVER = -1  # step of an exchange that has not been

vec4 = ti.types.vector(4, real)


def course_members() -> dict[str, Any]:
    """What the ground keeps of a contact for this.

    last      expansion (m), slope (2) and stored energy (J) of the last exchange
    rate      of these, per step
    solved    elastic force of the last exchange, N
    bearing   how many exchanges in a row have found a load on it, up to two
    """
    return {"last": vec4, "rate": vec4, "solved": real, "bearing": ti.i32}


@ti.data_oriented
class Extrapolation:
    """Carries the ground of ``exchange`` on over as many steps as there are to be between two.

    every   so many
    since   the step of the last exchange
    next    that of the next, a multiple of ``every`` except at a start: no result depends on how
            runs are cut
    phase   the largest w_H T at the last exchange, rad
    largest  that of all
    """

    def __init__(self, exchange: Any, builder: "ti.FieldsBuilder"):
        self.exchange, self.control = exchange, exchange.control
        self.every, self.since, self.next = (ti.field(ti.i64) for _ in range(3))
        self.phase, self.largest = ti.field(real), ti.field(real)
        builder.place(self.every, self.since, self.next, self.phase, self.largest)

    def forget(self) -> None:
        """Have the present step solved for, and for a rate the next one."""
        self.since[None], self.next[None], self.phase[None] = NEVER, 0, 0.0

    @property
    def lost(self) -> bool:
        """Whether a contact has swung too far between two exchanges."""
        return bool(self.phase[None] > LOST_PHASE)

    def reason(self) -> str:
        """The words for a run that is stopped."""
        fewer = max(1, int(STEEP_PHASE / self.phase[None] * self.every[None]))
        return (
            f"a contact with the substrate turns by {self.phase[None]:.3g} rad of its own "
            f"oscillation between two exchanges, more than {LOST_PHASE:g}: what is extrapolated so "
            f"far feeds motions of neighbours against each other. Try exchange_every = {fewer} or "
            "a smaller time step"
        )

    @ti.func
    def due(self):
        """Whether the present step is to be solved for."""
        return self.control.step[None] >= self.next[None]

    @ti.func
    def note(self, k, i):
        """Keep what the exchange found for member ``k``, particle ``i``; in one thread."""
        ground, body = self.exchange.ground[i], self.exchange.particles.body[i]
        now = vec4(ground.expansion, ground.slope[0], ground.slope[1], ground.stored)
        ground.bearing = ti.select(ground.force != 0.0, ti.min(ground.bearing + 1, 2), 0)
        ground.rate = vec4(0.0)
        if ground.bearing == 2:
            steps = ti.cast(self.control.step[None] - self.since[None], real)
            ground.rate = (now - ground.last) / ti.max(steps, 1.0)
        ground.last, ground.solved = now, ground.force
        if ground.force != 0.0:
            overlap = self.exchange.overlap(i) + ground.expansion
            # Adhesive laws grow stiff without bound where they let go: that is no oscillation.
            tangent = self.exchange.law(k, ti.max(overlap, 0.0))[1]
            time = ti.cast(self.every[None], real) * self.control.time_step[None]
            phase = time * ti.sqrt(tangent * body.inverse_mass)
            self.phase[None] = ti.max(self.phase[None], phase)
            if phase > STEEP_PHASE:
                ground.touched = self.exchange.doubts.note(STEEP, ground.touched)
        self.exchange.ground[i] = ground

    @ti.func
    def finish(self) -> ti.i32:
        """After all are noted; returns 0 if a contact swings too far until the next exchange."""
        self.largest[None] = ti.max(self.largest[None], self.phase[None])
        step, every = self.control.step[None], self.every[None]
        self.next[None] = ti.select(self.since[None] == NEVER, 1, every - step % every) + step
        self.since[None] = step
        return ti.cast(self.phase[None] <= LOST_PHASE, ti.i32)

    @ti.func
    def carry(self, p, contacts: ti.template()):
        """The ground under contact ``p`` at a step that is not solved for."""
        if self.control.step[None] != self.since[None]:
            i, history = contacts.ends[p].i, self.exchange.History()
            ground = self.exchange.ground[i]
            steps = ti.cast(self.control.step[None] - self.since[None], real)
            now = ground.last + steps * ground.rate
            overlap = self.exchange.overlap(i) + now[0]
            if ti.static(self.exchange.has_history):
                history = contacts.history[p]
            if ti.static(self.exchange.adhesion):
                self.exchange.hold(i, overlap, history, contacts.touching[p])
            self.exchange.ground[i].expansion = now[0]
            self.exchange.ground[i].slope = vec2(now[1], now[2])
            self.exchange.ground[i].stored = now[3]
            self.exchange.ground[i].force = self.exchange.elastic(i, overlap, history)[0]
            if overlap > 0.0 and ground.age == 0:
                touched = self.exchange.doubts.note(UNSEEN, ground.touched)
                self.exchange.ground[i].touched = touched
