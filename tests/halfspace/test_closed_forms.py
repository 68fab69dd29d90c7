"""The closed forms against the published values, and against independent quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erfc

from halfspace import greens
from halfspace import reference as ref


def test_hertz_duration_constant():
    def integrand(t):  # x = 1 - t^2 takes the square-root singularity at the end away
        return 4.0 * t / np.sqrt(1.0 - (1.0 - t * t) ** 2.5)

    value, _ = quad(integrand, 0, 1)
    constant = ref.HERTZ_DURATION
    assert constant == pytest.approx(value, rel=1e-9)
    assert constant == pytest.approx(2.943, abs=5e-4)


@pytest.mark.parametrize(
    ("impact", "sphere", "overlap", "force", "duration"),
    [
        (ref.equal_spheres_impact, ref.GLASS, 274.11e-6, 10.697e3, 40.336e-6),
        (ref.equal_spheres_impact, ref.LIMESTONE, 368.30e-6, 7.1082e3, 54.196e-6),
        (ref.rigid_plane_impact, ref.ALUMINIUM, 49.717e-6, 11.370e3, 731.59e-6),
        (ref.rigid_plane_impact, ref.MAGNESIUM, 52.123e-6, 7.2327e3, 766.99e-6),
    ],
)
def test_chung_ooi_impacts(impact, sphere, overlap, force, duration):
    result = impact(sphere)
    # Five digits: half a unit of the last. The table's durations are 2.943 overlap/speed.
    assert result.overlap == pytest.approx(overlap, rel=2e-5)
    assert result.force == pytest.approx(force, rel=5e-5)
    assert result.duration * 2.943 / ref.HERTZ_DURATION == pytest.approx(duration, rel=2e-5)


def test_impact_conserves_energy():
    impact = ref.hertz_impact(mass=0.3, radius=0.02, modulus=1e7, speed=1.5)
    assert 0.4 * impact.force * impact.overlap == pytest.approx(0.5 * 0.3 * 1.5**2, rel=1e-12)


def test_hertz_relations():
    radius, modulus, overlap = 0.01, 3e6, 2e-4
    force = ref.hertz_stiffness(radius, modulus) * overlap**1.5
    assert ref.hertz_overlap(force, radius, modulus) == pytest.approx(overlap, rel=1e-12)
    a = ref.hertz_contact_radius(force, radius, modulus)
    assert a == pytest.approx(np.sqrt(radius * overlap), rel=1e-12)
    law_force, tangent = ref.hertz_law(radius, modulus)(np.array([overlap, 0.0, -overlap]))
    assert law_force == pytest.approx([force, 0.0, 0.0], rel=1e-12)
    assert tangent == pytest.approx([2 * modulus * a, 0.0, 0.0], rel=1e-12)


def test_hertz_surface():
    a, radius = 0.3, 2.0
    inside = np.linspace(0, a, 7)
    assert ref.hertz_surface(inside, a, radius) == pytest.approx(
        a**2 / radius - inside**2 / (2 * radius), rel=1e-13
    )
    r = np.linspace(1.001, 3, 9) * a
    outside = ((2 * a**2 - r**2) * np.arcsin(a / r) + a * np.sqrt(r**2 - a**2)) / (np.pi * radius)
    assert ref.hertz_surface(r, a, radius) == pytest.approx(outside, rel=1e-12)
    assert ref.hertz_surface(a, a, radius) == pytest.approx(a**2 / (2 * radius), rel=1e-13)
    force = 4 * a**3 / (3 * radius)
    assert ref.hertz_surface(1e7 * a, a, radius) == pytest.approx(
        force / (np.pi * 1e7 * a), rel=1e-13
    )


def test_hertz_field_is_the_point_kernel_over_hertz_pressure():
    """Quadrature in rings about the contact: the mean of 1/r over a ring is 2K(m)/(pi (r + s))."""
    from scipy.special import ellipk

    a = 0.7

    def ring(s, r):
        m = 4 * r * s / (r + s) ** 2
        kernel = 2 * ellipk(m) / (np.pi * (r + s)) / np.pi
        return 3 / (2 * np.pi * a**2) * np.sqrt(1 - (s / a) ** 2) * 2 * np.pi * s * kernel

    for r in (0.0, 0.3 * a, 1.2 * a, 3 * a):
        value, _ = quad(ring, 0, a, args=(r,), points=[r] if 0 < r < a else None, limit=200)
        assert greens.hertz(r, a, 1.0) == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize(("a", "b"), [(1.0, 1.0), (1.0, 0.4), (0.4, 1.0)])
def test_concentric_hertz_pressures(a, b):
    weighted, _ = quad(lambda s: np.sqrt(b**2 - s**2) * s * greens.hertz(s, a, 2.0), 0, b)
    value = greens.hertz_concentric(a, b, 2.0)
    assert value == pytest.approx(weighted / (b**3 / 3), rel=1e-7)
    assert value == greens.hertz_concentric(b, a, 2.0)


def test_concentric_limits():
    assert greens.hertz_concentric(0.5, 0.0, 2.0) == greens.hertz(0.0, 0.5, 2.0)
    assert greens.hertz_concentric(0.0, 0.0, 2.0) == 0.0


def test_flat_punch():
    assert ref.flat_punch_force(0.5, 0.1, 3.0) == pytest.approx(2 * 0.5 * 3.0 * 0.1)


def test_uniform_disc():
    a, pressure, modulus = 0.4, 3.0, 7.0
    centre, edge = ref.uniform_disc(np.array([0.0, a]), a, pressure, modulus)
    assert centre == pytest.approx(2 * pressure * a / modulus, rel=1e-14)
    assert edge == pytest.approx(4 * pressure * a / (np.pi * modulus), rel=1e-14)
    beyond = ref.uniform_disc(np.array([a * (1 + 1e-9)]), a, pressure, modulus)
    assert beyond == pytest.approx(edge, rel=1e-7)
    far = 1e3 * a
    force = np.pi * a**2 * pressure
    assert ref.uniform_disc(far, a, pressure, modulus) == pytest.approx(
        force / (np.pi * modulus * far), rel=1e-6
    )


def test_westergaard():
    """A wave of pressure that full contact needs has the amplitude of the surface it flattens."""
    h, wavelength, modulus = 1e-5, 2e-3, 4e6
    p = ref.wavy_full_contact_pressure(h, wavelength, modulus)
    assert p == pytest.approx(np.pi * modulus * h / wavelength)
    assert ref.sinusoidal_depression(p, 2 * np.pi / wavelength, modulus) == pytest.approx(h)


@pytest.mark.parametrize(
    ("separation", "depth", "share"),
    [(2, 0.01, 0.969), (2, 0.05, 0.934), (4, 0.01, 0.984), (4, 0.05, 0.966)],
)
def test_two_rigid_spheres(separation, depth, share):
    radius, modulus = 0.02, 5e5
    force = ref.two_spheres(depth * radius, separation * radius, radius, modulus)
    alone = ref.hertz_stiffness(radius, modulus) * (depth * radius) ** 1.5
    assert force / alone == pytest.approx(share, abs=5e-4)
    left = depth * radius - force / (np.pi * modulus * separation * radius)
    assert force == pytest.approx(ref.hertz_stiffness(radius, modulus) * left**1.5, rel=1e-12)


def test_two_spheres_out_of_touch():
    assert ref.two_spheres(-1e-3, 1.0, 1.0, 1.0) == 0.0


def test_square_lattice_constant():
    """Ewald's sum with the width at which real and reciprocal space give the same terms."""
    i = np.arange(-8, 9)
    r = np.hypot(*np.meshgrid(i, i))
    r = r[r > 0]
    ewald = 2 * np.sum(erfc(np.sqrt(np.pi) * r) / r) - 4
    constant = ref.SQUARE_LATTICE
    assert constant == pytest.approx(ewald, rel=1e-14)
    assert constant == pytest.approx(-3.9002649200, abs=5e-11)


