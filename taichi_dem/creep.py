"""Ground that creeps under its contacts: what it remembers of them, and the solve with that.

The standard linear solid of :mod:`halfspace.viscoelastic`, under Hertz contacts. With the memory s
of a contact, sigma the ground's share of its compliance and G the inverse of Hertz's law H,

    delta = d + C (f + c s),    f = H(d) - sigma c s >= 0,    ds/dt = (f - s)/tau.

To the rest of a step this is elastic contact at the overlap G(f): what the contact's own dent has
crept counts as the surface having sunk. Where f = 0 the sphere hovers over a dent that recovers, by
G(sigma c s) - d.

Energy is stored in the springs of the solid, those of the contacts included,

    1/2 f.C f + c/2 s.C s + sum_k [E(d) - sigma c s d + sigma c/(1 + sigma c) E*((1 + sigma c) s)],

E and E* the integrals of H and G, d = G(f + sigma c s); and what is lost in its dashpot,
`c tau s'.C s' + sum_k sigma c [d - G((1 + sigma c) s)] s'`, is never negative.
"""

from typing import Any, NamedTuple

import numpy as np

import halfspace
from taichi_dem.substrate import Relaxation


class Pressed(NamedTuple):
    """Spheres of ``radius`` (n,) m and contact ``modulus`` (n,) E*, Pa, by ``ids`` (n,)."""

    ids: np.ndarray
    radius: np.ndarray
    modulus: np.ndarray

    def force(self, overlap: np.ndarray) -> np.ndarray:
        """H, N."""
        return self._strength * np.maximum(overlap, 0.0) ** 1.5

    def law(self, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """H, N, and its derivative, N/m."""
        return self.force(overlap), 1.5 * self._strength * np.sqrt(np.maximum(overlap, 0.0))

    def overlap(self, force: np.ndarray) -> np.ndarray:
        """G, m."""
        return np.cbrt((force / self._strength) ** 2)

    def energy(self, overlap: np.ndarray) -> np.ndarray:
        """E, J."""
        return 0.4 * self.force(overlap) * overlap

    def complement(self, force: np.ndarray) -> np.ndarray:
        """E*, J."""
        return 0.6 * force * self.overlap(force)

    @property
    def _strength(self) -> np.ndarray:
        return 4 / 3 * self.modulus * np.sqrt(self.radius)


class Creep:
    """The memory of a ``ground`` with ``relaxation``, by sphere, and what follows from it."""

    def __init__(self, ground: halfspace.HalfSpace, relaxation: Relaxation):
        given = relaxation.relaxed_modulus, relaxation.retardation_time
        self._soil = halfspace.Viscoelastic(ground, *given)

    def forget(self) -> None:
        """As if nothing had ever pressed."""
        self.restore({"ids": np.empty(0, np.int64), "memory": np.empty(0)})

    def save(self) -> dict[str, Any]:
        """The memory, for :meth:`restore`."""
        return self._soil.save()

    def restore(self, saved: dict[str, Any]) -> None:
        """Take up the memory that :meth:`save` gave."""
        self._soil.restore(saved)

    def solve(
        self,
        spheres: Pressed,
        place: np.ndarray,
        overlap: np.ndarray,
        expected: np.ndarray,
        time_step: float,
        residual: float,
        plan: halfspace.Plan,
    ) -> halfspace.Equilibrium:
        """Forces after a step of ``time_step``, s, in which they act; the overlaps that come back
        are those of elastic contacts. ``expected`` (n,) m: a guess of what the surface has sunk."""
        held = self._held(spheres)
        guess = overlap - expected
        start = np.where(guess > 0, 0.0, guess) + spheres.overlap(spheres.force(guess) + held)
        return self._soil.solve(
            place,
            overlap,
            spheres.law,
            time_step,
            ids=spheres.ids,
            share=self._share(spheres),
            residual=residual,
            start=start,
            plan=plan,
        )

    def accept(
        self,
        spheres: Pressed,
        overlap: np.ndarray,
        found: halfspace.Equilibrium,
        time_step: float,
    ) -> np.ndarray:
        """Let the step pass; returns the overlaps (n,) m of elastic contacts with the same forces.

        A sphere that has left the undeformed surface leaves its dent, which is forgotten."""
        self._soil.advance(time_step, found.force, spheres.ids)
        kept = (found.force > 0) | (overlap > 0)
        ids = spheres.ids[kept]
        self.restore({"ids": ids, "memory": self._soil.memory(ids)})
        hovers = found.overlap - spheres.overlap(self._held(spheres))
        return np.where(found.force > 0, spheres.overlap(found.force), np.minimum(hovers, 0.0))

    def load(self, ids: np.ndarray, force: np.ndarray) -> np.ndarray:
        """The forces (n,) N under which an elastic ground would have the dents that this has."""
        return force + self._soil.creep * self._soil.memory(ids)

    def depth(self, spheres: Pressed, force: np.ndarray) -> np.ndarray:
        """d (n,) m: how deep the contacts are, their own creep included."""
        return spheres.overlap(force + self._held(spheres))

    def stored(self, spheres: Pressed, force: np.ndarray, plan: halfspace.Plan) -> np.ndarray:
        """By contact (n,) J, what is stored beside what an elastic contact would hold."""
        c, s = self._soil.creep, self._soil.memory(spheres.ids)
        coupled = plan.energy(force) + c * plan.energy(s)
        own, depth = c * self._share(spheres), self.depth(spheres, force)
        local = spheres.energy(depth) - own * s * depth
        local += own / (1 + own) * spheres.complement((1 + own) * s)
        return coupled + local - spheres.energy(spheres.overlap(force))

    def _share(self, spheres: Pressed) -> np.ndarray:
        """The ground's share of the contacts' compliance."""
        return np.minimum(spheres.modulus / self._soil.ground.modulus, 1.0)

    def _held(self, spheres: Pressed) -> np.ndarray:
        """sigma c s (n,) N: what the memory takes off a contact's force."""
        return self._share(spheres) * self._soil.creep * self._soil.memory(spheres.ids)
