"""Rolling resistance: against a twin, and spheres that roll out, lie still and hold on slopes."""

import numpy as np
import pytest
from law_paths import Torques
from law_twins import Rolling
from setups import GLASS, random_rotation
from twins import dot, length

import taichi_dem as dem

N = 5000
LAWS = {
    "CDT": dem.CDT(0.1),
    "CDT with torsion": dem.CDT(0.1, torsion_torque=True),
    "CDT-JKR": dem.CDTJKR(0.05, 1.5),
    "CDT-JKR with torsion": dem.CDTJKR(0.05, 1.5, torsion_torque=True),
    "CDT spring": dem.CDT(0.1, regularization="spring", rolling_damping=0.3),
    "CDT spring with torsion": dem.CDT(0.1, True, "spring"),
    "CDT-JKR spring": dem.CDTJKR(0.05, 1.5, regularization="spring", rolling_damping=0.3),
    "CDT-JKR spring with torsion": dem.CDTJKR(0.05, 1.5, True, "spring"),
}
SPRINGS = [name for name in LAWS if "spring" in name]


def log_uniform(rng, low, high, n=N):
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def unit_vectors(rng, n=N):
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def random_contacts(rng):
    """Contacts under load; some pulled, some not turning at all, some that stop within a step."""
    radius, modulus = log_uniform(rng, 1e-8, 10), log_uniform(rng, 1e3, 1e12)
    overlap = radius * log_uniform(rng, 1e-6, 0.1)
    area_stiffness = 2 * modulus * np.sqrt(radius * overlap)
    elastic = 2 / 3 * area_stiffness * overlap * rng.choice([-1, 0, 1, 1, 1, 1], N)
    inertia = 1e4 * radius**5 * log_uniform(rng, 0.01, 1)
    dt = 0.05 * np.sqrt(inertia / radius**2 / area_stiffness)
    size = log_uniform(rng, 1e-6, 1e3) * rng.choice([0, 1, 1, 1], N) * overlap / radius / dt
    return {
        "radius": radius,
        "modulus": modulus,
        "elastic": elastic,
        "area_stiffness": area_stiffness,
        "inertia": inertia,
        "dt": dt,
        "normal": unit_vectors(rng),
        "spin": unit_vectors(rng) * size[:, None],
        "mean_spin": np.zeros(N),
    }


def twin_of(law, c, rng):
    """The twin of ``law`` for the contacts ``c``, and the kernel's coefficients."""
    load = np.maximum(c["elastic"], 0)
    if isinstance(law, dem.CDT):
        friction = log_uniform(rng, 1e-4, 1)
        limit = friction * load * c["radius"]
        stiffness = 9 / 4 * c["area_stiffness"] * friction**2 * c["radius"]
        k = {"friction": friction}
    else:
        work, eta = log_uniform(rng, 1e-6, 1) * c["modulus"] * c["radius"], law.adhesion_hysteresis
        a_0 = (9 * np.pi * work * c["radius"] ** 2 / (2 * c["modulus"])) ** (1 / 3)  # eq. (2)
        friction = np.pi * a_0 / (4 * c["radius"]) * eta  # eq. (3)
        limit = friction * load * c["radius"]  # eq. (8)
        stiffness = 4 * (1.5 * np.pi * work * c["radius"])  # four pull-off forces
        lever = np.pi / 4 * eta * (9 * np.pi * work / (2 * c["modulus"])) ** (1 / 3)
        k = {"lever": lever, "stiffness": 6 * np.pi * work}
    dashpot = 2 * law.rolling_damping * np.sqrt(c["inertia"] * stiffness * c["radius"])
    twin = Rolling(limit, stiffness, dashpot, c["radius"], c["inertia"], law.torsion_torque)
    return twin, k | {"damping": 2 * law.rolling_damping}


@pytest.fixture(scope="module")
def benches():
    return {name: Torques(law, N) for name, law in LAWS.items()}


def started(benches, name, rng, c):
    bench = benches[name]
    twin, k = twin_of(LAWS[name], c, rng)
    bench.fill(**k)
    if bench.remembers:
        bench.history.fill(0)
    return bench, twin


