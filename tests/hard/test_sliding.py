"""Small grains on large ones."""

from tests.hard import sliding
from tests.hard.kit import assert_holds, settings_of


@settings_of(sliding.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
