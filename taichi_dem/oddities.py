"""Scenes that can be run and hardly were meant: what is said of them before they are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from taichi_dem.scene import Scene
from taichi_dem.wording import quantity

DEEP = 0.1  # of the smaller radius: an overlap that a scene hardly begins with
MANY = 1e9  # steps


def oddities(scene: Scene, steps: int, dt: float, reason: str) -> Iterator[str]:
    """What is odd about ``scene``, and about a run of it with that many steps of ``dt`` (s), which
    has that ``reason``."""
    spheres = scene.spheres
    i, j, overlap = spheres.overlapping(scene.period)
    share = overlap / np.minimum(spheres.radius[i], spheres.radius[j])
    if len(share) and share.max() >= DEEP:
        k, many = int(share.argmax()), int((share >= DEEP).sum())
        others = f" ({many:,} pairs by more than {DEEP:.0%})" if many > 1 else ""
        yield (
            f"spheres {min(i[k], j[k])} and {max(i[k], j[k])} overlap by "
            f"{quantity(overlap[k], 'm')} at the start, {share[k]:.0%} of the smaller radius"
            f"{others}: they will fly apart unless they are held. Is a diameter given as a radius?"
        )
    if steps > MANY:
        said = f"dt = {quantity(dt, 's')}, {reason}"
        yield f"{steps:.2g} steps are more than can be waited for: {said}"
