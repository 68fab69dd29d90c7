"""A substrate that creeps: the standard linear solid, with a constant Poisson's ratio.

By the correspondence principle (E. H. Lee & J. R. M. Radok, J. Appl. Mech. 27, 438, 1960) the
surface is depressed by

    w = C (f + c s),    ds/dt = (f - s)/tau,    c = E0/E1 - 1,

where C is the influence matrix of the instantaneous modulus E0, E1 the modulus at rest, and tau the
time of retardation: under a constant force the depression creeps from `C f` to `(1 + c) C f` as
`1 - exp(-t/tau)`; at a constant depression the force relaxes with the time `tau E1/E0`. The update
of the memory s, N, is exact for a force that is constant over a step, however long.

The memory belongs to a contact and goes where it goes. That is right for contacts that stay. In
truth the past dent stays in the ground: a contact that moves by more than a fraction of its own
size, or of the way to its neighbours, within tau leaves it behind, is resisted by it (the rolling
resistance of a viscoelastic ground, which is not in here), and its neighbours feel it where it was.
A contact's own depression follows the same law as long as its contact area does not shrink; after
that (T. C. T. Ting, J. Appl. Mech. 33, 845, 1966) this is an approximation.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks
from .arrays import Array
from .ground import HalfSpace
from .plan import Plan
from .solve import Equilibrium, Law, solve

Ids = NDArray[np.int64]


class Viscoelastic:
    """A creeping substrate and its memory of the forces on each contact.

    ground: the elastic one of its instantaneous modulus, a layer or periodic as may be;
    relaxed_modulus: Young's modulus at rest, Pa, above 0 and not above that of `ground`;
    retardation_time: tau, s, > 0. Contacts go by whole numbers, `ids` (n,), each once; without,
    they are 0 ... n - 1. Raises ValueError for arguments without sense.
    """

    def __init__(self, ground: HalfSpace, relaxed_modulus: float, retardation_time: float) -> None:
        wanted = f"a number > 0 and <= {ground.youngs_modulus!r} Pa, the instantaneous modulus"
        relaxed = checks.number("relaxed_modulus", relaxed_modulus, wanted)
        if not 0 < relaxed <= ground.youngs_modulus:
            raise ValueError(f"relaxed_modulus = {relaxed!r}: must be {wanted}")
        time = checks.number("retardation_time", retardation_time, "a number > 0 s")
        if not time > 0:
            raise ValueError(f"retardation_time = {time!r}: must be a number > 0 s")
        self.ground, self.relaxed_modulus, self.retardation_time = ground, relaxed, time
        self.creep = ground.youngs_modulus / relaxed - 1
        self._ids: Ids = np.empty(0, np.int64)
        self._memory: Array = np.empty(0)

    # -- memory ----------------------------------------------------------------------------------

    def memory(self, ids: ArrayLike) -> Array:
        """s (n,), N, of these contacts: 0 for new ones, the force for those at rest."""
        wanted = _ids(ids)
        place = np.minimum(np.searchsorted(self._ids, wanted), max(len(self._ids) - 1, 0))
        if not len(self._ids):
            return np.zeros(len(wanted))
        return np.where(self._ids[place] == wanted, self._memory[place], 0.0)

    def advance(self, dt: float, f: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Let a time dt, s, pass under the constant forces f (n,), N.

        `s <- f + (s - f) exp(-dt/tau)`. Contacts that are not named carry nothing, and forget.
        """
        ids = _ids(np.arange(np.size(f)) if ids is None else ids)
        f, left = checks.scalars("f", f, len(ids)), self._left(dt)
        now = f + (self.memory(ids) - f) * left
        gone = ~np.isin(self._ids, ids)
        everyone = np.concatenate([ids, self._ids[gone]])
        memory = np.concatenate([now, self._memory[gone] * left])
        floor = np.finfo(np.float64).eps * np.abs(memory).max(initial=0.0)
        kept = np.flatnonzero(np.abs(memory) > floor)
        order = kept[np.argsort(everyone[kept])]
        self._ids, self._memory = everyone[order], memory[order]

    def save(self) -> dict[str, Any]:
        """The memory as arrays `ids` and `memory`, for `restore`."""
        return {"ids": self._ids.copy(), "memory": self._memory.copy()}

    def restore(self, state: dict[str, Any]) -> None:
        """Take up the memory that `save` gave."""
        ids = _ids(state["ids"])
        memory = checks.scalars("memory", state["memory"], len(ids))
        order = np.argsort(ids)
        self._ids, self._memory = ids[order], memory[order]

    # -- what the ground does now ----------------------------------------------------------------

    def plan(self, x: ArrayLike) -> Plan:
        """The sums of the instantaneous ground: what a change of forces does at once."""
        return self.ground.plan(x)

    def matrix(self, x: ArrayLike) -> Array:
        """The influence matrix (n, n), m/N, of the instantaneous ground."""
        return self.ground.matrix(x)

    def displacement(
        self, x: ArrayLike, f: ArrayLike, ids: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Depression (n,), m, and slope (n, 2) now, by the forces f and the memory of the past."""
        return self.ground.displacement(x, self._acting(f, ids))

    def field(
        self,
        x: ArrayLike,
        f: ArrayLike,
        points: ArrayLike,
        radius: ArrayLike | None = None,
        ids: ArrayLike | None = None,
    ) -> Array:
        """Depression (m,), m, at `points` (m, 2) now, as `HalfSpace.field`."""
        return self.ground.field(x, self._acting(f, ids), points, radius)

    # -- a step ----------------------------------------------------------------------------------

    def solve(
        self,
        x: ArrayLike,
        overlap: ArrayLike,
        law: Law,
        dt: float,
        ids: ArrayLike | None = None,
        share: ArrayLike = 1.0,
        residual: float = 1e-6,
        start: ArrayLike | None = None,
        max_iterations: int = 50,
        plan: Plan | None = None,
    ) -> Equilibrium:
        """Forces in equilibrium at the end of a step dt, s, that act over all of it.

        Arguments as for `halfspace.solve`, with contacts that count as points. The law is that of
        touch on the instantaneous ground, Hertz's or so, and creeps with it: it holds between the
        overlap and `f + share c s`, where `share` is the ground's share of the contact's compliance
        (1 on soft ground; scalar or (n,)). At dt = 0 the answer is that of the moment. The memory
        is left as it is: `advance(dt, state.force, ids)` accepts the step.
        """
        plan = self.ground.plan(x) if plan is None else plan
        plan.refresh(x)
        n = len(plan.x)
        delta = checks.scalars("overlap", overlap, n)
        ids = _ids(np.arange(n) if ids is None else ids)
        share = np.broadcast_to(np.asarray(share, dtype=np.float64), (n,))
        left = self._left(dt)
        past = self.creep * left * self.memory(ids)
        growth = 1 + self.creep * (1 - left)
        own = 1 + share * (growth - 1)

        def creeping(d: Array) -> tuple[Array, Array]:
            force, tangent = law(d)
            surplus = (force - share * past) * (growth / own)
            return np.maximum(surplus, 0.0), np.where(surplus > 0, growth / own * tangent, 0.0)

        sunk, slope = plan.displacement(past)
        state = solve(
            self.ground, plan.x, delta - sunk, creeping, residual, start, max_iterations, plan=plan
        )
        return replace(
            state,
            force=state.force / growth,
            tangent=state.tangent / growth,
            displacement=state.displacement + sunk,
            slope=state.slope + slope,
        )

    def _left(self, dt: float) -> float:
        wanted = "a number >= 0 s"
        dt = checks.number("dt", dt, wanted)
        if dt < 0:
            raise ValueError(f"dt = {dt!r}: must be {wanted}")
        return float(np.exp(-dt / self.retardation_time))

    def _acting(self, f: ArrayLike, ids: ArrayLike | None) -> Array:
        ids = _ids(np.arange(np.size(f)) if ids is None else ids)
        return checks.scalars("f", f, len(ids)) + self.creep * self.memory(ids)


def _ids(value: ArrayLike) -> Ids:
    ids = np.asarray(value)
    if ids.size == 0:
        return np.empty(0, np.int64)
    if ids.ndim != 1 or not np.issubdtype(ids.dtype, np.integer):
        raise ValueError(f"ids of shape {ids.shape} and type {ids.dtype}: must be (n,) integers")
    if len(np.unique(ids)) != len(ids):
        raise ValueError("ids: must name each contact once")
    return ids.astype(np.int64)
