"""Numbers in words: three digits, a unit of sensible size."""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_dem.style import scale_of

DIGITS = 3


def quantity(value: float, unit: str, digits: int = DIGITS) -> str:
    """``quantity(4.75e-6, "s")`` is ``"4.75 µs"``."""
    value = float(f"{value:.{digits}g}")
    factor, name = scale_of(value, unit)
    return f"{value * factor:.{digits}g} {name}"


def span(values: Any, unit: str) -> str:
    """``"0.9 to 1.3 mm"``, or one quantity if all are equal to that many digits."""
    low, high = (float(f"{bound(values):.{DIGITS}g}") for bound in (np.min, np.max))
    if low == high:
        return quantity(low, unit)
    factor, name = scale_of([low, high], unit)
    return f"{low * factor:.{DIGITS}g} to {high * factor:.{DIGITS}g} {name}"


def cubic(volume: float) -> str:
    """A volume in m³, cm³, mm³ or µm³."""
    sizes = ((1.0, "m³"), (1e-6, "cm³"), (1e-9, "mm³"))
    factor, name = next((pair for pair in sizes if volume >= pair[0]), (1e-18, "µm³"))
    value = float(f"{volume / factor:.{DIGITS}g}")
    return f"{value:,.0f} {name}" if value >= 100 else f"{value:g} {name}"


def mass(value: float) -> str:
    """Kilograms in grams, milligrams … where there are few."""
    return f"{value:.3g} kg" if value >= 1 else quantity(1e3 * value, "g")


def memory(size: float) -> str:
    """``"9.1 MB"``; bytes below a thousand."""
    return quantity(size, "B")


def clock(seconds: float) -> str:
    """Wall time: ``"12.3 s"``, ``"4 min 05 s"``, ``"3 h 20 min"``."""
    if seconds < 60:
        return f"{seconds:.3g} s"
    minutes, seconds = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours < 48 else f"{hours / 24:.3g} days"


def count(number: int, noun: str) -> str:
    """``"1 row"``, ``"2,000 rows"``."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
