"""Small grains that slide and roll over large ones, against rigid bodies with Coulomb friction.

A dashpot and a spring of friction that see the velocities of half a step before along the normals
of a whole one are said to hold small grains back on large ones (Vyas et al. 2025).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.integrate import solve_ivp

import taichi_dem as dem
from tests.hard.kit import Figure, energy, finite, hard, wobble
from tests.taichi_dem.setups import law

R, RATIO, G = 1e-3, 10, 9.81
SMALL = R / RATIO
PATH = R + SMALL  # radius of the path of the grain's centre
TIME, SPEED = np.sqrt(PATH / G), np.sqrt(PATH * G)
GRAIN = dem.Material("grain", 2500, 1e7, 0.22)
LARGE = dem.Material("large", 1e5, 1e7, 0.22)  # 4e4 times as heavy: it stays where it is
FLOOR = dem.Plane((0, 0, 0), (0, 0, 1), LARGE)
LOOKS = 10


@dataclass(frozen=True)
class Start:
    """``angle`` from the top, rad; ``speed`` over that of free flight from the top; no spin.  It
    stays on the sphere while it ``lasts``, times TIME."""

    angle: float
    speed: float
    lasts: float


STARTS = {"let go near the top": Start(0.1, 0.0, 2.6), "thrown along the top": Start(0.0, 0.6, 0.8)}


def rigid_grain(start, friction, times):
    """Angle (rad) and speeds along the path and of the surface by spin, both over sqrt(g PATH), of
    a rigid grain at ``times`` (over TIME): it rolls where friction can make it, and slides else."""

    def rates(_, state, smooth=1e-6):
        angle, speed, spin = state
        load = np.cos(angle) - speed**2
        # Coulomb's cone with a steep slope at zero slip, which rolling then finds by itself.
        rubs = friction * load * np.tanh((speed - spin) / smooth)
        return speed, np.sin(angle) - rubs, 2.5 * rubs

    found = solve_ivp(
        rates,
        (0, times[-1]),
        (start.angle, start.speed, 0.0),
        method="LSODA",
        t_eval=times,
        rtol=1e-9,
        atol=1e-11,
    )
    return found.y


def depth(load, radius):
    """m, of Hertz' contact of two of these materials, by the effective ``radius``."""
    modulus = GRAIN.youngs_modulus / (2 * (1 - GRAIN.poissons_ratio**2))
    return (load / (4 / 3 * modulus * np.sqrt(radius))) ** (2 / 3)


def laid(start, friction):
    """The large sphere on a floor and the grain on it, both as deep as they weigh, and how deep the
    grain's contact is (m).  Strongly damped, as that is what is said to trap it."""
    weight = G * 4 / 3 * np.pi * np.array([LARGE.density * R**3, GRAIN.density * SMALL**3])
    sunk = depth(weight[0], R)
    pressed = depth(weight[1] * (np.cos(start.angle) - start.speed**2), 1 / (1 / R + 1 / SMALL))
    out = np.array([np.sin(start.angle), 0.0, np.cos(start.angle)])
    along = np.array([np.cos(start.angle), 0.0, -np.sin(start.angle)])
    large = np.array([0.0, 0.0, R - sunk])
    spheres = dem.Spheres(
        np.array([large, large + (PATH - pressed) * out]),
        [R, SMALL],
        [LARGE, GRAIN],
        np.array([0 * along, start.speed * SPEED * along]),
    )
    laws, gravity = law(0.1, friction), (0.0, 0.0, -G)
    return dem.Scene(spheres=spheres, law=laws, boundaries=[FLOOR], gravity=gravity), pressed


def seen(sim, start, fineness):
    """The grain as :func:`rigid_grain` has it, at ``fineness`` times the stable number of steps."""
    lasts = start.lasts * TIME / LOOKS
    steps = fineness * int(np.ceil(lasts / sim.stable.value))
    sim.restart(dt=lasts / steps)
    found = []
    for _ in range(LOOKS):
        sim.run(steps=steps)
        now = sim.particles
        place = now.position[1] - now.position[0]
        speed, spin = np.linalg.norm(now.velocity[1]), now.omega[1, 1] * SMALL
        found.append((np.arctan2(place[0], place[2]), speed / SPEED, spin / SPEED))
    return np.transpose(found)


@hard("a small grain {0[0]} of a large one, friction {0[1]}", *product(STARTS, (0.1, 0.5)))
def trapped(setting, what):
    """It must be as far, as fast and spin as fast as a rigid grain, but for the depth of its
    contact; the error said to trap it is that of normals which turn by v dt / 2 PATH in half a
    step, by no more than which the step may matter."""
    name, friction = what
    start = STARTS[name]
    times = np.linspace(0, start.lasts, LOOKS + 1)
    expected = rigid_grain(start, friction, times)[:, 1:]
    scene, pressed = laid(start, friction)
    sim = setting.simulation(scene)
    coarse = seen(sim, start, 1)
    yield finite(sim)
    fallen = sim.particles.mass[1] * G * R
    yield energy(sim, fallen, wobble(sim))
    turned = 0.5 * sim.dt / TIME * coarse[1].max()
    for part, error in zip(("angle", "speed", "spin"), np.abs(coarse - expected), strict=True):
        yield Figure(f"{part}, error", float(error.max()), pressed / SMALL + turned)
    halved = np.abs(seen(sim, start, 2) - coarse).max()
    yield Figure("difference of half the step", float(halved), turned)
