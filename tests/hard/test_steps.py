"""Time steps at the edge and beyond."""

from tests.hard import steps
from tests.hard.kit import assert_holds, settings_of


@settings_of(steps.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
