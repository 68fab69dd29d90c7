"""What a study found, as it grows."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from taichi_dem.settings import Settings
from taichi_dem.study_point import Point


@dataclasses.dataclass
class Study:
    """``window``: s that it covers, looked at ``samples`` times; ``last``: the
    sample up to which trajectories are comparable, all of them unless the scene is ``chaotic``;
    ``orders``: those fitted to the errors of the time step, by measure; ``sparse_order``: that
    in the time between two exchanges, None where it was not measured.

    ``compared``: whether there is a reference; in it anything ``touched``, or was ``grounded`` on
    the substrate (None without one); ``tight``: its settings; ``turned``: the knobs that were;
    ``planned``: points to be measured so far; ``cut_short``: what ended the study before its time.
    """

    folder: Path
    window: float
    samples: int
    chaotic: bool = False
    last: int = 0
    points: list[Point] = dataclasses.field(default_factory=list)
    orders: dict[str, float] = dataclasses.field(default_factory=dict)
    sparse_order: float | None = None
    compared: bool = True
    touched: bool = True
    grounded: bool | None = None
    tight: Settings | None = None
    turned: tuple[str, ...] = ()
    planned: int = 0
    cut_short: str = ""
