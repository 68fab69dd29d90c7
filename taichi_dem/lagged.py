"""Whether the lagged exchange converges: its spectral radius, estimated while it runs.

Forces that answer to the surface of the step before are a fixed-point iteration,
d <- delta - C H(d).  Its errors grow or fall by the eigenvalues of -K C, K = H'(d): those of the
symmetric A = sqrt(K) C sqrt(K), but for the sign.  One product per look, carried from look to look,
is the power iteration for the largest of them; |A v|/|v| is never above it.
"""

from typing import Any

import numpy as np

import halfspace
from taichi_dem.doubts import RISKY
from taichi_dem.exchange import Exchange
from taichi_dem.members import MembersOnHost

LOOK_EVERY = 97  # steps; odd, as what diverges alternates
FIRST_LOOKS, FIRST_EVERY = 8, 3  # at contacts that bear load, soon after one another
IDLE_EVERY = 24  # while there is nobody to look at
FAINTEST = 1e-3  # part of a contact in the vector, that it may grow when others have gone
DIVERGENT = 1.0  # spectral radius


class LaggedWatch:
    """Looks at the contacts of a lagged ``exchange``.

    next        the step of the next look; it depends on steps and contacts alone
    looks       how many have found a contact that bears load
    radius      what the last look found
    largest     the largest of all
    risky       how many looks found more than ``RISKY``
    """

    def __init__(self, exchange: Exchange):
        self.exchange, self._members = exchange, MembersOnHost(exchange)
        self.restart()

    def restart(self) -> None:
        """As if nothing had been looked at, at step 0."""
        self.next, self.looks, self.risky = FIRST_EVERY, 0, 0
        self.radius, self.largest = 0.0, 0.0
        self._vector = np.ones(self.exchange.particles.count)  # by sphere
        self._plan: halfspace.Plan | None = None

    def save(self) -> tuple[Any, ...]:
        """What :meth:`restore` takes."""
        return self.next, self.looks, self.radius, self.risky, self._vector.copy()

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Go back to what was known then; ``largest``, which may be why, stays."""
        self.next, self.looks, self.radius, self.risky, vector = saved
        self._vector = vector.copy()

    @property
    def diverges(self) -> bool:
        """Whether the last look found that errors grow."""
        return self.radius > DIVERGENT

    def look(self, step: int) -> None:
        """One product more, for the contacts as they are now, at ``step``."""
        self.radius = self._multiply() if self.exchange.count else 0.0
        first = self.looks < FIRST_LOOKS
        self.next = step + (FIRST_EVERY if first else LOOK_EVERY)
        if first and not self.exchange.count:
            self.next = step + IDLE_EVERY
        self.largest = max(self.largest, self.radius)
        self.risky += self.radius > RISKY

    def _multiply(self) -> float:
        """|A v|/|v|; v becomes A v."""
        now, plan = self._members.now(), self._plan
        place, overlap = now.place + now.shift, now.overlap + now.expansion
        if plan is None:
            plan = self._plan = self.exchange.halfspace.plan(place)
        plan.refresh(place)
        size = now.contact_radius if self.exchange.finite else None
        influence = plan.tangent(now.force, size)
        tangent = self._members.law(overlap)[1]
        loaded = (tangent > 0) & ((overlap > 0) | (now.force != 0))
        if not loaded.any():
            return 0.0
        self.looks += 1
        root = np.sqrt(np.where(loaded, tangent, 0.0))
        vector = np.where(loaded, self._vector[now.ids], 0.0)
        image = root * influence(root * vector)
        grown = _size(image) / _size(vector)
        if grown > 0:
            image *= np.sqrt(np.count_nonzero(loaded)) / _size(image)
            image = np.copysign(np.maximum(np.abs(image), FAINTEST), image)
            self._vector[now.ids[loaded]] = image[loaded]
        return grown

    def reason(self) -> str:
        """The words for a run that is stopped."""
        return (
            f"the lagged exchange diverges: errors of the forces on the substrate grow by the "
            f"spectral radius {self.radius:.3g} at each step, whatever the step. Try "
            'exchange="implicit", which has no such limit, fewer or narrower contacts, or stiffer '
            "ground; force_lagged=True goes on all the same"
        )


def _size(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))
