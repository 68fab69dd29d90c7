"""How the pictures look: sizes, colours, and units chosen so that the numbers are easy to read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from taichi_dem.writing import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Told apart by readers with any kind of colour vision (Okabe & Ito 2008).
PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8C6D31", "#777777")
INK = "#333333"
GROUND = "#cdbfa8"

View = tuple[np.ndarray, np.ndarray]  # lower and upper corner, (2,) m

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
STEPS = [1, 2, 5, 10]  # between ticks
_DOTS_PER_INCH = 200
RAISED = 1e-3  # of the deepest, from which ground that has risen is shown
PALE = 0.72  # of a colour map, up to where dark red marks are seen on it
_FEW = 40  # points of a line that are marked


def scale_of(values: Any, unit: str) -> tuple[float, str]:
    """Factor and name of the unit in which the largest of ``values`` has one to three digits.

    The name has an SI prefix: ``scale_of(2e-5, "m")`` is ``(1e6, "µm")``. Values that are not
    finite do not count.
    """
    values = np.abs(np.asarray(values, dtype=float))
    largest = np.max(values, initial=0.0, where=np.isfinite(values))
    if largest == 0:
        return 1.0, unit
    power = 3 * math.floor(math.log10(largest) / 3 + 1e-9)
    power = min(max(power, min(_PREFIXES)), max(_PREFIXES))
    return 10.0**-power, _PREFIXES[power] + unit


def figure(width: float, height: float) -> Figure:
    """An empty figure of that size in inches, without pyplot or any global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=_DOTS_PER_INCH, layout="constrained")


def top(values: Any) -> float:
    """Upper end of a colour scale from zero: the largest value, or 1 where there is none."""
    return float(np.max(values, initial=0.0, where=np.isfinite(values))) or 1.0


def maps(views: list[View], side: float) -> tuple[Figure, list[Axes], float]:
    """Maps in true proportions, one below the other, all to one scale that fills 5 by 4.6 inches.

    ``views``: lower and upper corner of what each shows, two (2,) m, over one range of x; ``side``:
    inches kept free at the right. Returns figure, axes, and the factor from m to the unit on them.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    extents = np.array([high - low for low, high in views])
    factor, unit = scale_of(extents, "m")
    inches = extents * min(5.0 / extents[0, 0], 4.6 / extents[:, 1].max())
    width = 0.75 + inches[0, 0] + side
    height = inches[:, 1].sum() + 0.35 + 0.5 * len(views)
    drawing = Figure(figsize=(width, height), dpi=_DOTS_PER_INCH)
    panels, below = [], height - 0.35
    for (low, high), size in zip(views, inches, strict=True):
        below -= size[1] + 0.5
        place = (0.75 / width, (below + 0.5) / height, size[0] / width, size[1] / height)
        axes = drawing.add_axes(place)
        axes.set_aspect("equal")
        axes.set(xlim=(low[0] * factor, high[0] * factor), ylim=(low[1] * factor, high[1] * factor))
        for axis, length in zip((axes.xaxis, axes.yaxis), size, strict=True):
            axis.set_major_locator(MaxNLocator(int(np.clip(length / 0.5, 2, 8)), steps=STEPS))
        axes.set_xlabel(f"x ({unit})")
        dress(axes)
        panels.append(axes)
    return drawing, panels, factor


def aligned(views: list[View]) -> list[View]:
    """The views, each as wide as all of them."""
    left, right = min(low[0] for low, _ in views), max(high[0] for _, high in views)
    return [(np.array([left, low[1]]), np.array([right, high[1]])) for low, high in views]


def points(axes: Axes) -> float:
    """Typographic points (1/72 inch) per unit on the x axis of a map."""
    low, high = axes.get_xlim()
    drawing = cast("Figure", axes.figure)
    return 72 * axes.get_position().width * drawing.get_size_inches()[0] / (high - low)


def dress(axes: Axes) -> None:
    """Thin dark frame, ticks outward, legible text."""
    axes.tick_params(direction="out", length=3, width=0.7, colors=INK, labelsize=9)
    for spine in axes.spines.values():
        spine.set(linewidth=0.7, color=INK)
    axes.xaxis.label.set(size=10, color=INK)
    axes.yaxis.label.set(size=10, color=INK)


def label_few_decades(axis: Any) -> None:
    """Ticks of a logarithmic axis at 1, 2 and 5, written out, where it has less than two decades:
    powers of ten would be too few and too wide. Evenly spread ones where these are too few, too."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

    low, high = axis.get_view_interval()
    if high < 100 * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        if high < 4 * low:
            axis.set_major_locator(MaxNLocator(6, steps=STEPS))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def cycle() -> Iterator[str]:
    """The palette over and over."""
    return itertools.cycle(PALETTE)


