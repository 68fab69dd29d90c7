"""Contacts on the elastic half-space: none, one, many, wide, fast, and far too soft ground."""

import numpy as np

import taichi_dem as dem
from tests.hard.impacts import GLASS
from tests.hard.kit import DRIVERS, TEAM, Figure, energy, finite, hard, wobble
from tests.hard.late_surfaces import LateSurfaces
from tests.taichi_dem.setups import law, scene

R = 1e-3
GEL = dem.Material("gel", density=1050, youngs_modulus=2e5, poissons_ratio=0.49)
BOTH = ("implicit", "lagged")
ALL = (*BOTH, "every 2")
DRIVEN = (*DRIVERS, TEAM)  # whose members share the solve


def resting(position, material=GEL, depth=0.02, **rest):
    """Spheres ``depth`` radii deep in the ground at ``position`` (n, 2), in radii."""
    position = np.asarray(position, dtype=float)
    height = np.full((len(position), 1), 1 - depth)
    rest.setdefault("law", law(1.0))
    ground = dem.Substrate(material)
    return scene(R * np.hstack([position, height]), R, GLASS, substrate=ground, **rest)


def square(n, spacing=2.1):
    return spacing * np.stack(np.meshgrid(*[np.arange(n)] * 2), axis=-1).reshape(-1, 2)


def accounted(sim, steps, scale):
    """Run so far; that no energy (over ``scale``, J) is made but the work of a lagged surface."""
    late = LateSurfaces(sim)
    if sim.scene.substrate.exchange != "lagged":
        sim.run(steps=steps)
        return energy(sim, scale, wobble(sim))
    start = without_surface(sim)
    late.run(steps)
    made = without_surface(sim) - start - late.work
    return Figure("energy unaccounted for", abs(made) / max(scale, abs(late.work)), wobble(sim))


def without_surface(sim):
    """J, of spheres and contacts, and what those have lost."""
    parts = sim.energy()
    return sum(parts.get(name, 0.0) for name in ("kinetic", "normal", "tangential", "dissipated"))


@hard("no contact on the ground", exchanges=ALL)
def no_contact(setting):
    sim = setting.simulation(resting(square(2), depth=-0.1))
    sim.run(steps=50)
    yield finite(sim)
    yield Figure("force, N", np.abs(sim.particles.force).max(), 0)


@hard("one contact on the ground", exchanges=ALL)
def one_contact(setting):
    """It has nobody to feel: no expansion, and the energy of Hertz alone."""
    sim = setting.simulation(resting([[0.0, 0.0]]))
    before = sim.energy()["normal"]
    sim.run(steps=300)
    yield finite(sim)
    expansion = np.abs(sim.substrate.expansion).max(initial=0.0)
    yield Figure("expansion, radii", float(expansion / R), 0)
    yield energy(sim, before, wobble(sim))


@hard("two contacts {:.0e} radii apart", 1e6, exchanges=ALL)
def far_apart(setting, distance):
    """They feel each other by 1e-6 of the depth, and each is as deep as if it were alone."""
    pair = setting.simulation(resting([[0.0, 0.0], [distance, 0.0]]))
    alone = setting.simulation(resting([[0.0, 0.0]]), dt=pair.dt)
    for sim in (pair, alone):
        sim.run(steps=100)
    yield finite(pair)
    difference = pair.particles.velocity[0, 2] / alone.particles.velocity[0, 2] - 1
    yield Figure("difference to one alone", abs(difference), 1e-5)


@hard("a cluster on the ground with one far outlier", exchanges=ALL)
def outlier(setting):
    position = np.vstack([square(4), [[1e5, -1e5]]])
    sim = setting.simulation(resting(position, depth=0.005))
    scale = sim.energy()["normal"] + sim.energy().get("substrate", 0.0)
    sim.run(steps=200)
    yield finite(sim)
    if setting.exchange == "implicit":
        yield energy(sim, scale, wobble(sim))


@hard("all contacts on the ground lost and made in one step", exchanges=ALL, drivers=DRIVEN)
def lost_and_made(setting):
    """Spheres that bounce together: the solve starts from nothing each time."""
    sim = setting.simulation(resting(square(3), depth=-0.02, velocity=(0.0, 0.0, -0.05)))
    before, touched, changes = sim.energy()["kinetic"], False, 0
    for _ in range(150):
        sim.run(steps=20)
        now = len(sim.substrate.force) > 0
        changes, touched = changes + (now != touched), now
        if touched and changes == 1:
            pressed = sim.energy()["kinetic"]
    yield finite(sim)
    yield Figure("impacts missed", float(changes < 2), 0)
    yield energy(sim, before, wobble(sim))
    yield Figure("kinetic energy while pressed, gained", pressed / before - 1, wobble(sim))


