"""The loops of the particle mesh, compiled: sorting, spreading, gathering.

Contacts are kept in the order of bands, some rows of the grid (those of the first row that they
reach), and within a band in that of small groups of columns. So a band finds the contacts that
reach it in one or two contiguous stretches and adds them up itself, in that order: no two threads
write to the same place, and the bits do not depend on their number. A band is as high as the
cutoff, so that all neighbours of a contact lie in three bands, in one stretch each.

Every array passed to a kernel costs about 10 us, so there are few: `site` (n, 2) holds the
positions in that order; `node` (n, 4 + 2 w) the first row and column of the window, the first pair
and the number of pairs, and the weights of the window in both dimensions; `load` (4, n) the force,
and depression and slope as results.
"""

# mypy: ignore-errors
# (annotations are the compiler's types, which no checker knows)
from .backend import start, ti

start()

Numbers = ti.types.ndarray(dtype=ti.f64, ndim=1)
Table = ti.types.ndarray(dtype=ti.f64, ndim=2)
Integers = ti.types.ndarray(dtype=ti.i32, ndim=1)
vec2 = ti.types.vector(2, ti.f64)

BIN = 2  # grid columns in a group
ROW, COLUMN, FIRST, COUNT, WEIGHTS = 0, 1, 2, 3, 4


@ti.func
def wrapped(i, size):
    """The number of a row, column, band or group in a periodic cell."""
    return ti.raw_mod(ti.raw_mod(i, size) + size, size)


@ti.func
def first_row(band, bands, rows):
    """Where a band begins: row r belongs to the band `r bands // rows`."""
    return ti.raw_div(band * rows + bands - 1, bands)


@ti.kernel
def sort(
    x: Table, order: Integers, bins: Integers, begin: Integers,
    origin: vec2, spacing: vec2, rows: ti.i32, columns: ti.i32, bands: ti.i32,
    width: ti.template(), periodic: ti.template(),
) -> ti.i32:  # fmt: skip
    """Sort the contacts by band and group of columns; returns how many are not on the grid.

    order (n,); bins (n,) scratch; begin (groups + 2,): where each group starts in `order`.
    """
    groups = ti.raw_div(columns + BIN - 1, BIN)
    outside = 0
    for i in range(x.shape[0]):
        row = ti.cast(ti.ceil((x[i, 0] - origin[0]) / spacing[0] - 0.5 * width), ti.i32)
        column = ti.cast(ti.ceil((x[i, 1] - origin[1]) / spacing[1] - 0.5 * width), ti.i32)
        if ti.static(periodic):
            row, column = wrapped(row, rows), wrapped(column, columns)
        elif row < 0 or row > rows - width or column < 0 or column > columns - width:
            outside += 1
            row, column = 0, 0
        bins[i] = ti.raw_div(row * bands, rows) * groups + ti.raw_div(column, BIN)
    for i in range(begin.shape[0]):
        begin[i] = 0
    ti.loop_config(serialize=True)
    for i in range(x.shape[0]):
        begin[bins[i] + 2] += 1
    ti.loop_config(serialize=True)
    for i in range(2, begin.shape[0]):
        begin[i] += begin[i - 1]
    ti.loop_config(serialize=True)
    for i in range(x.shape[0]):
        place = begin[bins[i] + 1]
        order[place] = i
        begin[bins[i] + 1] = place + 1
    return outside


@ti.func
def weights(polynomials: ti.template(), v, width: ti.template()):
    """All weights of a window in one dimension, by Horner's rule."""
    result = ti.Vector([polynomials[0, a] for a in ti.static(range(width))])
    for d in range(1, polynomials.shape[0]):
        for a in ti.static(range(width)):
            result[a] = result[a] * v + polynomials[d, a]
    return result