def line(color: str, points: int) -> dict[str, Any]:
    """A line of that colour, with dots where the points are few."""
    return {"color": color, "linewidth": 1.3, "marker": "." if points <= _FEW else ""}


def pale_blues() -> Any:
    """White to a blue light enough for dark red marks on it."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["Blues"](np.linspace(0.0, PALE, 256)))


def depths(values: np.ndarray) -> tuple[Any, Any]:
    """Colours and their range for a depression (any shape), also where there is none: blue from
    zero down; where more than a thousandth is raised, green from zero up, as strong per metre."""
    from matplotlib.colors import ListedColormap, Normalize

    lowest, raised = top(values), top(-values) if np.any(values < 0) else 0.0
    if raised <= RAISED * lowest:
        return pale_blues(), Normalize(0.0, lowest)
    if not np.any(values > 0):
        lowest = 0.0
    share = np.linspace(-raised, lowest, 512) / max(raised, lowest)
    colors = np.where(share[:, None] > 0, _tint("Blues", share), _tint("Greens", -share))
    return ListedColormap(colors), Normalize(-raised, lowest)


def _tint(name: str, share: np.ndarray) -> np.ndarray:
    """Colours of a map, as far as marks are seen on them, for shares from 0, where it is white."""
    from matplotlib import colormaps

    share = np.clip(share, 0.0, 1.0)
    white = np.outer(1 - share, 1 - np.array(colormaps[name](0.0)))
    colors: np.ndarray = np.clip(colormaps[name](PALE * share) + white, 0.0, 1.0)
    return colors


def color_bar(axes: Axes, mappable: Any, label: str, place: int = 0) -> None:
    """A colour bar as high as the axes, at their right; ``place`` counts the bars before it."""
    from matplotlib.ticker import MaxNLocator

    drawing = cast("Figure", axes.figure)
    width, height = drawing.get_size_inches()
    box = axes.get_position()
    left = box.x1 + (0.12 + 0.85 * place) / width
    bar = drawing.colorbar(
        mappable, cax=drawing.add_axes((left, box.y0, 0.14 / width, box.height)), label=label
    )
    ticks = int(np.clip(box.height * height / 0.4, 2, 8))
    bar.locator = MaxNLocator(ticks, steps=STEPS)
    bar.update_ticks()
    dress(bar.ax)


def save(drawing: Figure, path: Path) -> Path:
    """Write the picture in one piece and return its path."""
    with replacing(path) as temporary:
        drawing.savefig(temporary, facecolor="white", bbox_inches="tight", pad_inches=0.08)
    return path


def title(axes: Axes, time: float) -> None:
    """The simulated time, small, above the left corner."""
    factor, unit = scale_of(time, "s")
    axes.set_title(f"t = {time * factor:.4g} {unit}", loc="left", size=9, color=INK)


def legend(axes: Axes, handles: list[Any] | None = None) -> None:
    """A legend without a frame: of ``handles`` at the right, else of all lines above the axes."""
    options: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 4}
    if handles is not None:
        options = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "handles": handles}
    axes.legend(
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        borderaxespad=0.2,
        handlelength=1.4,
        handletextpad=0.5,
        columnspacing=1.4,
        **options,
    )
