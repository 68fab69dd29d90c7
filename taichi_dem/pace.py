"""What is tuned while a simulation runs: the skin, by counts; the driver, by the clock."""

import math
import time
from collections.abc import Callable

import numpy as np

WAYS = ("serial", "team", "parallel")
SERIAL_BELOW = 300  # particles: threads never pay
LOOPS_ABOVE = 2000  # below, waking them for every loop never pays
PARALLEL_ABOVE = 200_000  # it always does
TRIAL_STEPS = 20  # at least; small scenes make more, so that waking threads does not count
TRIAL_WORK = 200_000  # particle-steps
TRIAL_LASTS = 10.0  # s, at least, until the ways are tried again
TRIAL_PAYS = 100.0  # times as long as it took
BURST = 2000  # steps that a team makes at most before it is asked how it goes
DISTURBED = 2.0  # times as slow as in its trial
NEVER = 2**62  # steps


class Skin:
    """How far beyond touching the contact list reaches.

    A thick skin makes the list long, a thin one makes it stale soon.  The width follows from how
    many steps the lists have lasted: counts, so that every run does the same.  At the step
    ``review`` a list has lasted so long that a thinner skin pays, though it is not stale.
    """

    def __init__(self, radius: np.ndarray, held: float | None = None):
        diameter = 2 * float(np.quantile(radius, 0.1))
        self._first, self._least, self._most = 0.1 * diameter, 0.02 * diameter, 0.4 * diameter
        if held is not None:
            self.hold(held)
        self.width = self._first
        cost = 4 + 3000 / len(radius)  # of a rebuild, in steps
        self._short, self._long = round(8 * cost), round(24 * cost)
        self._built_at = 0

    @property
    def review(self) -> int:
        """The step at which the list is to be made anew even if it is not stale."""
        return self._built_at + self._long if self.width > self._least else NEVER

    def hold(self, width: float) -> None:
        """Be ``width`` (m) from now on."""
        self.width = self._first = self._least = self._most = width

    def restart(self) -> None:
        """Forget what has been tuned: a run that starts again does what it did before."""
        self.width, self._built_at = self._first, 0

    def start_again(self, step: int) -> None:
        """The simulation went back to ``step``."""
        self._built_at = step

    def rebuilt(self, step: int) -> bool:
        """Note a rebuild at ``step``; whether the width has changed."""
        lasted, self._built_at, before = step - self._built_at, step, self.width
        if 0 < lasted < self._short:
            self.width = min(1.25 * self.width, self._most)
        elif lasted >= self._long:
            self.width = max(0.5 * self.width, self._least)
        return self.width != before


class Pace:
    """Chooses between ways to make the same steps by timing them.

    ``together``: whether threads run at the same time, as a team must; it is asked before the first
    step, and only where a team may pay.
    """

    def __init__(self, particles: int, asked: str, together: Callable[[], bool]):
        self._particles, self._asked, self._together = particles, asked, together
        self._ways: list[str] = []
        self._next_trial = math.inf
        self._trial_steps = max(TRIAL_STEPS, TRIAL_WORK // particles)
        self._trials: list[str] = []

    @property
    def driver(self) -> str:
        """Which way is the fastest, as far as is known."""
        if not self._ways:
            self._begin()
        return self._fastest

    @driver.setter
    def driver(self, name: str) -> None:
        self._choose_among([name])

    def _begin(self) -> None:
        """Find out which ways there are."""
        ways = [self._asked]
        if self._asked == "auto":
            ways = ["serial"]
            if self._particles >= SERIAL_BELOW and self._together():
                ways = ["serial", "team"] if self._particles < LOOPS_ABOVE else list(WAYS)
            if self._particles > PARALLEL_ABOVE and len(ways) > 1:
                ways = ["parallel"]
        elif self._asked == "team" and not self._together():
            ways = ["parallel"]
        self._choose_among(ways)

    def _choose_among(self, ways: list[str]) -> None:
        self._ways, self._fastest = ways, ways[0]
        self._begin_trials()

    def _begin_trials(self) -> None:
        # Twice, as what is disturbed in one round may be the fastest in the other; there and back,
        # as the list may be growing thinner, and steps faster, at the same time.
        there_and_back = [*self._ways, *reversed(self._ways)]
        self._trials = there_and_back if len(self._ways) > 1 else []
        self._cost: dict[str, float] = {}
        self._warm, self._took = "", 0.0

    def advance(self, steps: int, ways: dict[str, Callable[[int], int]]) -> int:
        """Make at most ``steps`` steps; returns how many were made."""
        driver = self.driver
        if self._trials:
            return self._try(steps, ways)
        start = time.perf_counter()
        made = ways[driver](min(steps, BURST) if driver == "team" else steps)
        end = time.perf_counter()
        cost = (end - start) / max(made, 1)
        # A bed may have settled, or others may have come to use the cores.
        disturbed = cost > DISTURBED * self._cost.get(driver, cost)
        if disturbed or end > self._next_trial:
            self._begin_trials()
        return made

    def _try(self, steps: int, ways: dict[str, Callable[[int], int]]) -> int:
        name = self._trials[0]
        if self._warm != name:  # compile it and warm the caches first
            self._warm = name
            return ways[name](1)
        start = time.perf_counter()
        made = ways[name](min(steps, self._trial_steps))
        end = time.perf_counter()
        self._took += end - start
        cost = (end - start) / max(made, 1)
        self._cost[name] = min(cost, self._cost.get(name, cost))
        self._trials.pop(0)
        if not self._trials:
            self._fastest = min(self._cost, key=lambda tried: self._cost[tried])
            self._next_trial = end + max(TRIAL_LASTS, TRIAL_PAYS * self._took)
        return made
