"""Laws that stick, yield and resist rolling."""

from tests.hard import laws
from tests.hard.kit import assert_holds, settings_of


@settings_of(laws.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
