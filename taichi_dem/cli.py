"""The command line: thin programs over scenes, simulations and pictures.

Nothing heavy is imported before a command needs it, so that ``--help`` answers at once.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

DONE, FAILED, WRONG_INPUT, STOPPED, INTERRUPTED = 0, 1, 2, 3, 130

EXITS = """\
exit codes: 0 done, 1 could not write, 2 wrong input (nothing is written),
            3 stopped by a guard (the last good state is kept), 130 interrupted (Ctrl-C, SIGTERM)
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    from taichi_dem.streams import lasting

    with lasting(), _interruptible():
        return _main(arguments)


@contextmanager
def _interruptible() -> Iterator[None]:
    """In the block Ctrl-C is heard also in what a shell has put in the background, and SIGTERM, by
    which ``timeout``, batch systems and containers end a process, does what Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: Any) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # `timeout` sends it twice
        interrupt = signal.getsignal(signal.SIGINT)  # within a run, it waits for the end of a step
        assert callable(interrupt)
        interrupt(number, frame)

    handlers = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: end}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _main(arguments: Sequence[str] | None) -> int:
    asked = _parser().parse_args(arguments)
    try:
        from taichi_dem.validation import InputError

        try:
            return asked.command(asked)
        except InputError as error:
            _complain_of_input(error)
            return WRONG_INPUT
    except KeyboardInterrupt:
        _complain("interrupted")
        return INTERRUPTED
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _complain(f"{where}{error.strerror or error}")
        return FAILED
    except ImportError as error:
        _complain(str(error))
        return FAILED


def _parser() -> argparse.ArgumentParser:
    from taichi_dem import __version__

    parser = argparse.ArgumentParser(
        prog="taichi-dem",
        description="Discrete elements on an elastic half-space.",
        epilog=EXITS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"taichi-dem {__version__}")
    commands = parser.add_subparsers(metavar="command", required=True)

    run = commands.add_parser("run", help="run a scene and write what happens into a folder")
    _add_scene(run)
    run.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="default: out/NAME for NAME.toml"
    )
    run.add_argument(
        "--overwrite", action="store_true", help="replace the run that the folder holds"
    )
    run.set_defaults(command=_run)

    run.add_argument(
        "--error",
        type=float,
        metavar="SHARE",
        help="choose time step, tolerances, coupling and exchange so that this error is met: 1e-3",
    )
    run.add_argument(
        "--left-out",
        choices=("warn", "refuse", "add"),
        default="warn",
        help="with --error: what becomes of effects that are left out and would change more; "
        "default: %(default)s",
    )

    run.add_argument(
        "--cost",
        action="store_true",
        help="time the scene without each of its effects at the end (compiles each of them)",
    )

    check = commands.add_parser(
        "check", help="say what a scene would compute, and how long it would take; writes nothing"
    )
    _add_scene(check)
    check.add_argument(
        "--cost",
        action="store_true",
        help="time the scene without each of its effects too (compiles each of them)",
    )
    check.set_defaults(command=_check)

    study = commands.add_parser(
        "study", help="what accuracy costs in time: turn every knob, and compare"
    )
    _add_scene(study)
    study.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="default: out/NAME.study for NAME.toml"
    )
    study.add_argument(
        "--knobs",
        nargs="+",
        metavar="KNOB",
        help="step, tolerance, residual, coupling, exchange, precision, skin; default: all",
    )
    study.add_argument("--rounds", type=int, default=3, help="runs that a time is the median of")
    study.set_defaults(command=_study)

    plot = commands.add_parser("plot", help="draw the pictures of a run again")
    plot.add_argument("folder", type=Path, help="of a run")
    plot.set_defaults(command=_plot)
    return parser


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, help="a scene file (TOML)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="replace an entry of the file: law.normal.restitution=0.5; may be repeated",
    )
    parser.add_argument(
        "--duration", type=float, metavar="SECONDS", help="simulated time, in place of the file's"
    )


def _run(asked: argparse.Namespace) -> int:
    from taichi_dem.run import run

    _check_environment()
    from taichi_dem.guards import SimulationStopped

    folder = asked.output or Path("out") / asked.scene.stem
    try:
        run(
            asked.scene,
            folder,
            asked.set,
            asked.duration,
            asked.overwrite,
            asked.error,
            asked.left_out,
            asked.cost,
        )
    except SimulationStopped as stop:
        _complain(f"stopped: {stop}")
        return STOPPED
    return DONE


def _check(asked: argparse.Namespace) -> int:
    from taichi_dem.check import check

    _check_environment()
    from taichi_dem.guards import SimulationStopped

    try:
        check(asked.scene, asked.set, asked.duration, asked.cost)
    except SimulationStopped as stop:
        _complain(f"the run would be stopped: {stop}")
        return STOPPED
    return DONE


def _study(asked: argparse.Namespace) -> int:
    from taichi_dem.studies import study

    _check_environment()
    from taichi_dem.workers import WorkerFailed

    folder = asked.output or Path("out") / f"{asked.scene.stem}.study"
    try:
        study(
            asked.scene,
            folder,
            asked.knobs,
            asked.duration,
            overrides=asked.set,
            rounds=asked.rounds,
        )
    except WorkerFailed as error:
        _complain(f"stopped: {error}")
        return STOPPED
    return DONE


def _plot(asked: argparse.Namespace) -> int:
    from taichi_dem.folder import draw

    for picture in draw(asked.folder):
        print(picture)
    return DONE


def _check_environment() -> None:
    """The kernel compiler is chosen by environment variables, which may be wrong."""
    from taichi_dem.validation import InputError, Problem

    try:
        import taichi_dem.types  # noqa: F401
    except ValueError as error:
        raise InputError([Problem("environment", None, str(error))]) from None


def _complain_of_input(error: Exception) -> None:
    from taichi_dem.tables import in_toml

    problems = getattr(error, "problems", ())
    found = "1 mistake" if len(problems) == 1 else f"{len(problems)} mistakes"
    _complain(f"{found} in the input")
    for problem in problems:
        print(f"  {in_toml(problem)}", file=sys.stderr)


def _complain(message: str) -> None:
    print(f"taichi-dem: {message}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
