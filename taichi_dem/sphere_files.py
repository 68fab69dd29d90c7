"""Spheres from files: LAMMPS data, CSV and NumPy archives. A mistake names the file and line."""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_dem.material import Material
from taichi_dem.reading import unreadable
from taichi_dem.validation import InputError, Problem, unknown
from taichi_dem.writing import replacing

if TYPE_CHECKING:
    from taichi_dem.spheres import Spheres

Columns = dict[str, Any]  # arguments of Spheres

DENSITY_TOLERANCE = 1e-6
CSV_VECTORS = {
    "position": ("x", "y", "z"),
    "velocity": ("vx", "vy", "vz"),
    "omega": ("wx", "wy", "wz"),
}
CSV_COLUMNS = (*(c for columns in CSV_VECTORS.values() for c in columns), "radius", "material")
NPZ_ARRAYS = ("position", "radius", "velocity", "omega", "material")
STATE_NAMES = "material_names"  # which only the state of a run has
NPZ_RULE = (
    "must be an .npz archive, as numpy.savez makes it, of the arrays position (n, 3) and "
    "radius (n,) and, if you like, velocity (n, 3), omega (n, 3) and material (n,), names"
)


def read_lammps_data(
    path: Path, materials: Material | Sequence[Material] | Mapping[int, Material]
) -> Columns:
    """Sections Atoms (id type diameter density x y z) and, if there, Velocities (id v w)."""
    lines = _lines(path, "lammps_data")
    sections = _sections(path, lines)
    if "Atoms" not in sections:
        raise _refused(path, None, "has no section 'Atoms'")
    atoms = _numbers(path, sections["Atoms"], "id type diameter density x y z", extra=3)
    atoms = atoms[np.argsort(atoms[:, 0], kind="stable")]
    ids, kinds = atoms[:, 0], atoms[:, 1].astype(int)
    promised = _promised_atoms(lines)
    if promised not in (None, len(atoms)):
        raise _refused(path, None, f"promises {promised} atoms and has {len(atoms)}")
    if (twice := np.flatnonzero(np.diff(ids) == 0)).size:
        raise _refused(path, None, f"has two atoms with id {ids[twice[0]]:.0f}")
    listed, index = _by_type(path, materials, kinds, atoms[:, 3])
    motion: np.ndarray = np.zeros((len(atoms), 6))
    if "Velocities" in sections:
        rows = _numbers(path, sections["Velocities"], "id vx vy vz wx wy wz")
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        if not np.array_equal(rows[:, 0], ids):
            raise _refused(path, None, "the ids of 'Velocities' are not those of 'Atoms'")
        motion = rows[:, 1:]
    return {
        "position": atoms[:, 4:7],
        "radius": atoms[:, 2] / 2,
        "material": (listed, index),
        "velocity": motion[:, :3],
        "omega": motion[:, 3:],
    }


def read_csv(path: Path, material: Material | Sequence[Material] | None) -> Columns:
    """A header and one line for each sphere."""
    rows = csv.reader(_lines(path, "file"))
    header = [name.strip() for name in next(rows, [])]
    where = f"{path}:1"
    for name in header:
        if name not in CSV_COLUMNS:
            raise InputError([unknown("file", where, name, CSV_COLUMNS, f"column '{name}'")])
        if header.count(name) > 1:
            raise _refused(path, 1, f"has the column '{name}' twice", "file")
    for columns in (*CSV_VECTORS.values(), ("radius",)):
        missing = [name for name in columns if name not in header]
        if missing and (len(missing) < len(columns) or columns[0] in ("x", "radius")):
            raise _refused(path, 1, f"column '{missing[0]}' is missing", "file")
    at = header.index("material") if "material" in header else None
    fields = " ".join(name for name in header if name != "material")
    numbered, names = [], []
    for line, row in enumerate(rows, start=2):
        if len(row) == len(header):
            names += [row[at].strip()] if at is not None else []
            numbered.append((line, [cell for k, cell in enumerate(row) if k != at]))
        elif row:
            rule = f"must have {len(header)} columns: {', '.join(header)}; has {len(row)}"
            raise _refused(path, line, rule, "file")
    values = _numbers(path, numbered, fields, key="file")
    column = dict(zip(fields.split(), values.T, strict=True))
    found: Columns = {
        name: np.stack([column[c] for c in columns], axis=1)
        for name, columns in CSV_VECTORS.items()
        if columns[0] in column
    }
    found["radius"] = column["radius"]
    found["material"] = _by_name(path, material, names if at is not None else None)
    return found


def read_npz(path: Path, material: Material | Sequence[Material] | None) -> Columns:
    """Arrays by name."""
    try:
        with np.load(path, allow_pickle=False) as data:
            found: Columns = {name: data[name] for name in data.files}
    except (ValueError, zipfile.BadZipFile, AttributeError):
        raise _refused(path, None, NPZ_RULE, "file") from None
    except OSError as error:
        raise _refused(path, None, unreadable(error), "file") from None
    if STATE_NAMES in found:
        found = _of_state(found)
    for name in found:
        if name not in NPZ_ARRAYS:
            raise InputError([unknown("file", str(path), name, NPZ_ARRAYS, f"array '{name}'")])
    for name in ("position", "radius"):
        if name not in found:
            raise _refused(path, None, f"array '{name}' is missing; {NPZ_RULE}", "file")
    names = found["material"].tolist() if "material" in found else None
    found["material"] = _by_name(path, material, names)
    return found


