"""Many bodies."""

from tests.hard import beds
from tests.hard.kit import assert_holds, settings_of


@settings_of(beds.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
