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

import numpy as np
from numpy.typing import NDArray

from . import mesh_kernels as kernels
from . import mesh_pairs
from .checks import Array
from .grid import Grid
from .layer_kernel import LayerKernel

SPARE = 1.1  # room for pairs, over what is needed: refreshed plans need a little more or less
CROWDED = 3.0  # growth of that room at which a grid no longer suits


class MeshSum:
    """The sums over one layout of contacts.

    x: (n, 2) positions, m; modulus: the plane-strain modulus `E'`, Pa; grid: one that they are on;
    radius: (n,) contact radii, m, or None, used for coincident contacts alone; workers: threads of
    the transforms, as in `scipy.fft` (the compiled loops use `HALFSPACE_THREADS`); layer: what one
    adds to 1/r, on the grid and under each contact itself. Raises ValueError for contacts that are
    not on the grid.
    """

    def __init__(
        self,
        x: Array,
        modulus: float,
        grid: Grid,
        radius: Array | None = None,
        workers: int | None = None,
        layer: LayerKernel | None = None,
    ) -> None:
        self.modulus, self.workers = modulus, workers
        self.grid, self._layer = grid, layer
        self._value, self._index = np.empty(0), np.empty(0, np.int32)
        self._prepare(grid)
        self.x, self._most = np.empty((0, 2)), np.inf
        if not self.refresh(x, radius):
            raise ValueError(f"x = {x.min(axis=0)} ... {x.max(axis=0)}: must lie on {grid}")
        self._most = CROWDED * float(self._space[-1])

    def _prepare(self, grid: Grid) -> None:
        """What depends on the grid alone."""
        window, split = grid.accuracy.window, grid.accuracy.split
        powers = np.arange(len(window.polynomials) - 1, 0, -1)
        self._polynomials = window.polynomials
        self._derivatives = np.ascontiguousarray(window.polynomials[:-1] * powers[:, None])
        self._short = split.polynomial
        self._own = split.origin / grid.cutoff
        self._influence = grid.influence(self._layer)
        rows, columns = grid.points
        # As high as the cutoff, in whole rows: two contacts that near begin at most so many apart.
        self._bands = max(rows // int(np.ceil(grid.cutoff / grid.spacing[0])), 1)
        self._begin = np.empty(self._bands * -(-columns // kernels.BIN) + 2, np.int32)
        self._space = np.zeros(self._bands + 1)
        self._density = np.empty(grid.points)
        width, periodic = grid.accuracy.width, int(grid.period is not None)
        vector = kernels.vec2
        self._place = (vector(grid.origin), vector(grid.spacing))
        self._period = vector(grid.period if periodic else (1.0, 1.0))
        self._kind = (width, periodic)

    def refresh(self, x: Array, radius: Array | None = None) -> bool:
        """The same grid for contacts that have moved, come or gone, (n, 2) m.

        False, and no longer fit for use, if they have left it or crowd so that another would be
        cheaper by far.
        """
        n, grid = len(x), self.grid
        if n != len(self.x):
            self._order, self._bins = np.empty(n, np.int32), np.empty(n, np.int32)
            self._load, self._site = np.empty((4, n)), np.empty((n, 2))
            self._node = np.empty((n, kernels.WEIGHTS + 2 * grid.accuracy.width))
        self.x, self.radius = x, radius
        if self._sort() or not self._make_room():
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
            self._value, self._index = np.empty(size), np.empty(size, np.int32)
        return True

    def _find_pairs(self) -> None:
        grid, (width, periodic) = self.grid, self._kind
        site, node, begin = self._site, self._node, self._begin
        extent = float(np.ptp(self.x, axis=0).max(initial=0.0)) if len(self.x) else 0.0
        self._unresolved = float(np.finfo(np.float64).eps * extent) ** 2
        coincident = mesh_pairs.pairs(
            site, node, begin, self._space, self._value, self._index, self._short,
            *self._place, self._period, *grid.points, self._bands,
            self._own, grid.cutoff, self._unresolved,
            width, len(self._short) - 1, periodic,
        )  # fmt: skip
        if coincident and self.radius is not None:
            mesh_pairs.concentric(
                site, node, self._value, self._index, self.radius, self._order,
                self._period, self._own, self._unresolved, periodic,
            )  # fmt: skip

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
            grid.cutoff, self._unresolved, width, len(self._short) - 1, periodic,
        )  # fmt: skip
        w, slope = self._unsorted(self._load[1]), np.empty((len(f), 2))
        slope[self._order] = self._load[2:].T
        return w, slope

    def _unsorted(self, values: Array) -> Array:
        result = np.empty(len(values))
        result[self._order] = values
        return result

    def _potential(self, f: Array) -> Array:
        """The smooth part of f/r, summed, on the grid."""
        np.take(f, self._order, out=self._load[0])
        kernels.spread(
            self._load, self._node, self._begin, self._density,
            self.grid.points[1], self._bands, *self._kind,
        )  # fmt: skip
        return self._convolve(self._density)

    def _convolve(self, density: Array) -> Array:
        from scipy import fft

        (rows, columns), workers = self.grid.torus, self.workers
        spectrum = fft.rfft(density, n=columns, axis=1, workers=workers)
        spectrum = fft.fft(spectrum, n=rows, axis=0, overwrite_x=True, workers=workers)
        spectrum *= self._influence
        spectrum = fft.ifft(spectrum, axis=0, overwrite_x=True, workers=workers)
        # Rows that no contact reaches need not be transformed.
        result: NDArray[np.float64] = fft.irfft(
            spectrum[: len(density)], n=columns, axis=1, overwrite_x=True, workers=workers
        )
        return result
