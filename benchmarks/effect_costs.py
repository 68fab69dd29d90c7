"""What each effect costs per step, on three standard scenes: each with and without it, by turns.

The scenes: a bed of spheres on a hard floor; a bed on soft ground; a powder pressed by a piston.
``--write docs/effects.md`` puts the table between the two marks in that file.
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import taichi_dem as dem
from benchmarks import bed as beds
from benchmarks import report
from benchmarks.report import Figure
from taichi_dem.cost import Cost, measure

BEGIN, END = "<!-- costs -->\n", "<!-- end of costs -->\n"
RUBS, ROLLS = dem.Mindlin(beds.FRICTION), dem.CDT(0.05, regularization="spring")
STICKY = dem.JKR(work_of_adhesion=1e-3, restitution=beds.RESTITUTION)
PRESSED = 0.05  # of the largest radius: how far the piston has come down when it is timed
SPEED = 0.02  # m/s, of the piston


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-n", "--particles", type=int, default=1000, help="bed and powder")
    parser.add_argument("-g", "--on-gel", type=int, default=300, help="on soft ground")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--driver", default="serial", help="serial, team, parallel or auto")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each")
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a turn")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into a document")


def run(options: argparse.Namespace) -> list[Figure]:
    """Every scene in turn."""
    found = {}
    for name in options.scenes:
        sim = SCENES[name](options)
        found[name] = measure(sim, options.rounds, options.seconds)
    if options.write:
        write(options.write, markdown(found))
    return [figure for name, costs in found.items() for figure in figures(name, costs)]


def bed(options: argparse.Namespace) -> dem.Simulation:
    """Spheres at rest on a floor, whose contacts rub, roll and feel each other."""
    law = dem.Law(dem.Hertz(beds.RESTITUTION), RUBS, ROLLS, dem.MultiContact())
    scene = dataclasses.replace(beds.scene(beds.settled(options.particles)), law=law)
    return _simulation(scene, options)


def soft_ground(options: argparse.Namespace) -> dem.Simulation:
    """Spheres at rest on an elastic half-space, about a fifth of them in touch with it."""
    given = beds.scene(beds.settled_on_gel(options.on_gel, options.on_gel // 5))
    law = dem.Law(dem.Hertz(beds.RESTITUTION), RUBS, ROLLS)
    return _simulation(dataclasses.replace(given, law=law), options)


def powder(options: argparse.Namespace) -> dem.Simulation:
    """Sticky spheres under a piston on its way down."""
    given = beds.scene(beds.settled(options.particles))
    top = float((given.spheres.position[:, 2] + given.spheres.radius).max())
    piston = dem.Piston((0, 0, top), (0, 0, -1), beds.GLASS, velocity=SPEED)
    law = dem.Law(STICKY, RUBS, ROLLS)
    sim = _simulation(
        dataclasses.replace(given, law=law, boundaries=(*given.boundaries, piston)), options
    )
    sim.run(duration=PRESSED * beds.RADIUS / SPEED)
    return sim


SCENES: dict[str, Callable[[argparse.Namespace], dem.Simulation]] = {
    "bed": bed,
    "soft ground": soft_ground,
    "powder": powder,
}


def figures(scene: str, costs: list[Cost]) -> list[Figure]:
    """The time of a step, and what it is over that without each effect."""
    (on,) = {cost.on for cost in costs if cost.on}
    return [
        Figure.median(f"{scene}: a step", [1e6 * seconds for seconds in on], "us"),
        *(
            Figure.median(f"{scene}: with over without {cost.name}", cost.ratios, "")
            for cost in costs
            if cost.on
        ),
    ]


def markdown(found: dict[str, list[Cost]]) -> str:
    """A line for each effect, a column for each scene: what it adds to the time of a step."""
    names = list(dict.fromkeys(cost.name for costs in found.values() for cost in costs))
    lines = [["effect", *found], ["---"] * (1 + len(found))]
    for name in names:
        cells = [
            next((_cell(cost) for cost in costs if cost.name == name), "")
            for costs in found.values()
        ]
        lines.append([name, *cells])
    steps = [f"{figures(name, costs)[0].value:.3g} µs" for name, costs in found.items()]
    lines.append(["a step with all of them", *steps])
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"{table}\n\nMeasured on: {report.machine()['processor']}.\n"


def _cell(cost: Cost) -> str:
    if not cost.on:
        return "stopped"
    ratios = sorted(cost.ratios)
    middle = Figure.median("", ratios, "").value
    return f"{middle - 1:+.0%} ({ratios[0] - 1:+.0%} … {ratios[-1] - 1:+.0%})"


def write(path: Path, table: str) -> None:
    """Replace what stands between the marks."""
    before, begin, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"{path} does not have the lines {BEGIN.strip()} and {END.strip()}")
    path.write_text(f"{before}{begin}{table}{end}{after}", encoding="utf-8")


def _simulation(scene: dem.Scene, options: argparse.Namespace) -> dem.Simulation:
    return dem.Simulation(scene, beds.TIME_STEP, driver=options.driver)
