"""A scene in the input language of LIGGGHTS 3.8, a timed run of its binary, and what it wrote.

What LIGGGHTS cannot do alike is refused with ``ValueError``: other laws than Hertz or EEPA with or
without Mindlin, CDT that stops and multi-contact (which it computes as our lagged one), slanted
walls, plates under load, a substrate that gives.  Fixed walls and conveyors become primitive
planes; walls that move become meshes, whose total forces are written.  The tangential dashpot is
sqrt(k_t/k_n) of the normal one, whatever Mindlin's ``damping``, unless that is zero; EEPA's is the
constant one.
"""

import itertools
import math
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import taichi_dem as dem

BINARY = "liggghts"
SKIN = 0.05  # of the smallest diameter
SOFT, HARD = 5e6, 1e9  # Pa: LIGGGHTS wants to be told of moduli beyond
SCRIPT, DATA, LOG = "in.scene", "scene.data", "log.scene"


@dataclass(frozen=True)
class Timing:
    """Seconds of the time loops alone, of the whole process, and of the core that it kept busy."""

    loop: float
    wall: float
    core: float


@dataclass(frozen=True)
class Sampling:
    """Forces are averaged over the ``count`` steps before each multiple of ``every`` steps."""

    every: int
    count: int


def available() -> bool:
    """Whether the binary is on the path."""
    return shutil.which(BINARY) is not None


