"""Who survives what: the hard cases here, in LIGGGHTS and in LAMMPS, at the same time step.

Each case runs here and is held to its own bounds; then others run its last scene, as the same
spheres, walls and laws, for as many steps.  Of them is asked at the end that every number is
finite, that every sphere is there and on its side of every wall, and that no energy has come from
nothing.  Refusing a scene or stopping with a reason is no failure, nor is energy that a step beyond
the stable one has made, if the code warns of it, which only ours does; going on with nonsense is,
and so is every other exception, crash or run without an end.  Of cases that no other can be told
only that is printed: ``hard_cases`` has them.
"""

import argparse
import dataclasses
import resource
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import taichi_dem as dem
from benchmarks import lammps, liggghts, peers, words
from benchmarks.report import Figure

if TYPE_CHECKING:
    from tests.hard import Case
    from tests.hard.witness import Trial

PATIENCE = 30  # s of the processor, for a peer
END = "end.dump"
DUMP = "dump end all custom {steps} {file} id x y z vx vy vz omegax omegay omegaz\n"


class UnsayableError(Exception):
    """The scene has no counterpart in a peer's input."""


class PeerStoppedError(Exception):
    """A peer ended with an error that it names."""


class PeerCrashedError(Exception):
    """A peer ended, by a signal or otherwise, without a reason."""


def add_options(parser: argparse.ArgumentParser) -> None:
    words.add_option(parser)


def run(options: argparse.Namespace) -> list[Figure]:
    """The table, printed line by line; the figures count who was told how much and who failed."""
    from tests.hard import CASES

    codes = ["ours", *(code for code in peers.BINARIES if peers.available(code))]
    ran, failures = dict.fromkeys(codes, 0), dict.fromkeys(codes, 0)
    for case in words.chosen(CASES, options.words):
        print(case.name)
        for code, outcome, good in judge(case, codes):
            if good is not None:
                ran[code] += 1
                failures[code] += not good
            print(f"    {code:10s}{'FAILS: ' if good is False else ''}{outcome}", flush=True)
    cases = [Figure(f"cases run by {code}", float(count), "") for code, count in ran.items()]
    return cases + [
        Figure(f"failures of {code}", float(count), "", at_most=0 if code == "ours" else None)
        for code, count in failures.items()
    ]


def judge(case: "Case", codes: Sequence[str]) -> Iterator[tuple[str, str, bool | None]]:
    """For each code what came out, in words, and whether it is sound; None where it did not run."""
    from tests.hard.witness import Witness

    others = [code for code in codes if code != "ours"]
    untold: dict[str, str] = {}

    def admit(scene: dem.Scene) -> None:
        untold.clear()
        for code in others:
            try:
                with tempfile.TemporaryDirectory() as name:
                    _write(code, Path(name), scene, dt=1e-9, steps=1)
            except UnsayableError as reason:
                untold[code] = f"cannot say it: {_last_words(str(reason))}"
        if others and len(untold) == len(others):
            raise UnsayableError

    exchanges = [setting.exchange for setting in case.settings]
    exchange = "none" if "none" in exchanges else exchanges[0]
    witness = Witness("serial", exchange, admit)
    yield from _ours(case, witness, untold, others)
    for code in others:
        if code in untold:
            yield code, untold[code], None
        elif witness.trials:
            yield code, *_judge_other(code, witness.trials[-1])


def _ours(
    case: "Case", witness, untold: dict[str, str], others: Sequence[str]
) -> Iterator[tuple[str, str, bool | None]]:
    """The row of this code, unless no other is told the scene."""
    try:
        figures = case.figures(witness)
    except Exception as reason:
        figures = reason
    if others and len(untold) == len(others):
        return
    if isinstance(figures, Exception):
        yield "ours", _broken(figures), False
        return
    missed = [figure for figure in figures if not figure.holds]
    worst = max(missed or figures, key=lambda each: each.value / each.bound if each.bound else 0.0)
    text = f"{worst.what}: {worst.value:.3g} of {worst.bound:.3g}"
    if witness.trials:
        trial = witness.trials[-1]
        if trial.stopped:
            text = f"{'refused' if trial.refused else 'stopped'}: {_last_words(trial.stopped)}"
        if trial.sim.warnings:
            text = f"{text}; warned of {', '.join(trial.sim.warnings)}"
    yield "ours", text, not missed


