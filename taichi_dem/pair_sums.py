"""Sums over pairs of substrate contacts, in blocks of rows that threads may share.

Two kinds.  :meth:`PairSums.evaluate` is exact: what forces f at places y do to each contact,

    w_k = 1/(pi E') sum_j f_j [1/r + (a_j^2/10 + a_k^2/6)/r^3],

the slope of the surface, and the potential `1/(pi E') sum_j f_j [1/r + (a_j^2 + a_k^2)/(10 r^3)]`,
of which `f_k/2` is a contact's part of the coupling energy (:mod:`halfspace.finite`, where also
stands how contacts act that overlap).  :meth:`PairSums.apply` is the derivative dw/df by a matrix
that is kept in single precision for where the contacts were a while ago: good to a percent, it
leads the solve, and is never part of a result.

A row is summed in the order of the contacts by whoever it is: no bit depends on threads.
"""

import math

from halfspace.finite import INNER, TOUCHING
from taichi_dem.blocks import block_field
from taichi_dem.types import real, ti

SHIFT = 3
LANES = 1 << SHIFT  # rows of a block, side by side in the processor's vectors
lanes = ti.types.vector(LANES, real)
narrow_lanes = ti.types.vector(LANES, ti.f32)
PairKernel = ti.types.struct(value=real, by_size=real, twice_by_size=real, by_square=real)


@ti.func
def of(field: ti.template(), k):
    """What contact ``k`` has in a field by blocks and lanes."""
    return field[k >> SHIFT, k & (LANES - 1)]


@ti.func
def pair_kernel(square: real, size: real) -> PairKernel:
    """K of two contacts at the squared distance ``square`` with ``size = a_j^2 + a_k^2``, and its
    derivatives by both; nothing for two points at one place."""
    kernel = PairKernel(value=0.0, by_size=0.0, twice_by_size=0.0, by_square=0.0)
    if square > TOUCHING * size:
        inverse = 1.0 / ti.sqrt(square)
        cubed = inverse / square
        kernel.value = inverse + 0.1 * size * cubed
        kernel.by_size = 0.1 * cubed
        kernel.by_square = -0.5 * cubed - 0.15 * size * cubed / square
    elif size > 0.0:
        root, u = ti.sqrt(size), square / size
        c = ti.static([float(c) for c in INNER.coef])
        k = c[0] + u * (c[1] + u * (c[2] + u * c[3]))
        k1 = c[1] + u * (2.0 * c[2] + u * 3.0 * c[3])
        k2 = 2.0 * c[2] + 6.0 * c[3] * u
        h = 0.5 * k + u * k1
        kernel.value = k / root
        kernel.by_size = -h / (root * size)
        kernel.twice_by_size = (1.5 * h + u * (1.5 * k1 + u * k2)) / (root * size * size)
        kernel.by_square = k1 / (root * size)
    return kernel


