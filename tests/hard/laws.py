"""Laws that stick, yield and resist rolling, in the states that break them."""

import numpy as np

import taichi_dem as dem
from tests.hard.beds import DOWN, FLOOR, R, box, poured, weight_energy
from tests.hard.impacts import GLASS, closing_energy, head_on
from tests.hard.kit import Figure, energy, finite, hard, kinetic, wobble
from tests.taichi_dem.setups import scene

SOFT = dem.Material("soft", density=1000, youngs_modulus=1e6, poissons_ratio=0.3)
RUBS = dem.Mindlin(0.5)


def gained(before, sim):
    """Kinetic energy out of a collision over that which went in."""
    return Figure("kinetic energy gained", kinetic(sim) / before - 1, wobble(sim))


@hard("sticky spheres that meet at {} m/s", 1e-3, 0.3)
def sticky(setting, speed):
    """Slow ones stay together, fast ones part; surfaces that come into touch gain their energy."""
    work = 0.05
    law = dem.Law(dem.JKR(work, 0.7))
    radius = (R, R)
    position = np.array([[0.0, 0.0, 0.0], [2.001 * R, 0.0, 0.0]])
    velocity = np.array([[0.5 * speed, 0.0, 0.0], [-0.5 * speed, 0.0, 0.0]])
    sim = setting.simulation(scene(position, radius, SOFT, velocity=velocity, law=law))
    before, lost = kinetic(sim), [0.0]
    for _ in range(40):
        sim.run(steps=50)
        lost.append(sim.energy()["dissipated"])
    # Both surfaces at their equilibrium hold about W times the area they share.
    held = work * np.pi * (9 * np.pi * work * R**2 / 4 / (2 * 5.5e5)) ** (2 / 3)
    yield finite(sim)
    yield energy(sim, before + held, wobble(sim))
    yield Figure("contacts that should not be", float(len(sim.contacts()) != (speed < 0.01)), 0)
    yield Figure("energy given back by dashpots", -np.diff(lost).min() / (before + held), 1e-3)


@hard("spheres that come close, and do not stick before they touch")
def near_miss(setting):
    law = dem.Law(dem.JKR(0.1, 0.5))
    position = np.array([[0.0, 0.0, 0.0], [2.0 * R * (1 + 1e-9), 0.0, 0.0]])
    sim = setting.simulation(scene(position, R, SOFT, law=law))
    sim.run(steps=200)
    yield Figure("contacts made by mere nearness", float(len(sim.contacts())), 0)
    yield Figure("speed", np.abs(sim.particles.velocity).max(), 0)


@hard("EEPA impact, stiffness ratio {}", 1.0, 10.0, 1e3)
def eepa(setting, ratio):
    law = dem.Law(dem.EEPA(0.7, ratio))
    sim, parting, *_ = head_on(setting, laws=law)
    yield finite(sim)
    yield energy(sim, closing_energy(sim, 0.5), wobble(sim))
    yield Figure("rebound over impact", parting / 0.5, 0.7 + np.pi / 40)
    if ratio < 100:  # or the dent is so stiff that what is left of the speed is damped out in it
        yield Figure("did not part", float(len(sim.contacts())), 0)


@hard("EEPA impact, {}", "surface energy", "pull-off force alone", "exponent 1", "c below d")
def eepa_adhesion(setting, kind):
    options = {
        "surface energy": {"surface_energy": 2.0},
        "pull-off force alone": {"pull_off_force": -1e-5},
        "exponent 1": {"overlap_exponent": 1.0, "surface_energy": 2.0},
        "c below d": {"adhesion_exponent": 0.5, "surface_energy": 2.0},
    }[kind]
    law = dem.Law(dem.EEPA(0.7, 5.0, **options), RUBS)
    position = np.array([[0.0, 0.0, 0.0], [2.001 * R, 0.1 * R, 0.0], [1.0 * R, -1.8 * R, 0.0]])
    velocity = np.array([[0.25, 0.0, 0.0], [-0.25, 0.0, 0.0], [0.0, 0.2, 0.0]])
    sim = setting.simulation(scene(position, R, GLASS, velocity=velocity, law=law))
    before, lost = kinetic(sim), [0.0]
    for _ in range(40):
        sim.run(steps=40)
        lost.append(sim.energy()["dissipated"])
    yield finite(sim)
    yield energy(sim, before, wobble(sim))
    yield Figure("energy given back", -np.diff(lost).min() / before, 1e-3)
    yield gained(before, sim)


@hard("{} spheres roll out on a floor and lie still", "CDT", "CDTJKR", "spring")
def rolling_out(setting, kind):
    """Coulomb's rule chatters at rest unless the torque may stop a sphere, but not turn it back."""
    normal = dem.JKR(0.02, 0.3) if kind == "CDTJKR" else dem.Hertz(0.3)
    rolling = {
        "CDT": dem.CDT(0.1),
        "CDTJKR": dem.CDTJKR(adhesion_hysteresis=3.0),
        "spring": dem.CDT(0.1, False, "spring", rolling_damping=0.5),
    }[kind]
    law = dem.Law(normal, RUBS, rolling)
    rolls = scene(
        [[0.0, 0.0, 0.999 * R], [0.0, 5 * R, 0.999 * R]],
        R,
        SOFT,
        velocity=[[0.05, 0.0, 0.0], [-0.02, 0.03, 0.0]],
        omega=[[0.0, 50.0, 0.0], [-30.0, -20.0, 0.0]],
        law=law,
        boundaries=[dem.Plane((0, 0, 0), (0, 0, 1), SOFT)],
        gravity=DOWN,
    )
    sim = setting.simulation(rolls)
    before = kinetic(sim)
    sim.run(duration=0.4)
    yield finite(sim)
    yield energy(sim, before, wobble(sim))
    yield Figure("kinetic energy left", kinetic(sim) / before, 1e-12)


