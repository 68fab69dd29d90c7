"""Short texts beside points of a picture, none on top of another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE = 7.5  # points, of the letters
NEAR, FAR, STEP = 4.0, 60.0, 4.0  # points from a mark to the nearest corner of its text
MARK = 4.0  # points, half of a mark's side
PAD = 1.5  # points between two texts
AWAY = 10.0  # points from which on a line leads to the mark
CORNERS = ((-1, -1), (1, 1), (-1, 1), (1, -1))  # in which a text may stand, the best first

Box = tuple[float, float, float, float]  # left, bottom, right, top, in dots


def beside(
    axes: Axes,
    places: Sequence[tuple[float, float, str, str]],
    marks: Sequence[tuple[float, float]],
) -> None:
    """Write each text of ``places`` (x, y, text, colour) near its point, at the lower left where
    there is room. No text covers another or one of ``marks`` (x, y) or leaves the axes; one for
    which there is no room is left out. To be called when the axes are complete."""
    from matplotlib.patheffects import withStroke

    drawing = cast("Figure", axes.figure)
    drawing.draw_without_rendering()  # so that it is known where everything is
    dot = drawing.dpi / 72
    half, pad = MARK * dot, PAD * dot
    taken = [(x - half, y - half, x + half, y + half) for x, y in axes.transData.transform(marks)]
    inside = axes.get_window_extent()
    frame = (inside.x0, inside.y0, inside.x1, inside.y1)
    for x, y, text, color in places:
        written = axes.annotate(
            text, (x, y), (0, 0), textcoords="offset points", size=SIZE, color=color, zorder=5
        )
        written.set_path_effects([withStroke(linewidth=2, foreground="white")])
        written.set_in_layout(False)
        size = written.get_window_extent()
        centre = axes.transData.transform((x, y))
        for away, box in _candidates(centre, size.width, size.height, dot):
            if _within(box, frame) and not any(_meet(box, other) for other in taken):
                taken.append((box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad))
                written.set_position(((box[0] - centre[0]) / dot, (box[1] - centre[1]) / dot))
                if away > AWAY:
                    _lead(axes, (x, y), box, centre, dot, color)
                break
        else:
            written.remove()


def _candidates(
    centre: np.ndarray, width: float, height: float, dot: float
) -> Iterator[tuple[float, Box]]:
    """Where a text of that size (dots) may stand, near places first: how far away (points), and
    its box."""
    for away in np.arange(NEAR, FAR, STEP):
        for right, up in CORNERS:
            for x, y in ((away, away), (NEAR, away), (away, NEAR)):
                left = centre[0] + right * x * dot - (width if right < 0 else 0)
                bottom = centre[1] + up * y * dot - (height if up < 0 else 0)
                yield float(away), (left, bottom, left + width, bottom + height)


def _within(box: Box, frame: Box) -> bool:
    across = frame[0] < box[0] and box[2] < frame[2]
    return across and frame[1] < box[1] and box[3] < frame[3]


def _meet(one: Box, other: Box) -> bool:
    across = one[0] < other[2] and other[0] < one[2]
    return across and one[1] < other[3] and other[1] < one[3]


def _lead(
    axes: Axes, point: tuple[float, float], box: Box, centre: np.ndarray, dot: float, color: str
) -> None:
    """A thin line from the point to the nearest place of its text."""
    end = np.clip(centre, box[:2], box[2:])
    axes.annotate(
        "",
        point,
        (end - centre) / dot,
        textcoords="offset points",
        arrowprops={"arrowstyle": "-", "color": color, "linewidth": 0.5, "shrinkA": 0},
    ).set_in_layout(False)