@ti.data_oriented
class PairSums:
    """Fields of at most ``capacity`` contacts; ``finite``: they have sizes, or are points.

    Set by the caller, for each of ``count`` contacts: place x, y (m), force f (N), square a^2 (m2).
    Come back: displacement w (m), potential (m), slope_x, slope_y (the gradient of -w) and, of
    points, nearest, the squared distance to the next one that carries load (m2).
    """

    def __init__(self, capacity: int, modulus: float, finite: bool, builder: "ti.FieldsBuilder"):
        self.capacity, self.finite, self._modulus = capacity, finite, modulus
        blocks = -(-capacity // LANES)
        rows = blocks * LANES
        self.count, self.sources, self.loads = (ti.field(ti.i32) for _ in range(3))
        self.compliance, self.unit = ti.field(real), ti.field(real)  # 1/(pi E'), of ``loads``
        builder.place(self.count, self.sources, self.loads, self.compliance, self.unit)
        for name in (
            "x y square force old_x old_y old_square"
            " source_x source_y source_square source_force source_moment"
        ).split():
            setattr(self, name, ti.field(real))
            builder.dense(ti.i, rows).place(getattr(self, name))
        for name in "displacement potential slope_x slope_y nearest image".split():
            setattr(self, name, block_field(builder, blocks, LANES))
        self.moved, self.load_place = ti.field(ti.i32), ti.field(ti.i32)
        builder.dense(ti.i, rows).place(self.moved)
        builder.dense(ti.i, rows).place(self.load_place)
        self.load, self.matrix = ti.field(ti.f32), ti.field(ti.f32)
        builder.dense(ti.i, rows).place(self.load)
        builder.dense(ti.ij, (blocks, rows)).dense(ti.k, LANES).place(self.matrix)

    def fill(self) -> None:
        """Write the constants, after the fields have been placed."""
        self.compliance[None] = 1 / (math.pi * self._modulus)

    @ti.func
    def blocks(self):
        return (self.count[None] + LANES - 1) // LANES

    # -- exact -----------------------------------------------------------------------------------

    @ti.func
    def gather_sources(self):
        """Note the contacts that carry force, before :meth:`evaluate`."""
        found = 0
        k = 0
        while k < self.count[None]:
            if self.force[k] != 0.0:
                self.source_x[found], self.source_y[found] = self.x[k], self.y[k]
                self.source_force[found] = self.force[k]
                self.source_square[found] = self.square[k]
                self.source_moment[found] = 0.1 * self.force[k] * self.square[k]
                found += 1
            k += 1
        self.sources[None] = found

    @ti.func
    def evaluate(self, block):
        """Displacement, potential and slope of the contacts of a block."""
        first = block * LANES
        x, y, square = lanes(0.0), lanes(0.0), lanes(0.0)
        near, steep, slope_x, slope_y = lanes(0.0), lanes(0.0), lanes(0.0), lanes(0.0)
        left_out, nearest, own = lanes(0.0), lanes(math.inf), 0.0
        for lane in ti.static(range(LANES)):
            x[lane], y[lane] = self.x[first + lane], self.y[first + lane]
            square[lane] = self.square[first + lane]
            if first + lane < self.count[None] and self.force[first + lane] != 0.0:
                own += 1.0
        for j in range(self.sources[None]):
            dx, dy, force = x - self.source_x[j], y - self.source_y[j], self.source_force[j]
            r2 = dx * dx + dy * dy
            fall = lanes(0.0)
            if ti.static(self.finite):
                size, moment = self.source_square[j], self.source_moment[j]
                apart = r2 > TOUCHING * (square + size)
                inverse = ti.select(apart, 1.0 / ti.sqrt(r2), lanes(0.0))
                left_out += ti.select(apart, lanes(0.0), lanes(1.0))
                inverse2 = inverse * inverse
                cubed = inverse * inverse2
                fifth = cubed * inverse2
                near += force * inverse + moment * cubed
                steep += force * cubed
                fall = force * (cubed + 0.3 * square * fifth) + 3.0 * moment * fifth
            else:
                apart = r2 > 0.0
                inverse = ti.select(apart, 1.0 / ti.sqrt(r2), lanes(0.0))
                near += force * inverse
                fall = force * (inverse * inverse * inverse)
                nearest = ti.min(nearest, ti.select(apart, r2, lanes(math.inf)))
            slope_x += fall * dx
            slope_y += fall * dy
        unit = self.compliance[None]
        self.put(block, self.displacement, unit * (near + square / 6.0 * steep))
        self.put(block, self.potential, unit * (near + square / 10.0 * steep))
        self.put(block, self.slope_x, unit * slope_x)
        self.put(block, self.slope_y, unit * slope_y)
        if ti.static(not self.finite):
            self.put(block, self.nearest, nearest)
        if ti.static(self.finite):
            if left_out.sum() > own:
                for lane in range(ti.min(LANES, self.count[None] - first)):
                    self.add_overlapping(block, lane)

    @ti.func
    def put(self, block, field: ti.template(), values):
        """Write the lanes of a block; side by side, so that they stay in the vectors."""
        for lane in ti.static(range(LANES)):
            field[block, lane] = values[lane]

    @ti.func
    def add_overlapping(self, block, lane):
        """What contacts do that overlap the contact of a lane."""
        k = block * LANES + lane
        j = 0
        while j < self.count[None]:
            dx, dy = self.x[k] - self.x[j], self.y[k] - self.y[j]
            square, size = dx * dx + dy * dy, self.square[k] + self.square[j]
            if j != k and not square > TOUCHING * size:
                kernel = pair_kernel(square, size)
                force = self.compliance[None] * self.force[j]
                sunk = kernel.value + 2.0 / 3.0 * self.square[k] * kernel.by_size
                self.displacement[block, lane] += force * sunk
                self.potential[block, lane] += force * kernel.value
                self.slope_x[block, lane] -= 2.0 * force * kernel.by_square * dx
                self.slope_y[block, lane] -= 2.0 * force * kernel.by_square * dy
            j += 1

    # -- the kept matrix -------------------------------------------------------------------------

    @ti.func
    def renew(self, block):
        """The matrix of a block anew where contacts have ``moved``, from their old places."""
        first, all_of_it = block * LANES, 0
        for lane in ti.static(range(LANES)):
            all_of_it += self.moved[first + lane]
        j = 0
        while j < self.count[None]:
            if all_of_it + self.moved[j] > 0:
                lane = 0
                while lane < ti.min(LANES, self.count[None] - first):
                    self.matrix[block, j, lane] = ti.cast(self.influence(first + lane, j), ti.f32)
                    lane += 1
            j += 1

    @ti.func
    def influence(self, k, j):
        """pi E' dw_k/df_j between old places."""
        dx, dy = self.old_x[k] - self.old_x[j], self.old_y[k] - self.old_y[j]
        mine, other, value = self.old_square[k], self.old_square[j], 0.0
        if j != k:
            kernel = pair_kernel(dx * dx + dy * dy, mine + other)
            value = kernel.value
            value += 2.0 / 3.0 * (mine + other) * kernel.by_size
            value += 4.0 / 9.0 * mine * other * kernel.twice_by_size
        return value

    @ti.func
    def gather_loads(self, values: ti.template()):
        """Note which of ``values`` (N) are not zero, before :meth:`apply`."""
        found, largest = 0, 0.0
        k = 0
        while k < self.count[None]:
            largest = ti.max(largest, ti.abs(values[k]))
            k += 1
        k = 0
        while k < self.count[None]:
            if values[k] != 0.0:
                self.load[found] = ti.cast(values[k] / largest, ti.f32)
                self.load_place[found] = k
                found += 1
            k += 1
        self.loads[None], self.unit[None] = found, largest * self.compliance[None]

    @ti.func
    def apply(self, block):
        """image = (dw/df) values, of a block."""
        sums = narrow_lanes(0.0)
        for q in range(self.loads[None]):
            j, load = self.load_place[q], self.load[q]
            for lane in ti.static(range(LANES)):
                sums[lane] += self.matrix[block, j, lane] * load
        self.put(block, self.image, self.unit[None] * ti.cast(sums, real))
