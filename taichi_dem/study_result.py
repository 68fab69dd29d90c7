"""What a study found, as it grows."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from taichi_dem.settings import Settings
from taichi_dem.study_point import Point


@dataclasses.dataclass(frozen=True)
class Reference:
    """What the runs at the tightest ``settings`` tell of a scene.

    ``last``: the sample up to which trajectories are comparable; ``chaotic``: whether that is
    before the end; ``members``: runs, an ensemble where it is; ``touched``: whether anything did;
    ``grounded``: whether anything touched the substrate, None without one.
    """

    settings: Settings
    last: int
    chaotic: bool = False
    members: int = 1
    touched: bool = True
    grounded: bool | None = None


@dataclasses.dataclass
class Study:
    """``window``: s that it covers, looked at ``samples`` times; ``reference``: None before there
    is one; ``turned``: knobs that were; ``planned``: points to be measured so far; ``points``:
    those that were; ``orders``: those fitted to the errors of the time step, by measure;
    ``sparse_order``: that in the time between two exchanges, None where it was not measured;
    ``paces``: what the pacer took each time, s per simulated s; ``cut_short``: what ended the
    study before its time.
    """

    folder: Path
    window: float
    samples: int
    reference: Reference | None = None
    turned: tuple[str, ...] = ()
    planned: int = 0
    points: list[Point] = dataclasses.field(default_factory=list)
    orders: dict[str, float] = dataclasses.field(default_factory=dict)
    sparse_order: float | None = None
    paces: list[float] = dataclasses.field(default_factory=list)
    cut_short: str = ""

    @property
    def chaotic(self) -> bool:
        """Whether errors are those of ensembles."""
        return self.reference is not None and self.reference.chaotic
