"""Whether the work of late surfaces is all that they make."""

import warnings
from dataclasses import replace

import pytest

import taichi_dem as dem
from tests.hard.ground import resting, square
from tests.hard.kit import wobble
from tests.hard.late_surfaces import LateSurfaces


@pytest.mark.slow
@pytest.mark.parametrize(
    "way", [{"exchange": "lagged", "force_lagged": True}, {"exchange_every": 4}], ids=str
)
def test_what_late_ground_makes_is_the_work_of_its_surface(way):
    """Spheres without losses, thrown up by ground that none has been felt on before."""
    laid = resting(square(3, 2.02), depth=0.03)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sim = dem.Simulation(replace(laid, substrate=replace(laid.substrate, **way)))
        late = LateSurfaces(sim)
        start = sim.energy()["kinetic"] + sim.energy()["normal"]
        late.run(300)
    made = sim.energy()["kinetic"] + sim.energy()["normal"] - start
    error = wobble(sim) * start
    assert abs(made) > 3 * error
    assert made == pytest.approx(late.work, abs=error)