@pytest.mark.parametrize("name", LAWS)
def test_equals_its_twin(benches, name):
    """Ten steps with random spins on a normal that stays; torque and stored energy to rounding."""
    rng = np.random.default_rng(1)
    c = random_contacts(rng)
    bench, twin = started(benches, name, rng, c)
    stored = np.zeros((N, 3))
    for _ in range(10 if bench.remembers else 1):
        c["spin"] = c["spin"] * 0.5 + 0.5 * unit_vectors(rng) * length(c["spin"])
        torque, energy = bench.run(c)
        if bench.remembers:
            expected, stored = twin.spring(stored, c["spin"], c["normal"], c["dt"])
        else:
            expected = twin.stop(c["spin"], c["normal"], c["dt"])
        scale = np.minimum(twin.limit, np.maximum(length(expected)[:, 0], 1e-3 * twin.limit))
        assert np.all(np.abs(torque - expected) <= 1e-11 * scale[:, None])
        assert np.all(length(torque)[:, 0] <= twin.limit * (1 + 1e-14))
        held = 0.5 * twin.stiffness * dot(stored, stored)[:, 0] / twin.radius
        assert np.all(np.abs(energy - held) <= 1e-11 * held)


@pytest.mark.parametrize("name", [name for name in LAWS if name not in SPRINGS])
def test_torque_never_turns_the_bodies_back(benches, name):
    """After the step, w has the direction it had or is exactly opposite by rounding at most."""
    rng = np.random.default_rng(2)
    c = random_contacts(rng)
    bench, twin = started(benches, name, rng, c)
    torque, _ = bench.run(c)
    spin = twin.opposed(c["spin"], c["normal"])
    after = spin + torque * (c["dt"] / c["inertia"])[:, None]
    before = dot(spin, spin)[:, 0]
    assert np.all(dot(after, spin)[:, 0] >= -4e-16 * before)
    stops = twin.limit * c["dt"] > c["inertia"] * np.sqrt(before)
    assert stops.sum() > 100 and (before > 0)[~stops].sum() > 100
    assert np.all(length(after)[stops, 0] <= 1e-15 * np.sqrt(before)[stops])
    if not LAWS[name].torsion_torque:
        left = 1e-15 * length(torque) * length(c["spin"])
        assert np.all(np.abs(dot(torque, c["normal"])) * length(spin) <= left)
    assert not torque[(c["elastic"] <= 0) | (before == 0)].any()


@pytest.mark.parametrize("name", LAWS)
def test_rotation_and_exchange_of_the_bodies(benches, name):
    """Turned contacts have turned torques; seen from j, the torque is the opposite."""
    rng = np.random.default_rng(3)
    c, turn = random_contacts(rng), random_rotation(rng)
    seen = []
    for matrix in (np.eye(3), turn, -np.eye(3)):
        again = np.random.default_rng(4)
        swapped = dict(c, spin=c["spin"] @ matrix.T, normal=c["normal"] @ matrix.T)
        bench, _ = started(benches, name, again, c)
        for _ in range(3):
            torque, _ = bench.run(swapped)
        seen.append(torque)
    scale = length(seen[0]) + 1e-12 * length(seen[0]).max()
    assert np.all(np.abs(seen[1] - seen[0] @ turn.T) <= 1e-12 * scale)
    assert np.array_equal(seen[2], -seen[0])


@pytest.mark.parametrize("name", SPRINGS)
def test_the_displacement_turns_with_the_contact(benches, name):
    """Rolled a little, then the pair turns as a whole: the torque turns with it, at its length."""
    rng = np.random.default_rng(5)
    c = random_contacts(rng)
    c["elastic"] = np.abs(c["elastic"]) + 1e-3 * np.abs(c["elastic"]).max()
    bench, _ = started(benches, name, rng, c)
    first, _ = bench.run(c)
    axis, angle, steps = unit_vectors(rng, 1)[0], 0.5, 64
    for k in range(1, steps + 1):
        w = angle * k / steps
        cross = np.cross(axis, c["normal"])
        normal = (
            c["normal"] * np.cos(w)
            + cross * np.sin(w)
            + np.outer(c["normal"] @ axis, axis) * (1 - np.cos(w))
        )
        spin = np.full(N, angle / steps) / c["dt"] * (normal @ axis)
        still = dict(c, normal=normal, spin=np.zeros((N, 3)), mean_spin=spin)
        torque, _ = bench.run(still)
    held = first + 0.0
    if LAWS[name].rolling_damping:  # the dashpot's share ends with the motion
        bench.history.fill(0)
        bench.run(c)
        held, _ = bench.run(dict(c, spin=np.zeros((N, 3))))
    turned = (
        held * np.cos(angle)
        + np.cross(axis, held) * np.sin(angle)
        + np.outer(held @ axis, axis) * (1 - np.cos(angle))
    )
    assert np.allclose(length(torque), length(held), rtol=1e-10, atol=0)
    assert np.all(length(torque - turned) <= 2e-3 * length(held))


# -- a sphere on a plane ---------------------------------------------------------------------------


