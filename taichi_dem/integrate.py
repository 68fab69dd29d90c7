"""Velocity Verlet: half kick, drift, forces, half kick.

Source: L. Verlet, Phys. Rev. 159 (1967) 98; W. C. Swope et al., J. Chem. Phys. 76 (1982) 637.
Damping sees the velocities at the half step.  Between two forces a particle takes two half kicks
and a drift; they are kept apart so that a run gives the same bits however it is cut into pieces.
"""

from taichi_dem.control import STALE, Control
from taichi_dem.particles import Particles
from taichi_dem.types import ti


@ti.data_oriented
class Verlet:
    """Moves ``particles``; they spin only if something can turn them."""

    def __init__(self, particles: Particles, control: Control, rotates: bool):
        self.particles, self.control, self.rotates = particles, control, rotates

    @ti.func
    def kick(self, i, force, torque, time_step):
        """Half a step of the velocities under ``force`` and ``torque``."""
        body = self.particles.body[i]
        acceleration = force * body.inverse_mass + self.control.gravity[0]
        self.particles.body[i].velocity = body.velocity + 0.5 * time_step * acceleration
        if ti.static(self.rotates):
            inverse_inertia = 2.5 * body.inverse_mass / (body.radius * body.radius)
            self.particles.spin[i].omega += 0.5 * time_step * inverse_inertia * torque

    @ti.func
    def stride(self, i, force, torque, time_step):
        """Two kicks and a drift, by the same operations as one by one: every number is read and
        written once, which compilers do not find out for themselves."""
        body = self.particles.body[i]
        kick = 0.5 * time_step * (force * body.inverse_mass + self.control.gravity[0])
        velocity = body.velocity + kick + kick
        self.particles.body[i].velocity = velocity
        if ti.static(self.rotates):
            inverse_inertia = 2.5 * body.inverse_mass / (body.radius * body.radius)
            turn = 0.5 * time_step * inverse_inertia * torque
            self.particles.spin[i].omega = self.particles.spin[i].omega + turn + turn
        self.put(i, body.position + time_step * velocity)

    @ti.func
    def drift(self, i, time_step):
        """A step of the position."""
        body = self.particles.body[i]
        self.put(i, body.position + time_step * body.velocity)

    @ti.func
    def put(self, i, position):
        """Move to ``position``; the list is stale once somebody has gone half the skin.
        (Written so that not-a-number counts as gone.)"""
        self.particles.body[i].position = position
        moved = position - self.particles.reference[i]
        limit = 0.5 * self.control.skin[None]
        if not (moved.dot(moved) < limit * limit):
            self.control.raise_flag(STALE)
