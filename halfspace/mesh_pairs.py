"""The near pairs of the particle mesh, compiled: found by bands and columns, valued once, kept.

The arrays are those of `mesh_kernels`.
"""

# mypy: ignore-errors
# (annotations are the compiler's types, which no checker knows)
from .backend import ti
from .mesh_kernels import (
    BIN,
    COUNT,
    FIRST,
    Integers,
    Numbers,
    Table,
    distance_squared,
    first_row,
    vec2,
    wrapped,
)


@ti.func
def stretch(
    site: ti.template(), begin: ti.template(), k, step, piece, cutoff, origin, spacing,
    rows, columns, bands, width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Where the possible neighbours of contact k are, `step` bands on: [from, to).

    Where the columns wrap around a periodic cell there is a second piece.
    """
    groups = ti.raw_div(columns + BIN - 1, BIN)
    x0 = (site[k, 0] - origin[0]) / spacing[0] - 0.5 * width
    x1 = (site[k, 1] - origin[1]) / spacing[1] - 0.5 * width
    if ti.static(periodic):
        x0 -= rows * ti.floor(ti.ceil(x0) / rows)
    band = ti.raw_div(ti.cast(ti.ceil(x0), ti.i32) * bands, rows) + step
    turn = 0
    if ti.static(periodic):
        turn = ti.floor(band / bands, ti.i32)
        band -= turn * bands
    low, high = 0, 0
    if 0 <= band < bands:
        x0 -= turn * rows
        above = first_row(band, bands, rows) - 1 - x0
        below = x0 - first_row(band + 1, bands, rows) + 1
        gap = ti.max(above, below, 0.0) * spacing[0]  # to the nearest contact there
        if gap < cutoff:
            chord = ti.sqrt(cutoff**2 - gap**2) / spacing[1]
            first = ti.floor(ti.ceil(x1 - chord) / BIN, ti.i32)
            last = ti.floor(ti.ceil(x1 + chord) / BIN, ti.i32)
            if ti.static(periodic):
                turn = first - wrapped(first, groups)
                first, last = first - turn, last - turn
                if piece == 0:
                    last = ti.min(last, groups - 1)
                else:
                    first, last = 0, last - groups
            else:
                first, last = ti.max(first, 0), ti.min(last, groups - 1)
            if first <= last:
                low, high = begin[band * groups + first], begin[band * groups + last + 1]
    return low, high


@ti.kernel
def room(
    begin: Integers, space: Numbers, reach: ti.i32, columns: ti.i32, bands: ti.i32,
    periodic: ti.template(),
):  # fmt: skip
    """Where each band may keep its pairs, one band after the other: space (bands + 1,).

    A contact has at most as many as there are within `reach` groups of columns in three bands.
    """
    groups = ti.raw_div(columns + BIN - 1, BIN)
    for band in range(bands):
        most = ti.cast(0.0, ti.f64)
        for step in range(-1, 2):
            other = band + step
            if ti.static(periodic):
                other = wrapped(other, bands)
            if 0 <= other < bands:
                for g in range(groups):
                    low, high = ti.max(g - reach, 0), ti.min(g + reach, groups - 1) + 1
                    near = begin[other * groups + high] - begin[other * groups + low]
                    if ti.static(periodic):  # what lies beyond the ends of the band
                        over, under = ti.max(g + reach + 1 - groups, 0), ti.min(g - reach, 0)
                        near += begin[other * groups + over] - begin[other * groups]
                        near += begin[(other + 1) * groups] - begin[(other + 1) * groups + under]
                    mine = begin[band * groups + g + 1] - begin[band * groups + g]
                    most += ti.cast(mine, ti.f64) * near
        space[band + 1] = most
    ti.loop_config(serialize=True)
    for band in range(bands):
        space[band + 1] += space[band]


@ti.kernel
def pairs(
    site: Table, node: Table, begin: Integers, space: Numbers, value: Numbers, index: Integers,
    short: Numbers, origin: vec2, spacing: vec2, period: vec2,
    rows: ti.i32, columns: ti.i32, bands: ti.i32,
    cutoff: ti.f64, left_out: ti.f64,
    width: ti.template(), degree: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Find the neighbours of every contact and what they add to the grid.

    Of pairs no further apart than `left_out`, squared, nothing is left, grid included.
    """
    groups = ti.raw_div(columns + BIN - 1, BIN)
    for band in range(bands):
        last = ti.cast(space[band], ti.i32)
        for k in range(begin[band * groups], begin[(band + 1) * groups]):
            first = last
            for step in range(-1, 2):
                for piece in range(1 + periodic):
                    low, high = stretch(
                        site, begin, k, step, piece, cutoff, origin, spacing,
                        rows, columns, bands, width, periodic,
                    )  # fmt: skip
                    for m in range(low, high):
                        squared = distance_squared(site, k, m, period, periodic)
                        # Written, and kept by moving on: a jump would often be guessed wrong.
                        value[last] = squared
                        index[last] = m
                        last += ti.cast(m != k and squared < cutoff**2, ti.i32)
            node[k, FIRST], node[k, COUNT] = first, last - first
            p = ti.Vector([short[a] for a in ti.static(range(degree + 1))])
            for m in range(first, last):
                squared = value[m]
                s = 2.0 * squared / cutoff**2 - 1.0
                smooth = p[degree]
                for a in ti.static(range(degree - 1, -1, -1)):
                    smooth = smooth * s + p[a]
                inverse = ti.select(squared > left_out, 1.0 / ti.sqrt(squared), 0.0)
                value[m] = inverse - smooth / cutoff
