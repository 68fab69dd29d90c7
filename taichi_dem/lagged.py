"""Whether the lagged exchange converges: its spectral radius, estimated while it runs.

Forces that answer to the surface of the step before are a fixed-point iteration,
d <- delta - C H(d).  Its errors grow or fall by the eigenvalues of -K C, K = H'(d): those of the
symmetric A = sqrt(K) C sqrt(K), but for the sign.  One product per look, carried from look to look,
is the power iteration for the largest of them; |A v|/|v| is never above it.
"""

from typing import Any

import numpy as np

from taichi_dem.exchange import Exchange
from taichi_dem.types import ti

LOOK_EVERY = 97  # steps; odd, as what diverges alternates
FAINTEST = 1e-3  # part of a contact in the vector, that it may grow when others have gone
RISKY, DIVERGENT = 0.5, 1.0  # spectral radii


@ti.data_oriented
class LaggedWatch:
    """Looks at the contacts of a lagged ``exchange``.

    next        the step of the next look
    radius      what the last look found
    largest     the largest of all
    risky       how many looks found more than ``RISKY``
    """

    def __init__(self, exchange: Exchange):
        self.exchange, self.particles = exchange, exchange.particles
        self.restart()

    def restart(self) -> None:
        """As if nothing had been looked at, at step 0."""
        self.next, self.radius, self.largest, self.risky = LOOK_EVERY, 0.0, 0.0, 0
        self._vector = np.ones(self.particles.count)  # by sphere
        self._plan = None

    def save(self) -> tuple[Any, ...]:
        """What :meth:`restore` takes."""
        return self.next, self.radius, self.risky, self._vector.copy()

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Go back to what was known then; ``largest``, which may be why, stays."""
        self.next, self.radius, self.risky, vector = saved
        self._vector = vector.copy()

    @property
    def diverges(self) -> bool:
        """Whether the last look found that errors grow."""
        return self.radius > DIVERGENT

    def look(self, step: int) -> None:
        """One product more, for the contacts as they are now, at ``step``."""
        self.next = step + LOOK_EVERY
        n = self.exchange.count
        ids, place = np.empty(n, np.int32), np.empty((n, 2))
        force, tangent, square = np.empty((3, n))
        self._send(n, ids, place, force, tangent, square)
        if self._plan is None:
            self._plan = self.exchange.halfspace.plan(place)
        self._plan.refresh(place)
        influence = self._plan.tangent(force, np.sqrt(square) if self.exchange.finite else None)
        root, loaded = np.sqrt(tangent), tangent > 0
        vector = np.where(loaded, self._vector[ids], 0.0)
        image = root * influence(root * vector)
        self.radius = _size(image) / _size(vector) if loaded.any() else 0.0
        if self.radius > 0:
            image *= np.sqrt(np.count_nonzero(loaded)) / _size(image)
            image = np.copysign(np.maximum(np.abs(image), FAINTEST), image)
            self._vector[ids[loaded]] = image[loaded]
        self.largest = max(self.largest, self.radius)
        self.risky += self.radius > RISKY

    def reason(self) -> str:
        """The words for a run that is stopped."""
        return (
            f"the lagged exchange diverges: errors of the forces on the substrate grow by the "
            f"spectral radius {self.radius:.3g} at each step, whatever the step. Try "
            'exchange="implicit", which has no such limit, fewer or narrower contacts, or stiffer '
            "ground; force_lagged=True goes on all the same"
        )

    @ti.kernel
    def _send(
        self,
        n: ti.i32,
        ids: ti.types.ndarray(),
        place: ti.types.ndarray(),
        force: ti.types.ndarray(),
        tangent: ti.types.ndarray(),
        square: ti.types.ndarray(),
    ):
        for k in range(n):
            i = self.exchange.members[k]
            body, ground = self.particles.body[i], self.exchange.ground[i]
            ids[k], force[k] = self.particles.spin[i].id, ground.force
            place[k, 0], place[k, 1] = body.position[0], body.position[1]
            square[k] = ti.pow(self.exchange.size(i) * ti.max(ground.force, 0.0), 2.0 / 3.0)
            if ti.static(self.exchange.finite):
                shift = self.exchange.expected_shift(i)
                place[k, 0] += shift[0]
                place[k, 1] += shift[1]
            overlap = self.exchange.overlap(i) + ground.expansion
            tangent[k] = 0.0
            if overlap > 0.0 or ground.force != 0.0:
                tangent[k] = self.exchange.law(k, overlap)[1]


def _size(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))
