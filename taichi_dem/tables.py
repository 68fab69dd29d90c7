"""Dataclasses from the tables of a TOML file; all mistakes are collected, each with its key."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from taichi_dem.toml_text import inline
from taichi_dem.validation import InputError, Problem, number_problem, unknown


class Tables:
    """Builds objects from tables; ``problems`` lists what was wrong so far.

    ``convert`` maps the name of a field to what turns its entry, at a path, into its value.
    """

    def __init__(self, convert: Mapping[str, Callable[[Any, str], Any]]):
        self.problems: list[Problem] = []
        self.convert = convert

    def note(self, path: str, value: Any, rule: str) -> None:
        """One more mistake."""
        self.problems.append(Problem(path, value, rule))

    def attempt(self, path: str, make: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """What ``make`` returns; None where it refuses, its reasons noted under ``path``."""
        try:
            return make(*args, **kwargs)
        except InputError as error:
            self.problems += [problem.under(path) for problem in error.problems]
            return None

    def table(self, value: Any, path: str, keys: Iterable[str] | None = None) -> dict[str, Any]:
        """``value`` as a table, without the keys that are not among the known ``keys``."""
        if not isinstance(value, Mapping):
            self.note(path, value, f"is missing: write [{path}]" if value is None else _TABLE)
            return {}
        known = list(value if keys is None else keys)
        at = f"{path}." if path else ""
        self.problems += [unknown(at + k, v, k, known) for k, v in value.items() if k not in known]
        return {key: entry for key, entry in value.items() if key in known}

    def rows(self, value: Any, path: str) -> list[Any]:
        """``value`` as a list of tables; one that is absent is empty."""
        if value is None or isinstance(value, list):
            return value or []
        self.note(path, value, f"must be a list of tables [[{path}]]")
        return []

    def build(self, kind: type, value: Any, path: str, **given: Any) -> Any:
        """An instance of a dataclass, some fields ``given``, the rest from a table; or None."""
        fields = {f.name: f for f in dataclasses.fields(kind) if f.init and f.name not in given}
        before = len(self.problems)
        entries = self.table(value, path, fields)
        if not isinstance(value, Mapping):
            return None
        for key in entries.keys() & self.convert.keys():
            entries[key] = self.convert[key](entries[key], f"{path}.{key}")
        ranges = {k: f.metadata["range"] for k, f in fields.items() if "range" in f.metadata}
        missing = [
            key
            for key, field in fields.items()
            if field.default is field.default_factory is dataclasses.MISSING and key not in entries
        ]
        if not missing:
            built = self.attempt(path, kind, **given, **entries)
            return built if len(self.problems) == before else None
        for key in missing:
            rule = f"; {ranges[key].rule()}" if key in ranges else ""
            self.note(f"{path}.{key}", None, f"is missing{rule}")
        for key in entries.keys() & ranges.keys():
            problem = number_problem(f"{path}.{key}", entries[key], ranges[key])
            self.problems += [problem] if problem else []
        return None

    def choose(self, kinds: Mapping[str, type], value: Any, path: str) -> Any:
        """An instance of the class that the entry ``type`` names, or None."""
        entries = self.table(value, path)
        if not isinstance(value, Mapping):
            return None
        name = entries.pop("type", None)
        if not isinstance(name, str) or name not in kinds:
            self.problems.append(unknown(f"{path}.type", name, name, kinds, "type"))
            return None
        return self.build(kinds[name], entries, path)


_TABLE = "must be a table"


def override(document: dict[str, Any], path: str, value: Any) -> Problem | None:
    """Put ``value`` at ``path.to.key`` or ``path[2].key``, making tables on the way."""
    place: Any = document
    *way, last = path.replace("[", ".").replace("]", "").split(".")
    try:
        for name in way:
            place = place[int(name)] if isinstance(place, list) else place.setdefault(name, {})
        place[int(last) if isinstance(place, list) else last] = value
    except (IndexError, ValueError, TypeError, AttributeError):
        return Problem(path, value, "there is no such place in the file")
    return None


def in_toml(problem: Problem) -> str:
    """A problem in the words of a scene file, as ``str(problem)`` is in Python's."""
    value = problem.value
    if value is None or isinstance(value, str):
        return str(problem)
    shown = inline(plain(value))
    if dataclasses.is_dataclass(value):
        shown = inline({"type": type(value).__name__, **plain(value)})
    return f"{problem.path} = {shown}: {problem.rule}"


def plain(value: Any) -> Any:
    """What TOML holds for a value: arrays as lists, dataclasses as tables of what is not None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init}
        return {key: plain(entry) for key, entry in fields.items() if entry is not None}
    value = getattr(value, "tolist", lambda: value)()
    return [plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value
