"""What each contact law costs per step, relative to Hertz without friction."""

import argparse
import dataclasses
import time

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
MOST = 2.0  # times Hertz, for a normal law in place of it


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=10_000)
    parser.add_argument("--laws", nargs="+", choices=LAWS, help="besides Hertz; all unless given")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each law")
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a turn")
    parser.add_argument("--driver", default="serial", help="serial, team, parallel or auto")
    parser.add_argument("--no-balance", action="store_true", help="without the books of losses")


def run(options: argparse.Namespace) -> list[Figure]:
    """All laws in turn, on the same bed at rest."""
    bed = beds.scene(beds.settled(options.particles))
    simulations = {
        name: dem.Simulation(
            dataclasses.replace(bed, law=law),
            dt=beds.TIME_STEP,
            driver=options.driver,
            energy_balance=not options.no_balance,
        )
        for name, law in LAWS.items()
        if name in ("Hertz", *(options.laws or LAWS))
    }
    steps = {
        name: max(int(options.seconds / _cost(sim, 50)), 2) for name, sim in simulations.items()
    }
    turns = [
        {name: _cost(sim, steps[name]) for name, sim in simulations.items()}
        for _ in range(options.rounds)
    ]
    figures = [Figure.median("Hertz: a step", [1e6 * turn["Hertz"] for turn in turns], "us")]
    for name in list(simulations)[1:]:
        ratios = [turn[name] / turn["Hertz"] for turn in turns]
        target = {} if "," in name else {"at_most": MOST}
        figures.append(Figure.median(f"{name}, over Hertz", ratios, "", **target))
    return figures


def _cost(simulation, steps: int) -> float:
    """Seconds of a step."""
    start = time.perf_counter()
    simulation.run(steps=steps)
    return (time.perf_counter() - start) / steps
