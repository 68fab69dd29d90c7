"""Scenes from TOML files. The keys are the names that Python has; every mistake names its key."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from taichi_dem.material import Material
from taichi_dem.reading import unreadable
from taichi_dem.run_plan import Run
from taichi_dem.scene import Scene
from taichi_dem.shapes import BOUNDARIES
from taichi_dem.spheres import Spheres
from taichi_dem.substrate import Layer, Relaxation, Substrate
from taichi_dem.tables import Tables, override, plain
from taichi_dem.validation import InputError, Problem, unknown

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

KEYS = (
    "gravity",
    "period",
    "sleep",
    "materials",
    "spheres",
    "boundaries",
    "substrate",
    "law",
    "run",
)
SOURCES = {  # ways to give spheres, and the keys that go with each
    "position": ("position", "radius", "material", "velocity", "omega"),
    "generate": ("generate", "material", "velocity", "omega"),
    "file": ("file", "material"),
    "lammps_data": ("lammps_data", "materials"),
}
SOURCES_SAID = ", ".join(SOURCES)
GENERATE = ("radius", "region", "count", "volume_fraction", "seed", "periodic")
READERS = {".csv": Spheres.from_csv, ".npz": Spheres.from_npz}
INSTEAD = {"run.steps": "duration", "run.duration": "steps"}  # which a replaced entry replaces
UNKNOWN_MATERIAL = Material("unknown", density=1.0, youngs_modulus=1.0, poissons_ratio=0.0)


def read(
    path: str | Path,
    overrides: Sequence[str] = (),
    laws: Any = None,
    duration: float | None = None,
) -> tuple[Scene, Run]:
    """The scene in a file and how to run it.

    ``overrides`` replace entries: ``law.normal.restitution=0.5``, ``boundaries[1].velocity=-1``;
    the value is TOML, or else text; ``run.steps`` takes the place of a ``run.duration`` and the
    other way round. ``duration`` (s) does so, too; an override that says how long is a mistake
    beside it. Files that the scene names are sought from its folder. In place
    of :mod:`taichi_dem.contacts.law`, ``laws`` may offer ``Law`` and ``LAWS``. Raises
    ``InputError`` with every mistake that was found.
    """
    path = Path(path)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError([Problem(str(path), None, unreadable(error))]) from None
    if laws is None:
        from taichi_dem.contacts import law as laws
    return _Reader(path.parent, laws).read(document, overrides, duration)


class _Reader(Tables):
    """Builds each part of a scene."""

    def __init__(self, folder: Path, laws: Any):
        super().__init__(
            convert={
                "material": self.material,
                "layer": lambda table, path: self.build(Layer, table, path),
                "relaxation": lambda table, path: self.build(Relaxation, table, path),
            }
        )
        self.folder, self.laws = folder, laws
        self.materials: dict[str, Material] = {}

    def read(
        self, document: dict[str, Any], overrides: Sequence[str], duration: float | None
    ) -> tuple[Scene, Run]:
        for text in overrides:
            self.override(document, text)
        if duration is not None:
            for text in overrides:
                if text.partition("=")[0].strip() in INSTEAD:
                    rule = f"--set {text} says how long, too; give one of them"
                    self.note("--duration", duration, rule)
            self.put(document, "run.duration", duration)
        document = self.table(document, "", KEYS)
        for name, table in self.table(document.get("materials", {}), "materials").items():
            material = self.build(Material, table, f"materials.{name}", name=name)
            self.materials[name] = material or UNKNOWN_MATERIAL
        parts: dict[str, Any]
        parts = {key: document[key] for key in ("gravity", "period", "sleep") if key in document}
        parts["spheres"] = self.spheres(document.get("spheres"))
        parts["boundaries"] = [
            self.choose(BOUNDARIES, table, f"boundaries[{k}]")
            for k, table in enumerate(self.rows(document.get("boundaries"), "boundaries"))
        ]
        if "substrate" in document:
            parts["substrate"] = self.build(Substrate, document["substrate"], "substrate")
        parts["law"] = self.law(document.get("law"))
        run = self.build(Run, document.get("run", {}), "run")
        before = len(self.problems)
        scene = self.attempt("", Scene, **parts)
        if before:  # of what could not be made the scene need not complain again
            absent = {key for key in ("spheres", "law") if parts[key] is None} | {"law.pairs"}
            absent |= {f"boundaries[{k}]" for k, w in enumerate(parts["boundaries"]) if w is None}
            found = [problem for problem in self.problems[before:] if problem.path not in absent]
            self.problems[before:] = found
        if self.problems:
            raise InputError(self.problems)
        return scene, run

    def override(self, document: dict[str, Any], text: str) -> None:
        path, equals, value = (part.strip() for part in text.partition("="))
        parsed: Any = value  # a plain word need not be quoted
        with suppress(tomllib.TOMLDecodeError):
            parsed = tomllib.loads(f"value = {value}")["value"]
        if not equals or not all(path.split(".")):
            rule = "must be KEY=VALUE, like law.normal.restitution=0.5"
            self.note("--set", text, rule)
        else:
            self.put(document, path, parsed)

    def put(self, document: dict[str, Any], path: str, value: Any) -> None:
        if problem := override(document, path, value):
            self.problems.append(problem)
        elif path in INSTEAD:
            document["run"].pop(INSTEAD[path], None)

    def material(self, name: Any, path: str) -> Material:
        if isinstance(name, str) and name in self.materials:
            return self.materials[name]
        if name is None:
            known = ", ".join(self.materials) or "none yet; make one under [materials]"
            self.note(path, None, f"is missing: must name one of the materials: {known}")
            return UNKNOWN_MATERIAL
        self.problems.append(unknown(path, name, name, self.materials, "material"))
        return UNKNOWN_MATERIAL

    def spheres(self, value: Any) -> Spheres | None:
        if value is None:
            self.note("spheres", None, f"is missing: write [spheres] with one of {SOURCES_SAID}")
            return None
        table = self.table(value, "spheres")
        if not isinstance(value, Mapping):
            return None
        given = [source for source in SOURCES if source in table]
        if len(given) != 1:
            found = ", ".join(given) or "none"
            rule = f"must have exactly one of {SOURCES_SAID}; has {found}"
            self.note("spheres", None, rule)
            return None
        entries = self.table(table, "spheres", SOURCES[given[0]])
        make: dict[str, Callable[..., Spheres]]
        make = {
            "position": self.inline,
            "generate": self.generated,
            "file": self.from_file,
            "lammps_data": self.from_lammps_data,
        }
        return self.attempt("spheres", make[given[0]], **entries)

    def inline(self, material: Any = None, **entries: Any) -> Spheres:
        if isinstance(material, list):
            path = "spheres.material[{}]".format
            made: Any = [self.material(name, path(k)) for k, name in enumerate(material)]
        else:
            made = self.material(material, "spheres.material")
        return Spheres(material=made, **{"radius": None, **entries})

    def generated(self, generate: Any, material: Any = None, **motion: Any) -> Spheres:
        wanted = self.table(generate, "spheres.generate", GENERATE)
        made = self.material(material, "spheres.material")
        return Spheres.generate(made, **{"radius": None, "region": None, **wanted, **motion})

    def from_file(self, file: Any, material: Any = None) -> Spheres:
        path = self.folder / str(file)
        if path.suffix not in READERS:
            raise InputError([Problem("file", file, f"must end in {' or '.join(READERS)}")])
        if material is None:
            return READERS[path.suffix](path, tuple(self.materials.values()))
        return READERS[path.suffix](path, self.material(material, "spheres.material"))

    def from_lammps_data(self, lammps_data: Any, materials: Any = None) -> Spheres:
        made: Any
        if isinstance(materials, Mapping):
            path = "spheres.materials.{}".format
            wrong = [key for key in materials if not key.isdigit()]
            if wrong:
                self.note(path(wrong[0]), materials[wrong[0]], "must be under an atom type: 1, 2 …")
            kinds = [key for key in materials if key.isdigit()]
            made = {int(kind): self.material(materials[kind], path(kind)) for kind in kinds}
        else:
            made = self.material(materials, "spheres.materials")
        return Spheres.from_lammps_data(self.folder / str(lammps_data), made)

    def law(self, value: Any) -> Any:
        slots = self.laws.LAWS
        if value is None:
            example = 'normal = { type = "Hertz", restitution = 0.5 }'
            self.note("law", None, f"is missing: write [law], and in it, say, {example}")
            return None
        before = len(self.problems)
        table = self.table(value, "law", (*slots, "pairs"))
        if not isinstance(value, Mapping):
            return None
        if "normal" not in table:
            kinds = ", ".join(slots["normal"])
            self.note("law.normal", None, f"is missing; its type must be one of {kinds}")
        parts = {
            slot: self.choose(slots[slot], table[slot], f"law.{slot}")
            for slot in slots
            if slot in table
        }
        pairs: dict[tuple[Any, ...], dict[str, Any]] = {}
        rows: dict[str, str] = {}
        for k, row in enumerate(self.rows(table.get("pairs"), "law.pairs")):
            path = f"law.pairs[{k}]"
            changes = self.table(row, path, ("materials", *slots))
            if not isinstance(row, Mapping):
                continue
            names = changes.pop("materials", None)
            if not isinstance(names, list) or len(names) != 2:
                self.note(f"{path}.materials", names, "must be the names of two materials")
                continue
            for name in names:
                self.material(name, f"{path}.materials")
            if tuple(names) in pairs or tuple(reversed(names)) in pairs:
                self.note(f"{path}.materials", names, "this pair was given before")
            rows[f"pairs[{tuple(names)!r}]"] = f"pairs[{k}]"
            pairs[tuple(names)] = {
                slot: self.changed(parts.get(slot), table, f"{path}.{slot}")
                for slot, table in changes.items()
            }
        if len(self.problems) > before:
            return None
        made = self.attempt("law", self.laws.Law, **parts, pairs=pairs)
        for k, problem in enumerate(self.problems[before:], start=before):
            for name, row in rows.items():  # which is how the file has it
                self.problems[k] = problem._replace(path=problem.path.replace(name, row))
        return made

    def changed(self, general: Any, value: Any, path: str) -> Any:
        """The law for all pairs with some of its numbers replaced."""
        if general is None:
            self.note(path, None, "changes a law that is not given, or not right, for all pairs")
            return None
        return self.build(type(general), plain(general) | self.table(value, path), path)
