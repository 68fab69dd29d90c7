"""Where the energy of a simulation is, and whether all of it is accounted for."""

from typing import Any

import numpy as np

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART
from taichi_dem.forces import Forces
from taichi_dem.types import ti


@ti.data_oriented
class Energy:
    """Sums over particles and contacts, each in one serial task: the same bits for any threads."""

    def __init__(self, forces: Forces, exchange: Any, boundaries: Boundaries):
        self.forces, self.contacts, self.particles = forces, forces.contacts, forces.particles
        self.exchange, self.coupled = exchange, exchange is not None
        self.boundaries = boundaries

    def parts(self, gravity: np.ndarray, lost_before: float, in_dents: float) -> dict[str, float]:
        """J, by part; ``lost_before`` is what :meth:`loss` has taken so far, ``in_dents`` what the
        ground holds where nobody presses."""
        sums = np.zeros(8)
        self._sum(sums, gravity)
        sums[5] += in_dents
        motion = [self.boundaries.motion[b] for b in range(self.boundaries.count)]
        plates = sum(0.5 * m.speed**2 / m.inverse_mass for m in motion if m.inverse_mass > 0)
        parts = {
            "kinetic": sums[0] + plates,
            "gravity": sums[1],
            "normal": sums[2],
            "tangential": sums[3],
            "rolling": sums[4],
            "substrate": sums[5],
            "expansion": sums[7],
            "dissipated": lost_before + sums[6] - sums[3] - sums[4],
            "external_work": float(sum(m.work for m in motion)),
        }
        if self.forces.plastic:  # all work of the contacts is booked, what they hold included
            parts["dissipated"] -= sums[2] + sums[5] + sums[7]
        there = {
            "tangential": self.forces.rubs,
            "rolling": self.forces.winds,
            "substrate": self.coupled,
            "expansion": self.forces.spreads,
            "dissipated": self.contacts.dissipates,
        }
        return {name: value for name, value in parts.items() if there.get(name, True)}

    @ti.kernel
    def _sum(self, sums: ti.types.ndarray(), gravity: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for row in range(self.particles.count):
            i = self.particles.index_of[row]
            body, omega = self.particles.body[i], self.particles.spin[i].omega
            mass = 1.0 / body.inverse_mass
            inertia = 0.4 * mass * body.radius * body.radius
            sums[0] += 0.5 * mass * body.velocity.dot(body.velocity)
            sums[0] += 0.5 * inertia * omega.dot(omega)
            for axis in ti.static(range(3)):
                sums[1] -= mass * gravity[axis] * body.position[axis]
            if ti.static(self.coupled):
                sums[5] += self.exchange.stored(i)
        ti.loop_config(serialize=True)
        for p in range(self.contacts.start[self.particles.count]):
            if self.contacts.touching[p] != APART:
                stored = self.forces.stored(p)
                for part in ti.static(range(3)):
                    sums[2 + part] += stored[part]
                if ti.static(self.forces.spreads):
                    sums[7] += self.forces.expansions.energy(p)
            if ti.static(self.contacts.dissipates):
                sums[6] += self.contacts.lost[p]

    @ti.kernel
    def loss(self, take: ti.i32) -> ti.f64:
        """What has gone into the contacts' dashpots, friction and the like; to ``take`` it off
        them is for when the list is made anew."""
        total = ti.cast(0.0, ti.f64)
        ti.loop_config(serialize=True)
        for p in range(self.contacts.start[self.particles.count]):
            if ti.static(self.contacts.dissipates):
                total += self.contacts.lost[p]
                if take != 0:
                    self.contacts.lost[p] = 0.0
        return total
