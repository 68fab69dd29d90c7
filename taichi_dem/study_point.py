"""One point of a study: settings, what they cost and how far off they are; and the table of all."""

from __future__ import annotations

import csv
import dataclasses
import math
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path

from taichi_dem.settings import Settings
from taichi_dem.writing import replacing

TABLE = "study.csv"
TARGETS = (1e-1, 1e-2, 1e-3, 1e-4)
MEASURES = (
    "trajectory",
    "contact force",
    "energy drift",
    "depression",
    "force on walls",
    "rebound",
)
STATISTICS = (
    "radius of gyration",
    "contact force",
    "energy turned over",
    "depression",
    "force on walls",
)
COLUMNS = (
    "knob",
    *(field.name for field in dataclasses.fields(Settings)),
    "outcome",
    "error",
    "uncertainty",
    "surely_within",
    "error_of_knob",
    "seconds_per_simulated_second",
    "least_seconds_per_simulated_second",
    "largest_seconds_per_simulated_second",
    "compile_s",
    "rounds",
    *(name.replace(" ", "_") for name in MEASURES),
    *(f"mean_{name.replace(' ', '_')}" for name in STATISTICS),
)


@dataclasses.dataclass
class Point:
    """``error``: the worst of ``errors``, or for a chaotic scene of the ensemble's ``means`` (error
    and ``uncertainty`` by name); ``alone``: that of the one knob that is turned, against the same
    step with all else at its tightest; ``times``: wall time of each round, in those that the pacer
    took just before and after; ``unit``: the median of all of the pacer's, s per simulated s."""

    knob: str
    settings: Settings
    outcome: str = "not run yet"
    errors: dict[str, float] = dataclasses.field(default_factory=dict)
    means: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    alone: float | None = None
    error: float = float("inf")
    uncertainty: float = 0.0
    built: float = 0.0
    times: list[float] = dataclasses.field(default_factory=list)
    unit: float = 1.0

    @property
    def stopped(self) -> bool:
        """Whether it did not get through."""
        return not self.outcome.startswith(("finished", "not run"))

    @property
    def label(self) -> str:
        """The point in a few characters."""
        value = getattr(self.settings, self.knob, "")
        shown = f"{value:.3g}" if isinstance(value, float) else str(value)
        return f"{self.knob} {shown}".strip()

    @property
    def timed(self) -> bool:
        """Whether it is known what it costs."""
        return bool(self.times)

    @property
    def cost(self) -> float:
        """Median wall time per simulated second."""
        return self.unit * statistics.median(self.times) if self.times else float("inf")

    @property
    def least(self) -> float:
        """That of the fastest round."""
        return self.unit * min(self.times, default=math.inf)

    @property
    def most(self) -> float:
        """That of the slowest round."""
        return self.unit * max(self.times, default=math.inf)

    @property
    def bound(self) -> float:
        """What all its errors are surely within: each with twice its uncertainty."""
        return max([self.error, *(error + 2 * doubt for error, doubt in self.means.values())])

    def meets(self, target: float) -> bool:
        """Whether its errors are surely within ``target``."""
        return self.bound <= target

    def row(self) -> dict[str, object]:
        """Its line of the table."""
        found: dict[str, object] = {"knob": self.knob, **dataclasses.asdict(self.settings)}
        found |= {
            "outcome": self.outcome,
            "error": self.error,
            "uncertainty": self.uncertainty,
            "surely_within": self.bound,
            "error_of_knob": self.alone,
            "seconds_per_simulated_second": self.cost,
            "least_seconds_per_simulated_second": self.least,
            "largest_seconds_per_simulated_second": self.most,
            "compile_s": self.built,
            "rounds": len(self.times),
        }
        found |= {name.replace(" ", "_"): value for name, value in self.errors.items()}
        found |= {f"mean_{k.replace(' ', '_')}": value for k, (value, _) in self.means.items()}
        return found


def write(folder: Path, points: Iterable[Point]) -> Path:
    """The table of ``points`` as ``study.csv`` in ``folder``, in one piece."""
    path = folder / TABLE
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(point.row() for point in points)
    return path


def cheapest(points: Sequence[Point], target: float) -> Point | None:
    """The one that surely meets ``target`` in the least time."""
    meeting = [point for point in points if point.meets(target) and point.timed]
    return min(meeting, key=lambda point: point.cost, default=None)


def pareto(points: Sequence[Point]) -> list[Point]:
    """Those that no other beats in both time and what the error is surely within, from cheap to
    accurate."""
    front: list[Point] = []
    for point in sorted(points, key=lambda point: (point.cost, point.bound)):
        if point.timed and point.bound < min((p.bound for p in front), default=float("inf")):
            front.append(point)
    return front
