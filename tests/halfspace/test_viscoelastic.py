"""A creeping substrate: closed forms of creep and relaxation, and what may never happen."""

import numpy as np
import pytest

import halfspace
from halfspace import reference as ref

E0, E1, NU, TAU = 3e4, 1e4, 0.4, 0.7
CREEP = E0 / E1 - 1
GROUND = halfspace.HalfSpace(E0, NU, coupling="point")
RELAXED = halfspace.HalfSpace(E1, NU, coupling="point")
RADIUS = 0.01


@pytest.fixture
def rng():
    return np.random.default_rng(2)


@pytest.fixture
def soil():
    return halfspace.Viscoelastic(GROUND, E1, TAU)


def layout(rng, n=9):
    side = np.arange(3)
    x = RADIUS * 1.5 * np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    return x[:n] + 0.1 * RADIUS * rng.random((n, 2)), 0.02 * RADIUS * (1 + 0.3 * rng.random(n))


@pytest.mark.parametrize("ground", [
    GROUND,
    halfspace.HalfSpace(E0, NU, layer=halfspace.Layer(RADIUS)),
    halfspace.HalfSpace(E0, NU, period=(0.1, 0.1)),
])  # fmt: skip
def test_creep_under_a_constant_load_is_exact_at_any_step(rng, ground):
    soil = halfspace.Viscoelastic(ground, E1, TAU)
    x, _ = layout(rng)
    f = rng.random(9)
    elastic, slope = ground.displacement(x, f)
    time = 0.0
    assert soil.displacement(x, f)[0] == pytest.approx(elastic, rel=1e-14)
    for dt in TAU * np.array([1e-6, 0.3, 1e-3, 2.0, 0.0, 5.0, 40.0]):
        soil.advance(dt, f)
        time += dt
        grown = 1 + CREEP * (1 - np.exp(-time / TAU))
        w, steep = soil.displacement(x, f)
        assert w == pytest.approx(grown * elastic, rel=1e-12)
        assert steep == pytest.approx(grown * slope, rel=1e-12, abs=1e-13 * np.abs(slope).max())
    relaxed = halfspace.HalfSpace(E1, NU, period=ground.period, layer=ground.layer)
    assert w == pytest.approx(relaxed.displacement(x, f)[0], rel=1e-12)
    points = 0.05 + 0.01 * rng.random((3, 2))
    assert soil.field(x, f, points) == pytest.approx(relaxed.field(x, f, points), rel=1e-12)


def test_creep_after_a_load_is_taken_off(soil, rng):
    x, _ = layout(rng)
    f = rng.random(9)
    soil.advance(0.5 * TAU, f)
    soil.advance(0.8 * TAU, np.zeros(9))
    expected = CREEP * (1 - np.exp(-0.5)) * np.exp(-0.8) * GROUND.displacement(x, f)[0]
    assert soil.displacement(x, np.zeros(9))[0] == pytest.approx(expected, rel=1e-13)
    soil.advance(1e3 * TAU, np.zeros(9))
    assert not soil.displacement(x, np.zeros(9))[0].any()


