"""Speed on a settled bed, against LIGGGHTS and LAMMPS on the same spheres.

Ours and theirs run in turns, several times; the figures are medians, and the ratios are those of
the turns.  Peers run with the best of a few skins, and ours without the sums of what is lost, which
they do not have (``--energy-balance`` makes them).  The contacts and the kinetic energy that each
code ends with say whether they computed the same bed.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks import peers
from benchmarks.others import undisturbed
from benchmarks.report import Figure

LEAST_RATIO = 1.4  # to LIGGGHTS on two ranks, from a thousand particles up
LEAST_SPEED = 15.0  # million particle-steps per second with a hundred particles on one core
SKINS = (0.025, 0.05, 0.1, 0.2)  # diameters, that peers are tried with
WARM_UP = 1e7  # particle-steps, at most, before anything is timed
GUESS = 5e6  # particle-steps per second, before anything is measured


def add_options(parser: argparse.ArgumentParser) -> None:
    counts = [100, 1000, 10_000, 100_000]
    parser.add_argument("-n", "--particles", type=int, nargs="+", default=counts)
    parser.add_argument("--peers", nargs="*", choices=list(peers.BINARIES), default=["liggghts"])
    parser.add_argument("--ranks", type=int, default=2, help="MPI ranks of the peers")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each code")
    parser.add_argument("--seconds", type=float, default=3.0, help="length of a turn")
    parser.add_argument("--patience", type=float, default=60.0, help="s to wait for a quiet turn")
    parser.add_argument("--warm-up", type=int, default=1000, help="untimed steps, at most")
    parser.add_argument("--energy-balance", action="store_true", help="sum up what is lost")
    parser.add_argument("--driver", choices=["auto", "serial", "team", "parallel"], default="auto")


def run(options: argparse.Namespace) -> list[Figure]:
    """Every size in turn."""
    return [figure for count in options.particles for figure in _one_size(count, options)]


def _one_size(count: int, options: argparse.Namespace) -> list[Figure]:
    bed = beds.settled(count)
    warm_up = min(options.warm_up, max(1, int(WARM_UP / count)))
    here = _Ours(bed, warm_up, options)
    others = [_Peer(code, bed, warm_up, options) for code in options.peers if peers.available(code)]
    codes: list[_Ours | _Peer] = [here, *others]
    for code in codes:
        code.speed(int(0.3 * GUESS * options.seconds / count) + 1)
    steps = [int(max(code.last, GUESS) * options.seconds / count) + 1 for code in codes]
    turns, disturbed = [], []
    for _ in range(options.rounds):
        turn, others = undisturbed(
            lambda: [code.speed(n) for code, n in zip(codes, steps, strict=True)],
            options.patience,
        )
        turns.append(turn)
        disturbed.append(others)
    figures = _figures(count, codes, turns)
    print(f"{count:7d} spheres: others used {statistics.median(disturbed):.2f} cores meanwhile")
    for code, n, figure in zip(codes, steps, figures, strict=False):
        contacts, energy = code.state()
        print(
            f"{count:7d} {code.name:9s} {figure.value:.4g} M/s, {n} steps a turn, {code.how()}: "
            f"{contacts:.0f} contacts of spheres, coordination {2 * contacts / count:.4f}, "
            f"kinetic energy {energy:.3g} J"
        )
    return figures


def _figures(count: int, codes: list, turns: list[list[float]]) -> list[Figure]:
    """Speeds of every code, and ratios of ours to the others, turn by turn."""
    target = {"at_least": LEAST_SPEED} if count == 100 else {}
    figures = []
    for column, code in enumerate(codes):
        speeds = [turn[column] / 1e6 for turn in turns]
        limit = target if column == 0 else {}
        what = f"{count} spheres, {code.name}"
        figures.append(Figure.median(what, speeds, "million particle-steps/s", **limit))
    for column, code in enumerate(codes[1:], start=1):
        ratios = [turn[0] / turn[column] for turn in turns]
        limit = {}
        if code.name == "liggghts" and code.ranks == 2 and count >= 1000:
            limit = {"at_least": LEAST_RATIO}
        figures.append(Figure.median(f"{count} spheres, ours / {code.name}", ratios, "", **limit))
    return figures


class _Ours:
    """This code: one simulation that goes on from turn to turn."""

    name = "ours"

    def __init__(self, bed: beds.Bed, warm_up: int, options: argparse.Namespace):
        self.count = bed.count
        self.simulation = dem.Simulation(
            beds.scene(bed),
            dt=beds.TIME_STEP,
            driver=options.driver,
            energy_balance=options.energy_balance,
        )
        self.simulation.run(steps=warm_up)
        self.last = GUESS

    def speed(self, steps: int) -> float:
        """Particle-steps per second."""
        start = time.perf_counter()
        self.simulation.run(steps=steps)
        self.last = self.count * steps / (time.perf_counter() - start)
        return self.last

    def state(self) -> tuple[float, float]:
        """Contacts between spheres, and the kinetic energy (J)."""
        between = self.simulation.contacts()["j"] >= 0
        return float(between.sum()), self.simulation.energy()["kinetic"]

    def how(self) -> str:
        summary = self.simulation.summary()
        skin = summary["skin_m"] / (2 * beds.RADIUS)
        return (
            f"{summary['driver']} on {summary['threads']} threads, skin {skin:.3g} d, "
            f"{summary['rebuilds']} rebuilds"
        )


class _Peer:
    """LIGGGHTS or LAMMPS: a process for every turn, from the same state each time."""

    def __init__(self, code: str, bed: beds.Bed, warm_up: int, options: argparse.Namespace):
        self.name, self.count, self.scene = code, bed.count, beds.scene(bed)
        self.ranks, self.warm_up = options.ranks, warm_up
        self.last, self.timing = GUESS, None
        self.skin = 0.0
        trial = int(0.2 * GUESS * options.seconds / bed.count) + 1
        self.skin = _best(SKINS, lambda skin: self._run(skin, trial))

    def speed(self, steps: int) -> float:
        """Particle-steps per second of its time loop, without start and set-up."""
        self.last = self._run(self.skin, steps)
        return self.last

    def _run(self, skin: float, steps: int) -> float:
        width = skin * 2 * beds.RADIUS
        self.timing = peers.run(
            self.name, self.scene, beds.TIME_STEP, steps, self.warm_up, width, self.ranks
        )
        return self.count * steps / self.timing.seconds

    def state(self) -> tuple[float, float]:
        """Contacts between spheres, and the kinetic energy (J)."""
        return self.timing.contacts, self.timing.kinetic_energy

    def how(self) -> str:
        return f"{self.ranks} ranks, skin {self.skin:g} d"


def _best(candidates: tuple[float, ...], speed: Callable[[float], float]) -> float:
    """The candidate of the highest speed in three rounds; a disturbance can only slow it down."""
    trials = [[speed(candidate) for candidate in candidates] for _ in range(3)]
    best = [max(column) for column in zip(*trials, strict=True)]
    return candidates[best.index(max(best))]
