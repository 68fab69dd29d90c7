"""Walls in motion: planes, boxes and pistons as flat faces that the contact list can hold.

Face f is body -2-f of a contact.  Every boundary moves along one fixed direction; what it has
travelled, s(t), is a table of (time, travel) that goes on with a final speed, or, for a piston
under load, the motion of a plate of given mass.
"""

import math
from dataclasses import dataclass

import numpy as np

from taichi_dem.contact_list import APART, FIRST_FACE
from taichi_dem.particles import Particles
from taichi_dem.scene import Scene
from taichi_dem.shapes import Box, Piston, Plane
from taichi_dem.types import real, ti, vec3

Face = ti.types.struct(
    origin=vec3,
    point=vec3,
    normal=vec3,
    velocity=vec3,
    inverse_mass=real,  # of a plate that moves freely under a load; zero elsewhere
    material=ti.i32,
    boundary=ti.i32,
)
Motion = ti.types.struct(
    direction=vec3,
    travel=real,
    speed=real,  # over the last step
    push=real,  # contact force on the boundary along its direction
    work=real,  # put in so far: by the prescribed motion, or by the load
    load=real,
    inverse_mass=real,  # 0: the table prescribes the motion
    rows=ti.i32,
    final_speed=real,
    moves=ti.i32,
    approach=real,  # share of the travel that goes along a face's normal: none on a conveyor
    enrolled=real,  # the travel at which the contact list was built
)


@dataclass(frozen=True)
class _Travel:
    """How one boundary moves, in numbers."""

    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    table: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    final_speed: float = 0.0
    load: float = 0.0
    inverse_mass: float = 0.0


def _travel_of(boundary: Plane | Box | Piston) -> _Travel:
    if not boundary.moves:
        return _Travel()
    if isinstance(boundary, Plane):
        speed = math.hypot(*boundary.velocity)
        return _Travel(tuple(v / speed for v in boundary.velocity), final_speed=speed)
    if isinstance(boundary, Piston):
        normal = tuple(boundary.faces()[0][1])
        if boundary.velocity is not None:
            return _Travel(normal, final_speed=boundary.velocity)
        if boundary.load is not None:
            return _Travel(normal, load=boundary.load, inverse_mass=1 / boundary.mass)
        rows = boundary.program
        start = () if rows[0][0] == 0 else ((0.0, 0.0),)
        return _Travel(normal, table=(*start, *rows))
    return _Travel()


def _finite_corner(box: Box) -> np.ndarray:
    """The low corner; the high one, or the origin, where that is infinite."""
    low, high = np.array(box.low), np.array(box.high)
    return np.where(np.isfinite(low), low, np.where(np.isfinite(high), high, 0.0))


