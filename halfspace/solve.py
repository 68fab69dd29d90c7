"""The coupled contact solve: forces in equilibrium with the surface that they deform.

Contacts with overlaps `delta` over the undeformed surface, a law `f = H(d)` and a substrate that
sinks by `w = C f` have the effective overlaps `d` that solve

    F(d) = d + C H(d) - delta = 0.

Semismooth Newton: with `K = H'(d)`, solve `(I + C K) s = -F`. In terms of `y = K s` that is the
symmetric `(K^-1 + C) y = -F` on the contacts that carry load; the others follow by
`d = delta - C f - C y`. Conjugate gradients with K as the preconditioner are, in terms of s,
conjugate gradients for `I + C K` in the inner product of K, which never divide by a stiffness that
vanishes. Where the matrix is not positive (contacts closer than their size), they stop short, and
the potential of which F is the gradient guides the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .checks import Array
from .ground import HalfSpace
from .plan import Plan

Law = Callable[[Array], tuple[Array, Array]]

HALVINGS = 10  # of a Newton step that does not improve the state


@dataclass(frozen=True)
class Equilibrium:
    """Contacts in equilibrium with the half-space under them (or, not converged, on the way there).

    force (n,) N; overlap (n,) m, effective: `force = law(overlap)`; displacement (n,) m, the
    depression `w` by the other contacts, so that `overlap = delta - displacement` to within the
    residual; slope (n, 2), the gradient of `-w`, so that `-force slope` is the lateral force on the
    sphere; tangent (n,) N/m, the law's; iterations of Newton; applications of the influence matrix
    (the slope is one evaluation more); residual, relative, reached.
    """

    force: Array
    overlap: Array
    displacement: Array
    slope: Array
    tangent: Array
    iterations: int
    applications: int
    residual: float
    converged: bool


class NotConverged(RuntimeError):
    """The solve did not reach its residual; `state` is the nearest Equilibrium it came to."""

    def __init__(self, message: str, state: Equilibrium) -> None:
        super().__init__(message)
        self.state = state


def solve(
    ground: HalfSpace,
    x: ArrayLike,
    overlap: ArrayLike,
    law: Law,
    residual: float = 1e-6,
    start: ArrayLike | None = None,
    max_iterations: int = 50,
    opening: ArrayLike = 0.0,
    plan: Plan | None = None,
) -> Equilibrium:
    """Equilibrium of n contacts with given overlaps on an elastic half-space.

    x: (n, 2) positions, m; overlap: (n,) over the undeformed surface, m, negative where there is a
    gap; law: the overlaps (n,) of all contacts -> (force (n,) N, tangent dforce/doverlap (n,) N/m).
    It is called with `max(d, opening)`, and what it returns where `d <= opening` is replaced by
    zero, so a law of touch, such as Hertz's, need not handle gaps. residual: of `d + C f - delta`,
    relative to the largest `overlap - opening`, the most that a contact has to lose; a contact that
    stays open has none. start: (n,) a guess of the effective overlaps, m; plan: one that
    `ground.plan` made for earlier positions, which is renewed for these.

    opening: the overlap at which a contact opens, scalar or (n,), m: 0, or for a contact that
    adheres its (negative) overlap at pull-off. A law that jumps there may have no equilibrium: the
    caller who knows which contacts were made and lost sets their opening and solves again.

    Raises ValueError for arguments without sense, and NotConverged, which carries the nearest
    state, after `max_iterations`.
    """
    if plan is None:
        plan = ground.plan(x)
    else:
        plan.refresh(x)
    n = len(plan.x)
    delta = checks.scalars("overlap", overlap, n)
    guess = delta if start is None else checks.scalars("start", start, n)
    if np.ndim(opening) == 0:
        opening = np.full(n, checks.number("opening", opening, "a finite overlap, m"))
    floor = checks.scalars("opening", opening, n)
    wanted = "a number between 0 and 1"
    if not 0 < checks.number("residual", residual, wanted) < 1:
        raise ValueError(f"residual = {residual!r}: must be {wanted}")
    checks.whole("max_iterations", max_iterations)

    scale = float((delta - floor).max(initial=0.0))
    problem = _Problem(plan.apply, delta, law, floor)
    state = problem.at(guess) if scale > 0 else problem.open()
    best, iterations = state, 0
    while state.error > residual * scale and iterations < max_iterations:
        state = problem.newton(state, residual * scale, scale)
        best = min(best, state, key=lambda s: s.error)
        iterations += 1
    result = Equilibrium(
        force=best.force,
        overlap=best.overlap,
        displacement=best.displacement,
        slope=plan.slope(best.force),
        tangent=best.tangent,
        iterations=iterations,
        applications=problem.applications,
        residual=best.error / scale if scale > 0 else 0.0,
        converged=best.error <= residual * scale,
    )
    if not result.converged:
        raise NotConverged(
            f"residual = {residual:.3g}: reached {result.residual:.3g} after "
            f"{iterations} iterations, {problem.applications} applications{problem.hint}",
            result,
        )
    return result


@dataclass(frozen=True)
class _State:
    """A guess and what follows from it: `defect` is F, `error` the largest that counts, m."""

    overlap: Array
    force: Array
    tangent: Array
    displacement: Array
    defect: Array
    error: float

    @property
    def merit(self) -> float:
        return float(np.abs(self.defect).max(initial=0.0))


class _Problem:
    def __init__(
        self, influence: Callable[[Array], Array], delta: Array, law: Law, opening: Array
    ) -> None:
        self._influence, self._law = influence, law
        self._delta, self._opening = delta, opening
        self.applications = 0
        self.hint = ""

    def apply(self, f: Array) -> Array:
        if not f.any():
            return np.zeros(len(f))
        self.applications += 1
        return self._influence(f)

    def open(self) -> _State:
        """No contact can carry load: the surface is flat."""
        zero = np.zeros(len(self._delta))
        return _State(self._delta.copy(), zero, zero, zero, zero, 0.0)

    def at(self, d: Array) -> _State:
        force, tangent = self._forces(d)
        w = self.apply(force)
        reached = self._delta - w
        # An open contact that stays open solves its equation outright.
        d = np.where(np.maximum(d, reached) <= self._opening, reached, d)
        error = np.maximum(d, self._opening) - np.maximum(reached, self._opening)
        return _State(d, force, tangent, w, d - reached, float(np.abs(error).max(initial=0.0)))

    def _forces(self, d: Array) -> tuple[Array, Array]:
        closed = d > self._opening
        values = self._law(np.maximum(d, self._opening))
        if not isinstance(values, tuple) or len(values) != 2:
            raise ValueError(f"law returned {type(values).__name__}: must be (force, tangent)")
        result = []
        for name, value in zip(("force", "tangent"), values, strict=True):
            value = np.asarray(value, dtype=np.float64)
            if value.shape != d.shape:
                raise ValueError(f"law returned a {name} of shape {value.shape}, not {d.shape}")
            value = np.where(closed, value, 0.0)
            if not np.isfinite(value).all():
                k = int(np.flatnonzero(~np.isfinite(value))[0])
                raise ValueError(
                    f"law returned {name}[{k}] = {float(value[k])!r} at overlap {float(d[k])!r} m"
                )
            result.append(value)
        return result[0], result[1]

    def newton(self, state: _State, goal: float, scale: float) -> _State:
        """The state after one Newton step, halved until it is an improvement.

        An improvement is a smaller defect, or, where the matrix was not positive and the defect is
        no guide, a larger potential `U(f)`: its gradient is `-F`, so its change is
        `-(F_0 + F_1)/2 . (f_1 - f_0)` to third order.
        """
        merit = state.merit
        share = np.clip(merit / scale, 0.5 * goal / merit, 0.1)
        # Where the law softens, its force is held while the others adapt.
        stiffness = np.maximum(state.tangent, 0.0)
        step, definite = _conjugate_gradients(self.apply, stiffness, -state.defect, share * merit)
        ceiling = np.maximum(state.overlap, self._delta) + scale
        full = trial = self.at(np.minimum(state.overlap + step, ceiling))
        if not definite:
            self.hint = "; contacts may be closer together than their size allows"
        size = 1.0
        for _ in range(HALVINGS):
            if definite:
                better = trial.merit < (1 - 1e-4 * size) * merit
            else:
                loss = (state.defect + trial.defect) @ (trial.force - state.force)
                better = bool(loss < 0)
            if better or trial.error <= goal:
                return trial
            size /= 2
            trial = self.at(np.minimum(state.overlap + size * step, ceiling))
        return full  # across a kink of the law the residual may have to grow


def _conjugate_gradients(
    apply: Callable[[Array], Array], k: Array, b: Array, goal: float
) -> tuple[Array, bool]:
    """Solve `(I + C K) s = b` to within `goal`, and tell whether `K + K C K` was positive.

    If not, this is what it came to before that showed; at the first step, the fixed-point step `b`.
    """
    s: Array = np.zeros(len(b))
    r: Array = b.copy()
    loaded = k > 0
    p, rr = r, r @ (k * r)
    for _ in range(2 * len(b)):
        if np.abs(r[loaded]).max(initial=0.0) <= goal:
            break
        q = p + apply(k * p)
        curvature = (k * p) @ q
        if not curvature > 0:
            return np.where(loaded, s, s + r) if s.any() else b, False
        s = s + (rr / curvature) * p
        r = r - (rr / curvature) * q
        rr, previous = r @ (k * r), rr
        p = r + (rr / previous) * p
    return np.where(loaded, s, s + r), True
