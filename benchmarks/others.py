"""How busy other processes kept the machine meanwhile: a timing beside them says little (Linux)."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

TICKS = 100.0  # of /proc/stat in a second
QUIET = 0.1  # cores that others may use
PAUSE = 0.3  # s, to listen

Result = TypeVar("Result")


def undisturbed(measure: Callable[[], Result], patience: float) -> tuple[Result, float]:
    """What ``measure`` gives while others are quiet, and the cores that they used meanwhile.

    Waits and measures again for ``patience`` (s); after that the least disturbed one has to do.
    """
    end = time.monotonic() + patience
    results = []
    while True:
        _wait(end)
        others = Others()
        results.append((measure(), others.cores()))
        if results[-1][1] < QUIET or time.monotonic() > end:
            return min(results, key=lambda result: result[1])


def _wait(end: float) -> None:
    """Until others are quiet, or ``end``."""
    while time.monotonic() < end:
        others = Others()
        time.sleep(PAUSE)
        if others.cores() < QUIET:
            return


class Others:
    """Counts the cores that others use from now on."""

    def __init__(self) -> None:
        self._then, self._busy, self._own = time.perf_counter(), _busy(), _own()

    def cores(self) -> float:
        """On average; 0 where the machine cannot tell."""
        busy, own = _busy() - self._busy, _own() - self._own
        return max(busy - own, 0.0) / (time.perf_counter() - self._then)


def _busy() -> float:
    """Seconds that the cores have worked, all together."""
    try:
        first = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    except OSError:
        return 0.0
    user, nice, system, _, _, interrupt, soft, stolen = map(float, first[:8])
    return (user + nice + system + interrupt + soft + stolen) / TICKS


def _own() -> float:
    """Seconds that this process and the ended ones that it started have worked."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system