def test_relaxation_at_a_constant_overlap():
    """f = k d (1 + c exp(-(1 + c) t/tau))/(1 + c); the error of a step that holds its force is of
    first order."""
    stiffness, overlap, end = 50.0, 1e-3, 0.6 * TAU

    def force(steps):
        soil = halfspace.Viscoelastic(GROUND, E1, TAU)
        for _ in range(steps):
            state = soil.solve(
                [[0.0, 0.0]],
                [overlap],
                lambda d: (stiffness * d, np.full(1, stiffness)),
                end / steps,
                residual=1e-13,
            )
            soil.advance(end / steps, state.force)
        return state.force[0]

    exact = stiffness * overlap / (1 + CREEP) * (1 + CREEP * np.exp(-(1 + CREEP) * end / TAU))
    steps = np.array([20, 40, 80])
    errors = [abs(force(n) - exact) for n in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(-1, abs=0.05)
    assert errors[-1] < 5e-3 * exact


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_short_and_long_times(soil, rng, share):
    """At once the instantaneous ground, long after the relaxed one, elastic both."""
    x, overlap = layout(rng)
    other = GROUND.modulus * share / (1 - share) if share < 1 else np.inf  # of the spheres

    def law_on(ground):
        return ref.hertz_law(RADIUS, 1 / (1 / ground.modulus + 1 / other))

    law = law_on(GROUND)
    for ground, dt in ((GROUND, 0.0), (RELAXED, 60 * TAU)):
        expected = halfspace.solve(ground, x, overlap, law_on(ground), residual=1e-12)
        state = soil.solve(x, overlap, law, dt, share=share, residual=1e-12)
        assert state.force == pytest.approx(expected.force, rel=1e-9)
        assert state.displacement == pytest.approx(expected.displacement, rel=1e-9)
        assert state.slope == pytest.approx(expected.slope, rel=1e-8, abs=1e-14)
        assert state.tangent == pytest.approx(expected.tangent, rel=1e-9)
    for _ in range(400):
        state = soil.solve(x, overlap, law, 0.1 * TAU, share=share, residual=1e-12)
        soil.advance(0.1 * TAU, state.force)
    assert state.force == pytest.approx(expected.force, rel=1e-9)
    assert soil.memory(np.arange(9)) == pytest.approx(state.force, rel=1e-9)


def test_what_is_returned_belongs_together(soil, rng):
    """At the step's end d + C (f + c s) = delta, and the law holds from d to f + c s; where the
    memory alone keeps the surface down, there is no force."""
    x, overlap = layout(rng)
    law = ref.hertz_law(RADIUS, GROUND.modulus)
    soil.advance(TAU, 0.02 * rng.random(9))
    state = soil.solve(x, overlap, law, 0.4 * TAU, residual=1e-12)
    soil.advance(0.4 * TAU, state.force)
    w, slope = soil.displacement(x, state.force)
    assert state.displacement == pytest.approx(w, rel=1e-12)
    assert state.slope == pytest.approx(slope, rel=1e-11, abs=1e-15)
    assert state.overlap + w == pytest.approx(overlap, abs=1e-11 * overlap.max())
    acting = state.force + CREEP * soil.memory(np.arange(9))
    elastic, closed = law(np.maximum(state.overlap, 0))[0], state.force > 0
    assert elastic[closed] == pytest.approx(acting[closed], rel=1e-12)
    assert 0 < closed.sum() < 9 and (elastic <= acting)[~closed].all()


def test_a_sphere_drawn_back_leaves_a_dent_that_recovers(soil):
    law = ref.hertz_law(RADIUS, GROUND.modulus)
    x, deep = np.zeros((1, 2)), 0.04 * RADIUS
    for _ in range(20):
        soil.advance(TAU, soil.solve(x, [deep], law, TAU).force)
    held = soil.memory([0])[0]
    dent = (CREEP * held / law(np.array(1.0))[0]) ** (2 / 3)
    lifted = np.array([0.9 * dent])
    state = soil.solve(x, lifted, law, 0.0)
    assert state.force[0] == 0 and state.overlap[0] == lifted[0]
    for _ in range(20):
        soil.advance(TAU, soil.solve(x, lifted, law, TAU).force)
    expected = ref.hertz_law(RADIUS, RELAXED.modulus)(lifted)[0]
    assert soil.memory([0]) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_dissipation_is_never_negative(seed):
    """Work done less energy stored, for any history, with the contacts' own linear compliance.

    At a jump of the force the work is that of the instantaneous springs; in between the force is
    constant. Stored are f.A f/2 in these and c s.A s/2 in the delayed ones.
    """
    rng = np.random.default_rng(seed)
    soil = halfspace.Viscoelastic(GROUND, E1, TAU)
    x, _ = layout(rng)
    stiffness = 1.0 * GROUND.modulus * RADIUS * rng.uniform(0.05, 0.2, 9)
    whole = GROUND.matrix(x) + np.diag(1 / stiffness)
    assert np.linalg.eigvalsh(whole)[0] > 0
    f, s, work, lost = np.zeros(9), np.zeros(9), 0.0, [0.0]
    for _ in range(60):
        dt = TAU * 10 ** rng.uniform(-2, 1)
        overlap = 1e-3 * rng.uniform(-0.5, 1, 9)
        state = soil.solve(x, overlap, lambda d: (stiffness * d, stiffness), dt, residual=1e-10)
        soil.advance(dt, state.force)
        now, then = soil.memory(np.arange(9)), s
        work += (f + state.force) @ whole @ (state.force - f) / 2
        work += CREEP * state.force @ whole @ (now - then)
        f, s = state.force, now
        lost.append(work - (f @ whole @ f + CREEP * s @ whole @ s) / 2)
    assert np.diff(lost).min() >= -1e-14 * work
    assert lost[-1] > 0.01 * work


def test_loss_of_a_steady_cycle():
    """pi f0^2 K c w tau/(1 + w^2 tau^2) per cycle of f = f0 sin(w t); the step's error is of second
    order."""
    x, compliance = [[0.0, 0.0], [0.01, 0.0]], 1 / (np.pi * GROUND.modulus * 0.01)
    omega, cycles = 1.3 / TAU, 8

    def loss(steps):
        soil = halfspace.Viscoelastic(GROUND, E1, TAU)
        dt = 2 * np.pi / omega / steps
        work = 0.0
        for k in range(cycles * steps):
            f = np.sin(omega * (k + 0.5) * dt) * np.array([1.0, 0.0])
            before = soil.displacement(x, f, [4, 7])[0][1]
            soil.advance(dt, f, [4, 7])
            if k >= (cycles - 1) * steps:
                work += f[0] * (soil.displacement(x, f, [4, 7])[0][1] - before)
        return work

    exact = np.pi * compliance * CREEP * omega * TAU / (1 + (omega * TAU) ** 2)
    errors = [abs(loss(n) - exact) for n in (20, 40, 80)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.1)


def test_memory_follows_its_contact(soil, rng):
    f = rng.random(4)
    soil.advance(TAU, f, [3, 9, 1, 5])
    soil.advance(0.5 * TAU, [1.0, 2.0], [9, 2])
    grown, left = 1 - np.exp(-1), np.exp(-0.5)
    expected = [1 + (f[1] * grown - 1) * left, 2 * (1 - left), f[0] * grown * left, 0.0]
    assert soil.memory([9, 2, 3, 8]) == pytest.approx(expected, rel=1e-14)
    soil.advance(100 * TAU, [1.0], [2])
    assert soil.save()["ids"].tolist() == [2]
    assert not halfspace.Viscoelastic(GROUND, E1, TAU).memory([1, 2]).any()


def test_saved_and_restored_it_goes_on_the_same(soil, rng):
    x, overlap = layout(rng)
    law = ref.hertz_law(RADIUS, GROUND.modulus)

    def go_on(ground):
        for k in range(3):
            state = ground.solve(x, overlap * (1 + 0.1 * k), law, 0.2 * TAU)
            ground.advance(0.2 * TAU, state.force)
        return state.force

    go_on(soil)
    again = halfspace.Viscoelastic(GROUND, E1, TAU)
    again.restore(soil.save())
    assert np.array_equal(go_on(soil), go_on(again))


def test_without_creep_it_is_elastic(rng):
    x, overlap = layout(rng)
    law = ref.hertz_law(RADIUS, GROUND.modulus)
    soil = halfspace.Viscoelastic(GROUND, E0, TAU)
    soil.advance(TAU, rng.random(9))
    elastic = halfspace.solve(GROUND, x, overlap, law)
    assert np.array_equal(soil.solve(x, overlap, law, TAU).force, elastic.force)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((2 * E0, TAU), r"relaxed_modulus = 60000.0: must be a number > 0 and <= 30000.0 Pa"),
        ((0.0, TAU), r"relaxed_modulus = 0.0: must be"),
        ((E1, 0.0), r"retardation_time = 0.0: must be a number > 0 s"),
    ],
)
def test_refused_substrates(arguments, words):
    with pytest.raises(ValueError, match=words):
        halfspace.Viscoelastic(GROUND, *arguments)


def test_refused_steps(soil):
    with pytest.raises(ValueError, match=r"dt = -1.0: must be a number >= 0 s"):
        soil.advance(-1.0, [1.0])
    with pytest.raises(ValueError, match=r"f has shape \(1,\): must be \(2,\)"):
        soil.advance(1.0, [1.0], [1, 2])
    with pytest.raises(ValueError, match="ids: must name each contact once"):
        soil.advance(1.0, [1.0, 1.0], [1, 1])
    with pytest.raises(ValueError, match=r"ids of shape \(1,\) and type float64"):
        soil.memory([1.5])
