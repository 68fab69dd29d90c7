"""Scenes whose outcome is known in closed form, to judge runs by more than other runs.

Two spheres that meet head-on, or one sphere and a plane, without gravity or friction to begin
with: after the impact they part with ``restitution`` times the speed at which they met. (Hertz and
Hooke are damped such that this is exact: see their files.) And spheres that nothing touches.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_dem.record import Record
from taichi_dem.scene import Scene

HEAD_ON = 1e-12  # of the speed, that may be across the line of centres
FREE = 1e-9  # of the way, that a free flight may be off


def rebound(scene: Scene) -> np.ndarray | None:
    """Velocities (n, 3) m/s after the only impact of the scene, or None where that is not known."""
    spheres, law = scene.spheres, scene.law
    plain = not np.any(scene.gravity) and not np.any(spheres.omega) and scene.period is None
    if not plain or not hasattr(law.normal, "restitution") or not _elastic(law.normal):
        return None
    walls: list[Any] = [*scene.boundaries, *([scene.substrate] if scene.substrate else [])]
    if spheres.count == 2 and not walls:
        return _of_two(scene)
    if scene.substrate is not None and not scene.substrate.homogeneous:
        return None  # a layer is stiffer than Hertz has it, and creep takes energy
    if spheres.count == 1 and len(walls) == 1 and len(walls[0].faces()) == 1:
        return _off_plane(scene, walls[0])
    return None


def rebound_error(velocity: np.ndarray, exact: np.ndarray, before: np.ndarray) -> float:
    """Of ``velocity`` (n, 3) after the impact, over the largest speed before it."""
    return float(np.abs(velocity - exact).max() / np.linalg.norm(before, axis=1).max())


def is_over(run: Record, exact: np.ndarray, before: np.ndarray) -> bool:
    """Whether the impact after which velocities are ``exact`` (n, 3) lies within ``run``: nothing
    touches at its end, where velocities are nearer to these than to those ``before``."""
    apart = not np.any(run.contact[:, 0] == run.samples)
    left = rebound_error(run.velocity, exact, before)
    return apart and left < 0.5 * rebound_error(before, exact, before)


def flown_freely(run: Record, scene: Scene) -> bool:
    """Whether nothing touched in ``run``, not even between two samples."""
    spheres, time = scene.spheres, run.time[:, None, None]
    free = parabola(spheres.position, spheres.velocity, scene.gravity, time)
    scale = np.abs(spheres.position).max() + np.abs(free - spheres.position).max()
    return not len(run.contact) and bool(np.abs(run.position - free).max() <= FREE * scale)


def parabola(position: np.ndarray, velocity: np.ndarray, gravity: Any, time: Any) -> np.ndarray:
    """Where spheres are, (n, 3) m, ``time`` (s) after they were at ``position`` (n, 3) m with
    ``velocity`` (n, 3) m/s, and nothing but ``gravity`` (m/s2) acts on them; (k, n, 3) for times
    (k, 1, 1)."""
    return position + time * (velocity + 0.5 * time * np.asarray(gravity))


def _elastic(normal: Any) -> bool:
    """Neither sticks nor yields."""
    return not getattr(normal, "adhesive", False) and not getattr(normal, "plastic", False)


def _of_two(scene: Scene) -> np.ndarray | None:
    spheres = scene.spheres
    between = spheres.position[1] - spheres.position[0]
    distance = float(np.linalg.norm(between))
    normal = between / distance
    closing = spheres.velocity[0] - spheres.velocity[1]
    if distance < spheres.radius.sum() or not _head_on(closing, normal):
        return None
    names = [spheres.materials[k].name for k in spheres.material_index]
    change = (1 + scene.law.between("normal", *names).restitution) * (closing @ normal) * normal
    share = spheres.mass[::-1] / spheres.mass.sum()
    return spheres.velocity + np.array([-share[0] * change, share[1] * change])


def _off_plane(scene: Scene, wall: Any) -> np.ndarray | None:
    spheres, ((point, normal),) = scene.spheres, wall.faces()
    moving = any(getattr(wall, name, None) is not None for name in ("program", "load"))
    if moving or np.any(getattr(wall, "velocity", 0.0)):
        return None
    before = spheres.velocity[0]
    if (spheres.position[0] - point) @ normal < spheres.radius[0] or not _head_on(-before, normal):
        return None
    names = spheres.materials[spheres.material_index[0]].name, wall.material.name
    restitution = scene.law.between("normal", *names).restitution
    return -restitution * spheres.velocity


def _head_on(closing: np.ndarray, normal: np.ndarray) -> bool:
    """Whether ``closing`` leads along ``normal`` and nowhere else."""
    along = float(closing @ normal)
    across = float(np.linalg.norm(closing - along * normal))
    return along > 0 and across <= HEAD_ON * along
