"""How busy other processes kept the machine meanwhile: a timing beside them says little (Linux)."""

import os
import time
from pathlib import Path

TICKS = 100.0  # of /proc/stat in a second


class Others:
    """Cores that others used since :meth:`start`, on average."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        self._then, self._busy, self._own = time.perf_counter(), _busy(), _own()

    def cores(self) -> float:
        """0 where the machine cannot tell."""
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
