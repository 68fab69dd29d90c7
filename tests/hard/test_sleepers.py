"""Clusters that sleep until they are touched."""

from tests.hard import sleepers
from tests.hard.kit import assert_holds, settings_of


@settings_of(sleepers.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
