"""A scene in the input language of LAMMPS (its pair style ``granular``).

What LAMMPS cannot do alike is refused with ``ValueError``: other laws than Hertz or JKR with or
without Mindlin, plates under load, a conveyor aslant, a substrate that gives.  Its dashpot is that
of Tsuji et al.  Each pair of materials is told as the one that is alike, so that its rules for
mixing them do not matter.
"""

import itertools
import math

import numpy as np

import taichi_dem as dem
from benchmarks import liggghts
from taichi_dem.contacts.elasticity import effective_shear_modulus, effective_youngs_modulus

SCRIPT = """\
units si
atom_style sphere
comm_modify vel yes
boundary f f f
newton off
read_data {data}
neighbor {skin!r} bin
neigh_modify delay 0 every 1 check yes
timestep {dt!r}
pair_style granular
{laws}
{gravity}
{walls}
fix motion all nve/sphere
thermo {steps}
run {steps}
"""


def script(scene: dem.Scene, dt: float, steps: int, skin: float) -> str:
    """The script that reads ``liggghts.write_data``'s file; ``skin`` in m.

    Raises ValueError where LAMMPS has no words for the scene.
    """
    kinds = list(enumerate(scene.materials, 1))
    pairs = itertools.combinations_with_replacement(kinds, 2)
    laws = [f"pair_coeff {i} {j} {_model(scene, a, b)}" for (i, a), (j, b) in pairs]
    laws += [f"group kind{i} type {i}" for i, _ in kinds]
    size = math.hypot(*scene.gravity)
    way = " ".join(repr(float(g) / size + 0.0) for g in scene.gravity) if size else "0 0 -1"
    return SCRIPT.format(
        data=liggghts.DATA,
        skin=skin,
        dt=dt,
        laws="\n".join(laws),
        gravity=f"fix gravity all gravity {size!r} vector {way}",
        walls="\n".join(_walls(scene, dt)),
        steps=steps,
    )


def alike(a: dem.Material, b: dem.Material) -> tuple[float, float]:
    """Young's modulus (Pa) and Poisson's ratio of the material whose contacts with itself are those
    of ``a`` with ``b``: E* = E/(2 (1 - nu^2)), G*/E* = (1 - nu)/(2 (2 - nu))."""
    modulus = effective_youngs_modulus(a, b)
    share = effective_shear_modulus(a, b) / modulus
    ratio = (1 - 4 * share) / (1 - 2 * share)
    return 2 * modulus * (1 - ratio**2), ratio


def _model(scene: dem.Scene, a: dem.Material, b: dem.Material) -> str:
    law = scene.law
    normal = law.between("normal", a.name, b.name)
    if law.rolling is not None or law.surface is not None:
        raise ValueError(f"law: must have neither rolling nor surface; is {law}")
    if not isinstance(normal, dem.Hertz | dem.JKR):
        raise ValueError(f"law: must be Hertz or JKR; is {law}")
    modulus, ratio = alike(a, b)
    words = f"{modulus!r} {normal.restitution!r} {ratio!r}"
    if isinstance(normal, dem.JKR):
        head = f"jkr {words} {normal.work_of_adhesion / 2!r}"  # of each of the two surfaces
    else:
        head = f"hertz/material {words}"
    rubs = law.between("tangential", a.name, b.name) or dem.Mindlin(0.0, 0.0)
    return f"{head} damping tsuji tangential mindlin NULL {rubs.damping!r} {rubs.friction!r}"


def _walls(scene: dem.Scene, dt: float) -> list[str]:
    lines: list[str] = []
    faces = [(wall, *face) for wall in liggghts.walls(scene) for face in wall.faces()]
    for wall, point, normal in faces:
        name = f"wall{len(lines)}"
        before, where = _surface(name, wall, point, normal, dt)
        lines += before
        for kind in scene.spheres.materials:
            model = _model(scene, kind, wall.material)
            style = "wall/gran/region" if before else "wall/gran"
            group = f"kind{scene.materials.index(kind) + 1}"
            lines.append(f"fix {name}_{group} {group} {style} granular {model} {where}")
    return lines


def _surface(
    name: str, wall: dem.Box | dem.Plane | dem.Piston, point: np.ndarray, normal: np.ndarray, dt
) -> tuple[list[str], str]:
    """A primitive plane where it lies across an axis and keeps its place, else a region."""
    axis, belt = int(np.argmax(np.abs(normal))), liggghts.belt(wall)
    moves = wall.moves and not belt
    if np.count_nonzero(normal) == 1 and not moves:
        ends = [repr(float(point[axis])), "NULL"]
        low, high = ends if normal[axis] > 0 else reversed(ends)
        return [], f"{'xyz'[axis]}plane {low} {high}{belt}"
    if belt:
        raise ValueError(f"boundaries: a conveyor must lie across an axis: {wall}")
    plane = " ".join(repr(float(value)) for value in (*point, *normal))
    lines, ways = [], []
    for letter, share in zip("xyz", normal * moves, strict=True):
        ways.append(f"v_{name}{letter}" if share else "NULL")
        if share:
            lines.append(f"variable {name}{letter} equal {float(share)!r}*({_travel(wall, dt)})")
    move = f" move {' '.join(ways)}" if moves else ""
    return [*lines, f"region {name} plane {plane} side in{move}"], f"region {name}"


def _travel(wall: dem.Plane | dem.Piston, dt: float) -> str:
    """Metres along the normal, as a formula of ``step``."""
    if isinstance(wall, dem.Plane):
        return f"{float(np.dot(wall.velocity, wall.faces()[0][1]) * dt)!r}*step"
    if wall.load is not None:
        raise ValueError("boundaries: a piston under load has no counterpart")
    if wall.program is None:
        return f"{wall.velocity * dt!r}*step"
    rows = [(0.0, 0.0), *(row for row in wall.program if row[0] > 0)]
    parts = [f"(step>={rows[-1][0] / dt!r})*{rows[-1][1]!r}"]
    for (start, gone), (end, there) in itertools.pairwise(rows):
        first, last, speed = start / dt, end / dt, (there - gone) / (end - start) * dt
        moved = f"{gone!r}+{speed!r}*(step-{first!r})"
        parts.append(f"(step>={first!r})*(step<{last!r})*({moved})")
    return "+".join(parts)
