"""The potential of the coupled contacts: the forces are its gradient, and motion conserves it."""

import numpy as np
import pytest

import halfspace
from halfspace import reference as ref

RADIUS, MODULUS = 1.0, 1.0
HERTZ = ref.hertz_law(RADIUS, MODULUS)
GROUND = halfspace.HalfSpace(MODULUS, 0.0, coupling="point")  # rigid spheres on it: E* = E'
pytestmark = pytest.mark.filterwarnings("ignore:coupling = ")  # points, though close together


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def array(rng, side, depth, spacing=1.0, roughness=0.0):
    """A square array with disorder, and overlaps of which some are gaps where it is rough."""
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    x = spacing * (cells + rng.uniform(-0.1, 0.1, cells.shape))
    return x, depth * (1 + roughness * rng.standard_normal(len(x)))


def hertz_energy(state):
    """Of the contacts, and of their coupling."""
    own = 0.4 * state.force @ np.maximum(state.overlap, 0)
    return own + 0.5 * state.force @ state.displacement


def test_the_potential_is_largest(rng):
    """Equilibrium maximises U(f) = delta.f - f.Cf/2 - sum 3/5 f^(5/3) k^(-2/3) over f >= 0."""
    x, overlap = array(rng, 5, 0.05, roughness=1.0)
    k = float(ref.hertz_stiffness(RADIUS, MODULUS))
    c = GROUND.matrix(x)

    def potential(f):
        return overlap @ f - 0.5 * f @ c @ f - 0.6 * np.sum(f ** (5 / 3)) * k ** (-2 / 3)

    state = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-12)
    top = potential(state.force)
    assert top == pytest.approx(hertz_energy(state), rel=1e-11)
    for size in (1e-4, 1e-2, 1.0):
        for _ in range(20):
            other = state.force + size * state.force.max() * rng.standard_normal(len(x))
            assert potential(np.maximum(other, 0)) < top


def test_force_is_minus_the_gradient_of_the_energy(rng):
    """Normal f, lateral -f slope: the error of central differences falls as the square."""
    x, overlap = array(rng, 3, 0.05)
    state = halfspace.solve(GROUND, x, overlap, HERTZ, residual=1e-14)
    ours = np.c_[-state.force[:, None] * state.slope, state.force]  # along x, y and up

    def potential(y, d):
        return hertz_energy(halfspace.solve(GROUND, y, d, HERTZ, residual=1e-14))

    def error(h):
        worst = 0.0
        for k in range(len(x)):
            for axis in range(3):
                move, lift = np.zeros_like(x), np.zeros(len(x))
                if axis < 2:
                    move[k, axis] = h
                else:
                    lift[k] = h
                rise = potential(x + move, overlap - lift) - potential(x - move, overlap + lift)
                worst = max(worst, abs(-rise / (2 * h) - ours[k, axis]))
        return worst

    steps = 4e-3 * 0.5 ** np.arange(3)
    order = np.polyfit(np.log(steps), np.log([error(h) for h in steps]), 1)[0]
    assert order == pytest.approx(2, abs=0.05)
    assert -state.slope[0, 0] * state.force[0] > 0  # the corner is drawn in


def fly(steps_per_period, lateral=True, residual=1e-10, periods=3):
    """Nine spheres bounce and slide on soft ground without loss, by velocity Verlet.

    Returns the largest deviation of the energy, over that of the equilibrium, and the applications
    of each step.
    """
    rng = np.random.default_rng(5)
    depth, spacing = 0.01, 0.3
    x, overlap = array(rng, 3, depth, spacing)
    rest = halfspace.solve(GROUND, x, overlap, HERTZ)
    period = 2 * np.pi / np.sqrt(2 * MODULUS * np.sqrt(RADIUS * depth))
    dt = period / steps_per_period
    position = np.c_[x, -overlap]
    velocity = rng.standard_normal((9, 3)) * [0.1 * spacing, 0.1 * spacing, 0.1 * depth] / period
    past, applications = [], []

    def act():
        start = 4 * past[-1] - 6 * past[-2] + 4 * past[-3] - past[-4] if len(past) > 3 else None
        x, overlap = position[:, :2], -position[:, 2]
        state = halfspace.solve(GROUND, x, overlap, HERTZ, residual, start)
        past.append(state.overlap)
        applications.append(state.applications)
        sideways = -lateral * state.force[:, None] * state.slope
        force = np.c_[sideways, state.force - rest.force]
        return force, hertz_energy(state) + rest.force @ position[:, 2]

    force, potential = act()
    total = [potential + 0.5 * np.sum(velocity**2)]
    for _ in range(periods * steps_per_period):
        velocity += 0.5 * dt * force
        position += dt * velocity
        force, potential = act()
        velocity += 0.5 * dt * force
        total.append(potential + 0.5 * np.sum(velocity**2))
    return np.abs(np.array(total) - total[0]).max() / hertz_energy(rest), applications


def test_energy_of_moving_spheres():
    """Half the step, a quarter of the deviation; not so without the lateral force."""
    coarse, fine = fly(50)[0], fly(100)[0]
    assert coarse / fine == pytest.approx(4, abs=0.2)
    without = [fly(steps, lateral=False)[0] for steps in (50, 100)]
    assert without[0] / without[1] == pytest.approx(1, abs=0.01)
    assert without[1] > 1e3 * fine


def test_cost_and_energy_at_the_default_residual():
    deviation, applications = fly(50, residual=1e-6)
    assert deviation < 1e-5
    assert max(applications[4:]) <= 6 and np.mean(applications[4:]) <= 5
