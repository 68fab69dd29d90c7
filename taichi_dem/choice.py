"""Settings that meet an asked error at least cost (``taichi-dem run --error``).

The error of a step is that of a finer one left out: it is followed from the stable step down by
halving, until the asked error lies between two steps or the errors fall in a steady order, and read
off the line between them in the logarithms. Coupling and residual are loosened as long as the error
of their own stays a small share of what is asked; the step gets the rest. At that step the ground
is solved for as seldom as what this adds stays such a share, or within what the step leaves.

What short runs have not seen is not loosened: not the ground's settings where nothing has touched
it, nor the coupling where more of the run is to come and contacts with the ground still arrive.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from taichi_dem import accuracy
from taichi_dem.guards import SimulationStopped
from taichi_dem.neglect import Neglected
from taichi_dem.pilot import Pilot, Span
from taichi_dem.scene import Scene
from taichi_dem.settings import EVERY, VALUES, Settings
from taichi_dem.study_report import described
from taichi_dem.wording import quantity

AIM = 0.8  # of the asked error
OWN_SHARE = 0.1  # of it, for each knob but the step
MOST_HALVINGS = 8
STEADY = 0.25  # that two orders in a row may differ, to go on beyond what was measured
FARTHEST = 4.0  # times, below the finest step measured
LOOSE = (1e-1, 1e-2, 1e-3)  # residuals, as shares of the asked error
SPARSE = (2, 4, 8, 16)  # steps from one exchange to the next
WORTH = 4  # pairs of contacts with the ground to each sphere, from which solving takes time
LOWEST, HIGHEST = 0.5, 4.0  # orders that are believed


@dataclasses.dataclass(frozen=True)
class Choice:
    """``settings`` and the error that they are ``expected`` to have over a ``span`` of the run;
    ``limit`` says what kept them from being cheaper, or from meeting what was ``asked``, and
    ``unseen`` what the span says nothing about. ``measured``: step (s, as text) to error."""

    settings: Settings
    asked: float
    expected: float
    span: Span
    limit: str
    measured: dict[str, float]
    left_out: tuple[Neglected, ...] = ()
    unseen: str = ""

    @property
    def met(self) -> bool:
        """Whether it is expected to be what was asked."""
        return self.expected <= self.asked

    @property
    def missing(self) -> list[Neglected]:
        """Effects that are laws and no settings, and would change more than the asked error."""
        return [effect for effect in self.left_out if effect.matters(self.asked)]

    def summary(self) -> dict[str, Any]:
        """For ``summary.json``."""
        return {
            "asked": self.asked,
            "expected": self.expected,
            "met": self.met,
            "compared_from_s": self.span.start,
            "compared_over_s": self.span.length,
            "trajectories_part": self.span.chaotic,
            "limit": self.limit,
            "unseen": self.unseen,
            "settings": dataclasses.asdict(self.settings),
            "measured": self.measured,
            "left_out": {effect.name: effect.summary(self.asked) for effect in self.left_out},
        }

    def words(self) -> Iterator[str]:
        """For people."""
        span = self.span
        times = span.stable / self.settings.step
        more = f", {times:.2g} times as many steps as the stable one takes" if times > 1.05 else ""
        yield f"settings: {described(self.settings)}, limited by {self.limit}{more}"
        over, part = quantity(span.length, "s"), " before trajectories part" if span.chaotic else ""
        where = f"the first {over}{part or ' of the run'}"
        if span.start > 0:
            where = f"{over} from t = {quantity(span.start, 's')} on{part}; nothing touches before"
        yield f"expected error {self.expected:.2g} over {where}"
        if not self.met:
            yield f"warning: that is more than the {self.asked:g} asked for"
        if self.unseen:
            yield self.unseen
        for effect in self.missing:
            yield f"not in this error: {effect.sentence(self.asked)}"


def choose(scene: Scene, duration: float, asked: float, estimate: bool = True) -> Choice:
    """The cheapest settings whose error over ``duration`` (s) is ``asked``: the worst of those that
    :func:`taichi_dem.accuracy.errors` gives, as long as trajectories are comparable; and, by an
    ``estimate``, what the scene leaves out that no setting turns on."""
    pilot = Pilot(scene, duration)
    choice = choose_by(pilot, asked)
    return dataclasses.replace(choice, left_out=tuple(pilot.left_out())) if estimate else choice


def choose_by(pilot: Pilot, asked: float) -> Choice:
    """:func:`choose`, by the runs of a pilot that there is already."""
    coarse = pilot.tight.but("step", pilot.span.stable)
    unseen = _unseen(pilot, coarse)
    if unseen:
        settings, used = Settings.of(pilot.scene, pilot.span.stable), 0.0
    else:
        settings, used = _coupling(pilot, coarse, asked)
        settings, more = _residual(pilot, settings, asked)
        used += more
    goal = AIM * asked - used
    steps, errors = _errors_of_steps(pilot, goal)
    step, expected = _step_for(goal, steps, errors)
    limit = "the asked error"
    if step >= steps[0]:
        limit = "the stable step"
    elif expected > 1.01 * goal:
        limit = f"short runs, which tell nothing of steps below {step:.3g} s"
    room = max(OWN_SHARE * asked, goal - expected)
    settings, used = _exchange(pilot, settings.but("step", step), used, room)
    return Choice(
        settings,
        asked,
        expected + used,
        pilot.span,
        limit,
        {f"{h:.4g}": e for h, e in zip(steps.tolist(), errors.tolist(), strict=True)},
        unseen=unseen,
    )


def _unseen(pilot: Pilot, tight: Settings) -> str:
    """What the short runs tell nothing about, if they do not tell all, for people."""
    if not pilot.touching(tight):
        return "nothing touched anything in that time: the error is that of free flight"
    if tight.coupling is not None and pilot.grounded(tight) == 0:
        return "nothing touched the ground in that time: its settings are the scene's own"
    return ""


def _coupling(pilot: Pilot, tight: Settings, asked: float) -> tuple[Settings, float]:
    """The loosest coupling whose own error is small, and that error."""
    if tight.coupling is None:
        return tight, 0.0
    loosest = VALUES["coupling"]
    if not (pilot.whole or pilot.steady(tight)):
        loosest = loosest[loosest.index(Settings.of(pilot.scene, 0.0).coupling) :]
    for coupling in loosest:
        loose = tight.but("coupling", coupling)
        if coupling != tight.coupling and loose.accepted(pilot.scene):
            own = _own_error(pilot, loose, tight)
            if own <= OWN_SHARE * asked:
                return loose, own
    return tight, 0.0


def _residual(pilot: Pilot, tight: Settings, asked: float) -> tuple[Settings, float]:
    """The loosest residual and tolerance whose own error is small, and that error."""
    if tight.residual is None or tight.coupling == "none":
        return tight, 0.0
    for share in LOOSE:
        loose = dataclasses.replace(tight, residual=share * asked, tolerance=share * asked)
        own = _own_error(pilot, loose, tight)
        if own <= OWN_SHARE * asked:
            return loose, own
    return tight, 0.0


def _exchange(pilot: Pilot, each: Settings, used: float, room: float) -> tuple[Settings, float]:
    """``each`` with as few exchanges as add at most ``room`` to what it has ``used`` of the error
    and need not be warned of, where that saves time; and what it then has used."""
    chosen, best = each, used
    if each.exchange != "implicit" or not _solving_takes_time(pilot):
        return chosen, best
    tight = pilot.tight.but("step", each.step)
    for every in SPARSE:
        sparse = each.but("exchange", f"{EVERY}{every}")
        if not sparse.accepted(pilot.scene):
            break
        own = _own_error(pilot, sparse, tight)
        if own > used + room or pilot.is_steep(sparse):
            break
        chosen, best = sparse, max(own, used)
    return chosen, best


def _solving_takes_time(pilot: Pilot) -> bool:
    """By counts, not by a clock: the choice is the same on every machine."""
    grounded = pilot.grounded(pilot.tight.but("step", pilot.span.stable))
    ground = pilot.scene.substrate
    if ground is not None and ground.homogeneous and pilot.scene.period is None:
        return grounded**2 >= WORTH * pilot.scene.spheres.count
    return grounded > 1  # through the host


def _own_error(pilot: Pilot, loose: Settings, tight: Settings) -> float:
    """What ``loose`` adds at the same step; infinite where a guard stops it."""
    try:
        found = pilot.distance(loose, tight)
    except SimulationStopped:
        return math.inf
    if "energy drift" in found:
        before = pilot.distance(tight, tight)["energy drift"]
        found["energy drift"] = max(found["energy drift"] - before, 0.0)
    return accuracy.worst(found)


def _errors_of_steps(pilot: Pilot, goal: float) -> tuple[np.ndarray, np.ndarray]:
    """Steps (s) from the stable one down, and their errors, as far as is needed for ``goal``."""
    steps = [pilot.span.stable / 2**k for k in range(MOST_HALVINGS + 1)]
    for finest in range(2, MOST_HALVINGS + 1):
        errors = _against(pilot, steps[: finest + 1])
        if errors[-1] <= goal or (finest >= 3 and _steady(errors, goal)):
            break
    return np.array(steps[: len(errors)]), errors


def _against(pilot: Pilot, steps: list[float]) -> np.ndarray:
    """The errors of all but the finest of ``steps`` against it, with what it hides of them."""
    settings = [pilot.tight.but("step", step) for step in steps]
    found = [pilot.distance(one, settings[-1]) for one in settings[:-1]]
    drift = [errors.pop("energy drift", 0.0) for errors in found]  # needs no reference
    seen = np.array([accuracy.worst(errors) if errors else 0.0 for errors in found])
    order = _order(seen)
    hidden = 1 - 2.0 ** (-order * np.arange(len(seen), 0, -1))
    return np.maximum(seen / hidden, drift)


def _order(errors: np.ndarray) -> float:
    """Of errors at halved steps against one more halving: e_k / e_(k+1) = 2^p + 1 for the last
    two."""
    if len(errors) < 2 or errors[-1] <= 0:
        return 1.0
    ratio = errors[-2] / errors[-1]
    return float(np.clip(np.log2(max(ratio - 1, 1e-9)), 1.0, HIGHEST))


def _steady(errors: np.ndarray, goal: float) -> bool:
    """Whether the errors fall in so regular an order that ``goal`` can be read off beyond them."""
    if not (errors > 0).all():
        return False
    orders = np.log2(errors[:-1] / errors[1:])
    near = abs(orders[-1] - orders[-2]) <= STEADY and orders[-1] >= LOWEST
    return bool(near and errors[-1] / goal <= FARTHEST ** orders[-1])


def _step_for(goal: float, steps: np.ndarray, errors: np.ndarray) -> tuple[float, float]:
    """The largest step whose error is ``goal`` on the line through the measured ones, at most the
    stable step; and the error that it has there."""
    if errors[0] <= goal:
        return float(steps[0]), float(errors[0])
    if errors[-1] > goal:
        order = float(np.clip(math.log2(errors[-2] / errors[-1]), LOWEST, HIGHEST))
        factor = min((errors[-1] / goal) ** (1 / order), FARTHEST)
        return float(steps[-1] / factor), float(errors[-1] / factor**order)
    k = int(np.argmax(errors <= goal))
    share = math.log(goal / errors[k - 1]) / math.log(max(errors[k], 1e-300) / errors[k - 1])
    return float(steps[k - 1] * (steps[k] / steps[k - 1]) ** share), goal
