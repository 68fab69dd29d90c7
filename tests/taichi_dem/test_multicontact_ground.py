"""Multi-contact on an elastic substrate: spheres and ground that both rise, solved together."""

import numpy as np
import pytest
from multicontact_ground_twin import equilibrium
from multicontact_twin import Bodies, contacts
from scipy.optimize import root
from setups import order_of, restart, rigid, scene, watch
from test_determinism import same_lines

import halfspace
import taichi_dem as dem
from halfspace import reference
from taichi_dem import exchange as exchange_module

pytestmark = pytest.mark.filterwarnings("ignore:a contact with the substrate is wider")

R = 5e-3
BEAD = dem.Material("bead", density=1000, youngs_modulus=1e5, poissons_ratio=0.3)
SOIL = dem.Material("soil", density=1000, youngs_modulus=8e4, poissons_ratio=0.45)
STILL = 1e-12  # s, a step in which nothing moves
TIGHT = 1e-13


def pile(seed=1, overlap=0.03):
    """Seven spheres on the ground and three above, pressed on each other: places and velocities."""
    rng = np.random.default_rng(seed)
    angle = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    angle = np.pi / 6 + np.arange(3) * 2 * np.pi / 3
    top = np.stack([np.cos(angle), np.sin(angle), np.sqrt(2) + 0 * angle], axis=1) / np.sqrt(3)
    place = 2 * R * (1 - overlap) * np.vstack([np.zeros(3), ring, top])
    place += 0.01 * R * rng.uniform(-1, 1, place.shape)
    place[:, 2] += 0.97 * R
    return place, 0.02 * rng.normal(size=place.shape)


def on_ground(surface=None, ground=None, place=None, soil=SOIL, kind=BEAD, **rest):
    surface = dem.MultiContact(residual=1e-11) if surface is None else surface
    ground = {"residual": TIGHT, **(ground or {})}
    rest.setdefault("law", dem.Law(dem.Hertz(1.0), surface=surface))
    place = pile()[0] if place is None else place
    return scene(place, R, kind, substrate=dem.Substrate(soil, **ground), **rest)


@pytest.fixture(scope="module")
def heap():
    """A pile on ground that gives by contacts of finite size, without friction or loss."""
    return dem.Simulation(on_ground(), dt=2e-5, driver="serial")


def assert_equal_to_the_twin(sim, place, finite=True, symmetric=True, close=1e-8):
    bodies = Bodies(np.full(len(place), R), BEAD.youngs_modulus, BEAD.poissons_ratio, GROUND)
    met = contacts(place, bodies, 0.01 * R)
    found = equilibrium(met, bodies, place, SOIL, finite, symmetric)
    force, effective, raised, sunk, held = found
    touches = effective > 0
    rows = {(row["i"], max(row["j"], -1)): row for row in sim.contacts()}
    expected = {frozenset(pair): k for k, pair in enumerate(zip(met.i, met.j, strict=True))}
    assert len(rows) == touches.sum()
    for pair, row in rows.items():
        k = expected[frozenset(pair)]
        assert row["normal_force"] == pytest.approx(force[k], abs=close * force.max())
        assert row["overlap"] == pytest.approx(effective[k], abs=close * effective.max())
    ground = met.j < 0
    assert np.count_nonzero(touches & ground) > 4 and np.count_nonzero(touches & ~ground) > 10
    kept = sim.substrate
    assert kept.expansion == pytest.approx(-sunk[kept.particle], abs=close * effective.max())
    if not symmetric:  # as LIGGGHTS has it: no energy belongs to that
        return
    stored = {"normal": 0.4 * force @ np.maximum(effective, 0), "substrate": held}
    stored["expansion"] = -0.5 * force @ raised @ force
    parts = sim.energy()
    for name, energy in stored.items():
        assert parts[name] == pytest.approx(energy, abs=10 * close * stored["normal"]), name
    assert abs(held) > 1e-3 * stored["normal"]
    assert abs(stored["expansion"]) > 1e-3 * stored["normal"]


