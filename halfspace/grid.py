"""The grid of the particle mesh: its size, and what a force on it does to every point.

A grid of a free half-space is folded on a torus at least twice as wide as the contacts, so that
the far side of a contact does not reach it. The kernel is sampled there as a function of distances
that are rounded where they meet on the far side: a kink would not be resolved by any grid.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .arrays import Array
from .layer_kernel import LayerKernel
from .splitting import Split
from .window import Window

SLACK = 2  # cells around the contacts in which they may move before there must be a new grid
ROUND = 1.6  # half-width of the rounding on the far side, in cutoffs
NEAR = 3.0  # least half-width of the torus, in cutoffs


@dataclass(frozen=True)
class Accuracy:
    """A window and a split that belong together, and the error that they were measured to make.

    error: root mean square over the contacts, of `f_rms/(pi E' s)`, for contacts strewn at random
    with `n` on the area `n s^2`; the worst of ten thousand errs by `WORST` times that. width:
    grid points of the window; cutoff: of the split, in grid cells; `sharpness` and `beta`: of the
    window and the split.
    """

    error: float
    width: int
    cutoff: float
    sharpness: float
    beta: float

    @cached_property
    def window(self) -> Window:
        return Window(self.width, self.sharpness)

    @cached_property
    def split(self) -> Split:
        return Split(self.beta)

    @cached_property
    def curved(self) -> Split:
        """Whose Laplacian is used."""
        return Split(self.beta, smooth=True)


# Measured against direct sums; for each width and cutoff the other two were chosen by a search.
ACCURACIES = tuple(
    Accuracy(10.0**digits, width, cutoff, width * sharpness, cutoff * beta)
    for digits, width, cutoff, sharpness, beta in (
        (-1.49, 3, 2.00, 2.76, 1.90),
        (-2.51, 4, 2.50, 2.42, 2.61),
        (-2.93, 4, 3.25, 2.45, 2.35),
        (-3.56, 5, 3.50, 2.37, 2.58),
        (-4.07, 6, 3.50, 2.17, 2.84),
        (-4.44, 6, 4.00, 2.24, 2.74),
        (-4.96, 7, 4.20, 2.15, 2.81),
        (-5.54, 8, 4.50, 2.05, 2.91),
        (-6.17, 9, 5.00, 2.02, 2.93),
        (-6.91, 10, 5.50, 2.05, 2.91),
        (-7.56, 11, 6.00, 2.04, 2.91),
        (-8.29, 12, 6.50, 2.01, 2.94),
        (-8.96, 13, 7.00, 1.98, 2.94),
        (-9.74, 14, 7.50, 1.96, 2.96),
        (-10.16, 14, 8.00, 2.01, 2.91),
        (-10.54, 15, 8.25, 1.95, 2.97),
        (-11.07, 16, 8.75, 2.00, 2.93),
    )
)
WORST = 8.0  # the worst contact's error over that, the forces being of one sign or not
FINEST = ACCURACIES[-1].error * WORST


def accuracy(tolerance: float) -> Accuracy:
    """The cheapest setting whose worst contact errs by at most `tolerance f_rms/(pi E' s)`."""
    for row in ACCURACIES:
        if WORST * row.error <= tolerance:
            return row
    raise ValueError(f"tolerance = {tolerance:.3g}: the particle mesh reaches {FINEST:.1g}")


@dataclass(frozen=True)
class Grid:
    """Points `origin + (i, j) spacing` of the plane.

    points: rows and columns that contacts can reach; torus: rows and columns of the transform, the
    same in a periodic cell; cutoff, m; period, m, or None.
    """

    origin: tuple[float, float]
    spacing: tuple[float, float]
    points: tuple[int, int]
    torus: tuple[int, int]
    cutoff: float
    accuracy: Accuracy = field(repr=False)
    period: tuple[float, float] | None = None

    def influence(self, layer: LayerKernel | None = None) -> Array:
        """What a force on the grid does to its points: its transform.

        (rows, columns/2 + 1) of the torus, real, in units where a force f acts by f/r. The windows
        at both ends are divided out. layer: what is added to 1/r; the grid holds it where it is at
        least as thick as the cutoff, for its spectrum falls by `exp(-2 q h)`.
        """
        return self._influence(self.accuracy.split, layer)

    def curved_influence(self, layer: LayerKernel | None = None) -> Array:
        """As `influence`, for the Laplacian: what acts by `1/r^3`."""
        symbol = self._influence(self.accuracy.curved, layer)
        k = [2 * np.pi * np.arange(m) / m for m in (self.torus[0], self.torus[1])]
        k[0] = np.minimum(k[0], 2 * np.pi - k[0])
        rows, columns = (k[axis] / self.spacing[axis] for axis in (0, 1))
        return -symbol * (rows[:, None] ** 2 + columns[: symbol.shape[1]] ** 2)

    def _influence(self, split: Split, layer: LayerKernel | None) -> Array:
        from scipy.fft import dctn

        window = self.accuracy.window
        waves = [2 * np.pi * np.arange(m // 2 + 1) / m for m in self.torus]
        if self.period is None:
            d = [self.spacing[0] * _round(m, ROUND * self.accuracy.cutoff) for m in self.torus]
            r = np.hypot(d[0][:, None], d[1])
            kernel = split.smooth(r / self.cutoff) / self.cutoff
            symbol = dctn(kernel if layer is None else kernel + layer.smooth(r), type=1)
        else:
            q = [k / h for k, h in zip(waves, self.spacing, strict=True)]
            wave = np.hypot(q[0][:, None], q[1])
            symbol = split.spectrum(self.cutoff * wave) * self.cutoff
            if layer is not None:
                symbol += layer.spectrum(wave)
            symbol /= self.spacing[0] * self.spacing[1]
        for axis, k in enumerate(waves):
            symbol /= np.expand_dims(window.transform(k) ** 2, 1 - axis)
        return np.concatenate([symbol, symbol[-2:0:-1]])


def free_grid(low: Array, high: Array, spacing: float, setting: Accuracy) -> Grid:
    """The grid of contacts between the corners `low` and `high` (2,), m, of a free half-space."""
    extent = (high - low) / spacing + 2 * SLACK
    width = setting.width
    least = np.maximum(extent, NEAR * setting.cutoff) + ROUND * setting.cutoff
    torus = tuple(_fast_even(2 * half) for half in least)
    points = tuple(int(np.floor(e)) + width + 1 for e in extent)
    start = low - (SLACK + width / 2 - 1) * spacing
    return Grid(
        (float(start[0]), float(start[1])),
        (spacing, spacing),
        (points[0], points[1]),
        (max(torus[0], points[0]), max(torus[1], points[1])),
        setting.cutoff * spacing,
        setting,
    )


def periodic_grid(period: tuple[float, float], spacing: float, setting: Accuracy) -> Grid:
    """The grid of a periodic cell with its corner at 0, m, its points at most `spacing` apart."""
    torus = tuple(_fast_even(length / spacing) for length in period)
    step = (period[0] / torus[0], period[1] / torus[1])
    size = (torus[0], torus[1])
    return Grid((0.0, 0.0), step, size, size, setting.cutoff * max(step), setting, period)


def _fast_even(least: float) -> int:
    """A length of at least `least` that is even and whose transform is fast."""
    from scipy.fft import next_fast_len

    return 2 * int(next_fast_len(int(np.ceil(least / 2)), real=True))


def _round(size: int, half_width: float) -> Array:
    """Distances 0 ... size/2 along the torus, in cells, smooth at size/2.

    `|x|` is replaced by its mean under a bump about the far side, which changes it within
    `half_width` of there alone.
    """
    from scipy.special import i0

    d = np.arange(size // 2 + 1, dtype=np.float64)
    gap = (size / 2 - d) / half_width
    node, weight = np.polynomial.legendre.leggauss(80)

    def tail(start: Array) -> Array:
        """`int_start^1 (s - start) bump(s) ds`: half of what the mean adds to `|start|`."""
        s = start[:, None] + (1 - start[:, None]) * (node + 1) / 2
        bump = i0(np.pi * half_width * np.sqrt(np.maximum(1 - s * s, 0.0)))
        return (bump * (s - start[:, None])) @ weight * (1 - start) / 2

    near = gap < 1
    whole = i0(np.pi * half_width * np.sqrt(1 - node**2)) @ weight
    d[near] -= half_width * 2 * tail(gap[near]) / whole
    return d
