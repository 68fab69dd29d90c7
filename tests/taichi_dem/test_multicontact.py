"""Multi-contact: forces against a twin, closed forms, conservation, limits, what is refused."""

import hashlib

import numpy as np
import pytest
from multicontact_limits import (
    R,
    cubic_limit,
    cubic_packing,
    six_walls,
    walls_closing,
    walls_limit,
)
from multicontact_twin import (
    Bodies,
    contacts,
    energy,
    equilibrium,
    forces_on_spheres,
)
from setups import EPS, order_of, restart, rigid, scene, skin_held_at, watch

import taichi_dem as dem

BEAD = dem.Material("bead", density=1000, youngs_modulus=1e5, poissons_ratio=0.3)
STILL = 1e-12  # s, a step in which nothing moves
TIGHT = 1e-13


def with_surface(surface, normal=None, tangential=None):
    return dem.Law(normal or dem.Hertz(1.0), tangential, surface=surface)


def cluster(rng, overlap=0.03):
    """A hexagon of spheres around one, and three above: each pressed on its neighbours."""
    angle = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    angle = np.pi / 6 + np.arange(3) * 2 * np.pi / 3
    top = np.stack([np.cos(angle), np.sin(angle), np.sqrt(2) + 0 * angle], axis=1) / np.sqrt(3)
    place = 2 * R * (1 - overlap) * np.vstack([np.zeros(3), ring, top])
    return place + 0.01 * R * rng.normal(size=place.shape), R * rng.uniform(0.98, 1.0, len(place))


# -- against a twin --------------------------------------------------------------------------------

TILT = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)
PLANES = (((0, 0, -0.95 * R), (0.0, 0.0, 1.0)), ((0, 0, -0.96 * R), tuple(TILT)))


@pytest.fixture(scope="module", params=["implicit", "lagged"])
def pressed(request):
    """A cluster on two planes that make a blunt wedge, so near to each other that the distance of
    contacts is cut off; its simulation, the bodies of the twin, and whether it is implicit."""
    position, radius = cluster(np.random.default_rng(5))
    setup = scene(
        position,
        radius,
        BEAD,
        law=with_surface(dem.MultiContact(exchange=request.param, residual=TIGHT)),
        boundaries=[dem.Plane(*plane, rigid()) for plane in PLANES],
    )
    bodies = Bodies(radius, BEAD.youngs_modulus, BEAD.poissons_ratio, PLANES, 1e30)
    return dem.Simulation(setup, dt=STILL), bodies, request.param == "implicit"


def test_forces_are_those_of_the_twin(pressed):
    sim, bodies, implicit = pressed
    restart(sim).run(steps=1 if implicit else 60)
    met = contacts(sim.scene.spheres.position, bodies, 0.01 * R)
    force, effective, _ = equilibrium(met, bodies, implicit)
    plain = equilibrium(met, bodies, implicit, rounds=0)[0]
    found, touches = sim.contacts(), effective > 0
    assert len(found) == touches.sum() > 25
    expected, mine = {}, {}
    for c in np.flatnonzero(touches):
        pair = frozenset((met.i[c], met.j[c]))
        expected.setdefault(pair, []).append((force[c], effective[c]))
    for row in found:
        pair = frozenset((row["i"], max(row["j"], -1)))
        mine.setdefault(pair, []).append((row["normal_force"], row["overlap"]))
    assert mine.keys() == expected.keys()
    for pair, rows in expected.items():
        np.testing.assert_allclose(sorted(mine[pair]), sorted(rows), rtol=1e-9)
    assert np.abs(force - plain).max() > 0.03 * force.max()
    if not implicit:
        total = forces_on_spheres(met, force, len(bodies.radius))
        np.testing.assert_allclose(sim.particles.force, total, atol=1e-9 * force.max())


