"""Multi-contact, lagged, against LIGGGHTS 3.8: the same scene in both.

Of the two spheres of a pair LIGGGHTS expands the radius of the second, in R* and in the place of
the contact, and not that of the first.  Here the first of all, or the last, kept in its place in
memory, is hit by others that have no second contact and do not expand.  Its expansions come a step
after ours, so that the codes meet as the step goes to zero.
"""

import numpy as np
import pytest
from setups import order_of, restart, scene, watch

import taichi_dem as dem
from benchmarks import liggghts

pytestmark = [
    pytest.mark.peers,
    pytest.mark.skipif(not liggghts.available(), reason="needs the liggghts binary"),
]

R = 5e-3
BEAD = dem.Material("bead", density=1000, youngs_modulus=1e5, poissons_ratio=0.3)
WAYS = np.array([(1, 0, 0.4), (-0.6, 0.8, 0.1), (-0.5, -0.8, 0.5), (0.1, 0.1, 1.0)])
TIME, FRAMES, STEPS = 5.6e-3, 7, (1400, 2800)  # s; until just before the first contact opens
FORMAT = "%d" + 3 * " %20.16g"


def star(surface, order=(0, 1, 2, 3, 4)):
    """Spheres that come down on one, number 0, at different times and of different sizes."""
    ways = WAYS / np.linalg.norm(WAYS, axis=1, keepdims=True)
    radius = R * np.array([1.0, 0.9, 0.8, 1.0, 0.95])
    gap = R * np.array([1e-3, 2e-3, 3e-3, 5e-3])
    place = np.vstack([np.zeros(3), ways * (radius[0] + radius[1:] + gap)[:, None]])
    velocity = np.vstack([np.zeros(3), -0.1 * ways])
    law, order = dem.Law(dem.Hertz(0.9), surface=surface), list(order)
    return scene(place[order], radius[order], BEAD, velocity=velocity[order], law=law)


def path_of_liggghts(folder, setup, steps):
    """Positions (frames, n, 3)."""
    script, every = liggghts.write(folder, setup, dt=TIME / steps, steps=steps), steps // FRAMES
    dump = f'dump all all custom {every} dump id x y z\ndump_modify all format "{FORMAT}" sort id\n'
    text = script.read_text().replace("map array", "map array sort 0 0")
    script.write_text(text.replace(f"run {steps}", f"{dump}run {steps}"))
    liggghts.run(script)
    frames = (folder / "dump").read_text().split("ITEM: ATOMS id x y z")[1:]
    rows = [frame.split("ITEM")[0].split() for frame in frames]
    return np.array(rows, dtype=float).reshape(len(rows), -1, 4)[:, :, 1:]


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (1, 2, 3, 4, 0)], ids=["first", "last"])
def test_spheres_that_meet_on_one_move_as_in_liggghts(tmp_path, order):
    setup = star(dem.MultiContact(exchange="lagged"), order)
    sim, apart = dem.Simulation(setup, dt=TIME / STEPS[0]), []
    for steps in STEPS:
        expected = path_of_liggghts(tmp_path / str(steps), setup, steps)
        restart(sim, velocity=setup.spheres.velocity, dt=TIME / steps)
        found = watch(sim, steps, steps // FRAMES, lambda sim: sim.particles.position)
        apart.append(np.abs(found - expected).max())
    assert np.abs(sim.contacts()["expansion"]).max() > 1e-4 * R
    plain = path_of_liggghts(tmp_path / "plain", star(None, order), steps)
    effect = np.abs(expected - plain).max()
    assert effect > 1e-3 * R
    assert apart[0] < 1e-3 * effect
    assert order_of(apart) > 0.95
