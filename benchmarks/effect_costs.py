"""What each effect costs per step, on three standard scenes: each with and without it, by turns.

``--write docs/effects.md`` puts the table between the two marks in that file.
"""

import argparse
import dataclasses
from pathlib import Path

from benchmarks import report
from benchmarks.effect_scenes import NOT_THERE, SCENES, beside
from benchmarks.report import Figure
from taichi_dem.cost import Cost, measure

BEGIN, END = "<!-- costs -->\n", "<!-- end of costs -->\n"
MANY = 5.0  # times a step, from which it is no longer told as a percentage


@dataclasses.dataclass(frozen=True)
class Found:
    """Of a scene: what its own effects cost, what others cost ``beside`` it, and why it has none of
    the rest, by name."""

    own: list[Cost]
    beside: list[Cost]
    lacks: dict[str, str]


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
        lacks = {effect.name: effect.reason for effect in sim.effects.listed if not effect.on}
        lacks |= {effect: why for (effect, scene), why in NOT_THERE.items() if scene == name}
        own = measure(sim, options.rounds, options.seconds)
        found[name] = Found(own, list(beside(name, options)), lacks)
    if options.write:
        write(options.write, markdown(found))
    return [figure for name, costs in found.items() for figure in figures(name, costs)]


def figures(scene: str, found: Found) -> list[Figure]:
    """The time of a step, and what it is over that without each effect."""
    return [
        Figure.median(f"{scene}: a step", [1e6 * seconds for seconds in _step(found)], "us"),
        *(
            Figure.median(f"{scene}: with over without {cost.name}", cost.ratios, "")
            for cost in (*found.own, *found.beside)
            if cost.on
        ),
    ]


def markdown(found: dict[str, Found]) -> str:
    """A line for each effect, a column for each scene: what it adds to the time of a step."""
    steps = [f"{Figure.median('', _step(one), '').value * 1e6:.3g} µs" for one in found.values()]
    lines = [
        ["effect", *found],
        ["---"] * (1 + len(found)),
        *_rows({name: one.own for name, one in found.items()}, found),
        ["a step with all of these", *steps],
        *_rows({name: one.beside for name, one in found.items()}, found),
    ]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"{table}\n\nMeasured on: {report.machine()['processor']}.\n"


def _rows(costs: dict[str, list[Cost]], found: dict[str, Found]) -> list[list[str]]:
    names = dict.fromkeys(cost.name for some in costs.values() for cost in some)
    return [
        [name, *(_cell(name, some, found[scene].lacks) for scene, some in costs.items())]
        for name in names
    ]


def _cell(name: str, costs: list[Cost], lacks: dict[str, str]) -> str:
    for cost in costs:
        if cost.name == name:
            return _told(cost)
    return f"– {lacks[name]}"


def _told(cost: Cost) -> str:
    if not cost.on:
        return "stopped"
    ratios = sorted(cost.ratios)
    middle = Figure.median("", ratios, "").value
    if middle > MANY:
        return f"×{middle:.3g} ({ratios[0]:.3g} … {ratios[-1]:.3g})"
    return f"{middle - 1:+.0%} ({ratios[0] - 1:+.0%} … {ratios[-1] - 1:+.0%})"


def _step(found: Found) -> tuple[float, ...]:
    """Seconds of a step with all effects of the scene's own."""
    (on,) = {cost.on for cost in found.own if cost.on}
    return on


def write(path: Path, table: str) -> None:
    """Replace what stands between the marks."""
    before, begin, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"{path} does not have the lines {BEGIN.strip()} and {END.strip()}")
    path.write_text(f"{before}{begin}{table}{end}{after}", encoding="utf-8")