GROUND = (((0, 0, 0), (0.0, 0.0, 1.0)),)


def test_forces_are_those_of_the_twin(heap):
    """Solved all at once from the published equations, by other means."""
    for seed in (1, 2):
        place = pile(seed)[0]
        restart(heap, place, dt=STILL)
        assert_equal_to_the_twin(heap, place)


def test_energy_is_conserved_to_the_order_of_the_scheme(heap):
    """A pile that falls apart and bounces on ground that gives, under its weight."""
    place, velocity = pile(overlap=0.02)
    largest, steps = [], 250
    for refined in range(3):
        restart(heap, place, velocity, dt=0.02 / steps)
        parts = watch(heap, steps, steps // 50, lambda sim: list(sim.energy().values()))
        names = list(heap.energy())
        largest.append(np.abs(parts[:, names.index("balance_error")]).max())
        steps *= 2
        assert refined < 2 or largest[-1] < 1e-3 * parts[:, names.index("normal")].max()
    assert np.all(order_of(largest) > 1.9)


def test_force_is_the_slope_of_the_energy(heap):
    """By central differences along random ways of all spheres."""
    place, step, rng = pile()[0], 1e-4 * R, np.random.default_rng(3)
    restart(heap, place)
    force = heap.particles.force - heap.particles.mass[:, None] * heap.scene.gravity
    for _ in range(2):
        way, held = rng.normal(size=place.shape), []
        for sign in (1, -1):
            restart(heap, place + sign * step * way)
            parts = heap.energy()
            held.append(parts["normal"] + parts["expansion"] + parts["substrate"])
        slope = (held[0] - held[1]) / (2 * step)
        assert -np.sum(force * way) == pytest.approx(slope, abs=1e-5 * np.abs(force * way).sum())


def test_spheres_that_are_pressed_only_by_the_ground_do_not_bulge(heap):
    """Without other contacts it is the coupled ground alone."""
    places = np.array([(2.4 * R * k, 0.3 * R * (k % 2)) for k in range(10)])
    height = R * (1 - 0.02 - 0.001 * np.arange(10))
    restart(heap, np.column_stack([places, height]))
    modulus = 1 / sum((1 - m.poissons_ratio**2) / m.youngs_modulus for m in (BEAD, SOIL))
    ground = halfspace.HalfSpace(SOIL.youngs_modulus, SOIL.poissons_ratio, coupling="finite")
    hertz = reference.hertz_law(R, modulus)
    exact = halfspace.solve(
        ground, places, R - height, hertz, residual=1e-13, radius=np.full(10, R), modulus=modulus
    )
    np.testing.assert_allclose(heap.substrate.force, exact.force, rtol=1e-9)
    assert heap.energy()["expansion"] == 0


def test_columns_of_two(heap):
    """Each lower sphere is pressed from above and from below, and beside the other column: three
    equations for the two overlaps and the point of contact."""
    s, above, below = 2.5 * R, 0.05 * R, 0.06 * R
    place = np.outer(np.arange(10) + 5, (0.0, 0.0, 3 * R))  # the others are out of reach
    for k, x in enumerate((-s / 2, s / 2)):
        place[2 * k] = x, 0, R - below
        place[2 * k + 1] = x, 0, 3 * R - below - above
    restart(heap, place, dt=STILL)
    bead = (1 - BEAD.poissons_ratio**2) / BEAD.youngs_modulus
    soil = (1 - SOIL.poissons_ratio**2) / SOIL.youngs_modulus
    nu, distance = BEAD.poissons_ratio, 1 / np.mean([1 / (R - above / 2), 1 / (R - below / 2)])
    bulge = 1.125 * (1 + nu) * (3 - 2 * nu) / (4 * np.pi * BEAD.youngs_modulus * distance)

    def forces(top, bottom):
        return (
            4 / 3 / (2 * bead) * np.sqrt(R / 2) * top**1.5,
            4 / 3 / (bead + soil) * np.sqrt(R) * bottom**1.5,
        )

    def wrong(unknown):
        top, bottom, shift = R * np.array(unknown)
        one, other = forces(top, bottom)
        square = np.cbrt(0.75 * other * R * (bead + soil)) ** 2
        r, unit = s + 2 * shift, soil / np.pi
        sunk = unit * other * (1 / r + (1 / 10 + 1 / 6) * square / r**3) + shift**2 / (2 * R)
        fall = unit * other * (1 / r**2 + 0.6 * square / r**4)  # and c = R grad(-w)
        return (
            (top - above - bulge * other) / R,
            (bottom - below - bulge * one + sunk) / R,
            shift / R - fall,
        )

    found = root(wrong, (0.05, 0.05, 0.0), options={"xtol": 1e-14}).x * R
    assert found[2] > 5e-4 * R  # each is tilted outwards, up the dent of the other
    rows = heap.contacts()
    assert len(rows) == 4 and rows["expansion"].max() > 0.02 * below
    for row in rows:
        k = int(row["j"] < 0)
        assert row["overlap"] == pytest.approx(found[k], rel=1e-10)
        assert row["normal_force"] == pytest.approx(forces(*found[:2])[k], rel=1e-9)


# -- the lagged forms ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("ground", ["implicit", "lagged"])
def test_lagged_expansions_come_to_the_same_as_the_published_ones(ground):
    """At rest, where the step before is as this one; with points and with finite contacts."""
    finite = ground == "implicit"
    coupling = {"coupling": "finite" if finite else "point", "exchange": ground}
    surface = dem.MultiContact(exchange="lagged")
    sim = dem.Simulation(on_ground(surface, coupling), dt=STILL, driver="serial")
    sim.run(steps=80)
    assert_equal_to_the_twin(sim, sim.scene.spheres.position, finite, symmetric=False)


@pytest.mark.slow
def test_lagged_expansions_on_a_layer():
    """Through the host: a layer as thick as hundreds of spheres is the half-space."""
    surface, forces = dem.MultiContact(exchange="lagged"), []
    for layer in (None, dem.Layer(400 * R)):
        sim = dem.Simulation(on_ground(surface, {"layer": layer}), dt=STILL, driver="serial")
        sim.run(steps=40)
        forces.append(sim.substrate.force)
    np.testing.assert_allclose(forces[1], forces[0], rtol=3e-3)


# -- limits ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_points_as_in_the_twin():
    sim = dem.Simulation(on_ground(ground={"coupling": "point"}), dt=STILL, driver="serial")
    assert_equal_to_the_twin(sim, sim.scene.spheres.position, finite=False)


@pytest.mark.slow
def test_ground_that_is_stiff_enough_is_a_rigid_plane():
    stone = dem.Material("stone", 1000, 1e14, 0.3)
    found = []
    for exchange in ("implicit", "none"):
        sim = dem.Simulation(
            on_ground(ground={"exchange": exchange}, soil=stone), dt=1e-5, driver="serial"
        )
        sim.run(steps=200)
        found.append(sim.particles)
    close = 1e-7 * np.abs(found[1].velocity).max()
    np.testing.assert_allclose(found[0].velocity, found[1].velocity, atol=close)


@pytest.mark.slow
def test_what_has_no_equilibrium_stops_the_run():
    """Four walls that close in on a sphere on the ground, which they press up, too."""
    planes = [
        dem.Plane(tuple(-0.95 * R * n), tuple(n), rigid(), velocity=tuple(0.1 * n))
        for n in np.vstack([np.eye(3)[:2], -np.eye(3)[:2]])
    ]
    soft = dem.Material("soft", 1000, 1e5, 0.5)
    setup = on_ground(place=np.array([[0, 0, 0.9 * R]]), kind=soft, boundaries=planes)
    sim = dem.Simulation(setup, dt=1e-5, driver="serial", max_overlap=1)
    with pytest.raises(dem.SimulationStopped, match="no equilibrium"):
        sim.run(steps=1500)
    assert np.isfinite(sim.particles.force).all()


# -- through the host ------------------------------------------------------------------------------


@pytest.mark.slow
def test_more_contacts_than_the_kernel_solves(monkeypatch):
    monkeypatch.setattr(exchange_module, "IN_KERNEL_CONTACTS", 6)
    sim = dem.Simulation(on_ground(), dt=STILL, driver="serial")
    assert sim._engine.exchange.hosted
    assert_equal_to_the_twin(sim, sim.scene.spheres.position)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ground", "rest"),
    [({"layer": dem.Layer(4 * R)}, {}), ({}, {"period": (12 * R, 13 * R)})],
    ids=["layer", "periodic"],
)
def test_energy_is_conserved_through_the_host(ground, rest):
    place, velocity = pile(overlap=0.02)
    setup = on_ground(None, {"residual": 1e-10, **ground}, place, **rest)
    sim = dem.Simulation(setup, dt=2e-5, driver="serial")
    largest, steps = [], 50
    for _ in range(3):
        restart(sim, velocity=velocity, dt=0.01 / steps)
        parts = watch(sim, steps, steps // 50, lambda sim: list(sim.energy().values()))
        names = list(sim.energy())
        largest.append(np.abs(parts[:, names.index("balance_error")]).max())
        steps *= 2
    assert np.abs(parts[:, names.index("expansion")]).max() > 10 * largest[-1]
    assert np.abs(parts[:, names.index("substrate")]).max() > 10 * largest[-1]
    assert np.all(order_of(largest) > 1.8)


# -- drivers ---------------------------------------------------------------------------------------

SCRIPT = """
import test_determinism
import test_multicontact_ground as test
import taichi_dem as dem

for sim in test.rubbing():
    for driver in ("serial", "parallel", "team"):
        sim._engine.pace.driver = driver
        test_determinism.begin(sim).run(steps=150)
        assert len(sim.contacts()) > 50
        print(test_determinism.digest(sim))
"""


def rubbing():
    """A box of soft spheres on the ground that a piston presses, solved and lagged."""
    rng = np.random.default_rng(8)
    grid = np.stack(np.meshgrid(*3 * [range(3)], indexing="ij"), axis=-1).reshape(-1, 3)
    place = (grid + 0.5) * 1.95 * R + rng.uniform(-0.01, 0.01, grid.shape) * R
    walls = [
        dem.Box((0, 0, -np.inf), (5.85 * R, 5.85 * R, np.inf), BEAD),
        dem.Piston((0, 0, 5.85 * R), (0, 0, -1), BEAD, velocity=0.1),
    ]
    for surface in ("implicit", "lagged"):
        law = dem.Law(dem.Hertz(0.7), dem.Mindlin(0.3), surface=dem.MultiContact(exchange=surface))
        spin = 5 * rng.normal(size=place.shape)
        setup = on_ground(place=place, law=law, omega=spin, boundaries=walls)
        yield dem.Simulation(setup, dt=5e-5)


@pytest.mark.slow
def test_drivers_and_threads_give_the_same_bits():
    lines = same_lines(SCRIPT)
    assert len(lines) == 6 and all(len(set(lines[k : k + 3])) == 1 for k in (0, 3))


# -- refusals --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ground", "rest", "what"),
    [
        ({"exchange": "lagged"}, {}, "substrate.exchange"),
        (
            {"coupling": "point", "relaxation": dem.Relaxation(5e4, 0.01)},
            {},
            "law.surface.exchange",
        ),
    ],
)
def test_what_is_not_solved_together_is_refused(ground, rest, what):
    with pytest.raises(dem.InputError, match=what):
        on_ground(ground=ground, **rest)