class Plane:
    """Spheres that roll on planes without slipping, (n,): only the law's torque resists.

    dv/dt = (5/7) (g sin(slope) - M/(m R)), w = v/R, by velocity Verlet with half-step velocities.
    """

    def __init__(self, law, slope=0.0, load=1.0, dt=1e-4, work=None):
        self.n = len(np.atleast_1d(slope))
        self.radius, self.mass, self.dt, self.g = 5e-3, 1e-3, dt, 9.81
        self.slope = np.atleast_1d(slope)
        self.bench = Torques(law, self.n)
        self.bench.fill(**law.coefficients(GLASS, GLASS))
        self.inertia = 0.4 * self.mass * self.radius**2
        self.load = load * self.mass * self.g * np.cos(self.slope)
        self.velocity = np.zeros(self.n)
        self.position = np.zeros(self.n)
        self.spin_seen = np.zeros(self.n)

    def resistance(self, velocity):
        """M/(m R), the torque against rolling along x as an acceleration."""
        spin = np.zeros((self.n, 3))
        spin[:, 1] = velocity / self.radius  # v = w x R z
        torque, _ = self.bench.run(
            {
                "elastic": self.load,
                "area_stiffness": 100.0,
                "radius": self.radius,
                "inertia": self.inertia,
                "mean_spin": 0.0,
                "dt": self.dt,
                "normal": (0.0, 0.0, 1.0),
                "spin": spin,
            }
        )
        return -torque[:, 1] / (self.mass * self.radius)

    def run(self, steps):
        """Positions and velocities after each step, (steps, n) each."""
        seen = []
        for _ in range(steps):
            pull = self.g * np.sin(self.slope) - self.resistance(self.velocity)
            self.velocity = self.velocity + self.dt * 5 / 7 * pull
            self.position = self.position + self.dt * self.velocity
            seen.append((self.position, self.velocity))
        return np.moveaxis(np.array(seen), 1, 0)


@pytest.mark.parametrize("law", [dem.CDT(0.05), dem.CDTJKR(0.5, 5.0)], ids=["CDT", "CDT-JKR"])
def test_a_rolling_sphere_slows_at_a_constant_rate_and_lies_still(law):
    """-dv/dt = (5/7) mu_r g, the whole way; then it creeps to rest without ever turning back: what
    stops the spin within a step takes 2/7 of the speed, for it stops the spin alone."""
    plane = Plane(law)
    k = law.coefficients(GLASS, GLASS)
    friction = k.get("friction", k.get("lever", 0) / plane.radius ** (1 / 3))
    plane.velocity = np.array([0.05])
    rate = 5 / 7 * friction * plane.g
    time = 0.05 / rate
    positions, velocities = plane.run(int(1.5 * time / plane.dt) + 4000)
    change = -np.diff(velocities[:, 0]) / plane.dt
    rolling = velocities[1:, 0] > 1e-3 * 0.05 + 2 * rate * plane.dt
    assert np.allclose(change[rolling], rate, rtol=1e-9)
    assert np.all(velocities >= 0) and np.all(np.diff(velocities[:, 0]) <= 0)
    assert velocities[-1, 0] < 1e-300
    assert np.array_equal(positions[-1], positions[-1000])
    assert np.isclose(positions[-1, 0], 0.05**2 / (2 * rate), rtol=2 * plane.dt / time)


def test_a_spinning_ball_in_a_socket_stops_exactly():
    """Where nothing but the torque acts, the last step takes all that is left."""
    law, spin = dem.CDT(0.05, torsion_torque=True), np.array([[3.0, -2.0, 5.0]])
    bench = Torques(law, 1)
    bench.fill(**law.coefficients(GLASS, GLASS))
    inertia, dt, speeds = 1e-8, 1e-4, []
    for _ in range(3000):
        torque, _ = bench.run(
            {
                "elastic": 0.1,
                "area_stiffness": 100.0,
                "radius": 5e-3,
                "inertia": inertia,
                "mean_spin": 0.0,
                "dt": dt,
                "normal": (0.0, 0.0, 1.0),
                "spin": spin,
            }
        )
        spin = spin + torque / inertia * dt
        speeds.append(np.linalg.norm(spin))
    change = -np.diff(speeds)
    turning = np.array(speeds[1:]) > 1e-9
    assert np.allclose(change[turning], 0.05 * 0.1 * 5e-3 / inertia * dt, rtol=1e-9)
    assert speeds[-1] < 1e-15 * speeds[0]


