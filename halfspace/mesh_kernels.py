"""The loops of the particle mesh, compiled: sorting, spreading, gathering, short range.

Contacts are kept in the order of the grid rows that they touch first, and within a row in that of
small groups of columns. So a row of the grid finds the contacts that reach it in a few contiguous
stretches and adds them up itself, in that order: no two threads write to the same place, and the
bits do not depend on their number. The same stretches serve the search for neighbours.

Every array passed to a kernel costs about 10 us, so there are few: `node` (n, 6 + 2 w) holds, per
contact, its position, the first row and column of its window, the first of its pairs and their
number, and the weights of its window in both dimensions; `load` (4, n) the force, and depression
and slope as results.
"""

from .backend import start, ti

start()

Numbers = ti.types.ndarray(dtype=ti.f64, ndim=1)
Table = ti.types.ndarray(dtype=ti.f64, ndim=2)
Integers = ti.types.ndarray(dtype=ti.i32, ndim=1)
real, vec2 = ti.f64, ti.types.vector(2, ti.f64)

BIN = 2  # grid columns in a group
ROW, COLUMN, FIRST, COUNT, WEIGHTS = 2, 3, 4, 5, 6


@ti.func
def wrapped(i, size):
    """A grid index, or a group of columns, in a periodic cell."""
    return ti.raw_mod(ti.raw_mod(i, size) + size, size)


@ti.kernel
def sort(
    x: Table, order: Integers, bins: Integers, begin: Integers,
    origin: vec2, spacing: vec2, rows: ti.i32, columns: ti.i32,
    width: ti.template(), periodic: ti.template(),
) -> ti.i32:  # fmt: skip
    """Sort the contacts by row and group of columns; returns how many are not on the grid.

    order (n,); bins (n,) scratch; begin (groups + 2,): where each group starts in `order`.
    """
    groups = (columns + BIN - 1) // BIN
    outside = 0
    for i in range(x.shape[0]):
        row = ti.cast(ti.ceil((x[i, 0] - origin[0]) / spacing[0] - 0.5 * width), ti.i32)
        column = ti.cast(ti.ceil((x[i, 1] - origin[1]) / spacing[1] - 0.5 * width), ti.i32)
        if ti.static(periodic):
            row, column = wrapped(row, rows), wrapped(column, columns)
        elif row < 0 or row > rows - width or column < 0 or column > columns - width:
            outside += 1
            row, column = 0, 0
        bins[i] = row * groups + column // BIN
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
    x: Table, order: Integers, node: Table, polynomials: Table,
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
            node[k, axis] = position
            node[k, ROW + axis] = first


