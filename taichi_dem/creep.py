"""Ground that creeps under its contacts: what it remembers of them, and the solve with that.

The standard linear solid of :mod:`halfspace.viscoelastic`, under Hertz contacts. With the memory s
of a contact, sigma the ground's share of its compliance and G the inverse of Hertz's law H,

    delta = d + C (f + c s),    f = H(d) - sigma c s >= 0,    ds/dt = (f - s)/tau.

To the rest of a step this is elastic contact at the overlap G(f): what the contact's own dent has
crept counts as the surface having sunk. Where f = 0 the sphere hovers over a dent that recovers, by
G(sigma c s) - d.

A sphere above the undeformed surface has left its dent, which recovers where it is: a contact that
bears no force. One that comes down within the dent's contact radius is over it again and takes its
memory up; farther away, the dent is a point to it, as contacts are to each other.

Energy is stored in the springs of the solid, those of the contacts included,

    1/2 f.C f + c/2 s.C s + sum_k [E(d) - sigma c s d + sigma c/(1 + sigma c) E*((1 + sigma c) s)],

E and E* the integrals of H and G, d = G(f + sigma c s); and what is lost in its dashpot,
`c tau s'.C s' + sum_k sigma c [d - G((1 + sigma c) s)] s'`, is never negative.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import halfspace
from taichi_dem.periodic import nearest_image
from taichi_dem.pressed import Pressed
from taichi_dem.substrate import Relaxation


class Creep:
    """The memory of a ``ground`` with ``relaxation``, by sphere, and what follows from it.

    Dents that have been left are kept, by ids below zero, while they are more than ``residual`` of
    what was the deepest when they were left."""

    def __init__(
        self, ground: halfspace.HalfSpace, relaxation: Relaxation, residual: float = 1e-6
    ) -> None:
        given = relaxation.relaxed_modulus, relaxation.retardation_time
        self._soil = halfspace.Viscoelastic(ground, *given)
        self._residual = residual
        self.forget()

    def forget(self) -> None:
        """As if nothing had ever pressed."""
        self._remember(np.empty(0, np.int64), np.empty(0))
        # At the last step, and the force that each had then.
        self._spheres, self._force = Pressed.nobody(), np.empty(0)
        self._dents, self._faintest = Pressed.nobody(), np.empty(0)
        self._left = 0  # dents so far

    def save(self) -> dict[str, Any]:
        """What :meth:`restore` takes."""
        kept = "_spheres", "_force", "_dents", "_faintest", "_left"
        return {**self._soil.save(), **{name: getattr(self, name) for name in kept}}

    def restore(self, saved: dict[str, Any]) -> None:
        """Take up the memory that :meth:`save` gave."""
        for name, value in saved.items():
            if name.startswith("_"):
                setattr(self, name, value)
        self._remember(saved["ids"], saved["memory"])

    # -- a step ----------------------------------------------------------------------------------

    def solve(
        self,
        spheres: Pressed,
        overlap: np.ndarray,
        expected: np.ndarray,
        time_step: float,
        plan: halfspace.Plan,
    ) -> halfspace.Equilibrium:
        """Forces after a step of ``time_step``, s, in which they act; the overlaps that come back
        are those of elastic contacts. ``expected`` (n,) m: a guess of what the surface has sunk."""
        self._leave(spheres, overlap)
        below, over = self._meet(spheres, overlap)
        guess = overlap - np.where(below, 0.0, expected)
        # Who is in the air over a dent cannot touch, and must not stand in the point that it is.
        there = np.flatnonzero(~over)
        everyone = spheres.those(there).and_those(self._dents)
        beyond = -self._dents.radius  # out of touch
        guess, delta = (np.concatenate([each[there], beyond]) for each in (guess, overlap))
        held = self._held(everyone)
        start = np.where(guess > 0, 0.0, guess) + everyone.overlap(everyone.force(guess) + held)
        try:
            found = self._soil.solve(
                everyone.place,
                delta,
                everyone.law,
                time_step,
                ids=everyone.ids,
                share=self._share(everyone),
                residual=self._residual,
                start=start,
                plan=plan,
            )
        except halfspace.NotConverged as error:
            nearest = _among(error.state, there, overlap)
            raise halfspace.NotConverged(str(error), nearest) from None
        return _among(found, there, overlap)

    def accept(
        self, spheres: Pressed, found: halfspace.Equilibrium, time_step: float
    ) -> np.ndarray:
        """Let the step pass; returns the overlaps (n,) m of elastic contacts with the same
        forces."""
        self._pass(spheres, found.force, time_step)
        hovers = found.overlap - spheres.overlap(self._held(spheres))
        return np.where(found.force > 0, spheres.overlap(found.force), np.minimum(hovers, 0.0))

    def wait(self, time_step: float) -> None:
        """Let a step pass without a sphere near the ground."""
        if len(self._spheres.ids) or len(self._dents.ids):
            nobody, nothing = Pressed.nobody(), np.empty(0)
            self._leave(nobody, nothing)
            self._pass(nobody, nothing, time_step)

    def _pass(self, spheres: Pressed, force: np.ndarray, time_step: float) -> None:
        self._soil.advance(time_step, force, spheres.ids)
        self._spheres, self._force = spheres, force
        self._keep_dents(self._soil.memory(self._dents.ids) > self._faintest)

    # -- dents -----------------------------------------------------------------------------------

    def _leave(self, spheres: Pressed, overlap: np.ndarray) -> None:
        """Who has gone from the surface since the last step leaves a dent where it was then."""
        before = self._spheres
        gone = ~np.isin(before.ids, spheres.ids[overlap > 0])
        still_near = np.isin(before.ids, spheres.ids)
        gone &= (self._force == 0) | ~still_near  # a surface that bulges touches also above
        memory = self._soil.memory(before.ids)
        gone &= memory > 0
        if not gone.any():
            return
        dents = before.those(gone)._replace(ids=-1 - self._left - np.arange(gone.sum()))
        self._left += len(dents.ids)
        ids, memories = self._memory_but(before.ids[gone])
        faintest = self._residual * max(memory.max(), memories.max(initial=0.0))
        self._remember(np.append(ids, dents.ids), np.append(memories, memory[gone]))
        self._faintest = np.append(self._faintest, np.full(len(dents.ids), faintest))
        self._dents = self._dents.and_those(dents)
        self._keep_dents(self._soil.memory(self._dents.ids) > self._faintest)

    def _meet(self, spheres: Pressed, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Who comes down over a dent takes it up; returns who did so, and who is in the air over
        one, (n,)."""
        below, dents = np.zeros(len(overlap), bool), self._dents
        if not len(dents.ids):
            return below, below
        apart = (spheres.place - dents.place[:, None]).reshape(-1, 2)
        near = np.hypot(*nearest_image(apart, self._soil.ground.period).T)
        near = near.reshape(len(dents.ids), len(overlap))
        within = near**2 < (dents.radius * self.depth(dents, np.zeros(len(near))))[:, None]
        over = (within & (overlap <= 0)).any(axis=0) & (self._soil.memory(spheres.ids) == 0)
        near[~within | (overlap <= 0)] = np.inf
        met = np.isfinite(near).any(axis=1)
        for dent in np.flatnonzero(met):
            nearest = near[dent].argmin()
            below[nearest] = True
            self._hand_over(dents.ids[[dent]], spheres.ids[[nearest]])
        self._keep_dents(~met)
        return below, over

    def _hand_over(self, dent: np.ndarray, sphere: np.ndarray) -> None:
        """The memory of one to the other."""
        total = self._soil.memory(dent) + self._soil.memory(sphere)
        ids, memory = self._memory_but(np.append(dent, sphere))
        self._remember(np.append(ids, sphere), np.append(memory, total))

    def _keep_dents(self, kept: np.ndarray) -> None:
        if not kept.all():
            self._remember(*self._memory_but(self._dents.ids[~kept]))
            self._dents, self._faintest = self._dents.those(kept), self._faintest[kept]

    def _memory_but(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        saved = self._soil.save()
        others = ~np.isin(saved["ids"], ids)
        return saved["ids"][others], saved["memory"][others]

    def _remember(self, ids: np.ndarray, memory: np.ndarray) -> None:
        self._soil.restore({"ids": ids, "memory": memory})

    # -- what there is now -----------------------------------------------------------------------

    def load(self, ids: np.ndarray, force: np.ndarray) -> np.ndarray:
        """The forces (n,) N under which an elastic ground would have the dents that this has."""
        return force + self._soil.creep * self._soil.memory(ids)

    def depth(self, spheres: Pressed, force: np.ndarray) -> np.ndarray:
        """d (n,) m: how deep the contacts are, their own creep included."""
        return spheres.overlap(force + self._held(spheres))

    def dents(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of all that is remembered of others than these: place (m, 2) m, load (m,) N and contact
        radius (m,) m."""
        spheres = self._spheres.those(~np.isin(self._spheres.ids, ids))
        dents = spheres.those(self._soil.memory(spheres.ids) > 0).and_those(self._dents)
        nothing = np.zeros(len(dents.ids))
        radius = np.sqrt(dents.radius * self.depth(dents, nothing))
        return dents.place, self.load(dents.ids, nothing), radius

    def stored(
        self, spheres: Pressed, force: np.ndarray, plan: halfspace.Plan
    ) -> tuple[np.ndarray, float]:
        """By contact (n,) J, what is stored beside what an elastic contact would hold; and what is
        in the dents that spheres have left. ``plan``: that of the last step."""
        n, everyone = len(force), spheres.and_those(self._dents)
        force = np.append(force, np.zeros(len(self._dents.ids)))
        c, s = self._soil.creep, self._soil.memory(everyone.ids)
        if not np.array_equal(plan.x, everyone.place):  # who looks must leave it as it is
            plan = self._soil.plan(everyone.place)
        coupled = plan.energy(force) + c * plan.energy(s)
        own, depth = c * self._share(everyone), self.depth(everyone, force)
        local = everyone.energy(depth) - own * s * depth
        local += own / (1 + own) * everyone.complement((1 + own) * s)
        total = coupled + local - everyone.energy(everyone.overlap(force))
        return total[:n], float(total[n:].sum())

    def _share(self, spheres: Pressed) -> np.ndarray:
        """The ground's share of the contacts' compliance."""
        return np.minimum(spheres.modulus / self._soil.ground.modulus, 1.0)

    def _held(self, spheres: Pressed) -> np.ndarray:
        """sigma c s (n,) N: what the memory takes off a contact's force."""
        return self._share(spheres) * self._soil.creep * self._soil.memory(spheres.ids)


def _among(
    found: halfspace.Equilibrium, there: np.ndarray, overlap: np.ndarray
) -> halfspace.Equilibrium:
    """What was found for the spheres ``there``, the first ones, and for all others over a plane."""

    def spread(values: np.ndarray, rest: Any = 0.0) -> np.ndarray:
        each = np.empty((len(overlap), *values.shape[1:]))
        each[:] = rest
        each[there] = values[: len(there)]
        return each

    return replace(
        found,
        force=spread(found.force),
        overlap=spread(found.overlap, overlap),
        displacement=spread(found.displacement),
        slope=spread(found.slope),
        tangent=spread(found.tangent),
        shift=spread(found.shift),
    )
