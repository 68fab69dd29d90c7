"""What each contact law costs per step, relative to Hertz without friction.

All laws see the same bed and the same contacts: the step is a thousandth of a usual one, so that
nothing moves that would under other forces, and contacts stay (left to itself, the bed expands
under one law and gives way under another: half of the contacts, half of the cost).  Short pieces
of all laws alternate, each between two of Hertz; a figure is the median over the rounds of the
ratio to the mean of these two.  One thread's pieces are timed by the processor time that they take,
which says little of what else the machine does.
"""

import argparse
import dataclasses
import statistics
import time
from collections.abc import Callable, Iterator

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks.report import Figure

RUBS = dem.Mindlin(beds.FRICTION)
HERTZ = dem.Hertz(beds.RESTITUTION)
JKR = dem.JKR(work_of_adhesion=1e-3, restitution=beds.RESTITUTION)
EEPA = dem.EEPA(beds.RESTITUTION, stiffness_ratio=3.0, surface_energy=1e-3)
LAWS = {
    "Hertz": dem.Law(HERTZ),
    "Hooke": dem.Law(dem.Hooke(1e4, beds.RESTITUTION)),
    "JKR": dem.Law(JKR),
    "EEPA": dem.Law(EEPA),
    "Hertz, Mindlin": dem.Law(HERTZ, RUBS),
    "Hertz, Mindlin, CDT": dem.Law(HERTZ, RUBS, dem.CDT(0.05)),
    "Hertz, Mindlin, CDT spring": dem.Law(HERTZ, RUBS, dem.CDT(0.05, regularization="spring")),
    "JKR, Mindlin, CDT-JKR": dem.Law(JKR, RUBS, dem.CDTJKR()),
    "EEPA, Mindlin, CDT": dem.Law(EEPA, RUBS, dem.CDT(0.05)),
}
MOST = 2.0  # times what a law takes the place of, or is added to
ADDED_TO = {"Hertz, Mindlin, CDT": "Hertz, Mindlin", "Hertz, Mindlin, CDT spring": "Hertz, Mindlin"}
TIME_STEP = 1e-3 * beds.TIME_STEP


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=10_000)
    parser.add_argument("--laws", nargs="+", choices=LAWS, help="besides Hertz; all unless given")
    parser.add_argument("--rounds", type=int, default=25, help="pieces of each law")
    parser.add_argument("--seconds", type=float, default=0.04, help="length of a piece of Hertz")
    parser.add_argument("--driver", default="serial", help="serial, team, parallel or auto")
    parser.add_argument("--no-balance", action="store_true", help="without the books of losses")


def run(options: argparse.Namespace) -> list[Figure]:
    """All laws in turn, on the same bed at rest."""
    bed = beds.scene(beds.settled(options.particles))
    simulations = {
        name: dem.Simulation(
            dataclasses.replace(bed, law=law),
            dt=TIME_STEP,
            driver=options.driver,
            energy_balance=not options.no_balance,
        )
        for name, law in LAWS.items()
        if name in ("Hertz", *(options.laws or LAWS))
    }
    clock = time.process_time if options.driver == "serial" else time.perf_counter
    for simulation in simulations.values():
        _cost(simulation, 50, clock)
    hertz, *others = simulations
    steps = max(int(options.seconds / _cost(simulations[hertz], 50, clock)), 2)
    alone, ratios = [], {name: [] for name in others}
    for _ in range(options.rounds):
        alone.append(_cost(simulations[hertz], steps, clock))
        for name in others:
            cost = _cost(simulations[name], steps, clock)
            alone.append(_cost(simulations[hertz], steps, clock))
            ratios[name].append(cost / statistics.mean(alone[-2:]))
    contacts = {len(simulation.contacts()) for simulation in simulations.values()}
    print(f"{steps} steps a piece; touching contacts: {sorted(contacts)}")
    return [
        Figure.median("Hertz: a step", [1e6 * cost for cost in alone], "us"),
        *(figure for name in others for figure in _figures(name, ratios)),
    ]


def _figures(name: str, ratios: dict[str, list[float]]) -> Iterator[Figure]:
    """The cost of a law over Hertz, and over the law that it is added to."""
    one = name.count(",") == 0 or name == "Hertz, Mindlin"
    target = {"at_most": MOST} if one else {}
    yield Figure.median(f"{name}, over Hertz", ratios[name], "", **target)
    if (base := ADDED_TO.get(name)) in ratios:
        added = [own / other for own, other in zip(ratios[name], ratios[base], strict=True)]
        yield Figure.median(f"{name}, over {base}", added, "", at_most=MOST)


def _cost(simulation: dem.Simulation, steps: int, clock: Callable[[], float]) -> float:
    """Seconds of a step."""
    start = clock()
    simulation.run(steps=steps)
    return (clock() - start) / steps