def _judge_other(code: str, trial: "Trial") -> tuple[str, bool]:
    from tests.hard.invariants import kept

    scene, dt, steps = trial.sim.scene, trial.dt, trial.steps
    try:
        rows = _theirs(code, scene, dt, steps)
    except PeerStoppedError as reason:
        return f"stopped: {_last_words(str(reason))}", True
    except Exception as reason:
        return _broken(reason), False
    figures = list(kept(scene, rows, trial.held, steps * dt))
    missed = [figure for figure in figures if not figure.holds]
    if missed:
        return f"{missed[0].what}: {missed[0].value:.3g}", False
    last = figures[-1]
    return (f"energy {100 * last.value:+.3g} %" if last.what == "energy made" else "sound"), True


def _theirs(code: str, scene: dem.Scene, dt: float, steps: int) -> np.ndarray:
    """(n, 9) position, velocity, omega at the end, as the other code has them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write(code, folder, scene, dt, steps)
        command = [peers.BINARIES[code], "-in", liggghts.SCRIPT, "-log", liggghts.LOG]
        done = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            preexec_fn=_be_patient,
        )
        told = done.stdout + done.stderr
        if done.returncode == -signal.SIGXCPU:
            raise PeerCrashedError(f"no end within {PATIENCE} s")
        if done.returncode > 0 and _errors(told):
            raise PeerStoppedError(told)
        if done.returncode:
            raise PeerCrashedError(f"{told}\nexit status {done.returncode}")
        frames = (folder / END).read_text().split("ITEM: ATOMS")
    last = [line.split() for line in frames[-1].splitlines()[1:]]
    rows = np.array(last, dtype=float).reshape(-1, 10)
    return rows[np.argsort(rows[:, 0]), 1:]


def _write(code: str, folder: Path, scene: dem.Scene, dt: float, steps: int) -> None:
    """The peer's own input; :class:`UnsayableError` where it has no words for the scene."""
    scene = dataclasses.replace(
        scene, boundaries=tuple(_in_steps(wall, dt) for wall in scene.boundaries)
    )
    skin = 2 * liggghts.SKIN * float(scene.spheres.radius.min())
    script = folder / liggghts.SCRIPT
    try:
        if code == "liggghts":
            liggghts.write(folder, scene, dt=dt, steps=steps, skin=skin)
        else:
            liggghts.write_data(folder / liggghts.DATA, scene)
            script.write_text(lammps.script(scene, dt, steps, skin))
    except ValueError as reason:
        raise UnsayableError(str(reason)) from reason
    text = script.read_text().replace("boundary f f f", "boundary m m m")
    text = text.replace("lost error", "lost warn")
    where = text.rindex("run ")
    dump = DUMP.format(steps=steps, file=END)
    script.write_text(text[:where] + dump + text[where:])


def _in_steps(wall: dem.Box | dem.Plane | dem.Piston, dt: float):
    """With a program whose times are whole numbers of steps, as not everyone takes others."""
    if not isinstance(wall, dem.Piston) or wall.program is None:
        return wall
    rows = tuple((round(time / dt) * dt, travel) for time, travel in wall.program)
    return dataclasses.replace(wall, program=rows)


def _be_patient() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE + 1))


def _broken(reason: Exception) -> str:
    return f"breaks, {type(reason).__name__}: {_last_words(str(reason))}"


def _last_words(text: str) -> str:
    return (_errors(text) or text.strip().splitlines() or ["without a word"])[-1][:90]


def _errors(text: str) -> list[str]:
    """What a peer says of why it ends."""
    return [line for line in text.splitlines() if line.startswith("ERROR")]
