"""The picture of the dented surface from above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .arrays import Array, host
from .ground import HalfSpace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARGIN = 0.15  # around the contacts, of their extent
LEAST_MARGIN = 4.0  # contact radii
PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def draw_dents(
    ground: HalfSpace,
    x: ArrayLike,
    f: ArrayLike,
    radius: ArrayLike,
    *,
    axes: Axes | None = None,
    window: tuple[float, float, float, float] | None = None,
    points: int = 240,
) -> Axes:
    """Draw the depression of the surface as a map, and the contacts as circles of their size.

    x: (n, 2) m; f: (n,) N; radius: (n,) contact radii, m; axes: where to draw, or None for a figure
    of its own; window: (left, right, bottom, top), m, or None for all contacts, or one cell of a
    periodic half-space; points: of the map along its longer side. Returns the axes, the figure of
    which can be saved. Raises ValueError as `HalfSpace.field` does.
    """
    x, f, radius = host(x), host(f), host(radius)
    x = checks.vectors("x", x)
    f, a = checks.scalars("f", f, len(x)), checks.radii("radius", radius, len(x))
    left, right, bottom, top = window or _window(ground, x, a)
    step = max(right - left, top - bottom) / points
    columns, rows = (max(int(np.ceil(s / step)), 2) for s in (right - left, top - bottom))
    across = left + (np.arange(columns) + 0.5) * (right - left) / columns
    upward = bottom + (np.arange(rows) + 0.5) * (top - bottom) / rows
    places = np.stack(np.meshgrid(across, upward), axis=-1).reshape(-1, 2)
    w = ground.field(x, f, places, a).reshape(rows, columns)
    w = np.where(np.isfinite(w), w, np.nan)

    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

    if axes is None:
        size = np.array([right - left, top - bottom])
        size = 5.0 * size / size.max()
        axes = Figure(figsize=(size[0] + 1.8, size[1] + 0.8), layout="constrained").add_subplot()
    length, metre = _scale([right - left, top - bottom], "m")
    depth, unit = _scale(w, "m")
    lowest = min(float(np.nanmin(w)), 0.0)
    highest = max(float(np.nanmax(w)), 0.0)
    sunk_only = highest > 0 and lowest > -1e-3 * highest
    reach = max(highest, -lowest) or 1.0
    image = axes.imshow(
        w * depth,
        origin="lower",
        extent=(left * length, right * length, bottom * length, top * length),
        cmap="Blues" if sunk_only else "RdBu",
        vmin=0.0 if sunk_only else -reach * depth,
        vmax=reach * depth,
        interpolation="bilinear",
    )
    axes.set(xlabel=f"x ({metre})", ylabel=f"y ({metre})")
    axes.set_aspect("equal")
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(image, ax=axes, label=f"depression ({unit})", shrink=0.9)
    centres, sizes = _shown(ground, x[f != 0], a[f != 0], (left, right, bottom, top))
    diameter = 2 * sizes * length
    circles = EllipseCollection(
        diameter,
        diameter,
        np.zeros(len(sizes)),
        units="xy",
        offsets=centres * length,
        offset_transform=axes.transData,
        facecolors="none",
        edgecolors="#D55E00",
        linewidths=1.0,
    )
    axes.add_collection(circles, autolim=False)
    return axes


def _window(ground: HalfSpace, x: Array, a: Array) -> tuple[float, float, float, float]:
    if ground.period is not None:
        return 0.0, ground.period[0], 0.0, ground.period[1]
    if len(x) == 0:
        return 0.0, 1.0, 0.0, 1.0
    low, high = x.min(axis=0), x.max(axis=0)
    margin = max(MARGIN * float((high - low).max()), LEAST_MARGIN * float(a.max()))
    margin = margin or 1.0
    low, high = low - margin, high + margin
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _shown(
    ground: HalfSpace, x: Array, a: Array, window: tuple[float, float, float, float]
) -> tuple[Array, Array]:
    """Centres and radii of the contacts, and of their images, that reach into the window."""
    left, right, bottom, top = window
    if ground.period is not None:
        corner = np.array([left, bottom])
        x = corner + np.mod(x - corner, ground.period)
        steps = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 1, 2)
        x = (x + steps * ground.period).reshape(-1, 2)
        a = np.tile(a, len(steps))
    seen = (x > np.array([left, bottom]) - a[:, None]) & (x < np.array([right, top]) + a[:, None])
    return x[seen.all(axis=1)], a[seen.all(axis=1)]


def _scale(values: ArrayLike, unit: str) -> tuple[float, str]:
    """Factor and name of the unit in which the largest of `values` has one to three digits."""
    values = np.abs(np.asarray(values, dtype=np.float64))
    largest = float(np.max(values, initial=0.0, where=np.isfinite(values)))
    if largest == 0:
        return 1.0, unit
    power = int(np.clip(3 * np.floor(np.log10(largest) / 3 + 1e-9), min(PREFIXES), max(PREFIXES)))
    return 10.0**-power, PREFIXES[power] + unit