@ti.kernel
def spread(
    load: Table, node: Table, begin: Integers, grid: Table,
    columns: ti.i32, width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """The forces on the grid, each row adding up the contacts that reach it."""
    groups = (columns + BIN - 1) // BIN
    for row in range(grid.shape[0]):
        for c in range(grid.shape[1]):
            grid[row, c] = 0.0
        for a in range(width):
            first = row - a
            if ti.static(periodic):
                first = wrapped(first, grid.shape[0])
            if first >= 0:
                for k in range(begin[first * groups], begin[(first + 1) * groups]):
                    f = load[0, k] * node[k, WEIGHTS + a]
                    c = ti.cast(node[k, COLUMN], ti.i32)
                    if ti.static(periodic) and c + width > columns:
                        for b in range(width):
                            grid[row, wrapped(c + b, columns)] += f * node[k, WEIGHTS + width + b]
                    else:
                        # All loads before all stores: else the compiler must assume that one
                        # array overlaps another, and handles one number at a time.
                        w = ti.Vector(
                            [node[k, WEIGHTS + width + b] for b in ti.static(range(width))]
                        )
                        held = ti.Vector([grid[row, c + b] for b in ti.static(range(width))])
                        for b in ti.static(range(width)):
                            grid[row, c + b] = held[b] + f * w[b]


@ti.func
def along_rows(
    grid: ti.template(), node: ti.template(), w: ti.template(), k,
    rows, columns, width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Grid values under the window of contact k, summed over rows with the weights w."""
    row, column = ti.cast(node[k, ROW], ti.i32), ti.cast(node[k, COLUMN], ti.i32)
    total = ti.Vector([ti.cast(0.0, ti.f64)] * width)
    if ti.static(periodic) and (row + width > rows or column + width > columns):
        for a in ti.static(range(width)):
            for b in ti.static(range(width)):
                value = grid[wrapped(row + a, rows), wrapped(column + b, columns)]
                total[b] += w[a] * value
    else:
        for a in ti.static(range(width)):
            for b in ti.static(range(width)):
                total[b] += w[a] * grid[row + a, column + b]
    return total


@ti.kernel
def gather(
    grid: Table, load: Table, node: Table, value: Numbers, index: Integers,
    rows: ti.i32, columns: ti.i32, own: ti.f64, scale: ti.f64,
    width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Depression of every contact: from the grid, less its own share, and from its pairs."""
    for k in range(node.shape[0]):
        w = ti.Vector([node[k, WEIGHTS + a] for a in ti.static(range(width))])
        across = along_rows(grid, node, w, k, rows, columns, width, periodic)
        total = -own * load[0, k]
        for b in ti.static(range(width)):
            total += across[b] * node[k, WEIGHTS + width + b]
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            total += value[m] * load[0, index[m]]
        load[1, k] = scale * total


@ti.func
def difference(node: ti.template(), k, m, period, periodic: ti.template()):
    """From contact m to contact k, by the shortest way in a periodic cell."""
    d = ti.Vector([node[k, 0] - node[m, 0], node[k, 1] - node[m, 1]])
    if ti.static(periodic):
        d -= period * ti.round(d / period)
    return d


@ti.kernel
def gather_slope(
    grid: Table, load: Table, node: Table, value: Numbers, index: Integers,
    polynomials: Table, derivatives: Table, short: Numbers,
    origin: vec2, spacing: vec2, period: vec2, rows: ti.i32, columns: ti.i32,
    own: ti.f64, scale: ti.f64, cutoff: ti.f64, unresolved: ti.f64,
    width: ti.template(), degree: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Depression, as `gather`, and the gradient of -1 times it, from the same sums."""
    for k in range(node.shape[0]):
        w = ti.Vector([node[k, WEIGHTS + a] for a in ti.static(range(width))])
        u = ti.Vector([node[k, WEIGHTS + width + a] for a in ti.static(range(width))])
        v = ti.Vector([ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)])
        for axis in ti.static(range(2)):
            low = (node[k, axis] - origin[axis]) / spacing[axis] - 0.5 * width
            v[axis] = 2.0 * (ti.ceil(low) - low) - 1.0
        dw = weights(derivatives, v[0], width)
        du = weights(derivatives, v[1], width)
        across = along_rows(grid, node, w, k, rows, columns, width, periodic)
        steep = along_rows(grid, node, dw, k, rows, columns, width, periodic)
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
            d = difference(node, k, other, period, periodic)
            squared = d.dot(d)
            s = 2.0 * squared / cutoff**2 - 1.0
            rise = ti.cast(0.0, ti.f64)  # dP/dv, by Horner's rule
            for a in ti.static(range(degree, 0, -1)):
                rise = rise * s + a * p[a]
            steepness = 4.0 * rise / cutoff**3
            if squared > unresolved:
                steepness += 1.0 / (squared * ti.sqrt(squared))
            slope += f * steepness * d
        load[1, k] = scale * total
        load[2, k] = scale * slope[0]
        load[3, k] = scale * slope[1]


@ti.func
def stretch(
    node: ti.template(), begin: ti.template(), k, step, piece, cutoff, origin, spacing,
    rows, columns, width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Where the possible neighbours of contact k are that start `step` rows on: [from, to).

    Where the columns wrap around a periodic cell there is a second piece.
    """
    groups = (columns + BIN - 1) // BIN
    x0 = (node[k, 0] - origin[0]) / spacing[0] - 0.5 * width
    x1 = (node[k, 1] - origin[1]) / spacing[1] - 0.5 * width
    row = ti.cast(ti.ceil(x0), ti.i32) + step
    gap = ti.max(row - 1 - x0, x0 - row, 0.0) * spacing[0]  # to the nearest contact there
    low, high = 0, 0
    if gap < cutoff:
        chord = ti.sqrt(cutoff**2 - gap**2) / spacing[1]
        first = ti.floor(ti.ceil(x1 - chord) / BIN, ti.i32)
        last = ti.floor(ti.ceil(x1 + chord) / BIN, ti.i32)
        if ti.static(periodic):
            row = wrapped(row, rows)
            shift = first - wrapped(first, groups)
            first, last = first - shift, last - shift
            if piece == 0:
                last = ti.min(last, groups - 1)
            else:
                first, last = 0, last - groups
        else:
            first, last = ti.max(first, 0), ti.min(last, groups - 1)
        if 0 <= row < rows and first <= last:
            low, high = begin[row * groups + first], begin[row * groups + last + 1]
    return low, high


@ti.kernel
def candidates(
    node: Table, begin: Integers,
    origin: vec2, spacing: vec2, rows: ti.i32, columns: ti.i32, cutoff: ti.f64,
    width: ti.template(), periodic: ti.template(),
) -> ti.f64:  # fmt: skip
    """Room for the pairs of every contact, one after the other; returns the whole."""
    reach = ti.cast(ti.ceil(cutoff / spacing[0]), ti.i32)
    for k in range(node.shape[0]):
        room = 0
        for step in range(-reach, reach + 1):
            for piece in range(1 + periodic):
                low, high = stretch(
                    node, begin, k, step, piece, cutoff, origin, spacing,
                    rows, columns, width, periodic,
                )  # fmt: skip
                room += high - low
        node[k, COUNT] = room
    total = ti.cast(0.0, ti.f64)
    ti.loop_config(serialize=True)
    for k in range(node.shape[0]):
        node[k, FIRST] = total
        total += node[k, COUNT]
    return total


@ti.kernel
def pairs(
    node: Table, begin: Integers, value: Numbers, index: Integers, short: Numbers,
    origin: vec2, spacing: vec2, period: vec2, rows: ti.i32, columns: ti.i32,
    cutoff: ti.f64, unresolved: ti.f64,
    width: ti.template(), degree: ti.template(), periodic: ti.template(),
) -> ti.i32:  # fmt: skip
    """Find the neighbours of every contact and what they add to the grid.

    Returns how many pairs are too close to tell apart: of them nothing is left, grid included.
    """
    reach = ti.cast(ti.ceil(cutoff / spacing[0]), ti.i32)
    coincident = 0
    for k in range(node.shape[0]):
        first = ti.cast(node[k, FIRST], ti.i32)
        last = first
        for step in range(-reach, reach + 1):
            for piece in range(1 + periodic):
                low, high = stretch(
                    node, begin, k, step, piece, cutoff, origin, spacing,
                    rows, columns, width, periodic,
                )  # fmt: skip
                for m in range(low, high):
                    d = difference(node, k, m, period, periodic)
                    squared = d.dot(d)
                    if squared < cutoff**2 and m != k:
                        value[last] = squared
                        index[last] = m
                        last += 1
        node[k, COUNT] = last - first
        p = ti.Vector([short[a] for a in ti.static(range(degree + 1))])
        for m in range(first, last):
            squared = value[m]
            s = 2.0 * squared / cutoff**2 - 1.0
            smooth = p[degree]
            for a in ti.static(range(degree - 1, -1, -1)):
                smooth = smooth * s + p[a]
            near = squared <= unresolved
            value[m] = ti.select(near, 0.0, 1.0 / ti.sqrt(squared)) - smooth / cutoff
            coincident += ti.cast(near, ti.i32)
    return coincident // 2


@ti.kernel
def concentric(
    node: Table, value: Numbers, index: Integers, radius: Numbers, order: Integers,
    period: vec2, own: ti.f64, unresolved: ti.f64, periodic: ti.template(),
):  # fmt: skip
    """Pairs too close to tell apart act by one concentric Hertz pressure under the other
    (`greens.hertz_concentric`, times `pi E'`)."""
    for k in range(node.shape[0]):
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            d = difference(node, k, index[m], period, periodic)
            if d.dot(d) <= unresolved:
                a, b = radius[order[k]], radius[order[index[m]]]
                wide, narrow = ti.max(a, b), ti.min(a, b)
                value[m] = -own
                if wide > 0:
                    value[m] += 0.375 * ti.math.pi * (2.0 - 0.4 * (narrow / wide) ** 2) / wide
