"""Cells in a dense or a sparse tree, and the particles sorted into them.

Both layouts have two levels, blocks of cells, and run under the same kernels; in the sparse one a
block exists only while something is in it.  Blocks are long in z, where their particles stand one
after another: a search reads them in few pieces.  Cell numbers wrap around, so the domain
has no edge: far apart cells may share a slot, which costs a few distance checks and loses nothing.
Along a side that repeats itself, a whole number of cells makes up one period.
"""

import math

import numpy as np

from taichi_dem.particles import Particles
from taichi_dem.types import real, ti, vec3

BLOCK = (2, 2, 16)  # cells per block and axis
CELLS = math.prod(BLOCK)
MOST_SPARSE_BLOCKS = 2**18  # pointers, 8 bytes each
DENSE_CELLS_PER_PARTICLE = 16  # up to here a dense tree costs less than pointers

Near = ti.types.struct(position=vec3, radius=real)


@ti.data_oriented
class Grid:
    """Cells of edge ``cell_size`` (m, may change) for ``particles`` spread over ``extent`` (3,) m;
    ``period``: the lengths of the sides that repeat themselves along x and y, m, or ().

    After :meth:`sort`, the particles of a cell are ``particle[end - population : end]``, and
    those of cells that follow each other in z within a block stand in one piece; ``near`` and
    ``rank`` hold in the same order what a search reads of them.
    """

    def __init__(
        self,
        particles: Particles,
        cell_size: float,
        extent: np.ndarray,
        period: tuple[float, ...] = (),
    ):
        self.particles, self.period = particles, period
        n = particles.count
        blocks = [_power_of_two(cells) for cells in (extent / cell_size + 1) / BLOCK]
        self.dense = math.prod(blocks) * CELLS <= DENSE_CELLS_PER_PARTICLE * max(n, 64)
        while math.prod(blocks) > MOST_SPARSE_BLOCKS:
            blocks[int(np.argmax(blocks))] //= 2
        self.mask = [b * size - 1 for b, size in zip(blocks, BLOCK, strict=True)]
        self.blocks = blocks

        self.block_population = ti.field(ti.i32)
        self.population, self.end = ti.field(ti.i32), ti.field(ti.i32)
        builder = ti.FieldsBuilder()
        layout = builder.dense if self.dense else builder.pointer
        self.block = layout(ti.ijk, blocks)
        self.block.place(self.block_population)
        self.block.dense(ti.ijk, BLOCK).place(self.population, self.end)

        self.particle, self.rank = ti.field(ti.i32), ti.field(ti.i32)
        self.near = Near.field()
        self.cell = ti.Vector.field(3, ti.i32)
        self.occupied, self.left = ti.Vector.field(3, ti.i32), ti.Vector.field(3, ti.i32)
        builder.dense(ti.i, n).place(self.particle)
        builder.dense(ti.i, n).place(self.rank)
        builder.dense(ti.i, n).place(self.near)
        builder.dense(ti.i, n).place(self.cell)
        builder.dense(ti.i, n).place(self.occupied, self.left)
        self.occupied_count, self.cell_size = ti.field(ti.i32), ti.field(real)
        builder.dense(ti.i, 1).place(self.occupied_count)
        builder.place(self.cell_size)
        self.tree = builder.finalize()
        self.cell_size[None] = cell_size

    @ti.func
    def cell_at(self, position):
        """The wrapped cell of a point; 64 bits, so that kilometres of micrometre cells fit."""
        wrapped, cells = ti.Vector([0, 0, 0]), self.cells()
        for axis in ti.static(range(3)):
            cell = ti.cast(ti.floor(position[axis] / self.cell_size[None]), ti.i64)
            wrapped[axis] = ti.cast(cell & self.mask[axis], ti.i32)
        for axis in ti.static(range(len(self.period))):
            share = position[axis] / self.period[axis]
            cell = ti.cast((share - ti.floor(share)) * cells[axis], ti.i32)
            wrapped[axis] = ti.max(0, ti.min(cell, cells[axis] - 1))
        return wrapped

    @ti.func
    def cells(self):
        """How many there are along each axis before their numbers repeat; along a periodic side
        they are as wide as it takes for a whole number of them."""
        number = ti.Vector(self.mask) + 1
        for axis in ti.static(range(len(self.period))):
            fitting = ti.floor(self.period[axis] / self.cell_size[None])
            number[axis] = ti.cast(ti.max(ti.min(fitting, number[axis]), 1.0), ti.i32)
        return number

    @ti.func
    def slot(self, axis: ti.template(), cell, cells):
        """Where any number of a cell along x or y stands in the tree."""
        slot = cell & self.mask[axis]
        if ti.static(axis < len(self.period)):
            slot = cell % cells[axis]
        return slot

    @ti.kernel
    def sort(self):
        """Counting sort of the particles by cell, in one serial task: deterministic, and a
        fraction of the cost of the search that follows."""
        ti.loop_config(serialize=self.particles.few)
        for i in range(self.particles.count):
            self.cell[i] = self.cell_at(self.particles.body[i].position)
        ti.loop_config(serialize=True)
        for _ in range(1):
            self._clear()
            self._count()
            self._place()
        ti.loop_config(serialize=self.particles.few)
        for s in range(self.particles.count):
            i = self.particle[s]
            body = self.particles.body[i]
            self.near[s].position, self.near[s].radius = body.position, body.radius
            self.rank[s] = self.particles.rank[self.particles.spin[i].id]

    @ti.func
    def _clear(self):
        """Empty the blocks of the last sort, and remember which they were."""
        for b in range(self.occupied_count[0]):
            block = self.occupied[b]
            self.left[b] = block
            self.block_population[block] = 0
            for cell in ti.grouped(ti.ndrange(*BLOCK)):
                self.population[block * ti.Vector(BLOCK) + cell] = 0
                self.end[block * ti.Vector(BLOCK) + cell] = 0

    @ti.func
    def _count(self):
        left_count = self.occupied_count[0]
        found = 0
        for i in range(self.particles.count):
            cell = self.cell[i]
            block = cell // ti.Vector(BLOCK)
            if self.block_population[block] == 0:
                self.occupied[found] = block
                found += 1
            self.block_population[block] += 1
            self.population[cell] += 1
        self.occupied_count[0] = found
        self._line_up()
        if ti.static(not self.dense):
            for b in range(left_count):
                if self.block_population[self.left[b]] == 0:
                    ti.deactivate(self.block, self.left[b])

    @ti.func
    def _line_up(self):
        """Shell sort of the occupied blocks by place, so that neighbours are near in memory too."""
        gap = self.occupied_count[0] // 2
        while gap > 0:
            for b in range(gap, self.occupied_count[0]):
                block, free = self.occupied[b], b
                while free >= gap and self._before(block, self.occupied[free - gap]):
                    self.occupied[free] = self.occupied[free - gap]
                    free -= gap
                self.occupied[free] = block
            gap //= 2

    @ti.func
    def _before(self, one, other):
        step = ti.Vector([self.blocks[1] * self.blocks[2], self.blocks[2], 1])
        return (one - other).dot(step) < 0

    @ti.func
    def _place(self):
        placed = 0
        for b in range(self.occupied_count[0]):
            for cell in ti.grouped(ti.ndrange(*BLOCK)):
                at = self.occupied[b] * ti.Vector(BLOCK) + cell
                self.end[at] = placed
                placed += self.population[at]
        for i in range(self.particles.count):
            slot = self.end[self.cell[i]]
            self.particle[slot] = i
            self.end[self.cell[i]] = slot + 1

    @ti.kernel
    def number_in_order(self):
        """After the particles themselves have been moved into the order of the cells."""
        for s in range(self.particles.count):
            self.particle[s] = s
            self.cell[s] = self.cell_at(self.particles.body[s].position)


def _power_of_two(number: float) -> int:
    return 1 << max(0, math.ceil(math.log2(max(number, 1))))


def best_cell_size(radius: np.ndarray, skin: float, volume: float) -> float:
    """The cell edge (m) that makes the search cheapest, from the radii and the region's volume.

    A particle looks for partners no larger than itself, within 2 R + skin: cells of the size of
    the smallest are right for them and make the largest visit many; the cost of visiting a cell
    and of checking a particle in it decide.
    """
    reach = 2 * radius + skin
    candidates = np.unique(np.quantile(reach, np.linspace(0, 1, 9)))
    per_volume = len(radius) / volume
    costs = [
        np.sum((2 * np.ceil(reach / size) + 1) ** 3) * (1 + per_volume * size**3)
        for size in candidates
    ]
    return float(candidates[int(np.argmin(costs))])
