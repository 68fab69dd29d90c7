"""The few numbers that every kernel reads, in fields because they may change while it runs."""

from taichi_dem.types import real, ti

STALE, TOO_DEEP, UNSOLVED, OVERPRESSED = range(4)  # why a kernel calls the host


@ti.data_oriented
class Control:
    """Shared scalars.

    step        steps made since the start
    time_step   s
    skin        m, how far beyond reach the contact list reaches
    reach       m, how far apart two undeformed bodies may be and yet touch
    deepest     share of the smaller radius beyond which an overlap stops the run
    gravity     m/s2
    flags       (4,) STALE, TOO_DEEP, UNSOLVED, OVERPRESSED
    """

    def __init__(self, builder: "ti.FieldsBuilder"):
        self.step, self.flags = ti.field(ti.i64), ti.field(ti.i32)
        self.time_step, self.skin, self.deepest = ti.field(real), ti.field(real), ti.field(real)
        self.reach = ti.field(real)
        self.gravity = ti.Vector.field(3, real)
        builder.place(self.step, self.time_step, self.skin, self.deepest, self.reach)
        builder.dense(ti.i, 1).place(self.gravity)
        builder.dense(ti.i, 4).place(self.flags)

    def fill(self, time_step: float, gravity: tuple[float, ...], deepest: float) -> None:
        """Write the constants, after the fields have been placed."""
        self.time_step[None], self.deepest[None] = time_step, deepest
        self.gravity[0] = gravity

    def restart(self, time_step: float) -> None:
        """Step 0, with steps of ``time_step`` (s), and nothing to complain of."""
        self.step[None], self.time_step[None] = 0, time_step
        self.flags.fill(0)

    @ti.func
    def raise_flag(self, reason: ti.template()):
        self.flags[reason] = 1

    @ti.func
    def calls_host(self) -> ti.i32:
        """Zero, or the sum of 2**reason over the flags that are up."""
        return (
            self.flags[STALE]
            + 2 * self.flags[TOO_DEEP]
            + 4 * self.flags[UNSOLVED]
            + 8 * self.flags[OVERPRESSED]
        )

    @ti.kernel
    def reasons(self) -> ti.i32:
        """:meth:`calls_host`, for the host."""
        return self.calls_host()