def write(
    folder: Path,
    scene: dem.Scene,
    *,
    dt: float,
    steps: int,
    skin: float | None = None,
    sampling: Sampling | None = None,
) -> Path:
    """Write the spheres, the meshes and a script that makes ``steps`` steps; returns the script.

    ``skin`` in m. With ``sampling`` the mean forces on each moving boundary are written, to be
    read by :func:`forces`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    low, high = _domain(scene)
    write_data(folder / DATA, scene)
    lines = [
        *_settings(scene, 2 * SKIN * scene.spheres.radius.min() if skin is None else skin),
        *_laws(scene),
        f"timestep {_exact(dt)}",
        *_gravity(scene),
        *_fixed_walls(scene),
    ]
    for k, boundary in _moving(scene):
        write_mesh(folder / f"boundary{k}.stl", boundary, low, high)
        lines += _mesh(k, scene.materials.index(boundary.material) + 1, _model(scene), sampling)
    lines += _surface(scene)
    lines += ["fix motion all nve/sphere", f"thermo {steps}", "thermo_modify lost error"]
    lines += _runs(scene, dt, steps)
    (folder / SCRIPT).write_text("\n".join(lines) + "\n")
    return folder / SCRIPT


def write_data(path: Path, scene: dem.Scene) -> None:
    """Write the spheres: box, id type diameter density x y z, and their velocities."""
    if scene.period is not None or scene.sleep:
        raise ValueError("period, sleep: have no counterpart here")
    spheres = scene.spheres
    low, high = _domain(scene)
    kinds = [scene.materials.index(material) + 1 for material in spheres.materials]
    with path.open("w") as file:
        file.write(f"spheres\n\n{spheres.count} atoms\n{len(scene.materials)} atom types\n\n")
        for axis, first, last in zip("xyz", low, high, strict=True):
            file.write(f"{_exact(first)} {_exact(last)} {axis}lo {axis}hi\n")
        file.write("\nAtoms\n\n")
        for k in range(spheres.count):
            kind = spheres.material_index[k]
            numbers = (2 * spheres.radius[k], spheres.materials[kind].density, *spheres.position[k])
            file.write(f"{k + 1} {kinds[kind]} {_row(numbers)}\n")
        file.write("\nVelocities\n\n")
        for k in range(spheres.count):
            file.write(f"{k + 1} {_row((*spheres.velocity[k], *spheres.omega[k]))}\n")


def write_mesh(
    path: Path, boundary: dem.Piston | dem.Plane, low: np.ndarray, high: np.ndarray
) -> None:
    """Write the boundary as two triangles that span the domain from ``low`` to ``high``."""
    axis = _axis(boundary)
    inset = 1e-3 * (high - low)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    corners = np.tile(np.array(boundary.point, dtype=float), (4, 1))
    corners[:, a] = np.array([low + inset, high - inset])[[0, 1, 1, 0], a]
    corners[:, b] = np.array([low + inset, high - inset])[[0, 0, 1, 1], b]
    with path.open("w") as file:
        file.write("solid boundary\n")
        for triangle in ((0, 1, 2), (0, 2, 3)):
            file.write(f"facet normal {_row(boundary.faces()[0][1])}\nouter loop\n")
            file.writelines(f"vertex {_row(corners[k])}\n" for k in triangle)
            file.write("endloop\nendfacet\n")
        file.write("endsolid boundary\n")


def walls(scene: dem.Scene) -> list[dem.Box | dem.Piston | dem.Plane]:
    """The boundaries, and the ground if it is a mere plane; ValueError if it gives."""
    ground = scene.substrate
    if ground is None:
        return list(scene.boundaries)
    if ground.exchange != "none":
        raise ValueError("substrate: there is none that gives; exchange must be 'none'")
    return [*scene.boundaries, *(dem.Plane(*face, ground.material) for face in ground.faces())]


def run(script: Path) -> Timing:
    """Run a script in its folder as one process; RuntimeError with its last words if it fails."""
    command = [BINARY, "-in", script.name, "-log", LOG]  # "-screen none" breaks reading meshes
    start, before = time.perf_counter(), os.times()
    done = subprocess.run(
        command, cwd=script.parent, capture_output=True, text=True, errors="replace"
    )
    wall, after = time.perf_counter() - start, os.times()
    if done.returncode:
        raise RuntimeError(f"{BINARY} failed:\n{done.stdout[-1000:]}{done.stderr[-1000:]}")
    loops = re.findall(r"Loop time of (\S+)", (script.parent / LOG).read_text())
    core = sum(after[2:4]) - sum(before[2:4])  # of children: user, system
    return Timing(sum(map(float, loops)), wall, core)


def forces(folder: Path, boundary: int) -> np.ndarray:
    """(rows, 4): step and mean force (N) on a moving boundary, as its number in the scene."""
    return np.loadtxt(folder / f"boundary{boundary}.txt", ndmin=2)


def _settings(scene: dem.Scene, skin: float) -> list[str]:
    moduli = [material.youngs_modulus for material in scene.materials]
    return [
        "atom_style granular",
        "atom_modify map array",
        "boundary f f f",
        "newton off",
        "communicate single vel yes",
        "units si",
        *(["soft_particles yes"] if min(moduli) < SOFT else []),
        *(["hard_particles yes"] if max(moduli) > HARD else []),
        f"neighbor {_exact(skin)} bin",
        "neigh_modify delay 0",
        f"read_data {DATA}",
    ]


def _model(scene: dem.Scene) -> str:
    law = scene.law
    normal = {dem.Hertz: "hertz", dem.EEPA: "edinburgh"}.get(type(law.normal))
    if normal is None:
        raise ValueError(f"law: must be Hertz or EEPA with or without Mindlin; is {law}")
    words = ["model", normal, "tangential", "off" if law.tangential is None else "history"]
    if law.tangential is not None and not law.tangential.damping:
        words += ["tangential_damping", "off"]
    if law.rolling is not None:
        if law.rolling != dem.CDT(getattr(law.rolling, "rolling_friction", 0.0)):
            raise ValueError(f"law: rolling must be CDT that stops; is {law.rolling}")
        words += ["rolling_friction", "cdt"]
    if law.surface is not None:
        words += ["surface", "multicontact"]
    return " ".join(words)


def _laws(scene: dem.Scene) -> list[str]:
    model = _model(scene)  # or the reason why there is none
    kinds, law = scene.materials, scene.law

    def kind(name: str, of: str) -> str:
        values = [getattr(each, of) for each in kinds]
        return f"fix {name} all property/global {name} peratomtype {_row(values)}"

    def pair(name: str, slot: str, of: str) -> str:
        values = [getattr(law.between(slot, a.name, b.name), of) for a in kinds for b in kinds]
        return f"fix {name} all property/global {name} peratomtypepair {len(kinds)} {_row(values)}"

    lines = [kind("youngsModulus", "youngs_modulus"), kind("poissonsRatio", "poissons_ratio")]
    lines += [pair("coefficientRestitution", "normal", "restitution")]
    if isinstance(law.normal, dem.EEPA):
        one = f"peratomtypepair {len(kinds)} {_row([1.0] * len(kinds) ** 2)}"
        lines += [
            pair("UnloadingStiffness", "normal", "stiffness_ratio"),
            pair("surfaceEnergy", "normal", "surface_energy"),
            pair("pullOffForce", "normal", "pull_off_force"),
            f"fix adhesion all property/global coefficientAdhesionStiffness {one}",
            f"fix c all property/global adhesionExponent scalar {law.normal.adhesion_exponent!r}",
            f"fix n all property/global overlapExponent scalar {law.normal.overlap_exponent!r}",
        ]
    if law.tangential is not None:
        lines.append(pair("coefficientFriction", "tangential", "friction"))
    if law.rolling is not None:
        lines.append(pair("coefficientRollingFriction", "rolling", "rolling_friction"))
    return [*lines, f"pair_style gran {model}", "pair_coeff * *"]


def _surface(scene: dem.Scene) -> list[str]:
    """Multi-contact; it looks for the walls that stand before it."""
    surface = scene.law.surface
    if surface is None:
        return []
    prefactor = f"geometric_prefactor {_exact(surface.prefactor)}"
    return [f"fix spread all multicontact/halfspace {prefactor}"]


def _gravity(scene: dem.Scene) -> list[str]:
    size = math.hypot(*scene.gravity)
    if size == 0:
        return []
    return [f"fix gravity all gravity {_exact(size)} vector {_row(np.divide(scene.gravity, size))}"]


def _fixed_walls(scene: dem.Scene) -> list[str]:
    model = _model(scene)
    lines: list[str] = []
    for wall in (wall for wall in walls(scene) if not _moves(wall)):
        kind = scene.materials.index(wall.material) + 1
        for point, normal in wall.faces():
            axis = _across(normal, wall)
            where = f"{'xyz'[axis]}plane {_exact(point[axis])}{belt(wall)}"
            name = f"wall{len(lines)}"
            lines.append(f"fix {name} all wall/gran {model} primitive type {kind} {where}")
    return lines


def _mesh(k: int, kind: int, model: str, sampling: Sampling | None) -> list[str]:
    name = f"boundary{k}"
    lines = [
        f"fix {name} all mesh/surface/stress file {name}.stl type {kind}",
        f"fix {name}_contact all wall/gran {model} mesh n_meshes 1 meshes {name}",
    ]
    if sampling is not None:
        force = " ".join(f"f_{name}[{component}]" for component in (1, 2, 3))
        when = f"1 {sampling.count} {sampling.every}"
        lines.append(f"fix {name}_force all ave/time {when} {force} file {name}.txt")
    return lines


def _runs(scene: dem.Scene, dt: float, steps: int) -> Iterator[str]:
    """One run for each stretch of time in which all boundaries keep their velocities."""
    moving = _moving(scene)
    times = [time for _, wall in moving for time, _ in getattr(wall, "program", None) or ()]
    stops = sorted({0, steps, *(s for s in (_step(t, dt) for t in times) if s < steps)})
    for first, last in itertools.pairwise(stops):
        names = []
        for k, wall in moving:
            velocity = _velocity(wall, 0.5 * (first + last) * dt)
            if any(velocity):
                names.append(f"boundary{k}_motion")
                yield f"fix {names[-1]} all move/mesh mesh boundary{k} linear {_row(velocity)}"
        yield f"run {last - first}"
        yield from (f"unfix {name}" for name in names)


def _step(time: float, dt: float) -> int:
    step = round(time / dt)
    if abs(step * dt - time) > 1e-6 * dt * max(step, 1):
        raise ValueError(f"program: {time} s must be a whole number of steps of {dt} s")
    return step


def _velocity(wall: dem.Piston | dem.Plane, time: float) -> np.ndarray:
    if isinstance(wall, dem.Plane):
        return np.array(wall.velocity)
    speed = wall.velocity or 0.0
    if wall.program is not None:
        rows = np.array([(0.0, 0.0), *(row for row in wall.program if row[0] > 0)])
        after = np.searchsorted(rows[:, 0], time)
        if after < len(rows):
            span, way = rows[after] - rows[after - 1]
            speed = way / span
    return speed * wall.faces()[0][1]


def belt(wall: dem.Box | dem.Piston | dem.Plane | dem.Substrate) -> str:
    """How a conveyor's speed follows its plane, in LIGGGHTS and in LAMMPS; "" if it is none."""
    if not isinstance(wall, dem.Plane) or not np.cross(wall.velocity, wall.normal).any():
        return ""
    if np.count_nonzero(wall.velocity) != 1 or np.dot(wall.velocity, wall.normal):
        raise ValueError(f"boundaries: a conveyor must go along an axis and itself: {wall}")
    axis = int(np.argmax(np.abs(wall.velocity)))
    return f" shear {'xyz'[axis]} {_exact(wall.velocity[axis])}"


