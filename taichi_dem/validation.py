"""Declared parameters: a unit, a range and a meaning beside each number, and one check for all.

A frozen dataclass lists its numbers with :func:`parameter` and calls :func:`validate` from its
``__post_init__``.  All mistakes are collected and raised together as one :class:`InputError`.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Callable, Iterable
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

INF = math.inf
SHOWN = 3  # offenders that are named when many entries of an array are wrong


class Problem(NamedTuple):
    """One mistake: where it was written, what was written, what would be right."""

    path: str
    value: Any
    rule: str

    def __str__(self) -> str:
        if self.value is None:
            return f"{self.path}: {self.rule}"
        plain = getattr(self.value, "tolist", lambda: self.value)()
        return f"{self.path} = {plain if isinstance(plain, str) else repr(plain)}: {self.rule}"

    def under(self, prefix: str) -> Problem:
        """The same problem seen from one level further out."""
        return self._replace(path=".".join(filter(None, (prefix, self.path))))


class InputError(ValueError):
    """Bad input; ``problems`` lists every mistake that was found, the message puts them under
    ``name``, what was being made."""

    def __init__(self, problems: Iterable[Problem], name: str = ""):
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem.under(name)) for problem in self.problems))


@dataclasses.dataclass(frozen=True)
class Range:
    """Unit, interval and meaning of one number."""

    unit: str
    meaning: str
    above: float = -INF
    at_least: float = -INF
    below: float = INF
    at_most: float = INF

    def rule(self) -> str:
        """The interval in words, as an error message says it."""
        bounds = (
            (">", self.above),
            (">=", self.at_least),
            ("<", self.below),
            ("<=", self.at_most),
        )
        interval = " and ".join(f"{sign} {value:g}" for sign, value in bounds if abs(value) < INF)
        unit = f" {self.unit}" if self.unit not in ("", "-") else ""
        kind = interval + unit if interval else "finite" + (unit and f", in{unit}")
        return f"must be {kind} ({self.meaning})"

    def holds(self, value: Any) -> Any:
        """Whether a number is inside; for an array, entry by entry."""
        return (
            np.isfinite(value)
            & (value > self.above)
            & (value >= self.at_least)
            & (value < self.below)
            & (value <= self.at_most)
        )


def parameter(
    unit: str, meaning: str, default: Any = dataclasses.MISSING, **interval: float
) -> Any:
    """A dataclass field that holds one number in a range (``above, at_least, below, at_most``)."""
    return dataclasses.field(default=default, metadata={"range": Range(unit, meaning, **interval)})


def number_problem(path: str, value: Any, allowed: Range) -> Problem | None:
    """What is wrong with one number, or ``None``."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return Problem(path, quoted(value), f"must be a number; {allowed.rule()}")
    return None if allowed.holds(float(value)) else Problem(path, value, allowed.rule())


def quoted(value: Any) -> Any:
    """Text in quotes, for messages where it stands in place of numbers; else the value."""
    return f'"{value}"' if isinstance(value, str) else value


def problems_of(instance: Any) -> list[Problem]:
    """Every declared number outside its range; those whose default is None may be None."""
    found = []
    for field in dataclasses.fields(instance):
        allowed = field.metadata.get("range")
        value = getattr(instance, field.name)
        if allowed is None or (value is None and field.default is None):
            continue
        if problem := number_problem(field.name, value, allowed):
            found.append(problem)
    return found


def validate(instance: Any, *more: Problem | None, name: str | None = None) -> None:
    """Raise :class:`InputError` if a declared number of ``instance`` or one of ``more`` is wrong.

    The message calls the instance ``name``, or by its class if none is given.
    """
    found = problems_of(instance) + [problem for problem in more if problem]
    if found:
        raise InputError(found, type(instance).__name__ if name is None else name)


def as_numbers(value: Any) -> np.ndarray | None:
    """A new array of doubles, or ``None`` where ``value`` is not a regular array of numbers; true
    and false, which NumPy would take for 1 and 0 among numbers, are none."""
    if isinstance(value, bool):
        return None
    if isinstance(value, (list, tuple)) and any(isinstance(entry, bool) for entry in value):
        return None
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    return np.array(array, dtype=np.float64, order="C") if array.dtype.kind in "iuf" else None


def set_vectors(instance: Any, *names: str, infinite: bool = False) -> list[Problem]:
    """Store the named fields of a frozen dataclass as tuples of three floats; what is wrong."""
    rule = f"must be three {'numbers' if infinite else 'finite numbers'}"
    found = []
    for name in names:
        value = getattr(instance, name)
        vector = as_numbers(value)
        if vector is None or vector.shape != (3,) or not (infinite or np.isfinite(vector).all()):
            found.append(Problem(name, quoted(value), rule))
        elif np.isnan(vector).any():
            found.append(Problem(name, value, rule + ", not nan"))
        else:
            object.__setattr__(instance, name, tuple(vector.tolist()))
    return found


def shape_of(value: Any) -> str:
    """The end of a message: the shape of an array, nothing for what is none."""
    shape = getattr(as_numbers(value), "shape", None)
    return "" if shape is None else f"; got shape {shape}"


def array_problem(path: str, value: Any, what: str, *row: int) -> Problem:
    """Why ``value`` is not ``what``, an array of rows of the shape ``row``: the first entry that is
    no number, or no such row, else its own shape."""
    rule = f"must be {what}"
    if isinstance(value, str):
        return Problem(path, quoted(value), rule)
    entries = value if isinstance(value, (list, tuple)) else ()
    nested = any(isinstance(entry, (list, tuple)) for entry in entries)
    wanted = row if nested else ()
    for k, entry in enumerate(entries):
        if getattr(as_numbers(entry), "shape", None) != wanted:
            size = f"{wanted[0]} numbers" if wanted else "a number"
            return Problem(f"{path}[{k}]", quoted(entry), f"must be {size}; {path} {rule}")
    return Problem(path, None, rule + shape_of(value))


def first_few(
    path: str, wrong: np.ndarray, values: Any, rule: str | Callable[[int], str]
) -> list[Problem]:
    """Problems for the first entries of ``values`` that are ``wrong``, and how many more are."""
    rows = np.flatnonzero(wrong)
    found = [
        Problem(f"{path}[{k}]", values[k], rule if isinstance(rule, str) else rule(k))
        for k in rows[:SHOWN].tolist()
    ]
    if len(rows) > SHOWN:
        found.append(Problem(path, None, f"and {len(rows) - SHOWN} more"))
    return found


def unknown(path: str, value: Any, key: Any, valid: Iterable[str], kind: str = "key") -> Problem:
    """The problem of a ``key`` that is not among the ``valid`` ones, with the nearest of them."""
    valid = list(dict.fromkeys(map(str, valid)))
    near = difflib.get_close_matches(str(key), valid, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return Problem(path, value, f"unknown {kind}; {hint}known: {', '.join(valid) or 'none'}")
