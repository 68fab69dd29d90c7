"""Shortened, the compiler still says where a mistake stands."""

from pathlib import Path

import pytest

from halfspace import backend

ti = backend.ti


@ti.func
def doubled(x):
    return 2 * x + missing  # noqa: F821


@ti.kernel
def mistaken() -> ti.f64:
    return doubled(1.0)


def test_a_mistake_is_told_with_its_file_line_function_and_text():
    backend.start()
    here = Path(__file__)
    line = here.read_text().splitlines().index("    return 2 * x + missing  # noqa: F821") + 1
    with pytest.raises(Exception, match="missing") as told:
        mistaken()
    message = str(told.value)
    assert str(here) in message
    assert f"line {line}, in doubled" in message
    assert "return 2 * x + missing" in message
    assert "in mistaken" in message
