"""The search for spheres that overlap, which packings, checks and the time step share."""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_dem.periodic import Period, nearest_image, wrapped

FEW = 500  # spheres: all pairs are looked at sooner than the search for near ones is imported


def overlapping(
    position: np.ndarray, radius: np.ndarray, period: Period | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Indices (i, j), each (p,), of the pairs whose centres are nearer than the sum of their radii.

    Radii are grouped by octaves, so that a few large spheres cost the small ones nothing.
    """
    if len(radius) <= FEW:
        i, j = np.triu_indices(len(radius), 1)
    else:
        i, j = _near(position, radius, period)
    close = _distance(position, i, j, period) < radius[i] + radius[j]
    return i[close], j[close]


def _near(
    position: np.ndarray, radius: np.ndarray, period: Period | None
) -> tuple[np.ndarray, np.ndarray]:
    octave = np.floor(np.log2(radius / radius.min()))
    groups = [np.flatnonzero(octave == k) for k in np.unique(octave)]
    position = wrapped(position, period)
    trees = [_tree(position[group], period) for group in groups]
    found = []
    for b, large in enumerate(groups):
        pairs = trees[b].query_pairs(2 * radius[large].max(), output_type="ndarray")
        found.append((large[pairs[:, 0]], large[pairs[:, 1]]))
        for a, small in enumerate(groups[:b]):
            near = trees[a].query_ball_point(position[large], radius[large] + radius[small].max())
            counts = np.fromiter(map(len, near), dtype=np.intp, count=len(near))
            inner = np.fromiter((k for row in near for k in row), np.intp, count=counts.sum())
            found.append((np.repeat(large, counts), small[inner]))
    i, j = (np.concatenate(side) for side in zip(*found, strict=True))
    return i, j


def deep_overlaps(
    position: np.ndarray, radius: np.ndarray, fraction: float, period: Period | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs i < j that overlap by more than ``fraction`` of the smaller radius, and by how much.

    Cheap searches go first (equal centres, nearest neighbours) and the first to find any ends it: a
    packing in wrong units may have n^2 overlaps.
    """
    searches = (overlapping,) if len(radius) <= FEW else (_coincident, _nearest, overlapping)
    for search in searches:
        i, j = search(position, radius, period)
        overlap = radius[i] + radius[j] - _distance(position, i, j, period)
        deep = (i != j) & (overlap > fraction * np.minimum(radius[i], radius[j]))
        if deep.any():
            break
    pairs = np.sort(np.stack([i[deep], j[deep]], axis=1), axis=1)
    pairs, first = np.unique(pairs, axis=0, return_index=True)
    return pairs[:, 0], pairs[:, 1], overlap[deep][first]


def _coincident(
    position: np.ndarray, radius: np.ndarray, period: Period | None
) -> tuple[np.ndarray, np.ndarray]:
    position = wrapped(position, period)
    order = np.lexsort(position.T)
    same = (position[order[1:]] == position[order[:-1]]).all(axis=1)
    return order[:-1][same], order[1:][same]


def _nearest(
    position: np.ndarray, radius: np.ndarray, period: Period | None
) -> tuple[np.ndarray, np.ndarray]:
    everyone, position = np.arange(len(position)), wrapped(position, period)
    tree = _tree(position, period)
    nearest = tree.query(position, k=min(2, len(position)))[1].reshape(len(position), -1)
    return everyone, np.where(nearest[:, 0] == everyone, nearest[:, -1], nearest[:, 0])


def _tree(position: np.ndarray, period: Period | None) -> Any:
    from scipy.spatial import cKDTree  # which takes longer to import than a few spheres to check

    return cKDTree(position, boxsize=None if period is None else (*period, 0.0))  # 0: endless


def _distance(
    position: np.ndarray, i: np.ndarray, j: np.ndarray, period: Period | None
) -> np.ndarray:
    between = nearest_image(position[i] - position[j], period)
    return np.sqrt(np.einsum("ij,ij->i", between, between))