def test_force_is_the_slope_of_the_energy(pressed):
    """The twin's energy by central differences along random ways of all spheres."""
    sim, bodies, implicit = pressed
    if not implicit:
        pytest.skip("no energy belongs to the lagged exchange")
    restart(sim)
    position, step = sim.scene.spheres.position, 1e-4 * R
    assert sum(sim.energy()[k] for k in ("normal", "expansion")) == pytest.approx(
        energy(position, bodies, 0.01 * R), rel=1e-9
    )
    met = contacts(position, bodies, 0.01 * R)
    without = forces_on_spheres(met, equilibrium(met, bodies)[0], len(bodies.radius))
    rng = np.random.default_rng(6)
    for _ in range(3):
        way = rng.normal(size=position.shape)
        either = [energy(position + sign * step * way, bodies, 0.01 * R) for sign in (1, -1)]
        slope = (either[0] - either[1]) / (2 * step)
        scale = np.abs(sim.particles.force * way).sum()
        assert np.sum(-sim.particles.force * way) == pytest.approx(slope, abs=1e-5 * scale)
        assert abs(np.sum(-without * way) - slope) > 1e-4 * scale  # it is not only F n


# -- closed forms ----------------------------------------------------------------------------------


def test_cube_of_walls_as_computed_and_to_its_limit():
    """Every wall's force, until there is none that fits: then the run stops and says so."""
    speed, dt = 0.05, 2e-6
    setup, bead = walls_closing(speed)
    limit = walls_limit(bead)
    sim = dem.Simulation(setup, dt=dt)
    steps = 2 * round(0.45 * limit / speed / dt)
    for _ in range(2):
        sim.run(steps=steps // 2)
        effective, _, stiffness = six_walls(bead, speed * sim.time)
        found = sim.contacts()
        np.testing.assert_allclose(found["overlap"], effective, rtol=1e-5)
        np.testing.assert_allclose(found["normal_force"], stiffness * effective**1.5, rtol=2e-5)
    with pytest.raises(dem.SimulationStopped, match="no equilibrium") as stop:
        sim.run(steps=steps)
    depth = speed * float(str(stop.value).split("t = ")[1].split()[0])
    assert depth == pytest.approx(limit, rel=0.01)
    assert 0.09 < limit / R < 0.11


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.95, 1.05])
def test_simple_cubic_packing_ends_where_it_should(share):
    setup, depth = cubic_packing(share)
    limit = min(cubic_limit(True), cubic_limit(False))
    assert limit == pytest.approx(0.092, abs=5e-4)

    def press():
        sim = dem.Simulation(setup, dt=STILL, max_overlap=1)
        sim.run(steps=2)
        return sim.contacts()

    if share > 1:  # from the start, so that it is the scene which is refused
        with pytest.raises(dem.InputError, match="no equilibrium"):
            press()
        return
    found = press()
    walls = found["j"] < 0
    assert (walls.sum(), (~walls).sum()) == (24, 12)
    for group in (found[walls], found[~walls]):
        force = group["normal_force"]
        np.testing.assert_allclose(force, force.mean(), rtol=1e-6)
    # More than without what the others raise, and the more the nearer to the limit.
    alone = 4 / 3 * 1e5 / 0.75 * np.sqrt(R) * depth**1.5
    assert np.all(found["normal_force"] > 1.5 * alone)


# -- conservation ----------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["elastic", "rubbing"])
def bursting(request):
    """A cluster that flies apart in a box; its simulation, and velocities to start with."""
    position, radius = cluster(np.random.default_rng(1))
    velocity = 0.02 * np.random.default_rng(2).normal(size=position.shape)
    rubbing = request.param == "rubbing"
    setup = scene(
        position,
        radius,
        BEAD,
        velocity=velocity,
        boundaries=[]
        if rubbing
        else [dem.Box((-0.016, -0.016, -5.8e-3), (0.016, 0.016, 0.014), BEAD)],
        law=with_surface(
            dem.MultiContact(residual=1e-11),
            dem.Hertz(0.8 if rubbing else 1.0),
            dem.Mindlin(0.3) if rubbing else None,
        ),
    )
    return dem.Simulation(setup, dt=1e-5), velocity, rubbing


