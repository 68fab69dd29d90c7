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
    image = axes.imshow(
        state.depression * depth,
        origin="lower",
        extent=(low[0] * factor, high[0] * factor, low[1] * factor, high[1] * factor),
        cmap=style.pale_blues(),
        vmin=0.0,
        vmax=style.top(state.depression * depth),
        interpolation="bilinear",
    )
    style.color_bar(axes, image, f"depression ({unit})")
    if len(state.substrate_force):
        _draw_contacts(axes, state, factor)


def _draw_contacts(axes: Axes, state: Snapshot, length: float) -> None:
    """Circles in the axes' unit, ``length`` per m, the strongest on top."""
    from matplotlib.collections import EllipseCollection

    factor, unit = style.scale_of(state.substrate_force, "N")
    order = np.argsort(state.substrate_force)
    diameter = 2 * state.substrate_radius[order] * length
    circles = EllipseCollection(
        diameter,
        diameter,
        np.zeros(len(order)),
        units="xy",
        offsets=state.substrate_position[order] * length,
        offset_transform=axes.transData,
        cmap="YlOrRd",
        edgecolors="white",
        linewidths=np.clip(0.025 * style.points(axes) * diameter - 0.05, 0.0, 0.5),
    )
    circles.set_array(state.substrate_force[order] * factor)
    circles.set_clim(0.0, style.top(state.substrate_force * factor))
    axes.add_collection(circles, autolim=False)
    style.color_bar(axes, circles, f"normal force ({unit})", place=1)
