"""Steps, speeds and stiffnesses beyond what a code resolves."""

from tests.hard import edges
from tests.hard.kit import assert_holds, settings_of


@settings_of(edges.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