def test_energy_is_conserved_to_the_order_of_the_scheme(bursting):
    sim, velocity, rubbing = bursting
    largest = []
    for steps in (500, 1000, 2000):
        restart(sim, velocity=velocity, dt=0.02 / steps)
        parts = watch(
            sim,
            steps,
            steps // 50,
            lambda sim: [sim.energy()[k] for k in ("balance_error", "normal")],
        )
        largest.append(np.abs(parts[:, 0]).max())
    orders = order_of(largest)
    assert np.all(orders > (1.2 if rubbing else 1.9))
    assert largest[0] < 2e-3 * parts[:, 1].max()


def test_momenta_are_conserved(bursting):
    """Spheres whose contacts lie off the middle turn each other by as much as they turn."""
    sim, velocity, rubbing = bursting
    if not rubbing:
        pytest.skip("walls take momentum")
    restart(sim, velocity=velocity, omega=20.0)

    def momenta(sim):
        now = sim.particles
        push = now.mass[:, None] * now.velocity
        turn = np.cross(now.position, push) + 0.4 * (now.mass * now.radius**2)[:, None] * now.omega
        return np.hstack([push.sum(axis=0), turn.sum(axis=0) / R])

    found = watch(sim, 400, 100, momenta)
    scale = np.abs(sim.particles.mass[:, None] * sim.particles.velocity).sum()
    assert np.abs(found - found[0]).max() < 1e-12 * scale
    assert len(np.unique(sim.particles.omega)) == 3 * len(sim.particles.omega)


# -- opening, and contacts made by expansion -------------------------------------------------------


@pytest.fixture(scope="module", params=["implicit", "lagged"])
def squeezed(request):
    """A sphere between two others that hold it, and a fourth beside it that does not touch."""
    place = np.array([(0, 0, 0), (1.94 * R, 0, 0), (-1.94 * R, 0, 0), (0, 2.0008 * R, 0)])
    law = with_surface(dem.MultiContact(exchange=request.param, residual=TIGHT))
    return dem.Simulation(scene(place, R, BEAD, law=law), dt=STILL)


def test_a_contact_made_by_expansion_alone_is_found(squeezed):
    """It is further off than the list would reach without expansions."""
    with skin_held_at(squeezed, 1e-5 * R):
        restart(squeezed).run(steps=60)
        found = squeezed.contacts()
    last = found[(found["i"] == 3) | (found["j"] == 3)]
    assert len(found) == 3 and len(last) == 1
    assert last["overlap"] > 0 and last["normal_force"] > 0
    assert last["expansion"].sum() == pytest.approx(last["overlap"][0] + 8e-4 * R, rel=1e-3)
    assert last["expansion"].min() == 0  # of the sphere that nothing else presses


def test_what_opens_is_forgotten(squeezed):
    """After the squeeze has ended and begun again, everything is as for the first time."""
    restart(squeezed).run(steps=60)
    first = squeezed.contacts()
    apart = squeezed.scene.spheres.position * 1.1
    engine = squeezed._engine
    engine.particles.write(apart, 0 * apart, 0 * apart)
    squeezed.run(steps=3)
    assert len(squeezed.contacts()) == 0
    history = engine.contacts.history.to_numpy()
    assert all(not np.any(history[name]) for name in history)
    engine.particles.write(squeezed.scene.spheres.position, 0 * apart, 0 * apart)
    squeezed.run(steps=60)
    again = squeezed.contacts()
    for name in ("normal_force", "expansion", "overlap"):
        np.testing.assert_allclose(again[name], first[name], rtol=1e-9)


