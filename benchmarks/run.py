"""Runs benchmarks: ``python benchmarks/run.py NAME [options]``; without a name, lists them.

A benchmark is a module of this folder with a docstring, ``add_options(parser)`` and
``run(options) -> list[Figure]``.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import report

NAMES = (
    "settled_bed",
    "hydrogel",
    "rebuild",
    "memory",
    "startup",
    "substrate_step",
    "asked_error",
    "hard_cases",
    "survival",
    "soak",
    "law_costs",
    "effect_costs",
    "absent_effects",
    "sleeping_bed",
    "half_space",
    "cold_solve",
    "moving_contacts",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for; returns 1 where a target is missed."""
    modules = {name: importlib.import_module(f"benchmarks.{name}") for name in NAMES}
    options = _parser(modules).parse_args(arguments)
    if options.name is None:
        for name, module in modules.items():
            print(f"{name:16s}{module.__doc__.splitlines()[0]}")
        return 0
    figures = modules[options.name].run(options)
    print(report.table(figures))
    if options.output:
        given = {key: str(value) for key, value in vars(options).items()}
        print(f"written to {report.write(options.output, options.name, given, figures)}")
    return int(any(figure.met is False for figure in figures))


def _parser(modules: dict) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="benchmarks/run.py", description=__doc__)
    chosen = parser.add_subparsers(dest="name", metavar="NAME")
    for name, module in modules.items():
        one = chosen.add_parser(
            name, description=module.__doc__, help=module.__doc__.split("\n")[0]
        )
        one.add_argument("-o", "--output", type=Path, help="folder for the results as JSON")
        module.add_options(one)
    return parser


if __name__ == "__main__":
    sys.exit(main())