def _of_state(found: Columns) -> Columns:
    """The spheres of the state that a run has left (:mod:`taichi_dem.snapshot`)."""
    arrays = {name: found[name] for name in NPZ_ARRAYS if name in found}
    if "material" in arrays:
        arrays["material"] = found[STATE_NAMES][arrays["material"]]
    return arrays


def write_npz(path: Path, spheres: Spheres) -> None:
    """What :func:`read_npz` reads."""
    names = np.array([material.name for material in spheres.materials], dtype=str)
    arrays = {name: getattr(spheres, name) for name in NPZ_ARRAYS if name != "material"}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays, material=names[spheres.material_index])


def _refused(path: Path, line: int | None, rule: str, key: str = "lammps_data") -> InputError:
    return InputError([Problem(key, str(path) if line is None else f"{path}:{line}", rule)])


def _lines(path: Path, key: str) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise _refused(path, None, unreadable(error), key) from None


def _sections(path: Path, lines: Sequence[str]) -> dict[str, list[tuple[int, list[str]]]]:
    """Numbered lines of fields under each title; a title is a line that starts with a capital."""
    sections: dict[str, list[tuple[int, list[str]]]] = {}
    title = ""
    for number, line in enumerate(lines[1:], start=2):
        fields = line.partition("#")[0].split()
        if fields and fields[0][0].isupper():
            title = " ".join(fields)
            style = line.partition("#")[2].strip()
            if title == "Atoms" and style not in ("", "sphere"):
                raise _refused(path, number, f"atom style '{style}' is not known; must be sphere")
            sections[title] = []
        elif fields and title:
            sections[title].append((number, fields))
    return sections


def _promised_atoms(lines: Iterable[str]) -> int | None:
    for line in lines:
        fields = line.split()
        if len(fields) == 2 and fields[1] == "atoms" and fields[0].isdigit():
            return int(fields[0])
    return None


def _numbers(
    path: Path,
    rows: Sequence[tuple[int, list[str]]],
    names: str,
    extra: int = 0,
    key: str = "lammps_data",
) -> np.ndarray:
    """(rows, names) numbers; ``extra`` more fields may follow and are dropped."""
    width = len(names.split())
    values = []
    for line, fields in rows:
        try:
            if len(fields) not in (width, width + extra):
                raise ValueError
            values.append([float(field) for field in fields[:width]])
        except ValueError:
            rule = f"must be {width} numbers: {names}; found '{' '.join(fields)}'"
            raise _refused(path, line, rule, key) from None
    if not values:
        raise _refused(path, None, "has no spheres", key)
    return np.array(values)


def _by_type(
    path: Path,
    materials: Material | Sequence[Material] | Mapping[int, Material],
    kinds: np.ndarray,
    density: np.ndarray,
) -> tuple[list[Material], np.ndarray]:
    """The materials of the atom types that occur, and the index of each atom into them."""
    used, index = np.unique(kinds, return_inverse=True)
    if isinstance(materials, Material):
        materials = dict.fromkeys(used.tolist(), materials)
    elif not isinstance(materials, Mapping):
        materials = dict(enumerate(materials, start=1))
    problems = []
    for kind in used.tolist():
        if kind not in materials:
            rule = f"has atoms of type {kind}; materials are given for {sorted(materials)}"
            problems.append(Problem("materials", str(path), rule))
            continue
        expected = materials[kind].density
        wrong = (kinds == kind) & ~(np.abs(density - expected) <= DENSITY_TOLERANCE * expected)
        if wrong.any():
            rule = (
                f"atoms of type {kind} have density {density[wrong][0]:g} kg/m3 in the file, and "
                f"their material '{materials[kind].name}' {expected:g}; make them equal"
            )
            problems.append(Problem("lammps_data", str(path), rule))
    if problems:
        raise InputError(problems)
    return [materials[kind] for kind in used.tolist()], index


def _by_name(
    path: Path, material: Material | Sequence[Material] | None, names: list[str] | None
) -> Any:
    """What Spheres takes as material: the one given, or those that the names stand for, or what is
    wrong with them."""
    if names is None:
        if isinstance(material, Material):
            return material
        return Problem("material", str(path), "names no materials: give one for all spheres")
    given = (material,) if isinstance(material, Material) else tuple(material or ())
    number = {one.name: k for k, one in enumerate(given)}
    for row, name in enumerate(names):
        if name not in number:
            problem = unknown("material", name, name, number, f"material in {path}, sphere {row}")
            if isinstance(material, Material):
                rule = f"{problem.rule}; leave spheres.material out where the file names materials"
                problem = problem._replace(rule=rule)
            return problem
    return given, np.array([number[name] for name in names])
