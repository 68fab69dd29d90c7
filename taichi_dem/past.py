"""Values of the last steps, latest first: kept, and extrapolated to the next step."""

from taichi_dem.types import ti


@ti.func
def shifted(past: ti.template(), latest):
    """The values that are kept when there is a ``latest`` one."""
    kept = past
    for step in ti.static(range(past.n - 1, 0, -1)):
        kept[step] = kept[step - 1]
    kept[0] = latest
    return kept


@ti.func
def extrapolated(past: ti.template(), age):
    """The next of ``age`` values, latest first, or of as many as are kept."""
    next_one = 0.0
    if age == 1:
        next_one = past[0]
    elif age == 2:
        next_one = 2.0 * past[0] - past[1]
    elif age >= 3:
        next_one = 3.0 * (past[0] - past[1]) + past[2]
    return next_one
