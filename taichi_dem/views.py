"""What a user sees of a simulation: NumPy arrays in the order the spheres were given."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_dem.boundaries import Boundaries
from taichi_dem.contact_list import APART, FIRST_FACE, ContactList
from taichi_dem.particles import Particles
from taichi_dem.periodic import Period, nearest_image
from taichi_dem.types import ti


@dataclass(frozen=True)
class ParticleState:
    """The spheres at one moment; each array (n, 3) or (n,), SI units.

    ``force`` includes gravity; ``material`` indexes ``scene.materials``. In a periodic scene
    ``position`` goes on without a jump when a sphere leaves the cell.
    """

    position: np.ndarray
    velocity: np.ndarray
    omega: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    radius: np.ndarray
    mass: np.ndarray
    material: np.ndarray


@dataclass(frozen=True)
class BoundaryState:
    """A boundary at one moment: the contact force (N) and torque about ``position`` (N m) on it,
    its reference point (m) and velocity (m/s), each (3,)."""

    force: np.ndarray
    torque: np.ndarray
    position: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True)
class SubstrateState:
    """The contacts with the substrate at one moment.

    particle (m,); position (m, 2) m; force (m,) elastic, N, pressing down (all of the normal force
    where contacts are not coupled); expansion (m,) m, what the surface under the contact has risen
    by the forces on the others; slope (m, 2), its gradient
    (the lateral force on the sphere is -force * slope); contact_radius (m,) m; load (m,) N, the
    forces under which an elastic ground would have these dents: ``force``, and on ground that
    creeps what it remembers besides; dent_position (k, 2) m, dent_load (k,) N and dent_radius (k,)
    m, the same of dents in which nothing presses any more.
    """

    particle: np.ndarray
    position: np.ndarray
    force: np.ndarray
    expansion: np.ndarray
    slope: np.ndarray
    contact_radius: np.ndarray
    load: np.ndarray
    dent_position: np.ndarray
    dent_load: np.ndarray
    dent_radius: np.ndarray
    ground: Any

    def field(self, points: np.ndarray) -> np.ndarray:
        """Depression (p,) in m of the surface at ``points`` (p, 2), each ``load`` spread as Hertz
        pressure over its contact or dent."""
        place = np.concatenate([self.position, self.dent_position])
        if not len(place):
            return np.zeros(len(points))
        load = np.append(self.load, self.dent_load)
        radius = np.append(self.contact_radius, self.dent_radius)
        return self.ground.field(place, load, points, radius=radius)


@ti.kernel
def _copy_contacts(
    contacts: ti.template(),
    particles: ti.template(),
    ends: ti.types.ndarray(),
    overlap: ti.types.ndarray(),
    force: ti.types.ndarray(),
    torque: ti.types.ndarray(),
) -> ti.i32:
    """Touching contacts, in the order of the ids of their first spheres; returns their number."""
    found = 0
    ti.loop_config(serialize=True)
    for row in range(particles.count):
        i = particles.index_of[row]
        for p in range(contacts.start[i], contacts.start[i + 1]):
            if contacts.touching[p] != APART:
                j = contacts.ends[p].j
                ends[found, 0] = row
                ends[found, 1] = particles.spin[j].id if j >= 0 else j
                ends[found, 2] = p
                overlap[found] = 2.0 * contacts.result[p].half_overlap
                for axis in ti.static(range(3)):
                    force[found, axis] = contacts.result[p].force[axis]
                    if ti.static(contacts.rolls):
                        torque[found, axis] = contacts.result[p].torque[axis]
                found += 1
    return found


def contact_records(
    contacts: ContactList,
    particles: Particles,
    boundaries: Boundaries,
    state: ParticleState,
    period: Period | None = None,
) -> np.ndarray:
    """One record per touching contact: i, j (>= 0 sphere, -1 substrate, -2-b boundary b), face
    (-1 where there is none), overlap (m), force on i (N), position of the contact (m), normal from
    j to i (both at i, of its nearest image j); with a rolling law, its torque on i (N m); and what
    the laws remember, by name."""
    room = max(1, contacts.count())
    ends, overlap = np.empty((room, 3), np.int32), np.empty(room)
    force, torque = np.empty((2, room, 3))
    found = _copy_contacts(contacts, particles, ends, overlap, force, torque)
    order = np.lexsort((ends[:found, 1], ends[:found, 0]))
    ends, overlap, force, torque = ends[order], overlap[order], force[order], torque[order]

    named = {"torque": torque} if contacts.rolls else {}
    named |= contacts.remembered(ends[:, 2])
    layout = [
        ("i", np.int32),
        ("j", np.int32),
        ("face", np.int32),
        ("overlap", float),
        ("force", float, 3),
        ("position", float, 3),
        ("normal", float, 3),
        *((name, float, values.shape[1:]) for name, values in named.items()),
    ]
    records = np.zeros(found, dtype=layout)
    i, j = ends[:, 0], ends[:, 1]
    wall = j <= FIRST_FACE
    face = np.where(wall, FIRST_FACE - j, 0)
    records["i"], records["overlap"], records["force"] = i, overlap, force
    records["face"] = np.where(wall, face, -1)
    records["j"] = np.where(wall, FIRST_FACE - boundaries.owner[face] if wall.any() else 0, j)
    normal = np.zeros((found, 3))
    normal[:, 2] = 1.0
    sphere = j >= 0
    apart = nearest_image(state.position[i[sphere]] - state.position[j[sphere]], period)
    normal[sphere] = apart / np.linalg.norm(apart, axis=1, keepdims=True)
    normals = boundaries.normals()
    if wall.any():
        normal[wall] = normals[face[wall]]
    records["normal"] = normal
    arm = state.radius[i] - 0.5 * overlap
    records["position"] = state.position[i] - arm[:, None] * normal
    for name, values in named.items():
        records[name] = values
    return records


def relative_overlaps(records: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The overlaps of contact ``records`` over the smaller ``radius`` (of the spheres, m)."""
    i, j = records["i"], records["j"]
    smaller = np.where(j >= 0, np.minimum(radius[i], radius[np.maximum(j, 0)]), radius[i])
    return records["overlap"] / smaller


def boundary_states(boundaries: Boundaries, records: np.ndarray) -> list[BoundaryState]:
    """One for each boundary, from all the contact ``records``."""
    states = []
    for b in range(boundaries.count):
        mine = records[records["j"] == FIRST_FACE - b]
        position, velocity = boundaries.state(b)
        torque = np.cross(mine["position"] - position, -mine["force"]).sum(axis=0)
        if "torque" in mine.dtype.names:
            torque -= mine["torque"].sum(axis=0)
        states.append(BoundaryState(-mine["force"].sum(axis=0), torque, position, velocity))
    return states
