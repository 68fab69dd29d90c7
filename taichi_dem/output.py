"""What a run writes while it runs, such that a killed run leaves a folder that can be read.

A run that starts at step 0 replaces what an earlier one left in the folder; one that goes on from a
checkpoint keeps the rows and frames up to there.
"""

from __future__ import annotations

import csv
import json
import math
import time
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from taichi_dem.frames import Frames
from taichi_dem.progress import Progress
from taichi_dem.run_plan import Run
from taichi_dem.snapshot import FILE, Snapshot
from taichi_dem.validation import InputError, Problem
from taichi_dem.writing import Output, check_every, check_points, replacing, write_text

__all__ = ["Frames", "History", "Output", "Progress", "State", "Summary", "read_history"]

HISTORY = "history.csv"
SUMMARY = "summary.json"
SCENE = "scene.toml"


class History:
    """One row per write in ``history.csv``, in full precision, units in the names of the columns.

    Time and step, each part of the energy, mean coordination number, largest overlap over the
    smaller radius, total normal force on the substrate, and for each boundary k the force
    ``boundary{k}_fx_N``; for a piston also its position and velocity. The columns are fixed when
    the run starts.
    """

    def __init__(self, folder: Path | str, every: float):
        self.path = Path(folder) / HISTORY
        self.every = check_every(self, every)
        self._file: TextIO | None = None

    def start(self, sim: Any) -> None:
        """Open the file; InputError if the run would go on in one that holds other columns."""
        columns = list(_row(sim))
        rows = self._rows_until(sim.steps, columns) if sim.steps > 0 else []
        self._last_step = int(rows[-1]["step"]) if rows else None
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with (
            replacing(self.path) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            table = self._table(file, columns)
            table.writeheader()
            table.writerows(rows)
        self._file = self.path.open("a", newline="", encoding="utf-8")
        self._rows = self._table(self._file, columns)

    def write(self, sim: Any) -> None:
        if self._file is None or sim.steps == self._last_step:
            return
        self._rows.writerow(_row(sim))
        self._file.flush()
        self._last_step = sim.steps

    def finish(self, sim: Any) -> None:
        """Add the last state if it is not there yet, and close the file."""
        if self._file is None:
            return
        try:
            self.write(sim)
        finally:
            self._file.close()
            self._file = None

    def _rows_until(self, step: int, columns: list[str]) -> list[dict[str, str]]:
        if not self.path.exists():
            return []
        found, rows = _read(self.path)
        if found != columns:
            rule = f"holds other columns than this run, {columns}; choose another folder"
            raise InputError([Problem(str(self.path), found, rule)])
        return [row for row in rows if int(row["step"]) <= step]

    @staticmethod
    def _table(file: TextIO, columns: list[str]) -> csv.DictWriter[str]:
        return csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")


def read_history(folder: Path | str) -> dict[str, np.ndarray]:
    """Columns of ``history.csv`` by name; a line cut short by a crash is left out."""
    names, rows = _read(Path(folder) / HISTORY)
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}


