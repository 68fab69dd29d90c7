"""The hard cases of ``tests/hard``: what each is held to, and what it reaches.

Every case runs under each driver and exchange that it names; a row for the figure that comes
nearest to its bound, or ``--all`` of them.  A case that raises is a row of the table, and broken.
"""

import argparse
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from benchmarks import words
from benchmarks.report import Figure

if TYPE_CHECKING:
    from tests.hard import Case


def add_options(parser: argparse.ArgumentParser) -> None:
    words.add_option(parser)
    parser.add_argument("--all", action="store_true", help="every figure of every setting")


def run(options: argparse.Namespace) -> list[Figure]:
    """Every case in turn, printed as it ends."""
    from tests.hard import CASES

    rows: list[Figure] = []
    for case in words.chosen(CASES, options.words):
        found = sorted(figures(case), key=_nearness, reverse=True)
        shown = found if options.all else found[:1]
        for figure in shown:
            print("  ".join(cell for cell in figure.row() if cell), flush=True)
        rows += shown
    broken = sum(not figure.met for figure in rows)
    return [*rows, Figure("cases that break", float(broken), "", at_most=0)]


def figures(case: "Case") -> Iterator[Figure]:
    """What ``case`` reaches in each of its settings; one that raises reaches nothing."""
    for setting in case.settings:
        where = f"{case.name} [{setting}]"
        try:
            for figure in case.figures(setting):
                what = f"{where}: {figure.what}"
                yield Figure(what, figure.value, "", at_most=figure.bound)
        except Exception as error:
            reason = (str(error).splitlines() or [""])[0]
            what = f"{where}: raised: {type(error).__name__}: {reason}"
            yield Figure(what, math.nan, "", at_most=0)


def _nearness(figure: Figure) -> float:
    """How much of its bound a figure takes; not-a-number and what breaks come first."""
    if not figure.met:
        return math.inf
    return figure.value / figure.at_most if figure.at_most else 0.0
