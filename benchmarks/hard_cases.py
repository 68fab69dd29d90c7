"""The hard cases of ``tests/hard``: what each is held to, and what it reaches.

Every case runs under each driver and exchange that it names; a row for the figure that comes
nearest to its bound, or ``--all`` of them.
"""

import argparse

from benchmarks.report import Figure


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("words", nargs="*", help="only cases whose names have all of these")
    parser.add_argument("--all", action="store_true", help="every figure of every setting")


def run(options: argparse.Namespace) -> list[Figure]:
    """Every case in turn, printed as it ends."""
    from tests.hard import CASES

    rows: list[Figure] = []
    for case in CASES:
        if not all(word in case.name for word in options.words):
            continue
        found = []
        for setting in case.settings:
            for figure in case.figures(setting):
                where = f"{case.name} [{setting}]: {figure.what}"
                found.append(Figure(where, figure.value, "", at_most=figure.bound))
        found.sort(key=_nearness, reverse=True)
        shown = found if options.all else found[:1]
        for figure in shown:
            print("  ".join(cell for cell in figure.row() if cell), flush=True)
        rows += shown
    broken = sum(not figure.met for figure in rows)
    return [*rows, Figure("cases that break", float(broken), "", at_most=0)]


def _nearness(figure: Figure) -> float:
    """How much of its bound a figure takes; not-a-number and what breaks come first."""
    if not figure.met:
        return float("inf")
    return figure.value / figure.at_most if figure.at_most else 0.0
