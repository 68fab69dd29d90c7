"""How far a run is: a bar on a terminal, a line now and then in a log."""

from __future__ import annotations

import sys
import time
from typing import Any, TextIO

from taichi_dem.validation import Range
from taichi_dem.writing import check_positive

_UPDATES = 500  # of the bar over a whole run: smooth to the eye, free beside the steps between
_SECONDS_PER_LINE = 10.0


class Progress:
    """Simulated time, steps per second and time left, on ``stream`` (standard error if None).

    ``total_time``: simulated time this run adds, in s. A terminal shows a bar; anything else gets
    at most a line every ten seconds of wall time.
    """

    def __init__(self, total_time: float, stream: TextIO | None = None):
        allowed = Range("s", "simulated time of the run", above=0)
        self.total_time = check_positive(self, "total_time", total_time, allowed)
        self.every = self.total_time / _UPDATES
        self._stream = stream
        self._bar: Any = None

    def start(self, sim: Any) -> None:
        from tqdm import tqdm

        stream = sys.stderr if self._stream is None else self._stream
        self._first_step = self._last_step = sim.steps
        self._end = sim.time + self.total_time
        self._clock = self._last_line = time.perf_counter()
        self._line = None if stream.isatty() else stream
        self._bar = tqdm(
            total=max(1, round(self.total_time / sim.dt)),
            file=stream,
            disable=not stream.isatty(),
            dynamic_ncols=True,
            unit=" steps",
            unit_scale=True,
            bar_format="{percentage:3.0f}% |{bar}| {desc}, {rate_fmt}, {remaining} left",
        )

    def write(self, sim: Any) -> None:
        if self._line is None:
            self._bar.set_description_str(self._time(sim), refresh=False)
            self._bar.update(sim.steps - self._last_step)
            self._last_step = sim.steps
        elif time.perf_counter() - self._last_line >= _SECONDS_PER_LINE:
            self._print(sim)

    def finish(self, sim: Any) -> None:
        if self._bar is None:
            return
        self.write(sim)
        self._bar.close()
        if self._line is not None and self._last_line > self._clock:
            self._print(sim)
        self._bar = None

    def _time(self, sim: Any) -> str:
        return f"t = {sim.time:.4g} of {self._end:.4g} s"

    def _print(self, sim: Any) -> None:
        self._last_line = time.perf_counter()
        wall = self._last_line - self._clock
        rate = (sim.steps - self._first_step) / wall
        left = (self._end - sim.time) / sim.dt / rate if rate > 0 else float("inf")
        line = f"{self._time(sim)}, {rate:.3g} steps/s"
        if 0 < left < float("inf"):
            line += f", {self._bar.format_interval(left)} left"
        print(line, file=self._line, flush=True)
