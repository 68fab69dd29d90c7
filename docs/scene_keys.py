"""Every key of a scene file, from the dataclasses that read them: the tables of docs/scene.md.

python docs/scene_keys.py           print them
python docs/scene_keys.py --write   put them into docs/scene.md
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from taichi_dem.contacts.law import LAWS
from taichi_dem.material import Material
from taichi_dem.run_plan import Run
from taichi_dem.scene_file import GENERATE, KEYS, SOURCES
from taichi_dem.shapes import BOUNDARIES
from taichi_dem.substrate import Layer, Relaxation, Substrate
from taichi_dem.toml_text import inline

PAGE = Path(__file__).with_name("scene.md")
BEGIN, END = "<!-- keys: made by scene_keys.py -->\n", "<!-- end of keys -->\n"

# What the dataclasses do not say themselves: of keys that are no plain numbers, and of tables.
TOP = {
    "gravity": "[x, y, z], m/s²; [0, 0, -9.81] if left out",
    "period": "[Lx, Ly], m: sides of a cell that repeats itself along x and y; none if left out",
    "sleep": "true: clusters at rest are left out until they are touched; false if left out",
    "materials": "a table for each material, by name",
    "spheres": "where the spheres are",
    "boundaries": "a list of walls",
    "substrate": "the elastic ground z < 0; none if left out",
    "law": "of the contacts",
    "run": "how long to run it and what to write",
}
SPHERES = {
    "position": "[[x, y, z], ...], m, of the centres",
    "radius": "m; one number, or one for each sphere",
    "material": "name of a material, or one for each sphere; of a `file` only if that names none",
    "velocity": "[x, y, z], m/s, or one for each sphere; at rest if left out",
    "omega": "[x, y, z], rad/s, or one for each sphere; none if left out",
    "generate": "a random packing, see below",
    "file": "a .csv or .npz file, or the `state.npz` of a run, sought from the scene's folder",
    "lammps_data": "a data file of LAMMPS or LIGGGHTS, atom_style sphere",
    "materials": "of `lammps_data`: the name of one material, or a table of names by atom type",
}
PACKING = {
    "radius": 'm: a number, or ["uniform", low, high], ["normal", mean, deviation, low, high], '
    '["lognormal", median, deviation of the logarithm, low, high]',
    "region": "[[x, y, z], [x, y, z]], m: the lowest and the highest corner",
    "count": "how many spheres; or `volume_fraction`",
    "volume_fraction": "share of the region that they fill; or `count`",
    "seed": "whole number >= 0; 0 if left out",
    "periodic": "true: up to and over the sides of a scene with `period`; false if left out",
}
WORDS = {
    "material": "name of a material",
    "point": "[x, y, z], m: where the wall is",
    "normal": "[x, y, z]: into the domain, of any length",
    "low": "[x, y, z], m; -inf: no wall there",
    "high": "[x, y, z], m; inf: no wall there",
    "Plane.velocity": "[x, y, z], m/s: along the normal it moves, across it is a conveyor",
    "program": "[[time, way], ...], s and m along the normal; linear in between",
    "coupling": '"finite" or "point"',
    "exchange": '"implicit", "lagged" or "none"',
    "exchange_every": "steps from one exchange to the next, extrapolated in between",
    "layer": "table: a layer on a rigid base",
    "relaxation": "table: ground that creeps",
    "force_lagged": "a lagged exchange goes on where it diverges",
    "base": '"bonded" or "frictionless"',
    "EEPA.damping": '"tangent": the same restitution at any speed; "constant": as LIGGGHTS',
    "limit_force": "the normal force never pulls; only without adhesion",
    "torsion_torque": "spinning about the normal is resisted too",
    "steps": "whole number >= 1, in the place of `duration`",
    "energy_balance": "whether what is lost is summed up",
    "estimate_neglected": "whether what is left out is estimated at the end",
    "effect_costs": "whether what each effect takes of a step is timed at the end",
    "MultiContact.exchange": '"implicit": solved together; "lagged": by forces of the step before',
    "regularization": '"stop": what rolls out comes to rest; "spring": it winds a spring',
}
OTHERWISE = {  # what None stands for
    "Run.dt": "the stable step",
    "Run.frames": "a hundredth of the run",
    "Run.history": "a thousandth of the run",
    "CDTJKR.work_of_adhesion": "that of JKR",
}


def tables() -> str:
    """All of them, as Markdown."""
    parts = [_given("The top of the file", TOP, KEYS)]
    parts.append(_fields("`[materials.NAME]`", Material))
    sources = ", ".join(f"`{name}`" for name in SOURCES)
    keys = list(dict.fromkeys(key for group in SOURCES.values() for key in group))
    title = f"`[spheres]`: exactly one of {sources}"
    parts.append(_given(title, SPHERES, keys))
    parts.append(_given("`[spheres.generate]`", PACKING, GENERATE))
    for name, kind in BOUNDARIES.items():
        parts.append(_fields(f'`[[boundaries]]` with `type = "{name}"`', kind))
    parts.append(_fields("`[substrate]`", Substrate))
    parts.append(_fields("`[substrate.layer]`", Layer))
    parts.append(_fields("`[substrate.relaxation]`", Relaxation))
    for slot, kinds in LAWS.items():
        for name, kind in kinds.items():
            parts.append(_fields(f'`[law]`: `{slot} = {{ type = "{name}", ... }}`', kind))
    parts.append(_fields("`[run]`: `duration` or `steps`", Run))
    return "\n".join(parts)


def _given(title: str, words: dict[str, str], keys: Any) -> str:
    lines = [f"| `{key}` | {_words_of(key, words, title)} |" for key in keys]
    return "\n".join([f"### {title}", "", "| key | |", "|---|---|", *lines, ""])


def _fields(title: str, kind: type) -> str:
    lines = list(_rows(kind, title))
    if not lines:
        return f"### {title}\n\nNo keys.\n"
    head = ["| key | must be | if left out | |", "|---|---|---|---|"]
    return "\n".join([f"### {title}", "", *head, *lines, ""])


def _rows(kind: type, title: str) -> Iterator[str]:
    for field in dataclasses.fields(kind):
        if not field.init or (kind is Material and field.name == "name"):
            continue
        allowed = field.metadata.get("range")
        if allowed is not None:
            meaning = allowed.meaning
            rule = allowed.rule().removeprefix("must be ").removesuffix(f" ({meaning})")
        else:
            words = {field.name: WORDS.get(f"{kind.__name__}.{field.name}", WORDS.get(field.name))}
            rule, meaning = "", _words_of(field.name, words, title)
        yield f"| `{field.name}` | {rule} | {_default(field, kind)} | {meaning} |"


def _default(field: dataclasses.Field[Any], kind: type) -> str:
    if field.default is dataclasses.MISSING:
        return "needed" if field.default_factory is dataclasses.MISSING else "none"
    if field.default is None:
        return OTHERWISE.get(f"{kind.__name__}.{field.name}", "none")
    return f"`{inline(field.default)}`"


def _words_of(key: str, words: dict[str, Any], title: str) -> str:
    if not words.get(key):
        raise SystemExit(f"docs/scene_keys.py: say what the key {key!r} of {title} means")
    return str(words[key])


def with_tables(page: str) -> str:
    """The text of the page with the tables as they are now."""
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + "\n" + tables() + "\n" + END + rest.partition(END)[2]


if __name__ == "__main__":
    if "--write" in sys.argv:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(with_tables(page), encoding="utf-8")
    else:
        print(tables())
