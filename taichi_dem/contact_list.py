"""The contacts that can touch before the next rebuild, their history and their forces.

Contacts stand in the order of their first particle (a CSR layout); the second is a particle, the
substrate or a face.  The history is the union of what the laws declare; it is kept under the ids of
the two bodies, so that no reordering can lose it.
"""

from typing import Any

import numpy as np

from taichi_dem.effects import Effects
from taichi_dem.types import real, ti, vec3

SUBSTRATE = -1  # body number of the half-space; face f of the boundaries is -2 - f
FIRST_FACE = -2
APART, TOUCHING = range(2)
CACHED = 30_000  # particles: what contacts of more do is moved by before a second look at it

Ends = ti.types.struct(i=ti.i32, j=ti.i32)


def result_parts(effects: Effects) -> dict[str, Any]:
    """What a contact does to its two bodies: the members of a struct.

    force         on i
    half_overlap  the arm of a sphere is its radius less this
    couple        normal x tangential force: its torque is -arm * couple on i and on j alike
    torque        on i; j gets the opposite
    drag          of the dashpot at the last step, N
    """
    parts: dict[str, Any] = {"force": vec3, "half_overlap": real}
    if effects.friction:
        parts["couple"] = vec3
    if effects.rolling:
        parts["torque"] = vec3
    if effects.losses and not effects.plastic:
        parts["drag"] = real
    return parts


def recalled_parts(effects: Effects) -> dict[str, Any]:
    """Of that, what is needed of the step before: by the books of energy the parts that do work, by
    contacts that sleep all of it."""
    parts = result_parts(effects)
    work = {"couple", "torque", "force" if effects.plastic else "drag"}
    return {name: kind for name, kind in parts.items() if effects.sleep or name in work}


def history_type(effects: Effects) -> Any:
    """What contacts remember, as a struct; without history the laws still get one, which the
    compiler drops."""
    return ti.types.struct(**(effects.history or {"nothing": ti.i32}))


