"""Spheres on a soft surface, their contacts of finite size: in an endless array, and in motion."""

import warnings

import numpy as np
import pytest

import halfspace
from halfspace import reference as ref

RADIUS, MODULUS = 1.0, 1.0
GROUND = halfspace.HalfSpace(MODULUS, 0.0)  # rigid spheres on it: E* = E'


def coupling_energy(x, f, a):
    """`1/2 sum f_j f_k/(pi E' r) [1 + (a_j^2 + a_k^2)/(10 r^2)]` as it is written."""
    r = np.linalg.norm(x[:, None] - x, axis=2)
    np.fill_diagonal(r, np.inf)
    s = a[:, None] ** 2 + a**2
    return 0.5 * f @ ((1 + s / (10 * r**2)) / (np.pi * MODULUS * r)) @ f


# An infinite array, against boundary elements ----------------------------------------------------


def pressed_in_a_cell(apart, n=64):
    """Approach of a rigid sphere, R = E' = 1, in a cell of side 1, for a contact radius without
    neighbours of 1/apart: `(force, approach)`; constrained conjugate gradients over Fourier
    transforms (I. A. Polonsky & L. M. Keer, Wear 231, 206, 1999)."""
    a, h = 1 / apart, 1 / n
    q = 2 * np.pi * np.hypot(np.fft.fftfreq(n, h)[:, None], np.fft.fftfreq(n, h))
    influence = np.divide(2.0, q, out=np.zeros_like(q), where=q > 0)

    def sink(p):
        return np.fft.ifft2(influence * np.fft.fft2(p)).real

    line = (np.arange(n) - n // 2) * h
    r2 = line[:, None] ** 2 + line**2
    p = np.sqrt(np.maximum(1 - r2 / a**2, 0.0))
    load = 4 / 3 * a**3 / h**2
    p *= load / p.sum()
    t, norm, follow = np.zeros_like(p), 1.0, False
    for _ in range(200):
        active = p > 0
        gap = sink(p) + r2 / 2
        approach = gap[active].mean()
        gap = gap - approach
        now = (gap[active] ** 2).sum()
        t = np.where(active, gap + (now / norm * t if follow else 0.0), 0.0)
        norm, response = now, sink(t)
        response -= response[active].mean()
        step = (gap * t)[active].sum() / (response * t)[active].sum()
        before, p = p, np.maximum(p - step * t, 0.0)
        lost = (p == 0) & (gap < 0)
        p[lost] -= step * gap[lost]
        follow = not lost.any()
        p *= load / p.sum()
        if np.abs(p - before).sum() < 1e-7 * load:
            break
    return load * h**2, approach


@pytest.mark.parametrize(
    ("apart", "finite_error", "point_error"),
    [(2.2, 0.0045, 0.15), (3.0, 0.0018, 0.059), (4.0, 0.0006, 0.024)],
)
def test_infinite_array(apart, finite_error, point_error):
    """The error of the approach under a given force, as one of the force (3/2 of it)."""
    force, approach = pressed_in_a_cell(apart)
    errors = {}
    for coupling in ("finite", "point"):
        ground = halfspace.HalfSpace(1.0, 0.0, coupling=coupling, period=(1.0, 1.0))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pressed = halfspace.press(ground, [[0.3, 0.4]], 1.0, load=[force])
        errors[coupling] = 1.5 * abs(pressed.approach[0] - approach) * apart**2
    assert errors["finite"] < finite_error
    assert errors["point"] == pytest.approx(point_error, rel=0.03)


# Motion ------------------------------------------------------------------------------------------


def fly(steps_per_period, periods=2):
    """Nine spheres bounce and slide close together, by velocity Verlet; the largest deviation of
    the energy over that of the equilibrium, and applications per step."""
    rng = np.random.default_rng(5)
    depth, spacing = 0.01, 0.3
    cells = np.stack(np.meshgrid(np.arange(3), np.arange(3)), axis=-1).reshape(-1, 2)
    x = spacing * (cells + rng.uniform(-0.1, 0.1, cells.shape))
    overlap = np.full(9, depth)
    law = ref.hertz_law(RADIUS, MODULUS)
    rest = halfspace.solve(GROUND, x, overlap, law)
    period = 2 * np.pi / np.sqrt(2 * MODULUS * np.sqrt(RADIUS * depth))
    dt = period / steps_per_period
    position = np.c_[x, -overlap]
    velocity = rng.standard_normal((9, 3)) * [0.1 * spacing, 0.1 * spacing, 0.1 * depth] / period
    past, costs, stiffness = [], [], float(ref.hertz_stiffness(RADIUS, MODULUS))

    def guess(index):
        p = [both[index] for both in past[-4:]]
        return 4 * p[3] - 6 * p[2] + 4 * p[1] - p[0] if len(p) == 4 else None

    def act():
        x, overlap = position[:, :2], -position[:, 2]
        s = halfspace.solve(GROUND, x, overlap, law, 1e-8, guess(0), shift=guess(1))
        past.append((s.overlap, s.shift))
        costs.append(s.applications)
        lost = (s.shift**2).sum(axis=1) / (2 * RADIUS)
        stored = s.force @ (overlap - lost) - 0.6 * np.sum(s.force ** (5 / 3)) * stiffness ** (
            -2 / 3
        )
        stored -= coupling_energy(x + s.shift, s.force, s.contact_radius)
        force = np.c_[-s.force[:, None] * s.slope, s.force - rest.force]
        return force, stored + rest.force @ position[:, 2], stored

    force, potential, scale = act()
    total = [potential + 0.5 * np.sum(velocity**2)]
    for _ in range(periods * steps_per_period):
        velocity += 0.5 * dt * force
        position += dt * velocity
        force, potential, _ = act()
        velocity += 0.5 * dt * force
        total.append(potential + 0.5 * np.sum(velocity**2))
    return np.abs(np.array(total) - total[0]).max() / scale, costs


def test_energy_of_moving_spheres():
    """Half the step, a quarter of the deviation."""
    (coarse, _), (fine, costs) = fly(50), fly(100)
    assert coarse / fine == pytest.approx(4, abs=0.2)
    assert fine < 1e-5
    assert np.mean(costs[4:]) <= 8