def _read(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Names of the columns, and the rows that end in a line break."""
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    reader = csv.DictReader(line for line in lines if line.endswith("\n"))
    return list(reader.fieldnames or ()), list(reader)


def _row(sim: Any) -> dict[str, float]:
    row: dict[str, float] = {"time_s": float(sim.time), "step": int(sim.steps)}
    row.update({f"{part}_J": float(energy) for part, energy in sim.energy().items()})
    row["coordination"] = float(sim.coordination())
    row["largest_overlap"] = float(sim.largest_overlap())
    if sim.substrate is not None:
        row["substrate_force_N"] = float(np.sum(sim.substrate.force))
    for k, (boundary, described) in enumerate(
        zip(sim.boundaries, sim.scene.boundaries, strict=True)
    ):
        row.update(_components(f"boundary{k}_f", boundary.force, "N"))
        if described.kind == "Piston":
            row.update(_components(f"boundary{k}_", boundary.position, "m"))
            row.update(_components(f"boundary{k}_v", boundary.velocity, "m_per_s"))
    return row


def _components(prefix: str, vector: np.ndarray, unit: str) -> dict[str, float]:
    return {f"{prefix}{axis}_{unit}": float(vector[k]) for k, axis in enumerate("xyz")}


class State:
    """The last state in ``state.npz``, from which ``taichi-dem plot`` redraws the pictures.

    ``substrate_points``: points along the longer side of the grid on which the substrate's surface
    is sampled. :class:`Frames` writes the same file.
    """

    def __init__(self, folder: Path | str, every: float, substrate_points: int = 129):
        self.path = Path(folder) / FILE
        self.every = check_every(self, every)
        self.substrate_points = check_points(self, substrate_points)
        self._started = False
        self._last_step: int | None = None

    def start(self, sim: Any) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._started, self._last_step = True, None

    def write(self, sim: Any) -> None:
        if sim.steps != self._last_step:
            Snapshot.of(sim, self.substrate_points).save(self.path)
            self._last_step = sim.steps

    def finish(self, sim: Any) -> None:
        if self._started:
            self.write(sim)


class Summary:
    """``summary.json``: how long, how fast, with which step, how it ended; and the scene as run.

    Written at start with the outcome "running", which a killed run keeps, and at finish. What
    ``sim.summary()`` returns is added and takes precedence; it should hold ``outcome``
    ("finished", "interrupted", "stopped: reason"). Without it the exception that is being handled
    decides. ``run`` is how the scene is run, for the scene as run; ``notes`` are more entries.
    """

    def __init__(
        self,
        folder: Path | str,
        every: float | None = None,
        *,
        run: Run | None = None,
        notes: dict[str, Any] | None = None,
    ):
        self.folder = Path(folder)
        self._run, self._notes = run, notes or {}
        self.every = None if every is None else check_every(self, every)
        self._started = False
        self._clock = 0.0
        self._first_step = 0

    def start(self, sim: Any) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self._started = True
        self._clock = time.perf_counter()
        self._first_step = sim.steps
        sim.scene.to_toml(self.folder / SCENE, self._run)
        self._save(sim, outcome="running")

    def write(self, sim: Any) -> None:
        self._save(sim, outcome="running")

    def finish(self, sim: Any) -> None:
        if self._started:
            self._save(sim)

    def _save(self, sim: Any, **fixed: Any) -> None:
        wall = time.perf_counter() - self._clock
        rate = 1 / wall if wall > 0 else 0.0
        steps = sim.steps - self._first_step
        spheres = len(sim.particles.radius)
        summary = {
            "simulated_time_s": sim.time,
            "steps": sim.steps,
            "steps_this_run": steps,
            "wall_time_s": wall,
            "steps_per_second": steps * rate,
            "particle_steps_per_second": spheres * steps * rate,
            "spheres": spheres,
            "dt_s": sim.dt,
            "dt_reason": getattr(sim, "dt_reason", None),
            "energy_J": sim.energy(),
            "warnings": getattr(sim, "warnings", {}),
            "version": _version(),
        }
        if hasattr(sim, "summary"):
            summary.update(sim.summary())
        summary.update(self._notes)
        summary.update(fixed)
        write_text(self.folder / SUMMARY, json.dumps(_plain(summary), indent=2) + "\n")


def amend(folder: Path | str, **entries: Any) -> None:
    """Add ``entries`` to the summary that a run has left in ``folder``."""
    path = Path(folder) / SUMMARY
    summary = json.loads(path.read_text(encoding="utf-8")) | entries
    write_text(path, json.dumps(_plain(summary), indent=2) + "\n")


def _version() -> str:
    try:
        return metadata.version("taichi-dem")
    except metadata.PackageNotFoundError:
        return "not installed"


def _plain(value: Any) -> Any:
    """``value`` as strict JSON can hold it; a number that is not finite becomes its name."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    return value if isinstance(value, str | int | float | None) else str(value)
