"""Random valid scenes of every law: no exception but a guard's, no not-a-number, no energy made."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import taichi_dem as dem
from tests.taichi_dem.setups import scene

STEPS = 2000
FEW = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def share(low=0.0, high=1.0):
    return st.floats(low, high)


def decades(low, high):
    return st.floats(math.log10(low), math.log10(high)).map(lambda power: 10.0**power)


@st.composite
def materials(draw, name):
    return dem.Material(
        name, draw(decades(100, 2e4)), draw(decades(1e2, 1e12)), draw(share(0, 0.5))
    )


@st.composite
def laws(draw, stiffness, tension):
    """Any combination; Hooke's spring and the surface energies go with the scene's own
    ``stiffness`` (N/m) and ``tension`` (J/m2), so that spheres touch rather than merge."""
    restitution = draw(share(0.05, 1.0))
    work = tension * draw(decades(1e-6, 1e-3))
    normal = draw(
        st.sampled_from(
            [
                dem.Hooke(stiffness, restitution),
                dem.Hertz(restitution),
                dem.JKR(work, restitution),
                dem.EEPA(restitution, draw(decades(1, 100)), surface_energy=work),
            ]
        )
    )
    tangential = draw(st.sampled_from([None, dem.Mindlin(draw(share(0, 2)), draw(share(0, 1)))]))
    own = None if isinstance(normal, dem.JKR) else work
    rolling = draw(
        st.sampled_from(
            [
                None,
                dem.CDT(draw(share(0, 0.5))),
                dem.CDT(draw(share(0, 0.5)), True, "spring", rolling_damping=draw(share())),
                dem.CDTJKR(own, adhesion_hysteresis=draw(share(0, 3))),
            ]
        )
    )
    return dem.Law(normal, tangential, rolling)


@st.composite
def scenes(draw):
    """Up to a dozen spheres of sizes 1:20 that are thrown together over a floor or the ground."""
    soft, hard = draw(materials("a")), draw(materials("b"))
    size = draw(decades(1e-6, 1.0))
    count = draw(st.integers(2, 12))
    radius = size * np.array([draw(decades(0.05, 1.0)) for _ in range(count)])
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    modulus = min(soft.youngs_modulus, hard.youngs_modulus)
    density = max(soft.density, hard.density)
    law = draw(laws(modulus * radius.min(), modulus * radius.min()))

    side = 2.2 * size * math.ceil(count ** (1 / 3))
    cells = np.stack(np.meshgrid(*[np.arange(3)] * 3), -1).reshape(-1, 3)[:count]
    position = 2.2 * size * (cells + 0.5)
    speed = draw(decades(1e-4, 2e-2)) * math.sqrt(modulus / density)
    velocity = speed * rng.normal(size=(count, 3)) - 0.5 * speed * (position / side - 0.5)
    boundaries = [dem.Box((0.0, 0.0, -math.inf), (3 * side,) * 3, soft)]
    ground = draw(st.booleans())
    if not ground:
        boundaries.append(dem.Plane((0, 0, 0), (0, 0, 1), hard))
    return scene(
        position,
        radius,
        soft,
        velocity=velocity,
        law=law,
        boundaries=boundaries,
        substrate=dem.Substrate(hard) if ground else None,
        gravity=(0.0, 0.0, -0.1 * speed**2 / size),
        sleep=not ground and draw(st.booleans()),
    )


def holds(problem):
    """Run ``problem``; a guard may stop it with its reason, nothing else may happen."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sim = dem.Simulation(problem, driver="serial", max_overlap=1.0)
        start = sim.energy()
        try:
            sim.run(steps=STEPS)
        except dem.SimulationStopped as stop:
            assert "Try" in str(stop)
    state, parts = sim.particles, sim.energy()
    for values in (state.position, state.velocity, state.omega, state.force):
        assert np.isfinite(values).all()
    height = np.abs(start["gravity"]) + np.abs(parts["gravity"])
    scale = start["kinetic"] + abs(start["normal"]) + height + abs(parts["normal"])
    # A twentieth of the half period: (pi / 20)^2 / 4, for every contact that swings.
    assert parts["balance_error"] <= 4 * 0.0062 * scale


@pytest.mark.slow
@settings(max_examples=200, **FEW)
@given(scenes())
def test_many_random_scenes_hold(problem):
    holds(problem)
