"""The half-space by itself."""

from tests.hard import surface
from tests.hard.kit import assert_holds, settings_of


@settings_of(surface.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
