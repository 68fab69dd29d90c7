"""Standard output and error whose reader may go away, as ``| head`` does, while a run goes on."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

GONE = (errno.EPIPE, errno.EIO)  # a closed pipe, a closed terminal
# Whether the kernel compiler takes another standard output for that of a graphical shell.
PYTHON_SHELLS = ("TI_ENABLE_PYBUF", "QD_ENABLE_PYBUF")


@contextmanager
def lasting() -> Iterator[None]:
    """What is printed in the block goes nowhere once nobody reads it any more."""
    for variable in PYTHON_SHELLS:
        os.environ.setdefault(variable, "0")
    before = sys.stdout, sys.stderr
    with open(os.devnull, "w", encoding="utf-8") as nowhere:  # for what was closed from the start
        sys.stdout, sys.stderr = (_Lasting(stream or nowhere) for stream in before)
        try:
            yield
        finally:
            try:
                sys.stdout.flush()
                sys.stderr.flush()
            finally:
                sys.stdout, sys.stderr = before


class _Lasting:
    """A stream, and an empty place in its stead when its reader has gone."""

    def __init__(self, stream: Any):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        self._try(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, act: Any, *args: Any) -> None:
        try:
            act(*args)
        except OSError as error:
            if error.errno not in GONE:
                raise
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            self._stream.flush()  # what it still held
