"""Contacts on the elastic half-space."""

from tests.hard import ground
from tests.hard.kit import assert_holds, settings_of


@settings_of(ground.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
