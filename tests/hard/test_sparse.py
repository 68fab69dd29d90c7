"""Ground that is solved for every few steps."""

from tests.hard import sparse
from tests.hard.kit import assert_holds, settings_of


@settings_of(sparse.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
