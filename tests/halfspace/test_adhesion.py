"""Laws that pull and soften: solved where there is an equilibrium, refused where there is none."""

import numpy as np
import pytest

import halfspace
from halfspace import reference as ref

RADIUS, MODULUS, WORK = 1.0, 1.0, 1e-3
GROUND = halfspace.HalfSpace(MODULUS, 0.0)
OPENING, _ = ref.jkr_opening(RADIUS, MODULUS, WORK)
PULL_OFF = ref.jkr_pull_off_force(RADIUS, WORK)
HERTZ = ref.hertz_law(RADIUS, MODULUS)


def jkr(overlap):
    """The branch of a contact that has been made, by Newton's method for its radius."""
    a = np.full(overlap.shape, 0.9)
    for _ in range(60):
        root = np.sqrt(2 * np.pi * WORK * a / MODULUS)
        a = a - (a**2 / RADIUS - root - overlap) / (2 * a / RADIUS - 0.5 * root / a)
    force = ref.jkr_force(a, RADIUS, MODULUS, WORK)
    root = np.sqrt(8 * np.pi * WORK * MODULUS * a**3)
    rise = 4 * MODULUS * a**2 / RADIUS - 1.5 * root / a
    with np.errstate(divide="ignore"):
        tangent = rise / (2 * a / RADIUS - 0.5 * np.sqrt(2 * np.pi * WORK / (MODULUS * a)))
    return force, np.maximum(tangent, -1e12)


def square(side, spacing):
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    return spacing * cells.astype(float)


def solve(overlap, side=3, spacing=1.0, **more):
    x = square(side, spacing)
    return halfspace.solve(
        GROUND, x, np.full(side**2, overlap), jkr, radius=RADIUS, modulus=MODULUS,
        opening=0.999 * OPENING, **more,
    )  # fmt: skip


def test_the_law_is_jkr():
    force, tangent = jkr(np.array([0.05, 0.0, 0.9 * OPENING]))
    h = 1e-7
    for k, d in enumerate((0.05, 0.0, 0.9 * OPENING)):
        ahead, behind = jkr(np.array([d + h]))[0], jkr(np.array([d - h]))[0]
        assert tangent[k] == pytest.approx((ahead - behind)[0] / (2 * h), rel=1e-4)
    assert force[1] == pytest.approx(-8 / 9 * PULL_OFF, rel=1e-9)  # at zero overlap
    assert tangent[2] < 0


@pytest.mark.parametrize("overlap", [0.06, 0.02, 0.0, -0.005])
def test_contacts_that_adhere(overlap):
    state = solve(overlap, residual=1e-10)
    x = square(3, 1.0)
    w, slope = GROUND.displacement(x + state.shift, state.force, state.contact_radius)
    lost = (state.shift**2).sum(axis=1) / (2 * RADIUS)
    assert state.overlap == pytest.approx(overlap - w - lost, abs=1e-11)
    assert state.shift == pytest.approx(RADIUS * slope, abs=1e-6)
    assert state.force == pytest.approx(jkr(state.overlap)[0], rel=1e-12)
    pulling = state.force < 0
    assert not state.contact_radius[pulling].any()
    # Where all pull, the surface rises, and leans towards the middle.
    if pulling.all():
        assert (state.displacement < 0).all() and state.slope[0, 0] > 0
    assert np.ptp(state.force[[0, 2, 6, 8]]) < 1e-9 * np.abs(state.force).max()


def test_pulled_off_slowly():
    """Level by level: they lift the surface, hold beyond what one alone can, soften, and are found
    in equilibrium until they come off, all at once; then they stay off."""
    state, held, softened = None, 0.0, 0
    for level in np.arange(0.0, 1.6, 0.04):
        start = None if state is None else state.overlap
        before, state = state, solve(level * OPENING, residual=1e-8, start=start)
        if not state.force.any():
            assert before is not None
            break
        assert state.force.min() > -PULL_OFF * (1 + 1e-9) and (state.force < 0).all()
        held, softened = level, max(softened, state.softening)
    assert softened == 9 and 1.25 < held < 1.4
    assert before.overlap.min() > OPENING
    after = solve((held + 0.1) * OPENING, start=state.overlap)
    assert not after.force.any()