def test_stick_radius():
    c = ref.stick_radius(0.2, [0.0, 0.5, 1.0, 2.0], 4.0, 0.25)
    assert c == pytest.approx([0.2, 0.2 * 0.5 ** (1 / 3), 0.0, 0.0])


def test_jkr():
    radius, modulus, work = 0.01, 1e5, 0.05
    pull_off = ref.jkr_pull_off_force(radius, work)
    a0 = ref.jkr_zero_load_radius(radius, modulus, work)
    assert ref.jkr_force(a0, radius, modulus, work) == pytest.approx(0, abs=1e-12 * pull_off)
    a = np.linspace(0.3, 1.5, 200001) * a0
    assert ref.jkr_force(a, radius, modulus, work).min() == pytest.approx(-pull_off, rel=1e-9)
    overlap = ref.jkr_overlap(a, radius, modulus, work)
    least = overlap.argmin()
    opening, force = ref.jkr_opening(radius, modulus, work)
    assert overlap[least] == pytest.approx(opening, rel=1e-9)
    assert force == pytest.approx(-5 / 9 * pull_off)
    assert ref.jkr_force(a[least], radius, modulus, work) == pytest.approx(force, rel=1e-4)


def test_restitution():
    e = np.linspace(0.2, 1.0, 5)
    assert ref.rebound_speed(3.0, e) == pytest.approx(3.0 * e)


def test_oblique_impact_obeys_newton():
    """A sliding impact: impulse m(1+e)v_n along the normal, mu times that along the surface."""
    sphere, friction, e, speed = ref.ALUMINA, 0.092, 0.98, 3.9
    angle = np.radians([40.0, 60.0, 80.0])
    result = ref.oblique_impact(angle, sphere.radius, speed, friction, e)
    impulse = sphere.mass * (1 + e) * speed * np.cos(angle)
    after = speed * np.sin(angle) - friction * impulse / sphere.mass
    assert result.tangential_restitution == pytest.approx(after / (speed * np.sin(angle)))
    inertia = 0.4 * sphere.mass * sphere.radius**2
    assert result.spin == pytest.approx(friction * impulse * sphere.radius / inertia)
    assert np.all(after > result.spin * sphere.radius)


def test_slip_to_roll_obeys_newton():
    speed, time = ref.slip_to_roll(2.0, 0.3, 9.81)
    assert 2.0 - 0.3 * 9.81 * time == pytest.approx(speed)
    assert 2.5 * 0.3 * 9.81 * time == pytest.approx(speed)
    assert speed == pytest.approx(10 / 7)
