"""The preconditioner of the coupled solve is positive, and leaves little of the matrix."""

import numpy as np
import pytest
from scipy.linalg import eigvalsh

import halfspace
from halfspace import coarse, reference
from halfspace.coarse import Coarse

GROUND = halfspace.HalfSpace(1.0, 0.0)


def square(side: int) -> np.ndarray:
    at = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    return at + np.random.default_rng(1).uniform(-0.05, 0.05, at.shape)


def layout(kind: str) -> np.ndarray:
    if kind == "line":
        return np.c_[square(16)[:, 0] + 16 * (np.arange(256) // 16), np.full(256, 3.0)]
    x = square(11)
    if kind == "two clusters":
        return np.r_[x / 2, x + 20]
    return x[x[:, 0] + x[:, 1] ** 2 / 5 < 8]


def matrices(x: np.ndarray, softness: float) -> tuple[np.ndarray, np.ndarray]:
    """Influence C and stiffnesses K, of a half to twice that for which the largest eigenvalue of
    C K is the ``softness``."""
    c = GROUND.matrix(x)
    k = np.random.default_rng(3).uniform(0.5, 2, len(x))
    return c, k * softness / np.linalg.eigvalsh(np.sqrt(k)[:, None] * c * np.sqrt(k)).max()


def ends(x: np.ndarray, softness: float) -> tuple[float, float, float, float]:
    """Least and largest eigenvalue of ``K (K^-1 + C)`` and of ``P (K^-1 + C)``."""
    c, k = matrices(x, softness)
    whole = k[:, None] * of(Coarse(x, GROUND.modulus).preconditioner(k), len(x))
    assert np.allclose(whole, whole.T, rtol=0, atol=1e-12 * whole.max())
    whole = (whole + whole.T) / 2
    assert np.linalg.eigvalsh(whole).min() > 0
    matrix = np.diag(1 / k) + c
    before = eigvalsh(matrix, np.diag(1 / k))
    after = eigvalsh(matrix, np.linalg.inv(whole))
    return before.min(), before.max(), after.min(), after.max()


def of(precondition, n: int) -> np.ndarray:
    return np.stack([precondition(e) for e in np.eye(n)], axis=1)


@pytest.mark.parametrize("softness", [2.0, 7.0, 30.0])
def test_what_is_large_on_soft_ground_is_gone(softness):
    least, most, least_left, most_left = ends(square(20), softness)
    assert most == pytest.approx(1 + softness)
    assert most_left < 1 + 0.05 * softness
    assert least_left > least - 0.01
    if softness == 7:
        assert most / least > 10 and most_left / least_left < 1.6


@pytest.mark.parametrize("kind", ["line", "two clusters", "corner"])
def test_it_helps_in_other_layouts(kind):
    least, most, least_left, most_left = ends(layout(kind), 7.0)
    assert most_left < 0.65 * most
    assert least_left > least - 0.01


def test_stiff_ground_goes_without():
    x = square(10)
    _, k = matrices(x, 0.1)
    assert Coarse(x, GROUND.modulus).preconditioner(k) is None


def test_one_contact_and_many_at_one_place():
    for n in (1, 5, 50):
        x, k = np.full((n, 2), 3.0), np.full(n, 100.0)
        assert Coarse(x, GROUND.modulus).preconditioner(k) is None


def test_inverse_by_sweeps():
    rng = np.random.default_rng(0)
    a = rng.standard_normal((30, 30))
    a = a @ a.T + np.eye(30)
    assert np.allclose(coarse._inverse(a), np.linalg.inv(a), rtol=1e-10, atol=1e-12)


def test_fewer_applications_and_the_same_forces(monkeypatch):
    x, law = square(20) * 0.2, reference.hertz_law(1.0, 1.0)
    overlap = np.random.default_rng(4).uniform(0.5e-3, 1e-3, len(x))
    found = halfspace.solve(GROUND, x, overlap, law, 1e-10)
    monkeypatch.setattr(halfspace.Plan, "preconditioner", lambda self, stiffness: None)
    plain = halfspace.solve(GROUND, x, overlap, law, 1e-10)
    assert np.allclose(found.force, plain.force, rtol=1e-7, atol=1e-8 * plain.force.max())
    assert found.applications < 0.7 * plain.applications


def test_tensors_as_arrays():
    torch = pytest.importorskip("torch")
    x = square(8)
    _, k = matrices(x, 7.0)
    r = np.random.default_rng(5).standard_normal(len(x))
    here = Coarse(x, 1.0).preconditioner(k)(r)
    there = Coarse(torch.tensor(x), 1.0).preconditioner(torch.tensor(k))(torch.tensor(r))
    assert np.allclose(here, there.numpy(), rtol=1e-12, atol=1e-14)
