"""EEPA: against its twin over random load paths, closed forms, restitution and symmetries."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from law_paths import Paths
from law_twins import EEPA
from setups import GLASS, order_of

import taichi_dem as dem

N, TURNS, PER_TURN = 1000, 8, 9
KINDS = {  # d_ex, c_ex, options
    "linear": (1.0, 1.0, {}),
    "Hertzian": (1.5, 1.5, {}),
    "Hertzian, linear pull": (1.5, 1.0, {}),
    "constant dashpot": (1.5, 3.0, {"damping": "constant"}),
    "any exponents": (1.3, 0.7, {}),
    "no pull at all": (1.5, 1.0, {"limit_force": True}),
}
COMMON = settings(
    deadline=None,
    derandomize=True,
    database=None,
    max_examples=3,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def log_uniform(rng, low, high, n=N):
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def random_contacts(rng, n, c, options, count=N):
    """Contacts of every size, hardness and stickiness: 3/2 pi gamma a from far below the limit on
    F_min to far above; a third elastic, a third without adhesion, a third on walls."""
    some = dict(n=count)
    radius_i = log_uniform(rng, 1e-8, 10, **some)
    radius_j = np.where(
        rng.random(count) < 1 / 3, np.inf, radius_i * log_uniform(rng, 0.05, 20, **some)
    )
    depth = radius_i * np.minimum(1, radius_j / radius_i) * log_uniform(rng, 1e-6, 0.05, **some)
    ratio = np.where(rng.random(count) < 1 / 3, 1.0, log_uniform(rng, 1.01, 1e3, **some))
    sticks = (rng.random(count) < 2 / 3) * (not options.get("limit_force", False))
    one = EEPA(
        modulus=log_uniform(rng, 1e3, 1e12, **some),
        restitution=rng.uniform(0.01, 1, count),
        stiffness_ratio=ratio,
        surface_energy=np.zeros(count),
        pull_off=np.zeros(count),
        radius_i=radius_i,
        radius_j=radius_j,
        mass=1e4 * radius_i**3,
        overlap_exponent=n,
        adhesion_exponent=c,
        **options,
    )
    force = one.first * depth**n
    energy = sticks * force * log_uniform(rng, 1e-3, 1e2, **some) / one.chord(depth)
    pull_off = -1.0 * sticks * (rng.random(count) < 0.5) * force * rng.random(count)
    return one._replace(surface_energy=energy, pull_off=pull_off), depth


def bench_of(contacts):
    """The kernel for the exponents and options of ``contacts``, filled with their numbers."""
    options = {name: getattr(contacts, name) for name in dem.EEPA.options}
    law = dem.EEPA(0.5, 2.0, **options)
    return fill(Paths(law, len(contacts.modulus)), contacts)


def fill(bench, contacts):
    linear = contacts.overlap_exponent == 1
    laws = [
        dem.EEPA(e, 2.0, **{n: getattr(contacts, n) for n in dem.EEPA.options})
        for e in contacts.restitution
    ]
    bench.fill(
        modulus=contacts.modulus * (2 if linear else 4 / 3),
        stiffness_ratio=contacts.stiffness_ratio,
        damping=[law.coefficients(GLASS, GLASS)["damping"] for law in laws],
        surface_energy=contacts.surface_energy,
        pull_off=contacts.pull_off,
    )
    return bench


def run(bench, contacts, overlaps, velocities=0.0):
    reach = np.where(np.isinf(contacts.radius_j), 0, 1 / (contacts.radius_i + contacts.radius_j))
    return bench.run(overlaps, contacts.radius, velocities, contacts.mass, reach)


def random_paths(rng, depth, per_turn=PER_TURN, turns=TURNS):
    """Overlaps that wander between random turning points, also apart, over many scales."""
    ends = rng.uniform(-0.2, 1, (turns, len(depth))) * 10.0 ** -rng.choice(
        [0, 0, 0, 1, 2], (turns, len(depth))
    )
    ends = np.vstack([np.full(len(depth), -0.01), ends, np.full(len(depth), -0.01)]) * depth
    share = np.linspace(0, 1, per_turn, endpoint=False)[:, None]
    parts = [low + (high - low) * share for low, high in zip(ends[:-1], ends[1:], strict=True)]
    return np.vstack([*parts, ends[-1:]])


@pytest.fixture(scope="module")
def benches():
    made = {}
    for name, (n, c, options) in KINDS.items():
        made[name] = bench_of(random_contacts(np.random.default_rng(0), n, c, options)[0])
    return made


@pytest.mark.parametrize("kind", KINDS)
@COMMON
@given(seed=st.integers(0, 2**32 - 1))
def test_equals_its_twin_along_random_paths(benches, kind, seed):
    """Elastic and total force at each of 80 overlaps, to rounding."""
    rng = np.random.default_rng(seed)
    contacts, depth = random_contacts(rng, *KINDS[kind])
    paths = random_paths(rng, depth)
    velocities = rng.normal(size=paths.shape) * np.sqrt(
        contacts.first * depth ** (KINDS[kind][0] + 1) / contacts.mass
    )
    found = run(fill(benches[kind], contacts), contacts, paths, velocities)
    elastic, total = contacts.path(paths, velocities)
    scale = contacts.stiffness_ratio * contacts.first * depth ** KINDS[kind][0]
    assert np.all(
        np.abs(found["elastic"] - contacts.pull_off * found["touching"] - elastic) < 1e-13 * scale
    )
    sized = scale + np.abs(found["damping"] * velocities)
    assert np.all(np.abs(found["total"] - total) < 1e-13 * sized)
    assert np.array_equal(found["touching"], paths > 0)