def test_snap_in():
    """Made or not made: two equilibria at one level, told apart by the opening."""
    x, level = square(2, 1.0), np.full(4, 0.3 * OPENING)
    apart = halfspace.solve(GROUND, x, level, jkr, radius=RADIUS)
    made = halfspace.solve(GROUND, x, level, jkr, radius=RADIUS, opening=OPENING)
    assert not apart.force.any() and (made.force < -0.5 * PULL_OFF).all()
    some = np.array([OPENING, 0.0, 0.0, 0.0])
    first = halfspace.solve(GROUND, x, level, jkr, radius=RADIUS, opening=some)
    assert first.force[0] < 0 and not first.force[1:].any()


@pytest.mark.parametrize("spacing", [1.0, 2.0, 5.0])
def test_softening_laws(spacing):
    """A force that falls again with the overlap: solved, and the softening counted."""

    def law(d):
        return 0.2 * d * np.exp(-((d / 0.05) ** 2)), 0.2 * (1 - 2 * (d / 0.05) ** 2) * np.exp(
            -((d / 0.05) ** 2)
        )

    x, overlap = square(4, spacing), np.full(16, 0.06)
    state = halfspace.solve(GROUND, x, overlap, law, residual=1e-10, radius=RADIUS)
    assert state.softening == 16 and (state.force > 0).all()
    w = GROUND.displacement(x + state.shift, state.force, state.contact_radius)[0]
    lost = (state.shift**2).sum(axis=1) / (2 * RADIUS)
    assert state.overlap == pytest.approx(overlap - w - lost, abs=1e-10)


def test_no_equilibrium():
    """A contact lifted by its own images, of a law that jumps down: where the law holds more it is
    lifted beyond the jump, and where it holds less it falls back."""

    def law(d):
        stiff = np.where(d < 0.05, 1.0, 0.1)
        return stiff * d, stiff

    cell = halfspace.HalfSpace(MODULUS, 0.0, period=(10.0, 10.0))
    for overlap, exists in ((0.04, True), (0.047, False), (0.055, True)):
        if exists:
            assert halfspace.solve(cell, [[0, 0]], [overlap], law).converged
            continue
        words = r"reached .* after 50 iterations.* there is no equilibrium close to it"
        with pytest.raises(halfspace.NotConverged, match=words) as no:
            halfspace.solve(cell, [[0, 0]], [overlap], law, radius=RADIUS)
        assert 1e-6 < no.value.state.residual < 1 and not no.value.state.converged


@pytest.mark.parametrize("overlap", [0.05, 0.12, 0.15])
def test_a_law_that_softens_faster_than_the_surface_gives(overlap):
    """`f = 0.3 (0.2 - d)` while it touches: two equal contacts are at rest at
    `d = (delta - 0.06 c)/(1 - 0.3 c)`, c what one does to the other, if that is above zero."""

    def law(d):
        return 0.3 * np.maximum(0.2 - d, 0.0), np.where(d < 0.2, -0.3, 0.0)

    points = halfspace.HalfSpace(MODULUS, 0.0, coupling="point")
    x, both, c = [[0, 0], [0.2, 0]], [overlap, overlap], 1 / (0.2 * np.pi)
    expected = (overlap - 0.06 * c) / (1 - 0.3 * c)
    if expected > 0:
        state = halfspace.solve(points, x, both, law, residual=1e-10)
        assert state.overlap == pytest.approx([expected] * 2, rel=1e-8)
        assert state.softening == 2
        return
    with pytest.raises(halfspace.NotConverged, match=r"no equilibrium close .* softens at 2") as no:
        halfspace.solve(points, x, both, law)
    assert 0 < no.value.state.residual < 1 and not no.value.state.converged