@ti.kernel
def place(
    x: Table, order: Integers, site: Table, node: Table, polynomials: Table,
    origin: vec2, spacing: vec2, rows: ti.i32, columns: ti.i32,
    width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Positions, windows and their weights, in sorted order."""
    for k in range(order.shape[0]):
        for axis in ti.static(range(2)):
            position = x[order[k], axis]
            low = (position - origin[axis]) / spacing[axis] - 0.5 * width
            first = ti.ceil(low)
            w = weights(polynomials, 2.0 * (first - low) - 1.0, width)
            for a in ti.static(range(width)):
                node[k, WEIGHTS + axis * width + a] = w[a]
            if ti.static(periodic):
                size = rows if axis == 0 else columns
                first = wrapped(ti.cast(first, ti.i32), size)
            site[k, axis] = position
            node[k, ROW + axis] = first


@ti.kernel
def spread(
    load: Table, node: Table, begin: Integers, grid: Table,
    columns: ti.i32, bands: ti.i32, width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """The forces on the grid, each band adding up the contacts that reach it."""
    rows = grid.shape[0]
    groups = ti.raw_div(columns + BIN - 1, BIN)
    for band in range(bands):
        top, bottom = first_row(band, bands, rows), first_row(band + 1, bands, rows)
        for row in range(top, bottom):
            for c in range(grid.shape[1]):
                grid[row, c] = 0.0
        start = top - width + 1
        for piece in ti.static(range(1 + periodic)):
            # A window that begins below the periodic cell begins above it, too.
            low, high, shift = 0, 0, 0
            if ti.static(piece == 0):
                low, high = ti.raw_div(ti.max(start, 0) * bands, rows), band + 1
            elif start < 0:
                low, high, shift = ti.raw_div((start + rows) * bands, rows), bands, rows
            for k in range(begin[low * groups], begin[high * groups]):
                row = ti.cast(node[k, ROW], ti.i32) - shift
                c = ti.cast(node[k, COLUMN], ti.i32)
                f = load[0, k]
                u = ti.Vector([node[k, WEIGHTS + width + b] for b in ti.static(range(width))])
                for r in range(ti.max(row, top), ti.min(row + width, bottom)):
                    w = f * node[k, WEIGHTS + r - row]
                    if ti.static(periodic) and c + width > columns:
                        for b in range(width):
                            grid[r, wrapped(c + b, columns)] += w * node[k, WEIGHTS + width + b]
                    else:
                        # All loads before all stores: else the compiler must assume that one
                        # overlaps another, and handles one number at a time.
                        held = ti.Vector([grid[r, c + b] for b in ti.static(range(width))])
                        for b in ti.static(range(width)):
                            grid[r, c + b] = held[b] + w * u[b]


@ti.func
def row_of(
    grid: ti.template(), row, column, rows, columns, width: ti.template(), periodic: ti.template()
):
    """Grid values under a window in one row."""
    values = ti.Vector([ti.cast(0.0, ti.f64)] * width)
    if ti.static(periodic):
        row = wrapped(row, rows)
    if ti.static(periodic) and column + width > columns:
        for b in ti.static(range(width)):
            values[b] = grid[row, wrapped(column + b, columns)]
    else:
        for b in ti.static(range(width)):
            values[b] = grid[row, column + b]
    return values


@ti.kernel
def gather(
    grid: Table, load: Table, node: Table, value: Numbers, index: Integers,
    rows: ti.i32, columns: ti.i32, own: ti.f64, scale: ti.f64,
    width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Depression of every contact: from the grid, less its own share, and from its pairs."""
    for k in range(node.shape[0]):
        row, column = ti.cast(node[k, ROW], ti.i32), ti.cast(node[k, COLUMN], ti.i32)
        across = ti.Vector([ti.cast(0.0, ti.f64)] * width)
        for a in range(width):
            values = row_of(grid, row + a, column, rows, columns, width, periodic)
            across += node[k, WEIGHTS + a] * values
        total = -own * load[0, k]
        for b in ti.static(range(width)):
            total += across[b] * node[k, WEIGHTS + width + b]
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            total += value[m] * load[0, index[m]]
        load[1, k] = scale * total


@ti.func
def difference(site: ti.template(), k, m, period, periodic: ti.template()):
    """From contact m to contact k, by the shortest way in a periodic cell."""
    d = ti.Vector([site[k, 0] - site[m, 0], site[k, 1] - site[m, 1]])
    if ti.static(periodic):
        d -= period * ti.round(d / period)
    return d


@ti.func
def distance_squared(site: ti.template(), k, m, period, periodic: ti.template()):
    d = difference(site, k, m, period, periodic)
    return d.dot(d)


@ti.kernel
def gather_slope(
    grid: Table, load: Table, site: Table, node: Table, value: Numbers, index: Integers,
    polynomials: Table, derivatives: Table, short: Numbers,
    origin: vec2, spacing: vec2, period: vec2, rows: ti.i32, columns: ti.i32,
    own: ti.f64, scale: ti.f64, cutoff: ti.f64, left_out: ti.f64,
    width: ti.template(), degree: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Depression, as `gather`, and the gradient of -1 times it, from the same sums."""
    for k in range(node.shape[0]):
        u = ti.Vector([node[k, WEIGHTS + width + a] for a in ti.static(range(width))])
        v = ti.Vector([ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)])
        for axis in ti.static(range(2)):
            low = (site[k, axis] - origin[axis]) / spacing[axis] - 0.5 * width
            v[axis] = 2.0 * (ti.ceil(low) - low) - 1.0
        dw = weights(derivatives, v[0], width)
        du = weights(derivatives, v[1], width)
        row, column = ti.cast(node[k, ROW], ti.i32), ti.cast(node[k, COLUMN], ti.i32)
        across = ti.Vector([ti.cast(0.0, ti.f64)] * width)
        steep = ti.Vector([ti.cast(0.0, ti.f64)] * width)
        for a in range(width):
            values = row_of(grid, row + a, column, rows, columns, width, periodic)
            across += node[k, WEIGHTS + a] * values
            steep += dw[a] * values
        total = -own * load[0, k]
        slope = ti.Vector([ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)])
        for b in ti.static(range(width)):
            total += across[b] * u[b]
            # v falls by 2 where the contact moves on by a cell
            slope[0] += 2.0 * steep[b] * u[b] / spacing[0]
            slope[1] += 2.0 * across[b] * du[b] / spacing[1]
        p = ti.Vector([short[a] for a in ti.static(range(degree + 1))])
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            other = index[m]
            f = load[0, other]
            total += value[m] * f
            d = difference(site, k, other, period, periodic)
            squared = d.dot(d)
            s = 2.0 * squared / cutoff**2 - 1.0
            rise = ti.cast(0.0, ti.f64)  # dP/dv, by Horner's rule
            for a in ti.static(range(degree, 0, -1)):
                rise = rise * s + a * p[a]
            steepness = 4.0 * rise / cutoff**3
            if squared > left_out:
                steepness += 1.0 / (squared * ti.sqrt(squared))
            slope += f * steepness * d
        load[1, k] = scale * total
        load[2, k] = scale * slope[0]
        load[3, k] = scale * slope[1]
