"""Plain values as TOML text that people like to read; numbers come back exactly."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any


def toml_text(document: Mapping[str, Any]) -> str:
    """A document of str, bool, int, float, lists and tables; what is None is left out."""
    return "\n".join(_table(document, "")).lstrip("\n") + "\n"


def inline(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, Mapping):
        entries = ", ".join(f"{_key(str(key))} = {inline(entry)}" for key, entry in value.items())
        return f"{{ {entries} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(inline, value))}]"
    return _value(value)


def _table(table: Mapping[str, Any], path: str) -> Iterator[str]:
    present = {_key(key): value for key, value in table.items() if value is not None}
    inner = {key: value for key, value in present.items() if _is_table(value)}
    yield from (f"{key} = {_value(present[key])}" for key in present if key not in inner)
    for key, value in inner.items():
        name = f"{path}.{key}" if path else key
        for one in value if isinstance(value, list) else [value]:
            if isinstance(value, list):
                yield f"\n[[{name}]]"
            elif not one or not all(map(_is_table, one.values())):
                yield f"\n[{name}]"
            yield from _table(one, name)


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list) and bool(value) and all(isinstance(v, Mapping) for v in value)
    )


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list):
        rows = len(value) > 1 and all(isinstance(v, list) for v in value)
        inside = (",\n  " if rows else ", ").join(map(_value, value))
        return f"[\n  {inside},\n]" if rows else f"[{inside}]"
    return repr(value)
