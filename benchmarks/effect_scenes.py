"""The standard scenes on which the cost of effects is measured, and what is measured beside them.

A bed of spheres on a hard floor; a bed on soft ground; a powder pressed by a piston. Most effects
are in one of them. Those that exclude others, or want another state, are measured beside them.
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterator

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks import sleeping_bed
from taichi_dem.cost import Cost, measure, measure_pair

RUBS, ROLLS = dem.Mindlin(beds.FRICTION), dem.CDT(0.05, regularization="spring")
STICKY = dem.JKR(work_of_adhesion=1e-3, restitution=beds.RESTITUTION)
PRESSED = 0.05  # of the largest radius: how far the piston has come down when it is timed
SPEED = 0.02  # m/s, of the piston
GROUNDS = {
    "lagged exchange": dem.Substrate(beds.GEL, exchange="lagged", force_lagged=True),
    "extrapolated exchange": dem.Substrate(beds.GEL, exchange_every=4),
    "layer": dem.Substrate(beds.GEL, layer=dem.Layer(10 * beds.RADIUS)),
    "relaxation": dem.Substrate(
        beds.GEL, coupling="point", relaxation=dem.Relaxation(beds.GEL.youngs_modulus / 2, 0.01)
    ),
}
FALLS_ASLEEP = 200_000  # steps, at most
NOT_THERE = {  # beside what the scenes themselves say
    ("sleep", "soft ground"): "refused: a load elsewhere dents the ground under those asleep",
    ("sleep", "powder"): "nothing rests",
    ("period", "powder"): "the piston goes on: no two turns would be alike",
}


def bed(options: argparse.Namespace, repeats: bool = False) -> dem.Simulation:
    """Spheres at rest on a floor, whose contacts rub, roll and feel each other."""
    law = dem.Law(dem.Hertz(beds.RESTITUTION), RUBS, ROLLS, dem.MultiContact())
    given = beds.scene(beds.settled(options.particles, repeats=repeats))
    return _simulation(dataclasses.replace(given, law=law), options)


def soft_ground(options: argparse.Namespace, repeats: bool = False) -> dem.Simulation:
    """Spheres at rest on an elastic half-space, about a fifth of them in touch with it."""
    found = beds.settled_on_gel(options.on_gel, options.on_gel // 5, repeats=repeats)
    law = dem.Law(dem.Hertz(beds.RESTITUTION), RUBS, ROLLS)
    return _simulation(dataclasses.replace(beds.scene(found), law=law), options)


def powder(options: argparse.Namespace, repeats: bool = False) -> dem.Simulation:
    """Sticky spheres under a piston on its way down."""
    given = beds.scene(beds.settled(options.particles, repeats=repeats))
    top = float((given.spheres.position[:, 2] + given.spheres.radius).max())
    piston = dem.Piston((0, 0, top), (0, 0, -1), beds.GLASS, velocity=SPEED)
    law = dem.Law(STICKY, RUBS, ROLLS)
    scene = dataclasses.replace(given, law=law, boundaries=(*given.boundaries, piston))
    sim = _simulation(scene, options)
    sim.run(duration=PRESSED * beds.RADIUS / SPEED)
    return sim


SCENES: dict[str, Callable[..., dem.Simulation]] = {
    "bed": bed,
    "soft ground": soft_ground,
    "powder": powder,
}


def beside(name: str, options: argparse.Namespace) -> Iterator[Cost]:
    """The costs of effects that the scene of that name could have and has not."""
    turns = options.rounds, options.seconds
    if name != "powder":
        periodic, walled = (SCENES[name](options, repeats) for repeats in (True, False))
        yield measure_pair("period", periodic, walled, *turns)
    if name == "bed":
        yield measure_pair("sleep", *_asleep_and_awake(options), *turns)
    if name == "soft ground":
        scene = soft_ground(options).scene
        for effect, ground in GROUNDS.items():
            given = _simulation(dataclasses.replace(scene, substrate=ground), options)
            yield from measure(given, *turns, only=[effect])


def _asleep_and_awake(options: argparse.Namespace) -> tuple[dem.Simulation, dem.Simulation]:
    """The bed without multi-contact, which does not go with sleep; all of it asleep, and without
    sleep."""
    given = beds.scene(beds.settled(options.particles))
    tired, awake = (
        _simulation(dataclasses.replace(given, law=sleeping_bed.LAW, sleep=sleep), options)
        for sleep in (True, False)
    )
    sleeping_bed.wait(tired, FALLS_ASLEEP)
    return tired, awake


def _simulation(scene: dem.Scene, options: argparse.Namespace) -> dem.Simulation:
    return dem.Simulation(scene, beds.TIME_STEP, driver=options.driver)