@pytest.mark.parametrize(
    "law",
    [
        dem.CDT(0.1, regularization="spring", rolling_damping=2.0),
        dem.CDTJKR(0.5, 5.0, regularization="spring", rolling_damping=2.0),
    ],
    ids=["CDT", "CDT-JKR"],
)
def test_a_spring_holds_a_sphere_on_a_slope_below_the_rolling_angle(law):
    """tan(slope) < mu_r: it rolls a little, and rests where the spring carries it; above, it rolls
    down at (5/7) g (sin - mu_r cos)."""
    k = law.coefficients(GLASS, GLASS)
    radius = 5e-3
    friction = k.get("friction", k.get("lever", 0) / radius ** (1 / 3))
    slope = np.arctan(friction * np.array([0.0, 0.5, 0.9, 1.2, 2.0]))
    plane = Plane(law, slope, dt=2e-4)
    positions, velocities = plane.run(10_000)
    assert not positions[:, 0].any()
    stiffness = k.get("stiffness", 0) * radius or 9 / 4 * 100.0 * friction**2 * radius
    resting = plane.mass * plane.g * np.sin(slope) * radius / stiffness
    assert np.allclose(positions[-1, 1:3], resting[1:3], rtol=1e-3)
    assert np.all(np.abs(velocities[-1, 1:3]) < 1e-3 * np.abs(velocities[:, 1:3]).max(axis=0))
    rate = 5 / 7 * plane.g * (np.sin(slope) - friction * np.cos(slope))
    found = (velocities[-1] - velocities[-1001]) / (1000 * plane.dt)
    assert np.allclose(found[3:], rate[3:], rtol=1e-9)


def test_a_stiffening_spring_makes_no_energy(benches):
    """CDT: the load grows and falls over a held spring; stored energy never grows by itself."""
    rng = np.random.default_rng(6)
    c = random_contacts(rng)
    c["elastic"] = np.abs(c["elastic"]) + 1e-6 * np.abs(c["elastic"]).max()
    bench, _ = started(benches, "CDT spring", rng, c)
    energies = [bench.run(c)[1]]
    still = dict(c, spin=np.zeros((N, 3)))
    for share in (1.0, 2.0, 5.0, 3.0, 0.5, 0.1, 4.0):
        loaded = dict(still, elastic=c["elastic"] * share**1.5)
        loaded["area_stiffness"] = c["area_stiffness"] * share**0.5
        energies.append(bench.run(loaded)[1])
    energies = np.array(energies)
    assert np.all(np.diff(energies, axis=0) <= 1e-12 * energies[:-1]) and energies[0].any()


# -- composition -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: dem.CDT(-0.1), "rolling_friction = -0.1"),
        (lambda: dem.CDT(0.1, regularization="none"), "must be one of stop, spring"),
        (lambda: dem.CDT(0.1, rolling_damping=0.1), "must be 0 without regularization"),
        (lambda: dem.CDT(0.1, torsion_torque=1), "must be true or false"),
        (lambda: dem.CDTJKR(-1.0), "work_of_adhesion = -1"),
        (
            lambda: dem.Law(dem.Hertz(0.5), rolling=dem.CDTJKR(adhesion_hysteresis=1.5)),
            "rolling.work_of_adhesion: is missing; must be >= 0 J/m2, as the normal law, Hertz",
        ),
        (
            lambda: dem.Law(dem.JKR(0.05, 0.5), rolling=dem.CDTJKR(0.05)),
            "rolling.work_of_adhesion = 0.05: must be left out",
        ),
        (
            lambda: dem.Law(
                dem.Hertz(0.5),
                rolling=dem.CDT(0.1),
                pairs={("a", "b"): {"rolling": dem.CDT(0.1, torsion_torque=True)}},
            ),
            "torsion_torque = True: must be False, as for all pairs",
        ),
        (
            lambda: dem.Law(
                dem.EEPA(0.5, 2.0), pairs={("a", "b"): {"normal": dem.EEPA(0.5, 2.0, 1.0)}}
            ),
            "overlap_exponent = 1.0: must be 1.5, as for all pairs",
        ),
    ],
)
def test_what_has_no_meaning_is_refused(make, message):
    with pytest.raises(dem.InputError, match=message):
        make()


def test_the_work_of_adhesion_comes_from_the_normal_law_of_each_pair():
    law = dem.Law(
        dem.JKR(0.05, 0.5),
        rolling=dem.CDTJKR(adhesion_hysteresis=2.0),
        pairs={("a", "b"): {"normal": dem.JKR(0.2, 0.5)}},
    )
    assert law.between("rolling", "b", "a") == dem.CDTJKR(0.2, 2.0)
    assert law.between("rolling", "a", "a") == dem.CDTJKR(0.05, 2.0)
    k = law.between("rolling", "a", "b").coefficients(GLASS, GLASS)
    assert np.isclose(k["stiffness"], 6 * np.pi * 0.2)
