"""When a run looks up from its steps: outputs that are due, and the user's Ctrl-C."""

import math
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from taichi_dem.writing import Output


class Schedule:
    """When outputs are due: the k-th time at the first step that reaches k times its interval."""

    def __init__(self, outputs: Sequence[Output], dt: float):
        self._outputs = [(output, output.every / dt) for output in outputs if output.every]

    def steps_to_next(self, step: int, limit: int) -> int:
        """Steps until something is due, at most ``limit``."""
        return min([limit, *(_next(step, every) - step for _, every in self._outputs)])

    def due(self, step: int) -> list[Output]:
        """The outputs to write at ``step``."""
        return [output for output, every in self._outputs if _next(step - 1, every) == step]


def _next(step: int, every: float) -> int:
    """The first step after ``step`` that reaches a multiple of ``every`` steps."""
    count = math.floor((step + 1e-9) / every) + 1
    return max(step + 1, math.ceil(count * every - 1e-9))


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Ctrl-C sets the event instead of breaking a step in two; a second one breaks it."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = signal.getsignal(signal.SIGINT)

    def ask_to_stop(number: int, frame: object) -> None:
        event.set()
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, ask_to_stop)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, previous)
