"""Refuses bad arguments by name, with their value and what would be right."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


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


def vectors(name: str, value: ArrayLike) -> Array:
    """Positions in the plane, (n, 2), finite; an empty list is (0, 2)."""
    array = _floats(name, value)
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 2))
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"{name} has shape {array.shape}: must be (n, 2), positions in the plane")
    return finite(name, array)


def scalars(name: str, value: ArrayLike, count: int) -> Array:
    """One finite number per contact, (count,)."""
    array = _floats(name, value)
    if array.shape != (count,):
        raise ValueError(f"{name} has shape {array.shape}: must be ({count},), one per contact")
    return finite(name, array)


def positive(name: str, value: ArrayLike, unit: str, count: int) -> Array:
    """Finite numbers > 0: (count,), or one for all."""
    array = np.full(count, _floats(name, value)) if np.ndim(value) == 0 else _floats(name, value)
    array = scalars(name, array, count)
    refuse(name, array, array <= 0, f"must be > 0 {unit}")
    return array


def radii(name: str, value: ArrayLike, count: int) -> Array:
    """Contact radii, (count,), finite and not negative."""
    array = scalars(name, value, count)
    refuse(name, array, array < 0, "must be >= 0 m")
    return array


def _floats(name: str, value: ArrayLike) -> Array:
    try:
        return np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {value!r}: must be an array of numbers") from None


def finite(name: str, array: Array) -> Array:
    refuse(name, array, ~np.isfinite(array), "must be finite")
    return array


def refuse(name: str, array: Array, bad: NDArray[np.bool_], wanted: str) -> None:
    """Refuses an array of which some elements are `bad`, and names the first."""
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        place = ", ".join(map(str, first))
        others = int(bad.sum()) - 1
        more = f" (and {others} more)" if others else ""
        raise ValueError(f"{name}[{place}] = {float(array[first])!r}: {wanted}{more}")
