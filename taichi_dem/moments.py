"""A few states of a run, kept to be looked at again at its end."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from taichi_dem.contact_list import SUBSTRATE

STATES = 4  # of a run


@dataclasses.dataclass(frozen=True)
class Moment:
    """Where everything is at one time.

    time: s; position: (n, 3) m; motion: that of the boundaries; grounded: contacts with the
    substrate; crowded: whether a sphere has more than one contact.
    """

    time: float
    position: np.ndarray
    motion: np.ndarray
    grounded: int
    crowded: bool

    @classmethod
    def of(cls, sim: Any) -> Moment:
        """The present one of a ``Simulation``."""
        records = sim.contacts()
        i, j = records["i"], records["j"]
        contacts = np.bincount(np.concatenate([i, j[j >= 0]]), minlength=1)
        motion = sim._engine.boundaries.read()
        motion[:, 1:] = 0.0  # at rest, nothing pushed, no work done
        return cls(
            sim.time,
            np.array(sim.particles.position),
            motion,
            int((j == SUBSTRATE).sum()),
            bool(contacts.max() > 1),
        )


class Moments:
    """An output that keeps ``STATES`` moments of a run of ``duration`` (s)."""

    def __init__(self, duration: float):
        self.every = duration / STATES
        self.kept: list[Moment] = []

    def start(self, sim: Any) -> None:
        self.kept.clear()

    def write(self, sim: Any) -> None:
        """Keep the present one; at the start nothing has happened yet."""
        if sim.steps > 0:
            self.kept.append(Moment.of(sim))

    def finish(self, sim: Any) -> None:
        """Nothing is outstanding."""
