"""Which way of summing is cheapest for a layout: directly, or on a grid, and how fine a grid.

What is weighed is a time step of the coupled solve: one renewal of the plan, a few applications,
one of them with slope.
The unit costs were measured once, on one thread; the choice depends on counts alone, never on a
clock, so that it is the same in every run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .arrays import Array
from .direct import KEEP
from .grid import FINEST, Accuracy, Grid, accuracy, free_grid, periodic_grid

APPLICATIONS = 4  # per renewal
MEMORY = 2**32  # bytes that a plan may take
ROOM = 2.5  # for pairs, over their number
CROWDED = 0.2  # share of all contacts near one, above which a grid resolves too little
WAVES = 250  # of a periodic direct sum over a square
STEP = 2.0**0.5  # between the grid spacings tried
WALK = 50  # at most, of such steps

# Measured costs, s.
CALLS, RENEWAL_CALLS = 2.5e-4, 5e-4  # of an application and a renewal, whatever their size
POINT = 1.7e-9  # spreading and gathering, per point of a contact's window
CONTACT, PAIR = 3e-8, 1.2e-9  # per contact, per pair; in an application
RENEWED_CONTACT, RENEWED_PAIR = 2.5e-7, 1e-8
SLOPE_CONTACT, SLOPE_PAIR = 1e-7, 6e-9  # besides the application
TRANSFORM = 4.2e-10  # per cell of the torus and doubling of their number
KEPT_ENTRY, MADE_ENTRY, LAYER_ENTRY = 3e-10, 6e-9, 6e-8  # of the dense matrix
SLOPE_ENTRY = 6e-9  # of a direct sum, besides the application
MODE = 1.5e-9  # per contact and wave of a periodic direct sum
# Contacts with sizes are forces and moments: what the same then costs, as a multiple.
SIZED_KEPT, SIZED_MADE = 3.0, 1.3  # of a direct sum
SIZED_CALLS, SIZED_WORK, SIZED_RENEWAL = 1.5, 2.5, 1.5  # of a mesh


@dataclass(frozen=True)
class Choice:
    """How a layout is summed, and why; `print` it.

    method: "direct" or "mesh"; time, s: of one application, as estimated; memory, bytes; reason: in
    words; grid: of the mesh, or None; pairs: per contact within the cutoff, estimated;
    alternatives: what else was considered, and its time for a renewal and `APPLICATIONS`
    applications; sized: whether contacts have sizes, which costs twice the transforms.
    """

    method: str
    count: int
    tolerance: float
    time: float
    memory: float
    reason: str
    grid: Grid | None = None
    pairs: float = 0.0
    alternatives: tuple[tuple[str, float], ...] = ()
    sized: bool = False

    def __str__(self) -> str:
        lines = [
            f"{self.count} contacts{' with sizes' * self.sized}, tolerance {self.tolerance:.1g}: "
            f"{self.method} sum, "
            f"because {self.reason}",
            f"  one application about {self.time * 1e3:.3g} ms, memory {self.memory / 1e6:.3g} MB",
        ]
        if self.grid is not None:
            g = self.grid
            lines.append(
                f"  grid {g.points[0]} x {g.points[1]} (transforms {g.torus[0]} x {g.torus[1]}), "
                f"spacing {g.spacing[0]:.3g} m, window {g.accuracy.width} points, "
                f"cutoff {g.cutoff:.3g} m with about {self.pairs:.0f} neighbours"
            )
        for words, time in self.alternatives:
            lines.append(f"  considered: {words}, {time * 1e3:.3g} ms per step")
        return "\n".join(lines)


def choose(
    x: Array,
    tolerance: float,
    period: tuple[float, float] | None,
    method: str | None = None,
    reach: float = 0.0,
    thickness: float | None = None,
    sized: bool = False,
) -> Choice:
    """The cheapest way to sum over the contacts `x` (n, 2); `method` insists on one.

    reach, m: pairs no further apart are summed elsewhere, which a mesh can allow within its cutoff;
    thickness: of a layer, m, which is the most that the cutoff may be; sized: contacts are not
    points.
    """
    n = len(x)
    direct, direct_step = _direct(n, tolerance, period, thickness, sized)
    if method == "direct":
        return replace(direct, reason="it was asked for")
    if n == 0:
        return replace(direct, reason="there is nothing to sum")
    if method is None and direct_step <= RENEWAL_CALLS + APPLICATIONS * CALLS:
        return replace(direct, reason="so few are summed sooner than a grid is filled")
    asked = tolerance * _sharpening(x, tolerance, period, thickness)
    if method is None and asked < FINEST:
        return replace(direct, reason=f"the mesh reaches no tolerance below {FINEST:.1g}")
    tried = _meshes(x, asked, period, reach, thickness, sized)
    if not tried:
        return replace(direct, reason="contacts are wider than a grid here can allow")
    fitting = [pair for pair in tried if pair[0].memory <= MEMORY]
    if not fitting and method == "mesh":
        least = min(mesh.memory for mesh, _ in tried) / 1e9
        raise MemoryError(f"the mesh takes {least:.3g} GB, more than {MEMORY / 1e9:.3g}")
    best = min(fitting, key=lambda pair: pair[1], default=None)
    others = tuple((_words(mesh), step) for mesh, step in tried if best is None or mesh != best[0])
    if best is None or (method is None and direct_step <= best[1]):
        crowded = min(mesh.pairs for mesh, _ in tried) > CROWDED * n
        reason = "a grid that spans all contacts " + (
            "and fits into memory cannot tell those close together apart"
            if crowded
            else "is dearer"
        )
        if best is not None:
            others = ((_words(best[0]), best[1]), *others)
        return replace(direct, reason=reason, alternatives=others)
    reason = "it was asked for" if method else "a step is cheapest so"
    others = ((f"direct sum, {direct.memory / 1e6:.3g} MB", direct_step), *others)
    return replace(best[0], reason=reason, alternatives=others)


def _words(mesh: Choice) -> str:
    assert mesh.grid is not None
    return f"grid spacing {mesh.grid.spacing[0]:.3g} m, {mesh.memory / 1e6:.3g} MB"


def _direct(
    n: int,
    tolerance: float,
    period: tuple[float, float] | None,
    thickness: float | None,
    sized: bool,
) -> tuple[Choice, float]:
    """The direct sum, and its time per step."""
    kept = n * n <= KEEP
    made = MADE_ENTRY + (0.0 if thickness is None else LAYER_ENTRY)
    made *= SIZED_MADE if sized else 1.0
    time = n * n * (KEPT_ENTRY * (SIZED_KEPT if sized else 1.0) if kept else made)
    memory = 8.0 * (n * n * (1 + sized) if kept else KEEP)
    if period is not None:
        modes = WAVES * max(period) / min(period)
        time += n * modes * MODE * (1 + sized)
        memory += 16 * n * modes
    making = n * n * (made if kept else 0.0)
    slope = n * n * SLOPE_ENTRY
    choice = Choice("direct", n, tolerance, time, memory, "", sized=sized)
    return choice, making + slope + APPLICATIONS * time


def _meshes(
    x: Array,
    tolerance: float,
    period: tuple[float, float] | None,
    reach: float,
    thickness: float | None,
    sized: bool,
) -> list[tuple[Choice, float]]:
    """Grids around a first guess, finer and coarser while that promises anything."""
    setting, n = accuracy(tolerance), len(x)
    low, high = x.min(axis=0), x.max(axis=0)
    guess = max(_first_guess(x, period), (1 + 1e-9) * reach / setting.cutoff)
    coarsest = np.inf if thickness is None else thickness / setting.cutoff
    if period is not None:
        coarsest = min(coarsest, min(period) / fewest_points(setting))
    guess = min(guess, coarsest)

    def mesh(spacing: float) -> tuple[Choice, float]:
        if period is None:
            return _mesh(x, free_grid(low, high, spacing, setting), tolerance, sized)
        return _mesh(x, periodic_grid(period, spacing, setting), tolerance, sized)

    found = [mesh(guess)]
    for factor in (1 / STEP, STEP):
        for k in range(1, WALK):
            spacing = guess * factor**k
            if spacing > coarsest:
                break
            found.append(mesh(spacing))
            choice, step = found[-1]
            dear = step > 2 * min(t for _, t in found)
            crowded = factor > 1 and choice.pairs > CROWDED * n
            if dear or crowded or _grid_bytes(choice.grid) > MEMORY:
                break
    return [pair for pair in found if pair[0].grid is not None and pair[0].grid.cutoff >= reach]


def _first_guess(x: Array, period: tuple[float, float] | None) -> float:
    """About the grid spacing that pays."""
    size = np.sort(np.ptp(x, axis=0) if period is None else np.asarray(period))
    longest = float(size[1]) or 1.0
    # Not a simple fraction of a lattice: all contacts would sit alike in their cells.
    return 0.53 * float(np.sqrt(longest * max(size[0], longest / len(x)) / len(x)))


def _sharpening(
    x: Array, tolerance: float, period: tuple[float, float] | None, thickness: float | None
) -> float:
    """How much finer a setting a layer needs: errors grow as cells get small against spacings."""
    if thickness is None or tolerance < FINEST:
        return 1.0
    coarsest = thickness / accuracy(tolerance).cutoff
    return min(1.0, coarsest / _first_guess(x, period))


def fewest_points(setting: Accuracy) -> int:
    """Rows or columns of a periodic cell: three bands, and no contact met twice."""
    reach = int(np.ceil(setting.cutoff)) + 1
    return max(3 * reach, 2 * reach + 8, setting.width + 2)


def _grid_bytes(grid: Grid | None) -> float:
    return 0.0 if grid is None else 30.0 * grid.torus[0] * grid.torus[1]


def _mesh(x: Array, grid: Grid, tolerance: float, sized: bool) -> tuple[Choice, float]:
    """The sum on a grid, and its time per step."""
    n, width = len(x), grid.accuracy.width
    pairs = _neighbours(x, grid.cutoff)
    points = float(grid.torus[0] * grid.torus[1])
    calls, more, again = (SIZED_CALLS, SIZED_WORK, SIZED_RENEWAL) if sized else (1.0, 1.0, 1.0)
    work = n * (CONTACT + POINT * width**2 + PAIR * pairs)
    time = calls * CALLS + more * (work + TRANSFORM * points * np.log2(points))
    renewal = RENEWAL_CALLS + again * n * (RENEWED_CONTACT + RENEWED_PAIR * pairs)
    slope = more * n * (SLOPE_CONTACT + SLOPE_PAIR * pairs)
    each = (20.0 if sized else 12.0) * ROOM * (pairs + 1)
    memory = (1 + sized) * _grid_bytes(grid) + n * (100.0 + 16 * width + each)
    choice = Choice("mesh", n, tolerance, time, memory, "", grid, pairs, sized=sized)
    return choice, renewal + slope + APPLICATIONS * time


def _neighbours(x: Array, cutoff: float) -> float:
    """How many others lie within the cutoff of a contact, on the mean, from counts in squares."""
    square = np.floor((x - x.min(axis=0)) / cutoff).astype(np.int64)
    _, count = np.unique(square[:, 0] * (square[:, 1].max() + 1) + square[:, 1], return_counts=True)
    return min(np.pi * float((count * (count - 1.0)).sum()) / len(x), len(x) - 1.0)
