"""The same physics seen from elsewhere: mirrored, turned, moved, carried along, in other units.

Mirrors, quarter turns and units that are powers of two change no rounding, so that the results must
be the same bits.  What changes the rounding may change the results by rounding and its growth in
the few collisions of a short run.
"""

import dataclasses

import numpy as np
import pytest
from setups import random_rotation, restart, scene, state

import taichi_dem as dem

R, SIDE, DT, STEPS = 5e-3, 0.032, 5e-5, 400
LAW = dem.Law(dem.Hertz(0.7), dem.Mindlin(0.4, damping=0.5))
UP = np.array([0.0, 0.0, 1.0])
SIDES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]
STONE = dem.Material("stone", density=2500, youngs_modulus=2e6, poissons_ratio=0.2)
SOIL = dem.Material("soil", density=1000, youngs_modulus=2e6, poissons_ratio=0.45)


@dataclasses.dataclass
class Setting:
    """A cloud in a box; directions are the columns of ``turn``, units those of SI times (length,
    time, mass)."""

    turn: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3))
    shift: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    units: tuple[float, float, float] = (1, 1, 1)
    ground: bool = True
    walls: bool = True

    def kind(self, material):
        length, time, mass = self.units
        return dem.Material(
            material.name,
            material.density * mass / length**3,
            material.youngs_modulus * mass / (length * time**2),
            material.poissons_ratio,
        )

    def scene(self):
        rng = np.random.default_rng(7)
        length, time, _ = self.units
        stone = self.kind(STONE)
        grid = np.stack(np.meshgrid(*[range(3)] * 3), axis=-1).reshape(-1, 3)
        radius = R * rng.uniform(0.9, 1, len(grid))
        place = (grid - [1, 1, 0]) * 1.95 * R + rng.uniform(-0.05, 0.05, grid.shape) * R
        place[:, 2] += np.where(grid[:, 2] == 0, 0.97 * radius, 0.9 * R)
        velocity = 0.2 * rng.normal(size=place.shape) - [0, 0, 0.1]
        omega = 50 * rng.normal(size=place.shape) * np.linalg.det(self.turn)  # an axial vector
        walls = [(SIDE / 2 * np.array(side), -np.array(side)) for side in SIDES]
        if not self.ground:
            walls += [(np.zeros(3), np.array([0, 0, 1])), (np.array([0, 0, SIDE]), -UP)]
        boundaries = [
            dem.Plane((self.turn @ point + self.shift) * length, self.turn @ facing, stone)
            for point, facing in walls
        ]
        return scene(
            (place @ self.turn.T + self.shift) * length,
            radius * length,
            stone,
            velocity @ self.turn.T * length / time,
            omega @ self.turn.T / time,
            gravity=self.turn @ UP * -9.81 * length / time**2 if self.walls else (0, 0, 0),
            law=LAW,
            boundaries=boundaries if self.walls else [],
            # Points: the size of a contact is a cube root, which no power of two leaves alone.
            substrate=dem.Substrate(self.kind(SOIL), coupling="point") if self.ground else None,
        )

    def run(self):
        """Position, velocity and angular velocity in the first setting's directions and units, and
        the number of contacts early on."""
        length, time, _ = self.units
        sim = dem.Simulation(self.scene(), dt=DT * time)
        sim.run(steps=STEPS // 20)
        early = sim.contacts()["j"]
        sim.run(steps=STEPS - STEPS // 20)
        found = state(sim) / np.repeat([length, length / time, 1 / time], 3)
        position, velocity, omega = np.split(found, 3, axis=1)
        omega = omega * np.linalg.det(self.turn)
        back = np.hstack([position - self.shift, velocity, omega])
        return (back.reshape(-1, 3, 3) @ self.turn).reshape(-1, 9), early


@pytest.fixture(scope="module")
def on_substrate():
    """The reference on a coupled substrate."""
    found, early = Setting().run()
    assert np.sum(early == -1) >= 6 and np.sum(early != -1) >= 15
    return found


@pytest.fixture(scope="module")
def in_box():
    """The reference in a closed box."""
    return Setting(ground=False).run()[0]


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("turn", [np.diag([-1.0, 1.0, 1.0]), QUARTER], ids=["mirror", "quarter"])
def test_mirrored_and_turned_by_a_quarter_to_the_bit(on_substrate, turn):
    assert np.array_equal(Setting(turn=turn).run()[0], on_substrate)


@pytest.mark.parametrize("units", [(2.0**-20, 2.0**-13, 2.0**-50), (2.0**10, 2.0**4, 2.0**30)])
def test_units_do_not_matter_to_the_bit(on_substrate, units):
    """Grains of 5 nm and of 5 m: no length, force or time is hidden in the code."""
    assert np.array_equal(Setting(units=units).run()[0], on_substrate)


@pytest.mark.parametrize("name", ["mirrored", "moved"])
def test_elsewhere_up_to_the_growth_of_rounding(in_box, name):
    """Turned at random; mirrored too, or moved and in units that are no powers of two."""
    rng = np.random.default_rng(8)
    turn, shift = random_rotation(rng), 5 * rng.normal(size=3) * SIDE
    setting = {
        "mirrored": Setting(turn=-turn, ground=False),
        "moved": Setting(turn, shift, (0.3, 7.0, 11.0), ground=False),
    }[name]
    assert np.abs(setting.run()[0] - in_box)[:, :3].max() < 1e-10 * R


def test_in_a_moving_frame():
    """A cloud without walls, seen at rest and flying many times faster than it stirs."""
    setup, boost = Setting(ground=False, walls=False).scene(), np.array([3.0, -2.0, 1.0])
    sim, ends, velocity = dem.Simulation(setup, dt=DT), [], setup.spheres.velocity
    for wind in (0, boost):
        restart(sim, velocity=velocity + wind, omega=setup.spheres.omega)
        sim.run(steps=STEPS)
        ends.append(sim.particles.position - STEPS * DT * wind)
    assert np.abs(ends[1] - ends[0]).max() < 1e-10 * R
    assert np.abs(ends[0] - setup.spheres.position - STEPS * DT * velocity).max() > 0.1 * R
