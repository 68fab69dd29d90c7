"""Contact laws along prescribed paths: many contacts in one kernel, each with its own numbers."""

import numpy as np

from halfspace import backend
from taichi_dem.contacts.contact import NormalForce, at_rest
from taichi_dem.types import real, ti, vec3


def columns(law_class, kinds, materials):
    """The coefficients of one law and one pair of materials per contact, by name."""
    rows = [law.coefficients(a, b) for law, (a, b) in zip(kinds, materials, strict=True)]
    return {name: np.array([row[name] for row in rows]) for name in law_class.coefficient_names}


@ti.data_oriented
class Paths:
    """``law`` along paths of the overlap, ``n`` contacts; the caller's part is played as the
    simulation does: a contact is made at a positive overlap, and forgets when it opens."""

    def __init__(self, law, n):
        backend.start()
        self.law, self.n = law, n
        self.adhesive = law.adhesive
        self.k = ti.Struct.field(dict.fromkeys(law.coefficient_names, real), shape=n)
        self.History = ti.types.struct(**(dict(law.history) or {"nothing": ti.i32}))

    def fill(self, **coefficients):
        for name, values in coefficients.items():
            column = np.ascontiguousarray(np.broadcast_to(values, self.n), dtype=float)
            getattr(self.k, name).from_numpy(column)

    def run(self, overlaps, radius, velocities=0.0, mass=1.0, inverse_reach=0.0):
        """Paths (steps, n); a dict of total, elastic, stiffness, damping, energy and touching."""
        shape = overlaps.shape
        motion = np.ascontiguousarray(np.stack([overlaps, np.broadcast_to(velocities, shape)], -1))
        body = np.stack([np.broadcast_to(v, self.n) for v in (radius, mass, inverse_reach)], -1)
        result = np.zeros((*shape, 6))
        self._run(motion, np.ascontiguousarray(body), result)
        names = ("total", "elastic", "stiffness", "damping", "energy", "touching")
        return dict(zip(names, np.moveaxis(result, -1, 0), strict=True))

    @ti.kernel
    def _run(
        self,
        motion: ti.types.ndarray(dtype=real, ndim=3),
        body: ti.types.ndarray(dtype=real, ndim=2),
        result: ti.types.ndarray(dtype=real, ndim=3),
    ):
        for c in range(self.n):
            history, touching = self.History(), 0
            for step in range(motion.shape[0]):
                contact = at_rest(motion[step, c, 0], body[c, 0], body[c, 1])
                contact.normal_velocity = motion[step, c, 1]
                contact.inverse_reach = body[c, 2]
                held = 0
                if ti.static(self.adhesive):
                    held = self.law.holds(contact, self.k[c], history) * touching
                if contact.overlap > 0.0 or held == 1:
                    push = self.law.force(contact, self.k[c], history)
                    result[step, c, 0], result[step, c, 1] = push.total, push.elastic
                    result[step, c, 2], result[step, c, 3] = push.stiffness, push.damping
                    result[step, c, 4] = self.law.energy(contact, self.k[c], history)
                    result[step, c, 5] = 1.0
                    touching = 1
                else:
                    history, touching = self.History(), 0

    @ti.kernel
    def _collide(
        self,
        body: ti.types.ndarray(dtype=real, ndim=2),
        speed: ti.types.ndarray(dtype=real, ndim=2),
        dt: ti.types.ndarray(dtype=real, ndim=1),
        limit: ti.i32,
    ):
        for c in range(self.n):
            history, overlap, velocity, force = self.History(), 0.0, -speed[c, 0], 0.0
            step, together = 0, 1
            while step < limit and together == 1:
                velocity += 0.5 * dt[c] * force / body[c, 1]
                overlap -= dt[c] * velocity
                contact = at_rest(overlap, body[c, 0], body[c, 1])
                contact.normal_velocity = velocity
                contact.inverse_reach = body[c, 2]
                force = 0.0
                held = ti.cast(overlap > 0.0, ti.i32)
                if ti.static(self.adhesive):
                    held |= self.law.holds(contact, self.k[c], history)
                if held == 1:
                    force = self.law.force(contact, self.k[c], history).total
                else:
                    together = 0
                velocity += 0.5 * dt[c] * force / body[c, 1]
                step += 1
            speed[c, 1] = velocity if together == 0 else ti.math.nan

    def collide(self, radius, mass, speed, dt, inverse_reach=0.0, limit=10_000):
        """The rebound speed of spheres that meet at ``speed``, by velocity Verlet whose dashpots
        see the velocity of the half step; not a number where they are together after ``limit``
        steps."""
        body = np.stack([np.broadcast_to(v, self.n) for v in (radius, mass, inverse_reach)], -1)
        speeds = np.zeros((self.n, 2))
        speeds[:, 0] = speed
        times = np.array(np.broadcast_to(dt, self.n), dtype=float)
        self._collide(np.ascontiguousarray(body), speeds, times, limit)
        return speeds[:, 1]


@ti.data_oriented
class Torques:
    """A rolling ``law`` on ``n`` contacts under given normal forces, step by step."""

    def __init__(self, law, n):
        backend.start()
        self.law, self.n = law, n
        self.k = ti.Struct.field(dict.fromkeys(law.coefficient_names, real), shape=n)
        self.remembers = bool(law.history)
        self.History = ti.types.struct(**(dict(law.history) or {"nothing": ti.i32}))
        self.history = self.History.field(shape=n)

    fill = Paths.fill

    def run(self, c):
        """Torques (n, 3) and stored energies (n,) of the contacts in the dict ``c``."""
        names = ("elastic", "area_stiffness", "radius", "inertia", "mean_spin", "dt")
        scalars = np.stack([np.broadcast_to(c[name], self.n) for name in names], -1)
        torque, energy = np.zeros((self.n, 3)), np.zeros(self.n)
        vectors = (np.array(np.broadcast_to(c[name], (self.n, 3))) for name in ("normal", "spin"))
        self._run(*vectors, np.ascontiguousarray(scalars), torque, energy)
        return torque, energy

    @ti.kernel
    def _run(
        self,
        normal: ti.types.ndarray(dtype=vec3, ndim=1),
        spin: ti.types.ndarray(dtype=vec3, ndim=1),
        scalars: ti.types.ndarray(dtype=real, ndim=2),
        torque: ti.types.ndarray(dtype=vec3, ndim=1),
        energy: ti.types.ndarray(dtype=real, ndim=1),
    ):
        for c in range(self.n):
            contact = at_rest(0.0, scalars[c, 2], 1.0)
            contact.normal = normal[c]
            contact.relative_spin = spin[c]
            contact.rolling_inertia = scalars[c, 3]
            contact.spin = scalars[c, 4]
            contact.time_step = scalars[c, 5]
            push = NormalForce(elastic=scalars[c, 0], area_stiffness=scalars[c, 1])
            history = self.history[c]
            torque[c] = self.law.torque(contact, push, self.k[c], history)
            energy[c] = self.law.energy(contact, self.k[c], history)
            self.history[c] = history
