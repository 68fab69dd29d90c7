"""The suite itself."""

from tests.hard import CASES
from tests.hard.kit import Figure


def test_there_are_enough_of_different_names():
    assert len({case.name for case in CASES}) == len(CASES) >= 60


def test_not_a_number_breaks_a_case():
    assert not Figure("lost", float("nan"), 1.0).holds
    assert Figure("kept", 1.0, 1.0).holds and not Figure("broken", 1.1, 1.0).holds