@hard("a bed of {} spheres falls", "JKR and CDT-JKR", "EEPA and CDT")
def powders(setting, kind):
    laws = {
        "JKR and CDT-JKR": dem.Law(dem.JKR(0.05, 0.5), RUBS, dem.CDTJKR(adhesion_hysteresis=1.5)),
        "EEPA and CDT": dem.Law(
            dem.EEPA(0.5, 5.0, surface_energy=1.0, pull_off_force=-1e-6), RUBS, dem.CDT(0.05)
        ),
    }
    position, radius = poured(40, ("uniform", 0.7 * R, R), 8 * R, 10 * R)
    bed = scene(position, radius, SOFT, law=laws[kind], boundaries=[box(8 * R)], gravity=DOWN)
    sim = setting.simulation(bed)
    scale = weight_energy(sim)
    sim.run(duration=0.15)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))


@hard("a sticky sphere hangs from a floor turned upside down")
def hanging(setting):
    """Held past zero overlap against its weight, over many rebuilds forced by a neighbour."""
    law = dem.Law(dem.JKR(0.05, 0.2), RUBS)
    position = [[0.0, 0.0, -0.9995 * R], [4 * R, 0.0, -6 * R]]
    ceiling = dem.Plane((0, 0, 0), (0, 0, -1), SOFT)
    held = scene(
        position,
        R,
        SOFT,
        velocity=[[0, 0, 0], [2.0, 0, 0]],
        law=law,
        boundaries=[ceiling],
        gravity=DOWN,
    )
    sim = setting.simulation(held)
    sim.run(duration=0.1)
    weight = float(sim.particles.mass[0] * 9.81)
    yield finite(sim)
    yield Figure("pull-off below the weight: no test", weight, 1.5 * np.pi * 0.05 * R)
    hangs = sim.contacts()["j"] == -2
    yield Figure("fell", float(not hangs.any()), 0)
    pull = float(-sim.contacts()["force"][hangs][:, 2].sum()) if hangs.any() else np.nan
    yield Figure("pull over weight, error", abs(pull / -weight - 1), 1e-6)


@hard("a sticky sphere is drawn off slowly across list rebuilds", seldom=True)
def drawn_off(setting):
    """Between two walls that part, along the whole branch past zero overlap: the largest pull is
    3/2 pi W R, and what it falls short by is the square of the step between two looks.

    Of the way to pull-off, p in units of t_m^4 and u = t^3/t_m^3, F is u^2 - 6 u and p = u^(4/3) -
    4 u^(1/3): near u = 3 the pull falls by 0.61 ((d - d_most)/d_c)^2, d_c = 3 a_m^2/R.
    """
    work, speed, look = 0.05, 2e-3, 4
    modulus = SOFT.youngs_modulus / (2 * (1 - SOFT.poissons_ratio**2))
    least = (np.pi * work * R**2 / (8 * modulus)) ** (1 / 3)  # a_m
    reach, most = 3 * least**2 / R, 1.5 * np.pi * work * R
    overlap = (6 ** (4 / 3) - 4 * 6 ** (1 / 3)) * reach / 3  # where they carry nothing
    walls = [
        dem.Plane((0, 0, 0), (0, 0, 1), SOFT),
        dem.Plane((0, 0, 2 * (R - overlap)), (0, 0, -1), SOFT, velocity=(0, 0, speed)),
    ]
    pulled = scene(
        [[0, 0, R - overlap], [5 * R, 0, R - overlap]],  # the other flies by, and makes lists stale
        [R, 0.5 * R],
        SOFT,
        velocity=[[0, 0, speed / 2], [2.0, 0, 0]],
        law=dem.Law(dem.JKR(work, 1.0)),
        boundaries=walls,
    )
    sim = setting.simulation(pulled)
    pulls, rebuilds = [], []
    while len(sim.contacts()) and sim.steps < 100_000:
        pulls.append(float(-sim.boundaries[0].force[2]))
        if sim.contacts()["overlap"].max() < 0:
            rebuilds.append(sim.summary()["rebuilds"])
        sim.run(steps=look)
    step = look * sim.dt * speed / 2
    yield finite(sim)
    yield Figure("contacts left", float(len(sim.contacts())), 0)
    yield Figure("lists made anew while held, too few", float(4 - np.ptp(rebuilds)), 0)
    yield Figure("pull beyond pull-off", max(np.abs(pulls)) / most - 1, 1e-9)
    yield Figure("short of pull-off", 1 - max(np.abs(pulls)) / most, (step / reach) ** 2 + 1e-9)


@hard("friction of {} in a stack", 0.0, 10.0)
def stack(setting, friction):
    position = [[0.0, 0.0, R], [0.01 * R, 0.0, 2.999 * R], [0.0, 0.01 * R, 4.998 * R]]
    law = dem.Law(dem.Hertz(0.5), dem.Mindlin(friction))
    pile = scene(position, R, GLASS, law=law, boundaries=[FLOOR], gravity=DOWN)
    sim = setting.simulation(pile)
    scale = weight_energy(sim)
    sim.run(duration=0.1)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
