"""The particle fields, and their way to and from NumPy in the order the user gave."""

import numpy as np

from taichi_dem.scene import Spheres
from taichi_dem.types import real, ti, vec3

# What one contact reads of a particle shares a cache line.
Body = ti.types.struct(position=vec3, radius=real, velocity=vec3, inverse_mass=real)
Spin = ti.types.struct(omega=vec3, material=ti.i32, id=ti.i32)
Load = ti.types.struct(force=vec3, torque=vec3)

Rows = ti.types.ndarray(dtype=ti.types.vector(3, ti.f64), ndim=1)

FEW = 3000  # for these, to wake the threads costs a rebuild more than they save


@ti.data_oriented
class Particles:
    """Fields of ``count`` particles; ``id`` is the place in the user's order.

    body  position (m), radius (m), velocity (m/s), inverse mass (1/kg)
    spin  angular velocity (rad/s), material index, id
    load  contact force (N) and torque (N m) at the end of the last step
    rank       by id, place in the order of size, of equals in that of their ids
    index_of   where the particle of an id is now
    reference  position when the contact list was made (m)
    """

    def __init__(
        self, spheres: Spheres, mass: np.ndarray, material: np.ndarray, builder: "ti.FieldsBuilder"
    ):
        self.count = spheres.count
        self.few = spheres.count < FEW
        self.body, self.spin, self.load = Body.field(), Spin.field(), Load.field()
        self._sorted_body, self._sorted_spin = Body.field(), Spin.field()
        for field in (self.body, self.spin, self.load, self._sorted_body, self._sorted_spin):
            builder.dense(ti.i, self.count).place(field)
        self.index_of, self.reference = ti.field(ti.i32), ti.Vector.field(3, real)
        self.rank = ti.field(ti.i32)
        builder.dense(ti.i, self.count).place(self.index_of)
        builder.dense(ti.i, self.count).place(self.rank)
        builder.dense(ti.i, self.count).place(self.reference)
        self._constant = (mass, material)

    def fill(self, spheres: Spheres) -> None:
        """Write the scene's spheres into the fields, in the user's order."""
        mass, material = self._constant
        rank = np.empty(self.count, np.int32)
        rank[np.argsort(spheres.radius, kind="stable")] = np.arange(self.count)
        self._fill(
            spheres.position,
            spheres.velocity,
            spheres.omega,
            spheres.radius,
            1 / mass,
            np.ascontiguousarray(material, np.int32),
            rank,
        )

    @ti.kernel
    def _fill(
        self,
        position: ti.types.ndarray(),
        velocity: ti.types.ndarray(),
        omega: ti.types.ndarray(),
        radius: ti.types.ndarray(),
        inverse_mass: ti.types.ndarray(),
        material: ti.types.ndarray(),
        rank: ti.types.ndarray(),
    ):
        for i in range(self.count):
            for axis in ti.static(range(3)):
                self.body[i].position[axis] = position[i, axis]
                self.body[i].velocity[axis] = velocity[i, axis]
                self.spin[i].omega[axis] = omega[i, axis]
            self.body[i].radius, self.body[i].inverse_mass = radius[i], inverse_mass[i]
            self.spin[i].material, self.spin[i].id = material[i], i
            self.rank[i], self.index_of[i] = rank[i], i

    def read(self) -> dict[str, np.ndarray]:
        """Position, velocity, omega, force and torque, each (n, 3), in the user's order."""
        names = ("position", "velocity", "omega", "force", "torque")
        arrays = {name: np.empty((self.count, 3)) for name in names}
        self._read(*arrays.values())
        return arrays

    @ti.kernel
    def _read(self, position: Rows, velocity: Rows, omega: Rows, force: Rows, torque: Rows):
        for i in range(self.count):
            row = self.spin[i].id
            position[row], velocity[row] = self.body[i].position, self.body[i].velocity
            omega[row] = self.spin[i].omega
            force[row], torque[row] = self.load[i].force, self.load[i].torque

    @ti.kernel
    def write(self, position: Rows, velocity: Rows, omega: Rows):
        """Put the particles somewhere else; each array (n, 3), in the user's order."""
        for i in range(self.count):
            row = self.spin[i].id
            self.body[i].position, self.body[i].velocity = position[row], velocity[row]
            self.spin[i].omega = omega[row]

    @ti.kernel
    def write_load(self, force: Rows, torque: Rows):
        """Forces and torques without gravity, each (n, 3), in the user's order."""
        for i in range(self.count):
            row = self.spin[i].id
            self.load[i].force, self.load[i].torque = force[row], torque[row]

    @ti.kernel
    def reorder(self, order: ti.template()):
        """Move the particle at ``order[s]`` to place s (load is rewritten at every step)."""
        for s in range(self.count):
            self._sorted_body[s] = self.body[order[s]]
            self._sorted_spin[s] = self.spin[order[s]]
        for s in range(self.count):
            self.body[s] = self._sorted_body[s]
            self.spin[s] = self._sorted_spin[s]
            self.index_of[self.spin[s].id] = s
