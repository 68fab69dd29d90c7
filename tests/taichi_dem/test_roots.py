"""Roots by arithmetic alone, to rounding over the whole range of doubles."""

import numpy as np
import pytest

from halfspace import backend
from taichi_dem.contacts.roots import cube_root, inverse_cube_root, power
from taichi_dem.types import real, ti

N = 20_000


@pytest.fixture(scope="module")
def values():
    """Dense over one factor of eight, where the first guess repeats, and sparse over the rest."""
    rng = np.random.default_rng(1)
    return np.concatenate([np.geomspace(1, 8, N // 2), np.exp(rng.uniform(-600, 600, N // 2))])


def evaluate(function, values):
    backend.start()

    @ti.kernel
    def run(x: ti.types.ndarray(dtype=real, ndim=1), result: ti.types.ndarray(dtype=real, ndim=1)):
        for i in range(x.shape[0]):
            result[i] = function(x[i])

    result = np.empty_like(values)
    run(values, result)
    return result


def test_cube_roots(values):
    found = evaluate(cube_root, values)
    assert np.abs(found / np.cbrt(values) - 1).max() < 2e-15
    assert np.abs(evaluate(inverse_cube_root, values) * np.cbrt(values) - 1).max() < 2e-15


def test_the_cube_root_of_zero_is_zero():
    assert np.array_equal(evaluate(cube_root, np.zeros(3)), np.zeros(3))


@pytest.mark.parametrize("exponent", [0, 0.5, 1, 1.5, 2, 2.5, 1 / 3, 2 / 3, 4 / 3, 0.7, 3.3])
def test_powers(values, exponent):
    """By roots, or by the library where there are none; nothing is lost at zero."""

    @ti.func
    def raised(x: real) -> real:
        return power(x, exponent)

    moderate = values[(values > 1e-60) & (values < 1e60)]
    expected = moderate**exponent
    if exponent in (1 / 3, 2 / 3, 4 / 3):  # which a float only comes near to
        expected = np.cbrt(moderate) ** round(3 * exponent)
    assert np.abs(evaluate(raised, moderate) / expected - 1).max() < 5e-15
    assert evaluate(raised, np.zeros(1))[0] == float(exponent == 0)
