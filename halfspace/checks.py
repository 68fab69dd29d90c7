"""Refuses bad arguments by name, with their value and what would be right."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .arrays import NUMPY, Array, Kind, host, kind_of


def number(name: str, value: Any, wanted: str) -> float:
    """`value` as a finite float; `wanted` says in the error what would be right."""
    if isinstance(value, (bool, str)) or not np.isscalar(value):
        raise ValueError(f"{name} = {value!r}: must be {wanted}")
    try:
        result = float(value)  # type: ignore[arg-type]
    except TypeError:
        raise ValueError(f"{name} = {value!r}: must be {wanted}") from None
    if not np.isfinite(result):
        raise ValueError(f"{name} = {value!r}: must be {wanted}")
    return result


def whole(name: str, value: Any) -> None:
    """Refuses what is not a whole number >= 0."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        raise ValueError(f"{name} = {value!r}: must be a whole number >= 0")


def one_of(name: str, value: Any, allowed: tuple[Any, ...]) -> None:
    """Refuses what is not among `allowed`."""
    if value not in allowed:
        raise ValueError(f"{name} = {value!r}: must be {' or '.join(map(repr, allowed))}")


def sides(name: str, value: Any) -> tuple[float, float]:
    """Two lengths > 0, m: the sides of a rectangle."""
    wanted = "(Lx, Ly), two lengths > 0 m"
    try:
        lengths = [number(name, side, wanted) for side in value]
    except TypeError:
        lengths = []
    if len(lengths) != 2 or min(lengths) <= 0:
        raise ValueError(f"{name} = {value!r}: must be {wanted}")
    return lengths[0], lengths[1]


def vectors(name: str, value: ArrayLike, kind: Kind | None = None) -> Array:
    """Positions in the plane, (n, 2), finite; an empty list is (0, 2).

    kind: of array that is wanted, or None for that of `value`.
    """
    kind = kind_of(value) if kind is None else kind
    array = _floats(name, value, kind)
    if 0 in array.shape and array.ndim <= 2:
        return kind.empty((0, 2))
    if array.ndim != 2 or array.shape[1] != 2:
        shape = tuple(array.shape)
        raise ValueError(f"{name} has shape {shape}: must be (n, 2), positions in the plane")
    return finite(name, array)


def scalars(name: str, value: ArrayLike, count: int, kind: Kind = NUMPY) -> Array:
    """One finite number per contact, (count,)."""
    array = _floats(name, value, kind)
    if tuple(array.shape) != (count,):
        shape = tuple(array.shape)
        raise ValueError(f"{name} has shape {shape}: must be ({count},), one per contact")
    return finite(name, array)


def each(name: str, value: ArrayLike, count: int, wanted: str, kind: Kind = NUMPY) -> Array:
    """Finite numbers: (count,), or one for all, which must be as `wanted` says."""
    if np.ndim(value) > 0:
        return scalars(name, value, count, kind)
    return kind.zeros(count) + number(name, value, wanted)


def positive(name: str, value: ArrayLike, unit: str, count: int, kind: Kind = NUMPY) -> Array:
    """Finite numbers > 0: (count,), or one for all."""
    array = _floats(name, value, kind)
    array = scalars(name, array if array.ndim else kind.zeros(count) + array, count, kind)
    refuse(name, array, array <= 0, f"must be > 0 {unit}")
    return array


def radii(name: str, value: ArrayLike, count: int, kind: Kind = NUMPY) -> Array:
    """Contact radii, (count,), finite and not negative."""
    array = scalars(name, value, count, kind)
    refuse(name, array, array < 0, "must be >= 0 m")
    return array


def _floats(name: str, value: ArrayLike, kind: Kind) -> Array:
    try:
        return kind.array(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {value!r}: must be an array of numbers") from None


def finite(name: str, array: Array) -> Array:
    """`array`, refused where it is not finite."""
    refuse(name, array, ~kind_of(array).isfinite(array), "must be finite")
    return array


def refuse(name: str, array: Array, bad: Any, wanted: str) -> None:
    """Refuses an array of which some elements are `bad`, a mask of its shape; names the first."""
    if bad.any():
        array, bad = host(array), host(bad)
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        place = ", ".join(map(str, first))
        others = int(bad.sum()) - 1
        more = f" (and {others} more)" if others else ""
        raise ValueError(f"{name}[{place}] = {float(array[first])!r}: {wanted}{more}")
