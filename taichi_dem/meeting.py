"""A place where the threads of one kernel wait for each other, so that they need not be woken again
for every loop of every step.

The numbers are read and written by atomic operations alone, which no compiler moves.  A thread that
waits is busy: where others need the cores a team is slow, and another driver is the right one.
"""

from taichi_dem.types import ti

TASK = 512  # iterations of a parallel loop that always stay with one thread
LINE = 16  # of these numbers lie on one cache line, which threads would fight for
ARRIVED, RELEASED, CALLED, MADE = (LINE * k for k in range(1, 5))
PATIENCE = 5_000_000  # looks, some hundredths of a second, at whether all members run at once


@ti.data_oriented
class Meeting:
    """Barriers for ``members`` threads."""

    def __init__(self, members: int, builder: "ti.FieldsBuilder"):
        self.members = members
        self.number = ti.field(ti.i32)
        builder.dense(ti.i, 6 * LINE).place(self.number)
        self._assembles: bool | None = None

    def assembles(self) -> bool:
        """Whether the members run at the same time; waiting for each other they would not end."""
        if self._assembles is None:
            self._assembles = self.members > 1 and self._try() == self.members
        return self._assembles

    @ti.kernel
    def _try(self) -> ti.i32:
        self.open()
        for place in range(TASK * self.members):
            if place % TASK == 0:
                ti.atomic_add(self.number[ARRIVED], 1)
                looks = 0
                while self.look(ARRIVED) < self.members and looks < PATIENCE:
                    looks += 1
                if looks < PATIENCE:
                    ti.atomic_add(self.number[RELEASED], 1)
        return self.number[RELEASED]

    @ti.func
    def open(self):
        """Nobody has arrived."""
        for place in ti.static((ARRIVED, RELEASED, CALLED, MADE)):
            self.number[place] = 0

    @ti.func
    def last_to_arrive(self):
        """Arrive; whether all others have."""
        return ti.atomic_add(self.number[ARRIVED], 1) % self.members == self.members - 1

    @ti.func
    def release(self):
        ti.atomic_add(self.number[RELEASED], 1)

    @ti.func
    def call(self):
        """Call for one more step."""
        ti.atomic_add(self.number[CALLED], 1)

    @ti.func
    def look(self, what: ti.template()):
        """Read what another thread may be writing."""
        return ti.atomic_or(self.number[what], 0)

    @ti.func
    def wait(self, releases):
        while self.look(RELEASED) < releases:
            pass
