"""Scenes to TOML files, which :func:`taichi_dem.scene_file.read` reads back equal."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from taichi_dem.run_plan import Run
from taichi_dem.scene import Scene
from taichi_dem.spheres import Spheres
from taichi_dem.tables import plain
from taichi_dem.toml_text import toml_text
from taichi_dem.writing import write_text

INLINE = 1000  # more spheres than this are kept in a file beside the scene's


def write(path: str | Path, scene: Scene, run: Run | None = None) -> None:
    """A file of ``scene`` and how to ``run`` it; many spheres go to a file beside it."""
    path = Path(path)
    document = {
        "gravity": list(scene.gravity),
        "period": list(scene.period) if scene.period else None,
        "sleep": scene.sleep or None,
        "materials": {m.name: _without(plain(m), "name") for m in scene.materials},
        "spheres": _spheres_table(scene.spheres, path),
        "boundaries": [{"type": wall.kind, **_named(wall)} for wall in scene.boundaries],
        "substrate": _named(scene.substrate) if scene.substrate else None,
        "law": _law_table(scene.law),
        "run": plain(run) if run else None,
    }
    write_text(path, toml_text(document))


def _without(table: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in table.items() if name != key}


def _named(instance: Any) -> dict[str, Any]:
    """The table of a dataclass, its material by name."""
    return plain(instance) | {"material": instance.material.name}


def _spheres_table(spheres: Spheres, path: Path) -> dict[str, Any]:
    if spheres.count > INLINE:
        beside = path.with_suffix(".spheres.npz")
        spheres.to_npz(beside)
        return {"file": beside.name}
    names = [material.name for material in spheres.materials]
    each = [names[k] for k in spheres.material_index]
    table: dict[str, Any] = {"material": each if len(names) > 1 else names[0]}
    for name in ("radius", "position", "velocity", "omega"):
        values = getattr(spheres, name)
        if name in ("radius", "position") or values.any():
            table[name] = values.tolist()
    return table


def _law_table(law: Any) -> dict[str, Any]:
    slots = [field.name for field in dataclasses.fields(law) if field.name != "pairs"]
    parts = {slot: getattr(law, slot) for slot in slots if getattr(law, slot) is not None}
    pairs = [
        {"materials": list(names), **{slot: plain(part) for slot, part in laws.items()}}
        for names, laws in law.pairs.items()
    ]
    described = {slot: {"type": type(part).__name__, **plain(part)} for slot, part in parts.items()}
    return {**described, "pairs": pairs or None}
