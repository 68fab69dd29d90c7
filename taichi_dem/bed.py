"""The picture of a bed from the side: x to the right, z up, seen along y."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_dem import style
from taichi_dem.snapshot import Snapshot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CROWD = 20_000  # more spheres than this, and those hidden behind others are left out
_LAYERS = 8  # of spheres that are kept in front of each spot, then
_SLENDER = 0.25  # shorter over longer side of the picture, at least
_SMOOTH = 3_000  # discs at most that are shaded in many steps, since each costs as much as a disc


def draw(axes: Axes, state: Snapshot, view: style.View, factor: float, color: str | None) -> None:
    """Spheres as shaded discs, near ones over far ones, with ground, walls and pistons.

    ``factor`` from m to the unit on the axes, which show the ``view``. ``color``: "material" (far
    spheres paler), "force" (sum of the normal forces on each) or "speed"; by default the material
    where there are several, else the force, or the speed while nothing touches.
    """
    if color is None:
        color = "force" if len(state.contact_i) else "speed"
        color = "material" if len(np.unique(state.material)) > 1 else color
    if color not in _COLORS:
        raise ValueError(f"color = {color!r}: must be one of {', '.join(_COLORS)}")
    low, high = view
    axes.set_ylabel(axes.get_xlabel().replace("x", "z", 1))
    style.title(axes, state.time)
    if state.has_substrate:
        _draw_ground(axes, state, low, high, factor)
    _draw_walls(axes, state, low, high, factor)
    shown = visible(state)
    if len(shown):
        _draw_spheres(axes, state, shown, _COLORS[color](axes, state, shown), factor)


def visible(state: Snapshot) -> np.ndarray:
    """Indices of the spheres to draw, farthest first; in a crowd only the front of each spot."""
    finite = np.isfinite(state.position).all(axis=1)
    order = np.flatnonzero(finite)[np.argsort(-state.position[finite, 1], kind="stable")]
    if len(order) <= _CROWD:
        return order
    near = order[::-1]
    spots = np.floor(state.position[near][:, [0, 2]] / np.median(state.radius)).astype(np.int64)
    _, spot = np.unique(spots, axis=0, return_inverse=True)
    sorting = np.argsort(spot.ravel(), kind="stable")
    first = np.searchsorted(spot.ravel()[sorting], np.arange(spot.max() + 1))
    depth = np.empty(len(near), dtype=np.int64)
    depth[sorting] = np.arange(len(near)) - first[spot.ravel()[sorting]]
    return near[depth < _LAYERS][::-1]


def view(state: Snapshot) -> style.View:
    """Lower and upper corner in x and z: all spheres, the ground, walls that are not far away."""
    finite = np.isfinite(state.position).all(axis=1)
    center, radius = state.position[finite][:, [0, 2]], state.radius[finite, None]
    if not len(center):
        center, radius = np.zeros((1, 2)), np.ones((1, 1))
    low, high = np.min(center - radius, axis=0), np.max(center + radius, axis=0)
    if state.has_substrate:
        low[1] = min(low[1], -0.8 * np.median(radius), -1.5 * state.deepest)
        high[1] = max(high[1], 0.0)
    near_low, near_high = low - (high - low).max(), high + (high - low).max()
    for point, normal in zip(state.face_point, state.face_normal, strict=True):
        for axis, k in enumerate((0, 2)):
            if abs(normal[k]) > 0.999 and near_low[axis] < point[k] < near_high[axis]:
                low[axis] = min(low[axis], point[k])
                high[axis] = max(high[axis], point[k])
    margin = 0.03 * (high - low).max()
    low, high = low - margin, high + margin
    spare = np.maximum(0.0, _SLENDER * (high - low).max() - (high - low))
    return low - spare * (0.5, 0.0), high + spare * (0.5, 1.0)


def _draw_ground(
    axes: Axes, state: Snapshot, low: np.ndarray, high: np.ndarray, factor: float
) -> None:
    """The substrate below the deepest dent at each x, and its surface before it was dented."""
    x = np.concatenate([[low[0]], state.grid_x, [high[0]]])
    z = -np.pad(state.depression.max(axis=0), 1, mode="edge")
    inside = (x >= low[0]) & (x <= high[0])
    x, z = x[inside] * factor, z[inside] * factor
    axes.fill_between(x, z, low[1] * factor, color=style.GROUND, linewidth=0, zorder=0.5)
    axes.plot(x, z, color="#7d6f55", linewidth=0.9, zorder=0.6)
    axes.axhline(0.0, color="#7d6f55", linewidth=0.7, linestyle=(0, (4, 3)), zorder=0.6)


def _draw_walls(
    axes: Axes, state: Snapshot, low: np.ndarray, high: np.ndarray, factor: float
) -> None:
    """Each face that is seen edge-on, as far as the other faces and the view leave it."""
    upright = np.abs(state.face_normal[:, 1]) < 1e-6
    normals = state.face_normal[upright][:, [0, 2]]
    anchors = state.face_point[upright][:, [0, 2]]
    frame_normals = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    bottom = np.array([low[0], 0.0 if state.has_substrate else low[1]])
    frame_anchors = np.array([bottom, bottom, high, high])
    for k, kind in enumerate(state.face_kind[upright]):
        along = np.array([-normals[k, 1], normals[k, 0]])
        others = np.arange(len(normals)) != k
        start, end = -np.inf, np.inf
        for normal, anchor in zip(
            np.concatenate([normals[others], frame_normals]),
            np.concatenate([anchors[others], frame_anchors]),
            strict=True,
        ):
            slope, height = along @ normal, (anchors[k] - anchor) @ normal
            if abs(slope) < 1e-9:
                continue
            if slope > 0:
                start = max(start, -height / slope)
            else:
                end = min(end, -height / slope)
        if start < end:
            ends = (anchors[k] + np.array([[start], [end]]) * along) * factor
            width = 3.0 if kind == "Piston" else 1.3
            axes.plot(*ends.T, color=style.INK, linewidth=width, solid_capstyle="butt", zorder=3)


def pressing(state: Snapshot) -> np.ndarray:
    """Sum of the normal forces on each sphere, (n,) N."""
    push, n = np.abs(state.normal_force), len(state.radius)
    pair = state.contact_j >= 0
    on_j = np.bincount(state.contact_j[pair], push[pair], n)
    return np.bincount(state.contact_i, push, n) + on_j


def _by_force(axes: Axes, state: Snapshot, shown: np.ndarray) -> np.ndarray:
    return _by_scale(axes, pressing(state)[shown], "N", "sum of normal forces", "YlOrRd")


def _by_speed(axes: Axes, state: Snapshot, shown: np.ndarray) -> np.ndarray:
    speed = np.linalg.norm(state.velocity[shown], axis=1)
    return _by_scale(axes, speed, "m/s", "speed", "viridis")


def _by_scale(axes: Axes, values: np.ndarray, unit: str, label: str, colors: str) -> np.ndarray:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    factor, unit = style.scale_of(values, unit)
    mappable = ScalarMappable(Normalize(0.0, style.top(values * factor)), colormaps[colors])
    style.color_bar(axes, mappable, f"{label} ({unit})")
    return mappable.to_rgba(values * factor)


def _by_material(axes: Axes, state: Snapshot, shown: np.ndarray) -> np.ndarray:
    from matplotlib.colors import to_rgba_array
    from matplotlib.lines import Line2D

    palette = to_rgba_array(style.PALETTE)
    colors = palette[state.material[shown] % len(palette)]
    y = state.position[shown, 1]
    depth = (y - y.min()) / max(np.ptp(y), 8 * np.median(state.radius))
    colors[:, :3] += 0.6 * depth[:, None] * (1 - colors[:, :3])
    handles = [
        Line2D([], [], linestyle="", marker="o", markersize=7, color=palette[k % len(palette)])
        for k in np.unique(state.material)
    ]
    for handle, k in zip(handles, np.unique(state.material), strict=True):
        handle.set_label(str(state.material_names[k]))
    style.legend(axes, handles)
    return colors


def _draw_spheres(
    axes: Axes,
    state: Snapshot,
    shown: np.ndarray,
    colors: np.ndarray,
    factor: float,
) -> None:
    """Discs with a highlight; how large they come out decides how thin the outlines must be."""
    from matplotlib.collections import EllipseCollection

    radius, center = state.radius[shown] * factor, state.position[shown][:, [0, 2]] * factor
    light = np.linspace(0.0, 1.0, 9 if len(shown) <= _SMOOTH else 3)
    size, shift, white = 1 - 0.8 * light, 0.33 * light, 0.4 * light**1.5
    diameters = np.outer(2 * radius, size)
    centers = center[:, None] + (radius[:, None] * shift)[:, :, None] * np.array([-1.0, 1.0])
    fill = np.repeat(colors[:, None, :], len(size), axis=1)
    fill[..., :3] += white[:, None] * (1 - fill[..., :3])
    outline = np.zeros(diameters.shape)
    outline[:, 0] = np.clip(0.05 * style.points(axes) * radius - 0.05, 0.0, 0.5)
    discs = EllipseCollection(
        diameters.ravel(),
        diameters.ravel(),
        np.zeros(diameters.size),
        units="xy",
        offsets=centers.reshape(-1, 2),
        offset_transform=axes.transData,
        facecolors=fill.reshape(-1, 4),
        edgecolors=style.INK,
        linewidths=outline.ravel(),
        zorder=2,
    )
    axes.add_collection(discs, autolim=False)


_COLORS = {"material": _by_material, "force": _by_force, "speed": _by_speed}
