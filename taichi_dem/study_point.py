"""One point of a study: settings, what they cost and how far off they are; and the table of all."""

from __future__ import annotations

import csv
import dataclasses
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path

from taichi_dem.settings import Settings

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
    and uncertainty by name); ``alone``: that of the one knob that is turned, against the same step
    with all else at its tightest; ``seconds``: wall time of each round, per simulated second."""

    knob: str
    settings: Settings
    outcome: str = "not run yet"
    errors: dict[str, float] = dataclasses.field(default_factory=dict)
    means: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    alone: float | None = None
    error: float = float("inf")
    uncertainty: float = 0.0
    built: float = 0.0
    seconds: list[float] = dataclasses.field(default_factory=list)

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
    def cost(self) -> float:
        """Median wall time per simulated second."""
        return statistics.median(self.seconds) if self.seconds else float("inf")

    def meets(self, target: float) -> bool:
        """Whether its error is surely within ``target``: with twice its uncertainty."""
        return self.error + 2 * self.uncertainty <= target

    def row(self) -> dict[str, object]:
        """Its line of the table."""
        found: dict[str, object] = {"knob": self.knob, **dataclasses.asdict(self.settings)}
        found |= {
            "outcome": self.outcome,
            "error": self.error,
            "uncertainty": self.uncertainty,
            "error_of_knob": self.alone,
            "seconds_per_simulated_second": self.cost,
            "least_seconds_per_simulated_second": min(self.seconds, default=self.cost),
            "largest_seconds_per_simulated_second": max(self.seconds, default=self.cost),
            "compile_s": self.built,
            "rounds": len(self.seconds),
        }
        found |= {name.replace(" ", "_"): value for name, value in self.errors.items()}
        found |= {f"mean_{k.replace(' ', '_')}": value for k, (value, _) in self.means.items()}
        return found


def write(folder: Path, points: Iterable[Point]) -> Path:
    """The table of ``points`` as ``study.csv`` in ``folder``."""
    path = folder / TABLE
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(point.row() for point in points)
    return path


def append(folder: Path, point: Point) -> None:
    """One more line at the end of the table, which is made if there is none."""
    path = folder / TABLE
    if not path.exists():
        write(folder, [])
    with path.open("a", newline="", encoding="utf-8") as file:
        csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(point.row())


def cheapest(points: Sequence[Point], target: float) -> Point | None:
    """The one that surely meets ``target`` in the least time."""
    meeting = [point for point in points if point.meets(target) and point.seconds]
    return min(meeting, key=lambda point: point.cost, default=None)


def pareto(points: Sequence[Point]) -> list[Point]:
    """Those that no other beats in both time and error, from cheap to accurate."""
    front: list[Point] = []
    for point in sorted(points, key=lambda point: (point.cost, point.error)):
        if point.seconds and point.error < min((p.error for p in front), default=float("inf")):
            front.append(point)
    return front
