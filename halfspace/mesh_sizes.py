"""What sizes of contacts add to the particle mesh, compiled: sums of 1/r^3, the Laplacian of 1/r.

The arrays are those of `mesh_kernels`; besides, `loads` (2, n) holds forces and moments in sorted
order, `curved` the Laplacians of pairs as `value` holds 1/r less its smooth part, and `bend` the
polynomial of the smooth part's Laplacian, as `short` is that of the smooth part.
"""

# mypy: ignore-errors
# (annotations are the compiler's types, which no checker knows)
from .backend import ti
from .mesh_kernels import (
    COLUMN,
    COUNT,
    FIRST,
    ROW,
    WEIGHTS,
    Integers,
    Numbers,
    Table,
    difference,
    distance_squared,
    row_of,
    vec2,
    weights,
)


@ti.kernel
def closest(
    site: Table, node: Table, index: Integers, least: Numbers, period: vec2, periodic: ti.template()
):  # fmt: skip
    """The least squared distance of a contact to one of its neighbours, or what stood there."""
    for k in range(node.shape[0]):
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            squared = distance_squared(site, k, index[m], period, periodic)
            least[k] = ti.min(least[k], squared)


@ti.kernel
def curve(
    site: Table, node: Table, curved: Numbers, index: Integers, bend: Numbers, period: vec2,
    cutoff: ti.f64, left_out: ti.f64, degree: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """The Laplacians of pairs: 1/r^3, but not of those left out, less the smooth part's."""
    for k in range(node.shape[0]):
        p = ti.Vector([bend[a] for a in ti.static(range(degree + 1))])
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            squared = distance_squared(site, k, index[m], period, periodic)
            s = 2.0 * squared / cutoff**2 - 1.0
            smooth = p[degree]
            for a in ti.static(range(degree - 1, -1, -1)):
                smooth = smooth * s + p[a]
            inverse = ti.select(squared > left_out, 1.0 / ti.sqrt(squared), 0.0)
            curved[m] = inverse**3 - smooth / cutoff**3


@ti.func
def interpolate(
    grid: ti.template(), node: ti.template(), k, rows, columns,
    width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """The value of a grid at contact k."""
    row, column = ti.cast(node[k, ROW], ti.i32), ti.cast(node[k, COLUMN], ti.i32)
    across = ti.Vector([ti.cast(0.0, ti.f64)] * width)
    for a in range(width):
        values = row_of(grid, row + a, column, rows, columns, width, periodic)
        across += node[k, WEIGHTS + a] * values
    total = ti.cast(0.0, ti.f64)
    for b in ti.static(range(width)):
        total += across[b] * node[k, WEIGHTS + width + b]
    return total


@ti.kernel
def gather_pair(
    near: Table, steep: Table, loads: Table, result: Table, node: Table,
    value: Numbers, curved: Numbers, index: Integers,
    rows: ti.i32, columns: ti.i32, own: ti.f64, own_curved: ti.f64, scale: ti.f64,
    width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Depression by forces and moments, and the Laplacian of that by the forces: result 0, 1."""
    for k in range(node.shape[0]):
        w = interpolate(near, node, k, rows, columns, width, periodic)
        bent = interpolate(steep, node, k, rows, columns, width, periodic)
        w -= own * loads[0, k] + own_curved * loads[1, k]
        bent -= own_curved * loads[0, k]
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            f = loads[0, index[m]]
            w += value[m] * f + curved[m] * loads[1, index[m]]
            bent += curved[m] * f
        result[0, k], result[1, k] = scale * w, scale * bent


@ti.func
def gradient(
    grid: ti.template(), site: ti.template(), node: ti.template(), derivatives: ti.template(), k,
    origin, spacing, rows, columns, width: ti.template(), periodic: ti.template(),
):  # fmt: skip
    """Minus the gradient of a grid's interpolation at contact k."""
    u = ti.Vector([node[k, WEIGHTS + width + a] for a in ti.static(range(width))])
    v = ti.Vector([ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)])
    for axis in ti.static(range(2)):
        low = (site[k, axis] - origin[axis]) / spacing[axis] - 0.5 * width
        v[axis] = 2.0 * (ti.ceil(low) - low) - 1.0
    dw = weights(derivatives, v[0], width)
    du = weights(derivatives, v[1], width)
    row, column = ti.cast(node[k, ROW], ti.i32), ti.cast(node[k, COLUMN], ti.i32)
    across = ti.Vector([ti.cast(0.0, ti.f64)] * width)
    along = ti.Vector([ti.cast(0.0, ti.f64)] * width)
    for a in range(width):
        values = row_of(grid, row + a, column, rows, columns, width, periodic)
        across += node[k, WEIGHTS + a] * values
        along += dw[a] * values
    fall = ti.Vector([ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)])
    for b in ti.static(range(width)):
        fall[0] += 2.0 * along[b] * u[b] / spacing[0]
        fall[1] += 2.0 * across[b] * du[b] / spacing[1]
    return fall


@ti.func
def rise(p: ti.template(), s, degree: ti.template()):
    """The derivative of a polynomial, by Horner's rule."""
    total = ti.cast(0.0, ti.f64)
    for a in ti.static(range(degree, 0, -1)):
        total = total * s + a * p[a]
    return total


@ti.kernel
def gather_falls(
    near: Table, steep: Table, loads: Table, result: Table, site: Table, node: Table,
    index: Integers, derivatives: Table, short: Numbers, bend: Numbers,
    origin: vec2, spacing: vec2, period: vec2, rows: ti.i32, columns: ti.i32,
    scale: ti.f64, cutoff: ti.f64, left_out: ti.f64,
    width: ti.template(), degree: ti.template(), bend_degree: ti.template(),
    periodic: ti.template(),
):  # fmt: skip
    """Minus the gradients of what `gather_pair` gives: result 2, 3 and 4, 5."""
    for k in range(node.shape[0]):
        fall = gradient(
            near, site, node, derivatives, k, origin, spacing, rows, columns, width, periodic
        )
        bent = gradient(
            steep, site, node, derivatives, k, origin, spacing, rows, columns, width, periodic
        )
        p = ti.Vector([short[a] for a in ti.static(range(degree + 1))])
        b = ti.Vector([bend[a] for a in ti.static(range(bend_degree + 1))])
        first = ti.cast(node[k, FIRST], ti.i32)
        for m in range(first, first + ti.cast(node[k, COUNT], ti.i32)):
            other = index[m]
            d = difference(site, k, other, period, periodic)
            squared = d.dot(d)
            s = 2.0 * squared / cutoff**2 - 1.0
            inverse = ti.select(squared > left_out, 1.0 / ti.sqrt(squared), 0.0)
            single = inverse**3 + 4.0 * rise(p, s, degree) / cutoff**3
            double = 3.0 * inverse**5 + 4.0 * rise(b, s, bend_degree) / cutoff**5
            fall += (loads[0, other] * single + loads[1, other] * double) * d
            bent += loads[0, other] * double * d
        for axis in ti.static(range(2)):
            result[2 + axis, k] = scale * fall[axis]
            result[4 + axis, k] = scale * bent[axis]