def test_two_contacts_at_right_angles(squeezed):
    """The force that the literature's formula gives, iterated to consistency."""
    place = np.array([(0, 0, 0), (2 * R - 2e-4, 0, 0), (0, 2 * R - 2e-4, 0), (9 * R, 0, 0)])
    restart(squeezed, place).run(steps=60)
    found = squeezed.contacts()
    np.testing.assert_allclose(found["normal_force"], 0.0104518732503, rtol=1e-11)
    assert np.count_nonzero(found["expansion"]) == 2  # the outer spheres have one contact each
    # The forces that belong to the change of M make no moment: each acts between two centres ...
    force = squeezed.particles.force
    assert np.abs(force.sum(axis=0)).max() < 10 * EPS * np.abs(force).max()
    moment = np.cross(place, force).sum(axis=0)  # ... and turning all changes nothing
    assert np.abs(moment).max() < 1e-9 * np.abs(force).max() * R


def test_a_single_contact_is_plain_hertz(squeezed):
    place = np.array([(0, 0, 0), (1.95 * R, 0, 0), (9 * R, 0, 0), (0, 9 * R, 0)])
    restart(squeezed, place)
    (found,) = squeezed.contacts()
    stiffness = 4 / 3 * BEAD.youngs_modulus / (2 * (1 - BEAD.poissons_ratio**2)) * np.sqrt(R / 2)
    assert not found["expansion"].any()
    assert found["normal_force"] == pytest.approx(stiffness * (0.05 * R) ** 1.5, rel=1e-12)
    assert np.linalg.norm(found["force"]) == pytest.approx(found["normal_force"], rel=1e-14)


# -- drivers ---------------------------------------------------------------------------------------


def heap(law):
    """Soft spheres pressed together in a box by a piston, spinning and rubbing."""
    rng = np.random.default_rng(8)
    grid = np.stack(np.meshgrid(*3 * [range(3)], indexing="ij"), axis=-1).reshape(-1, 3)
    place = (grid + 0.5) * 1.95 * R + rng.uniform(-0.01, 0.01, grid.shape) * R
    side = 5.85 * R
    return scene(
        place,
        R * rng.uniform(0.95, 1, len(place)),
        BEAD,
        gravity=(0, 0, -9.81),
        omega=5 * rng.normal(size=place.shape),
        law=law,
        boundaries=[
            dem.Box((0, 0, 0), (side, side, np.inf), BEAD),
            dem.Piston((0, 0, side), (0, 0, -1), BEAD, velocity=0.1),
        ],
    )


@pytest.mark.parametrize(
    ("exchange", "normal"),
    [("implicit", dem.Hertz(0.7)), ("lagged", dem.Hooke(50.0, 0.7))],
    ids=["implicit, Hertz", "lagged, Hooke"],
)
def test_the_drivers_give_the_same_bits(exchange, normal):
    law = with_surface(dem.MultiContact(exchange=exchange), normal, dem.Mindlin(0.3))
    seen = set()
    for driver in ("serial", "team", "parallel"):
        sim = dem.Simulation(heap(law), dt=5e-5, driver=driver)
        sim.run(steps=200)
        found = sim.contacts()
        whole = hashlib.sha256(sim.particles.position.tobytes())
        for name in found.dtype.names:
            whole.update(np.ascontiguousarray(found[name]).tobytes())
        seen.add(whole.hexdigest())
    assert len(seen) == 1
    assert len(found) > 60 and np.abs(found["expansion"]).max() > 1e-3 * R


# -- refusals --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"prefactor": -1.0}, "prefactor"),
        ({"exchange": "instant"}, "exchange"),
        ({"residual": 0.0}, "residual"),
        ({"iterations": 2.5}, "whole number"),
    ],
)
def test_wrong_parameters_are_refused(given, what):
    with pytest.raises(dem.InputError, match=what):
        dem.MultiContact(**given)


def test_a_surface_law_for_a_pair_is_refused_with_the_reason():
    surface = dem.MultiContact()
    with pytest.raises(dem.InputError, match="whole sphere"):
        dem.Law(dem.Hertz(0.9), surface=surface, pairs={("bead", "bead"): {"surface": surface}})