@hard(
    "7x7 undamped spheres on soft ground, {} steps a half period",
    *(50, 400),
    exchanges=ALL,
    drivers=DRIVEN,
)
def seven_by_seven(setting, fineness):
    """Where the lagged exchange gains more energy than there is, the others stay bounded."""
    laid = resting(square(7, 2.02), depth=0.03)
    sim = setting.simulation(laid)
    sim = setting.simulation(laid, dt=sim.dt * 20 / fineness)
    sim.run(steps=1)
    scale = sim.energy()["normal"] + sim.energy()["substrate"]
    start = without_surface(sim)
    sim.run(steps=1200)
    yield finite(sim)
    if setting.exchange == "lagged":  # which is why it is not the default
        gain = (without_surface(sim) - start) / scale
        yield Figure("energy of the start over that gained", 1 / gain if gain > 0 else np.inf, 1)
    else:
        yield energy(sim, scale, wobble(sim))


@hard("impact at half the wave speed of the ground", exchanges=(*ALL, "none"))
def fast_impact(setting):
    """Not quasi-static: it runs, and says so (but where the ground is a mere plane)."""
    speed = 0.5 * np.sqrt(GEL.youngs_modulus / (2 * 1.49) / GEL.density)
    fast = resting([[0.0, 0.0]], depth=-0.05, velocity=(0, 0, -speed))
    sim = setting.simulation(fast, max_overlap=1.0)
    before = sim.energy()["kinetic"]
    sim.run(steps=100)
    yield finite(sim)
    yield energy(sim, before, wobble(sim))
    if setting.exchange != "none":
        yield Figure("no warning", float("fast_impacts" not in sim.warnings), 0)


@hard("contacts wider than 0.3 radii", exchanges=ALL)
def wide(setting):
    sim = setting.simulation(resting([[0.0, 0.0]], depth=0.12))
    before = sim.energy()["normal"]
    sim.run(steps=200)
    yield finite(sim)
    yield energy(sim, before, wobble(sim))
    yield Figure("no warning", float("wide_contacts" not in sim.warnings), 0)


@hard("ground of {:.0e} Pa", 1e2, 1e12, exchanges=ALL)
def moduli(setting, modulus):
    """Spheres of 50 MPa on it: who is softer changes nothing in how it is computed."""
    soil = dem.Material("soil", 1000, modulus, 0.3)
    sim = setting.simulation(resting(square(3), soil, depth=0.005))
    scale = sim.energy()["normal"] + abs(sim.energy()["substrate"])
    yield accounted(sim, 300, scale)
    yield finite(sim)


@hard("ground of Poisson's ratio {}", 0.0, 0.5, exchanges=ALL)
def poisson(setting, ratio):
    soil = dem.Material("soil", 1000, 2e5, ratio)
    sim = setting.simulation(resting(square(3), soil, depth=0.01))
    scale = sim.energy()["normal"] + abs(sim.energy()["substrate"])
    yield accounted(sim, 300, scale)
    yield finite(sim)


@hard("spheres whose contacts on the ground overlap", exchanges=ALL)
def crowded(setting):
    """Large spheres with a small one between them, nearer to them than its own contact is wide."""
    position = R * np.array([[0.0, 0.0, 0.98], [1.98, 0.0, 0.98], [0.99, 0.0, 0.049]])
    radius = R * np.array([1.0, 1.0, 0.05])
    crowd = scene(position, radius, GLASS, law=law(0.8), substrate=dem.Substrate(GEL))
    sim = setting.simulation(crowd)
    parts = sim.energy()
    scale = parts["normal"] + abs(parts["substrate"])
    yield accounted(sim, 500, scale)
    yield finite(sim)


@hard(
    "spheres so deep in the ground that their contacts cover each other",
    exchanges=ALL,
    seldom=True,
)
def covering(setting):
    """Wider than the distance between them: coincident, for what the surface can tell."""
    triangle = 1.56 / np.sqrt(3) * np.array([(np.cos(t), np.sin(t)) for t in (0.0, 2.1, 4.2)])
    sim = setting.simulation(resting(triangle, depth=0.95, law=law(0.5)), max_overlap=1.0)
    parts = sim.energy()
    scale = parts["normal"] + abs(parts["substrate"])
    widest = sim.substrate.contact_radius.max() / R
    yield Figure("distance over the widest contact", 1.56 / (2 * widest), 1)
    yield accounted(sim, 300, scale)
    yield finite(sim)


@hard("a sphere that rolls over the ground's dents", exchanges=("implicit",))
def rolling(setting):
    """Past others that press it: the lateral force takes and gives back the same energy."""
    position = [[0.0, 0.0], [2.2, 2.05], [4.0, -2.05], [6.5, 2.05]]
    velocity = np.zeros((4, 3))
    velocity[0, 0] = 0.2
    sim = setting.simulation(resting(position, depth=0.02, velocity=velocity))
    parts = sim.energy()
    scale = parts["kinetic"] + parts["normal"]
    sim.run(steps=2000)
    yield finite(sim)
    yield energy(sim, scale, wobble(sim))
