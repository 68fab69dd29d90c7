"""What outputs have in common: three methods, an interval, files that are whole at any moment."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from taichi_dem.validation import InputError, Problem, Range, number_problem


class Output(Protocol):
    """What a simulation asks of an output.

    ``every`` is the simulated time between writes in s; None means at start and finish only.
    """

    @property
    def every(self) -> float | None: ...

    def start(self, sim: Any) -> None:
        """Open what is written to; a mistake in the set-up shows here, before any step."""

    def write(self, sim: Any) -> None:
        """Write the present state; called at step 0 and at each multiple of ``every``."""

    def finish(self, sim: Any) -> None:
        """Write what is outstanding and close; called however the run ends."""


def check_positive(owner: object, name: str, value: float, allowed: Range) -> float:
    """``value`` if it lies in the range, else :class:`InputError` naming ``owner.name``."""
    if problem := number_problem(f"{type(owner).__name__}.{name}", value, allowed):
        raise InputError([problem])
    return float(value)


def check_every(owner: object, every: float) -> float:
    """``every`` if it is a positive number of seconds, else :class:`InputError`."""
    allowed = Range("s", "simulated time between writes", above=0)
    return check_positive(owner, "every", every, allowed)


def check_points(owner: object, points: int) -> int:
    """``points`` if it is a whole number >= 2, else :class:`InputError`."""
    if isinstance(points, bool) or not isinstance(points, int) or points < 2:
        rule = "must be a whole number >= 2 (points along the longer side of the substrate's grid)"
        raise InputError([Problem(f"{type(owner).__name__}.substrate_points", points, rule)])
    return points


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A temporary name beside ``path``, which takes its place if the block succeeds.

    Whoever reads ``path`` sees the old file or the new one, never part of one. The suffix is kept,
    for libraries that choose the format by it. What is no plain file, such as /dev/stdout, is
    written itself.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        yield path
        return
    temporary = path.with_name(f".partial-{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


def write_text(path: Path | str, text: str) -> None:
    """Write ``text`` to ``path`` in one piece."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