@ti.data_oriented
class Boundaries:
    """Fields of the faces and of the motion of the boundaries they belong to; ``period``: the
    lengths of the sides that are periodic, m, or ()."""

    def __init__(self, scene: Scene, particles: Particles, builder: "ti.FieldsBuilder"):
        self._scene, self.particles, self.period = scene, particles, scene.period or ()
        self._travels = [_travel_of(boundary) for boundary in scene.boundaries]
        faces = [(b, *face) for b, wall in enumerate(scene.boundaries) for face in wall.faces()]
        self._faces = faces
        self.owner = np.array([b for b, *_ in faces], dtype=int)
        self.count, self.face_count = len(scene.boundaries), len(faces)
        self._moves = [boundary.moves for boundary in scene.boundaries]
        self.any_moves = any(self._moves)
        self._moving_faces = sum(self._moves[b] for b in self.owner)
        self.longest_table = max([len(t.table) for t in self._travels], default=1)
        self.face, self.motion = Face.field(), Motion.field()
        self.table = ti.field(real)
        builder.dense(ti.i, max(self.face_count, 1)).place(self.face)
        builder.dense(ti.i, max(self.count, 1)).place(self.motion)
        builder.dense(ti.ijk, (max(self.count, 1), self.longest_table, 2)).place(self.table)
        self.pressing, self.pressing_count = ti.field(ti.i32), ti.field(ti.i32)
        builder.dense(ti.i, max(self._moving_faces * particles.count, 1)).place(self.pressing)
        builder.place(self.pressing_count)

    def fill(self, material_index: dict) -> None:
        """Write the scene's boundaries into the fields."""
        speed = [self._initial_speed(travel) for travel in self._travels]
        faces = [
            (
                *point,
                *normal,
                *(speed[b] * way for way in self._travels[b].direction),
                self._travels[b].inverse_mass,
                material_index[self._scene.boundaries[b].material],
                b,
            )
            for b, point, normal in self._faces
        ]
        motions = [
            (
                *travel.direction,
                speed[b],
                travel.load,
                travel.inverse_mass,
                len(travel.table),
                travel.final_speed,
                self._moves[b],
                self._approach(b),
            )
            for b, travel in enumerate(self._travels)
        ]
        table = np.zeros((self.count, self.longest_table, 2))
        for b, travel in enumerate(self._travels):
            table[b, : len(travel.table)] = travel.table
        if self.count > 0:
            self._write(np.array(faces, float), np.array(motions, float), table)

    @ti.kernel
    def _write(
        self,
        faces: ti.types.ndarray(dtype=ti.types.vector(12, ti.f64), ndim=1),
        motions: ti.types.ndarray(dtype=ti.types.vector(10, ti.f64), ndim=1),
        table: ti.types.ndarray(dtype=ti.types.vector(2, ti.f64), ndim=2),
    ):
        ti.loop_config(serialize=True)
        for f in range(faces.shape[0]):
            row = faces[f]
            for axis in ti.static(range(3)):
                self.face[f].origin[axis] = self.face[f].point[axis] = row[axis]
                self.face[f].normal[axis] = row[3 + axis]
                self.face[f].velocity[axis] = row[6 + axis]
            self.face[f].inverse_mass = row[9]
            self.face[f].material = ti.cast(row[10], ti.i32)
            self.face[f].boundary = ti.cast(row[11], ti.i32)
        ti.loop_config(serialize=True)
        for b in range(motions.shape[0]):
            row = motions[b]
            for axis in ti.static(range(3)):
                self.motion[b].direction[axis] = row[axis]
            self.motion[b].speed, self.motion[b].load = row[3], row[4]
            self.motion[b].inverse_mass = row[5]
            self.motion[b].rows = ti.cast(row[6], ti.i32)
            self.motion[b].final_speed = row[7]
            self.motion[b].moves = ti.cast(row[8], ti.i32)
            self.motion[b].approach = row[9]
            self.motion[b].travel = self.motion[b].push = 0.0
            self.motion[b].work = self.motion[b].enrolled = 0.0
            for entry in range(table.shape[1]):
                for column in ti.static(range(2)):
                    self.table[b, entry, column] = table[b, entry][column]

    def _approach(self, b: int) -> float:
        direction = np.array(self._travels[b].direction)
        return max(abs(float(normal @ direction)) for owner, _, normal in self._faces if owner == b)

    def normals(self) -> np.ndarray:
        """The faces' normals, (faces, 3)."""
        return np.array([normal for *_, normal in self._faces]).reshape(-1, 3)

    def state(self, b: int) -> tuple[np.ndarray, np.ndarray]:
        """Reference point (m) and velocity (m/s) of boundary ``b``."""
        boundary, motion = self._scene.boundaries[b], self.motion[b]
        start = _finite_corner(boundary) if isinstance(boundary, Box) else boundary.point
        direction = np.array(self._travels[b].direction)
        return np.array(start) + motion.travel * direction, motion.speed * direction

    def read(self) -> np.ndarray:
        """Travel, speed, push and work of each boundary: what changes in a run."""
        values = np.zeros((self.count, 4))
        if self.any_moves:
            self._copy(values, False)
        return values

    def write(self, values: np.ndarray) -> None:
        """Take back what :meth:`read` gave."""
        if self.any_moves:
            self._copy(values, True)

    @ti.kernel
    def _copy(self, values: ti.types.ndarray(), inward: ti.template()):
        ti.loop_config(serialize=True)
        for b in range(self.count):
            if ti.static(inward):
                self.motion[b].travel, self.motion[b].speed = values[b, 0], values[b, 1]
                self.motion[b].push, self.motion[b].work = values[b, 2], values[b, 3]
            else:
                values[b, 0], values[b, 1] = self.motion[b].travel, self.motion[b].speed
                values[b, 2], values[b, 3] = self.motion[b].push, self.motion[b].work
        if ti.static(inward):
            ti.loop_config(serialize=True)
            for f in range(self.face_count):
                motion = self.motion[self.face[f].boundary]
                self.face[f].velocity = motion.speed * motion.direction
                self.face[f].point = self.face[f].origin + motion.travel * motion.direction

    @staticmethod
    def _initial_speed(travel: _Travel) -> float:
        if len(travel.table) > 1:
            (t0, s0), (t1, s1) = travel.table[:2]
            return (s1 - s0) / (t1 - t0)
        return travel.final_speed

    @ti.func
    def prescribed_travel(self, b, time):
        """s(t) from the table of boundary ``b``."""
        last = self.motion[b].rows - 1
        travel = self.table[b, last, 1] + self.motion[b].final_speed * (
            time - self.table[b, last, 0]
        )
        for row in range(last):
            start, end = self.table[b, row, 0], self.table[b, row + 1, 0]
            if start <= time < end:
                share = (time - start) / (end - start)
                travel = (1 - share) * self.table[b, row, 1] + share * self.table[b, row + 1, 1]
        return travel

    @ti.kernel
    def enrol(self, contacts: ti.template()):
        """List the contacts with moving boundaries, in the order of the particles' ids."""
        found = 0
        ti.loop_config(serialize=True)
        for row in range(self.particles.count):
            i = self.particles.index_of[row]
            for p in range(contacts.start[i], contacts.start[i + 1]):
                j = contacts.ends[p].j
                if j <= FIRST_FACE:
                    if self.motion[self.face[FIRST_FACE - j].boundary].moves != 0:
                        self.pressing[found] = p
                        found += 1
        self.pressing_count[None] = found
        for b in range(self.count):
            self.motion[b].enrolled = self.motion[b].travel

    @ti.func
    def push_on(self, b, contacts: ti.template()):
        """The contact force on boundary ``b`` along its direction of motion."""
        push = 0.0
        for q in range(self.pressing_count[None]):
            p = self.pressing[q]
            face = FIRST_FACE - contacts.ends[p].j
            if contacts.touching[p] != APART and self.face[face].boundary == b:
                push -= contacts.result[p].force.dot(self.motion[b].direction)
        return push

    @ti.func
    def settle(self, b, push, time_step):
        """Book the work of the step that ends now (trapezoidal) and take its second half kick."""
        motion = self.motion[b]
        step = time_step * motion.speed
        if motion.inverse_mass > 0:
            self.motion[b].work += motion.load * step
        else:
            self.motion[b].work -= 0.5 * (motion.push + push) * step
        self.motion[b].push = push
        self.kick(b, time_step)

    @ti.func
    def kick(self, b, time_step):
        """Half a kick of a plate under load; a prescribed motion has no inverse mass."""
        motion = self.motion[b]
        self.motion[b].speed += 0.5 * time_step * motion.inverse_mass * (motion.push + motion.load)

    @ti.func
    def drift(self, time, time_step) -> real:
        """Carry every moving boundary and its faces on to ``time``; returns how far the farthest
        has gone since the contact list was built."""
        farthest = 0.0
        for b in range(self.count):
            motion = self.motion[b]
            if motion.moves != 0:
                travel = motion.travel + time_step * motion.speed
                if motion.inverse_mass == 0:
                    travel = self.prescribed_travel(b, time)
                    self.motion[b].speed = (travel - motion.travel) / time_step
                self.motion[b].travel = travel
                gone = motion.approach * ti.abs(travel - motion.enrolled)
                farthest = ti.max(farthest, gone)
        for f in range(self.face_count):
            b = self.face[f].boundary
            if self.motion[b].moves != 0:
                direction = self.motion[b].direction
                self.face[f].velocity = self.motion[b].speed * direction
                self.face[f].point = self.face[f].origin + self.motion[b].travel * direction
        return farthest
