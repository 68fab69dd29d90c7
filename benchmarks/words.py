"""Words on the command line that choose among named cases."""

import argparse
from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar


class Named(Protocol):
    @property
    def name(self) -> str: ...


Case = TypeVar("Case", bound=Named)


def add_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("words", nargs="*", help="only cases whose names have all of these")


def chosen(cases: Iterable[Case], words: Sequence[str]) -> list[Case]:
    """The cases whose names have all ``words``; ends the program with a message if there is none.

    A table of no cases would read as one without failures.
    """
    cases = list(cases)
    found = [case for case in cases if all(word in case.name for word in words)]
    if not found:
        names = "".join(f"\n  {case.name}" for case in cases)
        raise SystemExit(
            f"words: no case has all of {', '.join(map(repr, words))}; there are{names}"
        )
    return found
