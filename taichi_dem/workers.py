"""Processes that compute one setting each, as the one that asks them sees them."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from taichi_dem.settings import Settings

PATIENCE = 20.0  # s that a process has to end by itself
PACKAGE = Path(__file__).resolve().parent.parent


class WorkerFailed(RuntimeError):
    """A process ended before it answered; the message is the last that it said."""


class Worker:
    """A process for ``scene`` (path) with ``settings``; ``step`` None is the stable one.

    ``built``: s that it took to compile and warm up; ``stable``: the stable step, s.
    """

    def __init__(
        self, scene: Path, settings: Settings, window: float, samples: int, step: float | None
    ):
        self._abandoned = True  # until it has answered, and while it has not
        self._said = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115
        path = os.pathsep.join([str(PACKAGE), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "taichi_dem.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            text=True,
            env={**os.environ, "HALFSPACE_PRECISION": settings.precision, "PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C is for the one that asks
        )
        try:
            answer = self._ask(
                scene=str(scene),
                settings=dataclasses.asdict(settings) | {"step": step},
                window=window,
                samples=samples,
            )
        except BaseException:
            self.close()
            raise
        self.built, self.stable = float(answer["built"]), float(answer["stable"])

    def look(self, save: Path, member: int = 0, step: float | None = None) -> dict[str, Any]:
        """One run whose record goes to ``save``; see :mod:`taichi_dem.worker`. ``stopped`` is in
        the answer if a guard stopped it."""
        return self._ask(member=member, step=step, save=str(save))

    def time(self, step: float | None = None) -> float:
        """Seconds that the steps of a run take which nobody looks at."""
        return float(self._ask(member=0, step=step, save=None)["seconds"])

    def close(self) -> None:
        """End the process; one that ends by itself leaves its compiled kernels to the next."""
        process = self._process
        try:
            process.communicate(timeout=0 if self._abandoned else PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        self._said.close()

    def _ask(self, **order: Any) -> dict[str, Any]:
        stdin, stdout = self._process.stdin, self._process.stdout
        self._abandoned = True
        assert stdin is not None and stdout is not None
        try:
            stdin.write(json.dumps(order) + "\n")
            stdin.flush()
            line = stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            self._said.seek(0)
            said = self._said.read().strip().splitlines()
            raise WorkerFailed(said[-1] if said else "the process ended without a word")
        self._abandoned = False
        answer: dict[str, Any] = json.loads(line)
        return answer