@ti.data_oriented
class ContactList:
    """Fields of at most ``capacity`` contacts of ``particles`` particles.

    ends         first particle, second particle or body number
    touching     APART or TOUCHING
    result       what the contact does to the two, while it touches
    history      what the laws remember of the contact (absent if they remember nothing)
    lost         energy that has gone into dashpot, friction and rolling so far, what their springs
                 hold included, J; of plastic laws, all work of the contact force (absent if nothing
                 dissipates)
    number       touching contacts of each particle at the last step (absent if no law asks)
    start        (particles + 1) first contact of each first particle
    incidence    contacts of each particle, 2 p, or 2 p + 1 where it is the second, in the order of
                 the partner's id: sums do not depend on the order of the list
    earliest, latest  contact of each particle (absent where all of them fit into the caches)
    found, name  notes of the one who makes the list, ``room`` for each particle
    """

    def __init__(
        self,
        particles: int,
        capacity: int,
        effects: Effects,
    ):
        history = effects.history
        self.particles, self.capacity, self.names = particles, capacity, tuple(history)
        self.has_history, self.dissipates = bool(history), effects.losses
        self.recalls = effects.losses or effects.sleep
        self.rolls = effects.rolling
        self.shares_inertia = "rolling_inertia" in effects.asks_for
        builder = ti.FieldsBuilder()
        self.ends = Ends.field()
        self.result = ti.types.struct(**result_parts(effects)).field()
        self.start, self.incidence_start = ti.field(ti.i32), ti.field(ti.i32)
        self.incidence = ti.field(ti.i32)
        self.touching = ti.field(ti.i32)
        builder.dense(ti.i, capacity).place(self.ends)
        builder.dense(ti.i, capacity).place(self.touching)
        builder.dense(ti.i, capacity).place(self.result)
        builder.dense(ti.i, particles + 1).place(self.start, self.incidence_start)
        builder.dense(ti.i, 2 * capacity).place(self.incidence)
        self.outgrows_caches = particles > CACHED
        if self.outgrows_caches:
            self.earliest, self.latest = ti.field(ti.i32), ti.field(ti.i32)
            builder.dense(ti.i, particles).place(self.earliest, self.latest)
        self.room = 2 * capacity // particles
        self.found, self.name = ti.field(ti.i32), ti.field(ti.i32)
        builder.dense(ti.i, 2 * capacity).place(self.found)
        builder.dense(ti.i, 2 * capacity).place(self.name)
        self.old_start, self.old_end = ti.field(ti.i32), ti.field(ti.i32)
        self.old_partner = ti.field(ti.i32)
        builder.dense(ti.i, capacity).place(self.old_partner)
        builder.dense(ti.i, particles).place(self.old_start, self.old_end)
        self.History = history_type(effects)
        if history:
            self.history, self.old_history = self.History.field(), self.History.field()
            builder.dense(ti.i, capacity).place(self.history)
            builder.dense(ti.i, capacity).place(self.old_history)
        if self.dissipates:
            self.lost = ti.field(real)
            builder.dense(ti.i, capacity).place(self.lost)
        if self.recalls:
            kept = recalled_parts(effects)
            self.old_result = ti.types.struct(**kept).field()
            builder.dense(ti.i, capacity).place(self.old_result)
            self.recalled = [
                tuple(whole.get_member_field(name) for whole in (self.result, self.old_result))
                for name in kept
            ]
        if self.shares_inertia:
            self.number = ti.field(ti.i32)
            builder.dense(ti.i, particles).place(self.number)
        self.tree = builder.finalize()
        filed = [getattr(self, name, None) for name in ("old_partner", "old_history", "old_result")]
        self._numbers = [one for field in filed if field is not None for one in _scalars(field)]

    def count(self) -> int:
        """How many contacts are on the list, touching or not."""
        return int(self.start[self.particles])

    def remembered(self, which: np.ndarray) -> dict[str, np.ndarray]:
        """The history of the contacts ``which``, by name."""
        if not self.has_history:
            return {}
        values = self.history.to_numpy()
        return {name: values[name][which] for name in self.names}

    @ti.func
    def count_touching(self, i):
        """How many of the contacts of ``i`` touch."""
        number = 0
        for q in range(self.incidence_start[i], self.incidence_start[i + 1]):
            number += self.touching[self.incidence[q] >> 1] != APART
        return number

    @ti.func
    def needed(self, i, end):
        """Up to which contact, of those before ``end``, all must be known before ``i`` moves."""
        until = end
        if ti.static(self.outgrows_caches):
            until = ti.min(self.latest[i] + 1, end)
        return until

    @ti.func
    def lie_within(self, i, first, end):
        """Whether all contacts of ``i`` are known to be from ``first`` on and before ``end``."""
        within = False
        if ti.static(self.outgrows_caches):
            within = first <= self.earliest[i] and self.latest[i] < end
        return within

    def filed(self) -> tuple[np.ndarray, np.ndarray]:
        """What is on file (see ``Neighbors.save``), for :meth:`put_on_file`."""
        places = np.empty((self.particles, 2), np.int32)
        numbers = np.empty((self.count(), len(self._numbers)))
        self._read_file(places, numbers)
        return places, numbers

    def put_on_file(self, kept: tuple[np.ndarray, np.ndarray]) -> None:
        """That of a list that had no more contacts than this one has room for."""
        self._write_file(*kept)

    @ti.kernel
    def _read_file(self, places: ti.types.ndarray(), numbers: ti.types.ndarray()):
        for row in range(self.particles):
            places[row, 0], places[row, 1] = self.old_start[row], self.old_end[row]
        for p in range(numbers.shape[0]):
            for k in ti.static(range(len(self._numbers))):
                numbers[p, k] = self._numbers[k][p]

    @ti.kernel
    def _write_file(self, places: ti.types.ndarray(), numbers: ti.types.ndarray()):
        for row in range(self.particles):
            self.old_start[row], self.old_end[row] = places[row, 0], places[row, 1]
        for p in range(numbers.shape[0]):
            for k in ti.static(range(len(self._numbers))):
                number = ti.static(self._numbers[k])
                number[p] = ti.cast(numbers[p, k], number.dtype)

    def inherit(self, other: "ContactList") -> None:
        """Take over what a smaller list has on file."""
        _copy_file(other, self)


def _scalars(field: Any) -> list[Any]:
    """The scalar fields that a field consists of."""
    if hasattr(field, "keys"):
        return [one for name in field.keys for one in _scalars(field.get_member_field(name))]
    if isinstance(field, ti.MatrixField):
        return [field.get_scalar_field(k) for k in range(field.n)]
    return [field]


@ti.kernel
def _copy_file(old: ti.template(), new: ti.template()):
    for i in range(old.particles):
        new.old_start[i], new.old_end[i] = old.old_start[i], old.old_end[i]
    for p in range(old.capacity):
        new.old_partner[p] = old.old_partner[p]
        if ti.static(old.has_history):
            new.old_history[p] = old.old_history[p]
        if ti.static(old.recalls):
            new.old_result[p] = old.old_result[p]
