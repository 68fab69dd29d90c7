"""What is kept of a run to compare it with another: samples at the same times whatever the step."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from taichi_dem.writing import replacing

SAMPLES = 32
SURFACE_POINTS = 9  # along each side of the square on which the surface is sampled


@dataclasses.dataclass(frozen=True)
class Record:
    """Of n spheres, b boundaries and, at s + 1 times, c contacts in all; SI units."""

    time: np.ndarray  # (s + 1,)
    position: np.ndarray  # (s + 1, n, 3)
    velocity: np.ndarray  # (n, 3) at the end
    balance: np.ndarray  # (s + 1,) error of the energy balance; NaN where there are no books
    turnover: np.ndarray  # (s + 1,) energy that is there, was lost or was put in, J
    contact: np.ndarray  # (c, 4) sample, first and second body, face of a boundary or -1
    force: np.ndarray  # (c, 3) of the contact
    push: np.ndarray  # (s + 1, b, 3) force on each boundary
    ground: np.ndarray  # (s + 1,) normal force on the substrate
    depression: np.ndarray  # (p,) of the substrate's surface at the end; empty without one

    def save(self, path: Path) -> None:
        """Write all of it to an ``.npz`` file."""
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **vars(self))

    @classmethod
    def load(cls, path: Path) -> Record:
        """Read what :meth:`save` wrote."""
        with np.load(path, allow_pickle=False) as data:
            return cls(**{field.name: data[field.name] for field in dataclasses.fields(cls)})

    @property
    def samples(self) -> int:
        """Samples after the one at the start."""
        return len(self.time) - 1

    def until(self, sample: int) -> Record:
        """The part up to ``sample``; what was looked at only at the end stays that of the end."""
        rows = slice(0, sample + 1)
        early = self.contact[:, 0] <= sample
        cut = {name: getattr(self, name)[rows] for name in _IN_TIME}
        return dataclasses.replace(
            self, contact=self.contact[early], force=self.force[early], **cut
        )


_IN_TIME = ("time", "position", "balance", "turnover", "push", "ground")


def even_step(step: float, window: float, samples: int = SAMPLES) -> float:
    """The largest step, at most ``step``, of which a whole number fits between two samples."""
    between = window / samples
    return between / math.ceil(between / step * (1 - 1e-12))


def record(sim: Any, window: float, samples: int = SAMPLES) -> Record:
    """Run ``sim`` from time zero over ``window`` (s), looking ``samples`` times; its step must be
    one that :func:`even_step` gives."""
    steps = round(window / samples / sim.dt)
    rows = [_look(sim)]
    for _ in range(samples):
        sim.run(steps=steps)
        rows.append(_look(sim))
    contacts = [row.pop("contacts") for row in rows]
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Record(
        **columns,
        velocity=np.array(sim.particles.velocity),
        contact=np.concatenate(
            [
                np.column_stack([np.full(len(c), k), *(c[name] for name in ("i", "j", "face"))])
                for k, c in enumerate(contacts)
            ]
        ),
        force=np.concatenate([np.array(c["force"]) for c in contacts]),
        depression=_depression(sim),
    )


def _look(sim: Any) -> dict[str, Any]:
    energy = dict(sim.energy())
    balance = energy.pop("balance_error", math.nan)
    ground = sim.substrate
    return {
        "time": sim.time,
        "position": np.array(sim.particles.position),
        "balance": balance,
        "turnover": sum(abs(value) for part, value in energy.items() if part != "gravity"),
        "contacts": sim.contacts().copy(),
        "push": np.array([wall.force for wall in sim.boundaries]).reshape(-1, 3),
        "ground": 0.0 if ground is None else float(np.sum(ground.force)),
    }


def _depression(sim: Any) -> np.ndarray:
    """At a grid of points below where the spheres were at the start."""
    if sim.substrate is None:
        return np.empty(0)
    spheres = sim.scene.spheres
    reach = spheres.radius[:, None]
    low = (spheres.position[:, :2] - reach).min(axis=0)
    high = (spheres.position[:, :2] + reach).max(axis=0)
    axes = [np.linspace(low[k], high[k], SURFACE_POINTS) for k in (0, 1)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return np.asarray(sim.substrate.field(points), dtype=float)
