"""The picture of the substrate from above: its depression, and the contacts that press on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_dem import style
from taichi_dem.snapshot import Snapshot

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def view(state: Snapshot) -> style.View:
    """Lower and upper corner in x and y of the grid on which the surface is known."""
    x, y = state.grid_x, state.grid_y
    half = 0.5 * (x[1] - x[0])
    return np.array([x[0], y[0]]) - half, np.array([x[-1], y[-1]]) + half


def draw(axes: Axes, state: Snapshot, factor: float) -> None:
    """The depression as a map, the contacts as circles of their true radius; ``factor`` from m to
    the unit on the axes."""
    low, high = view(state)
    depth, unit = style.scale_of(state.depression, "m")
    axes.set_ylabel(axes.get_xlabel().replace("x", "y", 1))
    colors, norm = style.depths(state.depression * depth)
    image = axes.imshow(
        state.depression * depth,
        origin="lower",
        extent=(low[0] * factor, high[0] * factor, low[1] * factor, high[1] * factor),
        cmap=colors,
        norm=norm,
        interpolation="bilinear",
    )
    style.color_bar(axes, image, f"depression ({unit})")
    if len(state.substrate_force):
        _draw_contacts(axes, state, factor)


def _draw_contacts(axes: Axes, state: Snapshot, length: float) -> None:
    """Circles in the axes' unit, ``length`` per m, the strongest on top."""
    from matplotlib.collections import EllipseCollection

    factor, unit = style.scale_of(state.substrate_force, "N")
    place, which = _with_images(state)
    force, radius = state.substrate_force[which], state.substrate_radius[which]
    order = np.argsort(force, kind="stable")
    diameter = 2 * radius[order] * length
    circles = EllipseCollection(
        diameter,
        diameter,
        np.zeros(len(order)),
        units="xy",
        offsets=place[order] * length,
        offset_transform=axes.transData,
        cmap="YlOrRd",
        edgecolors="white",
        linewidths=np.clip(0.025 * style.points(axes) * diameter - 0.05, 0.0, 0.5),
    )
    circles.set_array(force[order] * factor)
    circles.set_clim(0.0, style.top(state.substrate_force * factor))
    axes.add_collection(circles, autolim=False)
    style.color_bar(axes, circles, f"normal force ({unit})", place=1)


def _with_images(state: Snapshot) -> tuple[np.ndarray, np.ndarray]:
    """Places (k, 2), m, of the contacts and of those of their images that reach into the cell; and
    whose images they are, (k,)."""
    place, radius = state.substrate_position, state.substrate_radius
    everyone = np.arange(len(place))
    if not np.isfinite(state.period).all():
        return place, everyone
    shown, whose = [place], [everyone]
    for i, j in ((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j):
        image = place + np.array([i, j]) * state.period
        inside = ((image > -radius[:, None]) & (image < state.period + radius[:, None])).all(axis=1)
        shown.append(image[inside])
        whose.append(everyone[inside])
    return np.concatenate(shown), np.concatenate(whose)