def _moving(scene: dem.Scene) -> list[tuple[int, dem.Piston | dem.Plane]]:
    return [(k, wall) for k, wall in enumerate(scene.boundaries) if _moves(wall)]


def _moves(wall: dem.Box | dem.Piston | dem.Plane) -> bool:
    if isinstance(wall, dem.Piston) and wall.load is not None:
        raise ValueError("boundaries: a piston under load has no counterpart")
    return wall.moves and not belt(wall)


def _axis(wall: dem.Piston | dem.Plane) -> int:
    return _across(wall.faces()[0][1], wall)


def _across(normal: np.ndarray, wall: object) -> int:
    axis = int(np.argmax(np.abs(normal)))
    if np.count_nonzero(normal) != 1:
        raise ValueError(f"boundaries: the normal must be along an axis: {wall}")
    return axis


def _domain(scene: dem.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around spheres and walls across the axes, with room for what moves out a
    little."""
    spheres = scene.spheres
    points = [spheres.position.min(axis=0), spheres.position.max(axis=0)]
    for wall in scene.boundaries:
        for point, normal in wall.faces():
            if np.count_nonzero(normal) == 1:
                points.append(np.where(normal != 0, point, points[0]))
    margin = 4 * spheres.radius.max()
    return np.min(points, axis=0) - margin, np.max(points, axis=0) + margin


def _row(values: Iterable[float]) -> str:
    return " ".join(map(_exact, values))


def _exact(value: float) -> str:
    """The shortest text that reads back as ``value``."""
    return repr(float(value) + 0.0)
