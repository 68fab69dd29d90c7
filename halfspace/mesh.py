"""Fast summation: a smooth part on a grid, by Fourier transforms, and near pairs one by one.

`C f` for the point kernel with all the forces, in a time that grows with their number and not with
its square. Each force is spread over the grid by a window, the grid is convolved with the smooth
part of 1/r, and the same window reads the result; what the smooth part lacks is added pair by pair
within the cutoff. A force's action on itself by the smooth part, `Phi'(0)/rc`, is subtracted.

The slope is the exact derivative of the energy `1/2 f.C f` of this very sum, windows and all, and
`C` is symmetric to rounding: whatever the tolerance, the forces derive from a potential as long as
the grid stays. (P. P. Ewald, 1921; R. W. Hockney & J. W. Eastwood, Computer Simulation Using
Particles, 1988, ch. 8; the split and the window are those of `splitting` and `window`.)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import mesh_kernels as kernels
from . import mesh_pairs, mesh_sizes
from .arrays import Array, host, kind_of
from .finite import Close
from .grid import Grid
from .layer_kernel import LayerKernel

SPARE = 1.1  # room for pairs, over what is needed: refreshed plans need a little more or less
CROWDED = 3.0  # growth of that room at which a grid no longer suits


class MeshSum:
    """The sums over one layout of contacts.

    x: (n, 2) positions, m; modulus: the plane-strain modulus `E'`, Pa; grid: one that they are on;
    reach, m: pairs no further apart are left out, at most the cutoff; workers: threads of the
    transforms, as in `scipy.fft` (the compiled loops use `HALFSPACE_THREADS`); layer: what one adds
    to 1/r, on the grid and under each contact itself. Raises ValueError for contacts that are not
    on the grid.
    """

    def __init__(
        self,
        x: Array,
        modulus: float,
        grid: Grid,
        reach: float = 0.0,
        workers: int | None = None,
        layer: LayerKernel | None = None,
    ) -> None:
        self.modulus, self.workers = modulus, workers
        self.grid, self._layer = grid, layer
        self._arrays = arrays = kind_of(x)
        self._value, self._index = arrays.empty(0), arrays.integers(0)
        self._curved, self._bent = arrays.empty(0), None
        self._prepare(grid)
        self.x, self._most = arrays.empty((0, 2)), np.inf
        if not self.refresh(x, reach):
            x = host(x)
            raise ValueError(f"x = {x.min(axis=0)} ... {x.max(axis=0)}: must lie on {grid}")
        self._most = CROWDED * float(self._space[-1])

    def _prepare(self, grid: Grid) -> None:
        """What depends on the grid alone."""
        window, split, arrays = grid.accuracy.window, grid.accuracy.split, self._arrays
        powers = np.arange(len(window.polynomials) - 1, 0, -1)
        self._polynomials = arrays.array(window.polynomials)
        self._derivatives = arrays.array(window.polynomials[:-1] * powers[:, None])
        self._short = arrays.array(split.polynomial)
        self._own = split.origin / grid.cutoff
        self._influence = arrays.array(grid.influence(self._layer))
        rows, columns = grid.points
        # As high as the cutoff, in whole rows: two contacts that near begin at most so many apart.
        self._bands = max(rows // int(np.ceil(grid.cutoff / grid.spacing[0])), 1)
        self._begin = arrays.integers(self._bands * -(-columns // kernels.BIN) + 2)
        self._space = arrays.zeros(self._bands + 1)
        self._density = arrays.empty(grid.points)
        width, periodic = grid.accuracy.width, int(grid.period is not None)
        vector = kernels.vec2
        self._place = (vector(grid.origin), vector(grid.spacing))
        self._period = vector(grid.period if periodic else (1.0, 1.0))
        self._kind = (width, periodic)

    def refresh(self, x: Array, reach: float = 0.0) -> bool:
        """The same grid for contacts that have moved, come or gone, (n, 2) m.

        False, and no longer fit for use, if they have left it or crowd so that another would be
        cheaper by far.
        """
        n, grid, arrays = len(x), self.grid, self._arrays
        if n != len(self.x):
            self._order, self._bins = arrays.integers(n), arrays.integers(n)
            self._load, self._site = arrays.empty((4, n)), arrays.empty((n, 2))
            self._node = arrays.empty((n, kernels.WEIGHTS + 2 * grid.accuracy.width))
        self.x, self.reach = x, reach
        if reach > grid.cutoff or self._sort() or not self._make_room():
            return False
        kernels.place(
            x, self._order, self._site, self._node, self._polynomials,
            *self._place, *grid.points, *self._kind,
        )  # fmt: skip
        self._find_pairs()
        return True

    def _sort(self) -> int:
        """How many contacts are not on the grid."""
        return int(
            kernels.sort(
                self.x, self._order, self._bins, self._begin,
                *self._place, *self.grid.points, self._bands, *self._kind,
            )
        )  # fmt: skip

    def _make_room(self) -> bool:
        """Storage for pairs, unless there are far too many."""
        grid = self.grid
        columns = int(np.ceil(grid.cutoff / grid.spacing[1]))  # apart, two that near, at most
        reach = -(-columns // kernels.BIN)
        mesh_pairs.room(self._begin, self._space, reach, grid.points[1], self._bands, self._kind[1])
        needed = float(self._space[-1])
        if needed > min(self._most, np.iinfo(np.int32).max):
            return False
        if needed > len(self._value):
            size = int(SPARE * needed)
            self._value, self._index = self._arrays.empty(size), self._arrays.integers(size)
        return True

    def _find_pairs(self) -> None:
        grid, (width, periodic) = self.grid, self._kind
        site, node, begin = self._site, self._node, self._begin
        extent = (
            max((float(a.max() - a.min()) for a in self.x.T), default=0.0) if len(self.x) else 0.0
        )
        self._left_out = float(max(np.finfo(np.float64).eps * extent, self.reach)) ** 2
        mesh_pairs.pairs(
            site, node, begin, self._space, self._value, self._index, self._short,
            *self._place, self._period, *grid.points, self._bands,
            grid.cutoff, self._left_out,
            width, len(self._short) - 1, periodic,
        )  # fmt: skip
        self._curved_known = False
        self._closest: float | None = None

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact by the forces on the others, (n,), m."""
        potential = self._potential(f)
        kernels.gather(
            potential, self._load, self._node, self._value, self._index,
            *self.grid.points, self._own, 1 / (np.pi * self.modulus), *self._kind,
        )  # fmt: skip
        return self._unsorted(self._load[1])

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope (n, 2), the gradient of the expansion `e = -w`."""
        grid, (width, periodic) = self.grid, self._kind
        kernels.gather_slope(
            self._potential(f), self._load, self._site, self._node, self._value, self._index,
            self._polynomials, self._derivatives, self._short,
            *self._place, self._period, *grid.points, self._own, 1 / (np.pi * self.modulus),
            grid.cutoff, self._left_out, width, len(self._short) - 1, periodic,
        )  # fmt: skip
        return self._unsorted(self._load[1]), self._unsorted(self._load[2:].T)

    def _unsorted(self, values: Array) -> Array:
        result: Array = self._arrays.empty(values.shape)
        result[self._order] = values
        return result

    def pair(self, f: Array, q: Array | None) -> tuple[Array, Array]:
        """Depression by the forces `f` and the moments `q`, and the Laplacian of that by `f`.

        As `direct.DirectSum.pair`; with twice the transforms of `apply`.
        """
        if q is None:
            return self.apply(f), self._arrays.zeros(len(f))
        self._gather_pair(f, q)
        return self._unsorted(self._result[0]), self._unsorted(self._result[1])

    def pair_slope(self, f: Array, q: Array) -> tuple[Array, Array, Array, Array]:
        """What `pair` gives, and minus the gradients of both, (n, 2) each."""
        near, steep = self._gather_pair(f, q)
        grid, (width, periodic) = self.grid, self._kind
        mesh_sizes.gather_falls(
            near, steep, self._loads, self._result, self._site, self._node, self._index,
            self._derivatives, self._short, self._bend, *self._place, self._period, *grid.points,
            1 / (np.pi * self.modulus), grid.cutoff, self._left_out,
            width, len(self._short) - 1, len(self._bend) - 1, periodic,
        )  # fmt: skip
        depression, laplacian = self._result[0], self._result[1]
        parts = depression, laplacian, self._result[2:4].T, self._result[4:6].T
        near, steep, fall, steep_fall = map(self._unsorted, parts)
        return near, steep, fall, steep_fall

    @property
    def closest(self) -> float:
        """The least distance between two contacts, m; at most the cutoff is looked at."""
        if self._closest is None:
            least = self._arrays.zeros(len(self.x)) + self.grid.cutoff**2
            mesh_sizes.closest(
                self._site, self._node, self._index, least, self._period, self._kind[1]
            )
            self._closest = float(least.min()) ** 0.5 if len(least) else np.inf
        return self._closest

    def close(self) -> Close:
        """The pairs that are left out."""
        from scipy.spatial import cKDTree

        box, place = self.grid.period, host(self.x)
        x = place if box is None else np.mod(place, box) % box
        tree = cKDTree(x, boxsize=box)
        k, j = tree.query_pairs(float(np.sqrt(self._left_out)), output_type="ndarray").T
        k, j = np.r_[k, j], np.r_[j, k]
        order = np.lexsort((j, k))
        k, j = k[order], j[order]
        d = place[k] - place[j]
        if box is not None:
            d -= np.round(d / box) * box
        return Close(len(x), k, j, d)

    def _gather_pair(self, f: Array, q: Array) -> tuple[Array, Array]:
        grid, (width, periodic) = self.grid, self._kind
        if self._bent is None:
            split = grid.accuracy.curved
            self._bend = self._arrays.array(split.laplacian)
            self._own_curved = split.bend / grid.cutoff**3
            self._bent = self._arrays.array(grid.curved_influence(self._layer))
        if not self._curved_known:
            if len(self._curved) != len(self._value):
                self._curved = self._arrays.empty(len(self._value))
            mesh_sizes.curve(
                self._site, self._node, self._curved, self._index, self._bend, self._period,
                grid.cutoff, self._left_out, len(self._bend) - 1, periodic,
            )  # fmt: skip
            self._curved_known = True
            self._loads, self._result = (self._arrays.empty((m, len(f))) for m in (2, 6))
        forces, moments = self._transform(f), self._transform(q)
        for load, values in zip(self._loads, (f, q), strict=True):
            load[:] = self._arrays.take(values, self._order)
        near = self._back(forces * self._influence + moments * self._bent)
        steep = self._back(forces * self._bent)
        mesh_sizes.gather_pair(
            near, steep, self._loads, self._result, self._node,
            self._value, self._curved, self._index, *grid.points,
            self._own, self._own_curved, 1 / (np.pi * self.modulus), width, periodic,
        )  # fmt: skip
        return near, steep

    def _potential(self, f: Array) -> Array:
        """The smooth part of f/r, summed, on the grid."""
        spectrum = self._transform(f)
        spectrum *= self._influence
        return self._back(spectrum)

    def _transform(self, f: Array) -> Any:
        """Forces on the grid, transformed."""
        self._load[0] = self._arrays.take(f, self._order)
        kernels.spread(
            self._load, self._node, self._begin, self._density,
            self.grid.points[1], self._bands, *self._kind,
        )  # fmt: skip
        return self._arrays.transform(self._density, self.grid.torus, self.workers)

    def _back(self, spectrum: Any) -> Array:
        columns, rows = self.grid.torus[1], self.grid.points[0]
        return self._arrays.back(spectrum, rows, columns, self.workers)
