"""Two bodies that meet."""

from tests.hard import impacts
from tests.hard.kit import assert_holds, settings_of


@settings_of(impacts.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
