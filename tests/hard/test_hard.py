"""Every hard case holds, under every driver and exchange that it names."""

import pytest

from tests.hard import CASES

ALL = [(case, setting) for case in CASES for setting in case.settings]


@pytest.mark.parametrize(
    ("case", "setting"), ALL, ids=[f"{case.name} [{setting}]" for case, setting in ALL]
)
def test_holds(case, setting):
    figures = case.figures(setting)
    assert figures
    broken = [
        f"{f.what}: {f.value:.3g}, must be at most {f.bound:.3g}" for f in figures if not f.holds
    ]
    assert not broken


def test_there_are_enough():
    assert len({case.name for case in CASES}) == len(CASES) >= 40
