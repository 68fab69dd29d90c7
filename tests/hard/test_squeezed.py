"""Soft spheres at the limit of what can be solved."""

from tests.hard import squeezed
from tests.hard.kit import assert_holds, settings_of


@settings_of(squeezed.__name__.rpartition(".")[2])
def test_holds(case, setting):
    assert_holds(case, setting)
