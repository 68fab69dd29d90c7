"""When a run looks up from its steps: outputs that are due, and the user's Ctrl-C."""

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from taichi_dem.writing import Output


class Schedule:
    """The steps at which outputs are due: multiples of their interval, counted from step 0."""

    def __init__(self, outputs: Sequence[Output], dt: float):
        self._intervals = [
            (output, max(1, round(output.every / dt)))
            for output in outputs
            if output.every is not None
        ]

    def steps_to_next(self, step: int, limit: int) -> int:
        """Steps until something is due, at most ``limit``."""
        return min([limit, *(every - step % every for _, every in self._intervals)])

    def due(self, step: int) -> list[Output]:
        """The outputs to write at ``step``."""
        return [output for output, every in self._intervals if step % every == 0]


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
