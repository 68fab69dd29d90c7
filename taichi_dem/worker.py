"""``python -m taichi_dem.worker``: a process that computes one scene with one set of settings.

It is spoken to in lines of JSON. The first says what to compute: ``scene`` (path), ``settings``
(its ``step`` may be null: the stable one), ``window`` (s), ``samples``; the answer says how long it
took to compile. Each further line asks for one run from the start: ``member`` (0: as the scene is;
k: the k-th perturbed start), ``step`` (s, null: that of the settings), ``save`` (where the record
is to go; null: none is made, and the answer has the seconds that the steps took). It ends when
there are no more lines, and waits without using the processor between two of them: processes can
take turns.
"""

from __future__ import annotations

import json
import os
import signal
import statistics
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

LONG_ENOUGH = 0.3  # s to be timed
MOST_RUNS = 300
WARM_UP_STEPS = 70  # every driver is compiled and has been tried within these


def main() -> None:
    """Answer the lines of standard input on standard output; what libraries print goes to
    standard error."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # for the one that asks, as Ctrl-C is
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    sim, asked = _prepare(json.loads(sys.stdin.readline()), answers)
    for line in sys.stdin:
        _answer(answers, **_run(sim, asked, json.loads(line)))


def _answer(answers: TextIO, **values: Any) -> None:
    answers.write(json.dumps(values) + "\n")
    answers.flush()


def _prepare(asked: dict[str, Any], answers: TextIO) -> tuple[Any, dict[str, Any]]:
    """The simulation, compiled and warm."""
    start = time.perf_counter()
    from taichi_dem import scene_file
    from taichi_dem.guards import SimulationStopped
    from taichi_dem.settings import Settings
    from taichi_dem.simulation import Simulation

    scene, _ = scene_file.read(asked["scene"])
    settings = Settings(**asked["settings"])
    sim = Simulation(settings.applied(scene), settings.step or None, skin=settings.skin)
    with suppress(SimulationStopped):  # the runs themselves will say so
        sim.run(steps=WARM_UP_STEPS)
    sim.contacts()
    sim.energy()
    _answer(answers, built=time.perf_counter() - start, stable=sim.stable.value)
    return sim, asked


def _run(sim: Any, asked: dict[str, Any], order: dict[str, Any]) -> dict[str, Any]:
    from taichi_dem.accuracy import perturbed
    from taichi_dem.guards import SimulationStopped
    from taichi_dem.record import even_step, record

    settled = asked["settings"]["step"] or sim.stable.value
    step = even_step(order["step"] or settled, asked["window"], asked["samples"])
    sim.restart(perturbed(sim._built_with, order["member"]), dt=step)
    if not order["save"]:
        return {"seconds": _time(sim, round(asked["window"] / step))}
    try:
        record(sim, asked["window"], asked["samples"]).save(Path(order["save"]))
    except SimulationStopped as stop:
        return {"stopped": str(stop)}
    return {"hosted": bool(getattr(sim._engine.exchange, "hosted", False))}


def _time(sim: Any, steps: int) -> float:
    """Seconds that ``steps`` take from the start; of short runs, the median of many."""
    seconds: list[float] = []
    while not seconds or (sum(seconds) < LONG_ENOUGH and len(seconds) < MOST_RUNS):
        if seconds:
            sim.restart(dt=sim.dt)
        start = time.perf_counter()
        sim.run(steps=steps)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


if __name__ == "__main__":
    main()
