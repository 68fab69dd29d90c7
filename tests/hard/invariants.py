"""What any code must keep of any scene, seen from outside: spheres, walls and energy at the end."""

from collections.abc import Iterator

import numpy as np

import taichi_dem as dem
from taichi_dem.contacts.elasticity import effective_youngs_modulus
from tests.hard.kit import Figure

MADE = 0.02  # of the energy at the start: what is more counts as nonsense; no bound of the scheme
TOUCHING = 6  # contacts a sphere in a packing, each shared by two: twelve spheres can touch one


def kept(scene: dem.Scene, rows: np.ndarray, held: float, time: float) -> Iterator[Figure]:
    """Of the end, (n, 9) position, velocity, omega, at ``time`` (s); ``held``: J in the contacts at
    the start.  Where walls work nothing is said of the energy."""
    spheres = scene.spheres
    yield Figure("spheres gone", float(spheres.count - len(rows)), 0)
    if len(rows) < spheres.count:
        return
    yield Figure("numbers not finite", float((~np.isfinite(rows)).sum()), 0)
    position = rows[:, :3]
    beyond = [
        (position - point - travelled(wall, time) * normal) @ normal < 0
        for wall in scene.boundaries
        for point, normal in wall.faces()
    ]
    yield Figure("spheres through a wall", float(np.sum(beyond)), 0)
    if not any(wall.moves for wall in scene.boundaries):
        yield Figure("energy made", gained(scene, rows, held), MADE)


def gained(scene: dem.Scene, rows: np.ndarray, held: float) -> float:
    """The share by which there is more energy at the end than there was, and stuck in surfaces."""
    spheres = scene.spheres
    before = held + _moving(scene, spheres.position, spheres.velocity, spheres.omega)
    after = _moving(scene, rows[:, :3], rows[:, 3:6], rows[:, 6:])
    most = before + _sticking(scene)
    return after / most - 1 if most else after


def travelled(wall: dem.Box | dem.Plane | dem.Piston, time: float) -> float:
    """m along the normal; what moves under a load is where it was, as nobody knows better."""
    if isinstance(wall, dem.Plane):
        return float(np.dot(wall.velocity, wall.faces()[0][1]) * time)
    if isinstance(wall, dem.Piston) and wall.velocity is not None:
        return wall.velocity * time
    if isinstance(wall, dem.Piston) and wall.program is not None:
        return float(np.interp(time, *np.transpose([(0.0, 0.0), *wall.program])))
    return 0.0


def _moving(
    scene: dem.Scene, position: np.ndarray, velocity: np.ndarray, omega: np.ndarray
) -> float:
    """Kinetic energy and gravity's, J, from the lowest wall or sphere at the start up."""
    mass, radius = scene.spheres.mass, scene.spheres.radius
    inertia = 0.4 * mass * radius**2
    moving = 0.5 * mass @ (velocity**2).sum(axis=1) + 0.5 * inertia @ (omega**2).sum(axis=1)
    floor = min([0.0, float(scene.spheres.position[:, 2].min())])
    return float(moving - mass @ (position[:, 2] - floor) * scene.gravity[2])


def _sticking(scene: dem.Scene) -> float:
    """J, no less than sticky surfaces can give: W pi a_0^2 each, a_0^3 = 9 pi W R*^2/(2 E*)."""
    law, count = scene.law, scene.spheres.count
    if not isinstance(law.normal, dem.JKR):
        return 0.0
    pairs = [(a, b) for a in scene.materials for b in scene.materials]
    work = max(law.between("normal", a.name, b.name).work_of_adhesion for a, b in pairs)
    modulus = min(effective_youngs_modulus(a, b) for a, b in pairs)
    area = np.pi * (9 * np.pi * work * scene.spheres.radius.max() ** 2 / (2 * modulus)) ** (2 / 3)
    faces = sum(len(wall.faces()) for wall in scene.boundaries)
    contacts = min(count * (count - 1) // 2, TOUCHING * count) + count * faces
    return float(contacts * work * area)
