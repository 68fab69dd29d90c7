"""Clusters at rest that sleep until they are touched: no forces and no motion for them meanwhile.

Every few steps the spheres that touch each other are put together into clusters.  A cluster falls
asleep when each of its spheres is still: what it has in motion is nothing beside what its contacts
hold, and the forces and torques on it are in balance (so a sphere that turns round is not taken for
one at rest).  Contacts of two sleepers, or of one with a wall that cannot move, keep their forces
and are not looked at.

A sphere wakes in the very step in which somebody awake, or a wall that can move, touches it: its
other contacts have not changed, so what they keep is right.  In the next step it is awake for its
neighbours.  So waking goes from sphere to sphere, one at each step, which no wave that the contacts
carry can overtake: nothing has happened to those who still sleep.
"""

from typing import Any

import numpy as np

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART, FIRST_FACE
from taichi_dem.particles import Particles
from taichi_dem.types import ti, vec3

LOOK_EVERY = 200  # steps
REST = 1e-4  # forces out of balance over forces; squared, energy of motion over that of contacts


@ti.data_oriented
class Sleep:
    """Who sleeps.

    asleep   by particle
    touched  by particle, whether somebody awake has touched it in this step
    next     the step of the next look, a multiple of LOOK_EVERY: however runs are cut
    """

    def __init__(self, particles: Particles, boundaries: Boundaries, builder: "ti.FieldsBuilder"):
        self.particles, self.boundaries = particles, boundaries
        self.moves = boundaries.any_moves
        self.asleep, self._sorted, self.touched = (ti.field(ti.i32) for _ in range(3))
        for field in (self.asleep, self._sorted, self.touched):
            builder.dense(ti.i, particles.count).place(field)
        self.next = LOOK_EVERY

    def wake_all(self, step: int) -> None:
        """As for a state at ``step`` that no step has led to."""
        self.asleep.fill(0)
        self.touched.fill(0)
        self._look_after(step)

    def _look_after(self, step: int) -> None:
        self.next = (step // LOOK_EVERY + 1) * LOOK_EVERY

    @ti.kernel
    def reorder(self, order: ti.template()):
        """Follow the particles into the order of the cells."""
        for s in range(self.particles.count):
            self._sorted[s] = self.asleep[order[s]]
        for s in range(self.particles.count):
            self.asleep[s] = self._sorted[s]

    def read(self) -> np.ndarray:
        """Who sleeps, (n,) in the user's order."""
        now = np.empty(self.particles.count, bool)
        now[self.particles.spin.id.to_numpy()] = self.asleep.to_numpy() != 0
        return now

    # -- falling asleep --------------------------------------------------------------------------

    def look(self, step: int, forces: Any) -> float:
        """Let clusters at rest sleep; returns what was in their motion, J."""
        from scipy.sparse import coo_array  # slow to import, and seldom needed
        from scipy.sparse.csgraph import connected_components

        self._look_after(step)
        n, contacts = self.particles.count, max(forces.contacts.count(), 1)
        still, pairs = np.zeros(n, np.int32), np.full((2, contacts), -1, np.int32)
        self._survey(forces, still, pairs[0], pairs[1])
        joined = pairs[:, pairs[0] >= 0]
        links = coo_array((np.ones(joined.shape[1], bool), (joined[0], joined[1])), shape=(n, n))
        number, cluster = connected_components(links, directed=False)
        restless = np.zeros(number, bool)
        restless[cluster[still == 0]] = True
        return self._put_to_sleep(np.ascontiguousarray(~restless[cluster], np.int32))

    @ti.kernel
    def _survey(
        self,
        forces: ti.template(),
        still: ti.types.ndarray(),
        first: ti.types.ndarray(),
        second: ti.types.ndarray(),
    ):
        """Who is still, and which contacts join two spheres (-1 stays where they do not)."""
        for i in range(self.particles.count):
            weight = forces.control.gravity[0] / self.particles.body[i].inverse_mass
            still[i] = ti.cast(self.is_still(i, forces, weight), ti.i32)
        for p in range(forces.contacts.start[self.particles.count]):
            if forces.contacts.ends[p].j >= 0 and forces.contacts.touching[p] != APART:
                first[p], second[p] = forces.contacts.ends[p].i, forces.contacts.ends[p].j

    @ti.func
    def is_still(self, i, forces: ti.template(), weight):
        """Whether particle ``i`` is at rest, and stays so."""
        body, spin = self.particles.body[i], self.particles.spin[i]
        force, torque = forces.gather(i)
        pressing, held, free = weight.norm(), 0.0, True
        for q in range(forces.contacts.incidence_start[i], forces.contacts.incidence_start[i + 1]):
            p = forces.contacts.incidence[q] >> 1
            if forces.contacts.touching[p] != APART:
                push = forces.contacts.result[p].force.norm()
                pressing += push
                held += push * ti.abs(2.0 * forces.contacts.result[p].half_overlap)
                free &= not self.moves_against(forces.contacts.ends[p].j)
        motion = body.velocity.dot(body.velocity)
        motion += 0.4 * body.radius * body.radius * spin.omega.dot(spin.omega)
        slow = 0.5 * motion / body.inverse_mass <= REST * REST * held
        balanced = (force + weight).norm() <= REST * pressing
        return free & slow & balanced & (torque.norm() <= REST * pressing * body.radius)

    @ti.kernel
    def _put_to_sleep(self, resting: ti.types.ndarray()) -> ti.f64:
        lost = ti.cast(0.0, ti.f64)
        ti.loop_config(serialize=True)
        for row in range(self.particles.count):
            i = self.particles.index_of[row]
            if resting[i] != 0 and self.asleep[i] == 0:
                body, omega = self.particles.body[i], self.particles.spin[i].omega
                turning = 0.4 * body.radius * body.radius * omega.dot(omega)
                lost += 0.5 * (body.velocity.dot(body.velocity) + turning) / body.inverse_mass
                self.particles.body[i].velocity = vec3(0.0)
                self.particles.spin[i].omega = vec3(0.0)
                self.asleep[i] = 1
        return lost

    # -- inside the step's kernel ----------------------------------------------------------------

    @ti.func
    def moves_against(self, j):
        """Whether body ``j`` is a wall that can move."""
        found = False
        if ti.static(self.moves):
            if j <= FIRST_FACE:
                b = self.boundaries.face[FIRST_FACE - j].boundary
                found = self.boundaries.motion[b].moves != 0
        return found

    @ti.func
    def is_awake(self, i):
        return self.asleep[i] == 0

    @ti.func
    def concerns(self, i, j):
        """Whether somebody awake takes part in the contact of particle ``i`` with body ``j``."""
        found = self.asleep[i] == 0
        if j >= 0:
            found |= self.asleep[j] == 0
        else:
            found |= self.moves_against(j)
        return found

    @ti.func
    def touch(self, i, j):
        """Somebody awake takes part in this contact, which is made: the other one wakes.  (All who
        find that write the same.)"""
        if self.asleep[i] != 0:
            self.touched[i] = 1
        if j >= 0:
            if self.asleep[j] != 0:
                self.touched[j] = 1

    @ti.func
    def rouse(self, i):
        """After the contacts: whether particle ``i`` is awake, now."""
        if self.touched[i] != 0:
            self.touched[i], self.asleep[i] = 0, 0
        return self.asleep[i] == 0
