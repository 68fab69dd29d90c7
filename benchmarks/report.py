"""What a benchmark gives back: figures with their targets, as a table and as JSON."""

import dataclasses
import json
import os
import platform
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class Figure:
    """One number: the median of ``samples`` where it was measured more than once."""

    what: str
    value: float
    unit: str
    at_least: float | None = None
    at_most: float | None = None
    samples: tuple[float, ...] = ()

    @classmethod
    def median(cls, what: str, samples: Sequence[float], unit: str, **target: float) -> "Figure":
        """The median of ``samples``; ``target`` is ``at_least`` or ``at_most``."""
        values = tuple(float(sample) for sample in samples)
        return cls(what, statistics.median(values), unit, samples=values, **target)

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None where there is none."""
        if self.at_least is not None:
            return bool(self.value >= self.at_least)
        return None if self.at_most is None else bool(self.value <= self.at_most)

    def row(self) -> list[str]:
        """Cells of the table: what, value, spread, target, verdict."""
        spread = target = ""
        if len(self.samples) > 1:
            spread = f"{min(self.samples):.4g} .. {max(self.samples):.4g}"
        if self.met is not None:
            sign, limit = ("<=", self.at_most) if self.at_least is None else (">=", self.at_least)
            target = f"{sign} {limit:g}"
        verdict = {None: "", True: "met", False: "MISSED"}[self.met]
        return [self.what, f"{self.value:.4g} {self.unit}".strip(), spread, target, verdict]


def table(figures: Sequence[Figure]) -> str:
    """The figures as lines of aligned columns."""
    rows = [["", "value", "spread", "target", ""], *(figure.row() for figure in figures)]
    widths = [max(len(row[column]) for row in rows) for column in range(5)]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def write(folder: Path, name: str, options: dict[str, Any], figures: Sequence[Figure]) -> Path:
    """Write ``<folder>/<name>.json``: the figures, and what they were measured on."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    document = {
        "benchmark": name,
        "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "machine": machine(),
        "options": options,
        "figures": [dataclasses.asdict(figure) | {"met": figure.met} for figure in figures],
    }
    path.write_text(json.dumps(document, indent=1) + "\n")
    return path


def machine() -> dict[str, Any]:
    """The processor, its cores that may be used, and how busy it was when the benchmark ended."""
    from halfspace.backend import cores  # which reads the environment: a benchmark may set it first

    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    load = os.getloadavg() if hasattr(os, "getloadavg") else ()
    return {
        "processor": model,
        "cores": cores(),
        "load": [round(value, 2) for value in load],
        "python": platform.python_version(),
        "threads": os.environ.get("HALFSPACE_THREADS"),
        "backend": os.environ.get("HALFSPACE_BACKEND", "taichi"),
        "precision": os.environ.get("HALFSPACE_PRECISION", "double"),
    }
