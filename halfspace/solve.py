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

Spheres whose radii R are known (`coupling="finite"`) are contacts of finite size: `C` is the
derivative of `w(f)`, see `finite`. And where the surface is tilted they do not touch it at x, under
their lowest point, but at `y = x + c`. Of all points, the effective overlap
`delta + e(x + c) - c^2/(2R)` is greatest at

    c = R grad e(y),

uphill. Both follow from one potential, `f.(delta - c^2/(2R)) - E_c(f, x + c) - E_local(f)`, which
is stationary in f and in c; its derivative by x, at constant overlap, is `f grad e(y) = f c/R`, so
that the force on the sphere is `f` along the normal of the tilted surface, through the centre.
Newton's method finds f for a given c, substitution finds c: it contracts by about
`R f/(pi E' r^3) ~ (a/r)^3/2` a round.
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
FIRST = 0.02  # residual at which to look first where the spheres touch
MEMORY = 4  # rounds
EASE = 0.03  # residual of the forces, over that of the points of contact, until these are found


@dataclass(frozen=True)
class Equilibrium:
    """Contacts in equilibrium with the half-space under them (or, not converged, on the way there).

    force (n,) N; overlap (n,) m, effective: `force = law(overlap)`; displacement (n,) m, the
    depression `w` by the other contacts, so that `overlap = delta - displacement` to within the
    residual; slope (n, 2), the gradient of `-w`, so that `-force slope` is the lateral force on the
    sphere; tangent (n,) N/m, the law's; iterations of Newton; applications of the influence matrix
    (the slope is one evaluation more); residual, relative, reached. softening: how many contacts
    are where their law softens (tangent < 0), where an equilibrium need not be stable.

    Of spheres, if the law or the caller said how large they are: contact_radius (n,) m; and, with
    `coupling="finite"`, shift (n, 2) m, the point of contact seen from x, where displacement and
    slope are. Then `overlap = delta - displacement - shift^2/(2R)`.
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
    softening: int
    contact_radius: Array | None
    shift: Array


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
    radius: ArrayLike | None = None,
    modulus: ArrayLike | None = None,
    shift: ArrayLike | None = None,
) -> Equilibrium:
    """Equilibrium of n contacts with given overlaps on an elastic half-space.

    x: (n, 2) positions, m; overlap: (n,) over the undeformed surface, m, negative where there is a
    gap; law: the overlaps (n,) of all contacts -> (force (n,) N, tangent dforce/doverlap (n,) N/m).
    It is called with `max(d, opening)`, and what it returns where `d <= opening` is replaced by
    zero, so a law of touch, such as Hertz's, need not handle gaps. residual: of `d + C f - delta`,
    relative to the largest `overlap - opening`, the most that a contact has to lose; a contact that
    stays open has none. start: (n,) a guess of the effective overlaps, m; plan: one that
    `ground.plan` made for earlier positions, which is renewed for these.

    radius: of the spheres, scalar or (n,), m, and modulus: of the contacts, `E*`, Pa (without:
    that of rigid spheres): what `coupling="finite"` needs to know of contacts, whose radii are
    Hertz's, `a = (3 f R/(4 E*))^(1/3)`, and zero where they pull. A law that has attributes
    `radius` and `modulus`, as `reference.hertz_law` gives, need not be told. Without radii contacts
    are points. shift: (n, 2) a guess of where they touch the surface, seen from x, m.

    opening: the overlap at which a contact opens, scalar or (n,), m: 0, or for a contact that
    adheres its (negative) overlap at pull-off. A law that jumps there may have no equilibrium: the
    caller who knows which contacts were made and lost sets their opening and solves again. Where a
    law softens its force is held while the others adapt, which converges where the surface is
    stiffer than the law is soft; where not, the contact is about to jump.

    Raises ValueError for arguments without sense, and NotConverged, which carries the nearest
    state, after `max_iterations`.
    """
    x = checks.vectors("x", x)
    n = len(x)
    spheres = Spheres.of(ground, law, radius, modulus, n)
    tilting = spheres is not None and ground.coupling == "finite"
    offset = np.zeros((n, 2)) if shift is None or not tilting else checks.vectors("shift", shift)
    if offset.shape != x.shape:
        raise ValueError(f"shift has shape {offset.shape}: must be {x.shape}, one per contact")
    if plan is None:
        plan = ground.plan(x + offset)
    else:
        plan.refresh(x + offset)
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
    goal = residual * scale
    problem = _Problem(plan, delta, law, floor, spheres)
    best: _Found | None = None
    # A guess of where spheres touch is worth a full solve, none at all is not.
    iterations, aim, points = 0, goal, Points()
    if tilting and shift is None:
        aim = max(goal, FIRST * scale)
    state = problem.at(guess, offset) if scale > 0 else problem.open(offset)
    while True:
        nearest = state
        while state.error > aim and iterations < max_iterations:
            state = problem.newton(state, aim, scale)
            nearest = min(nearest, state, key=lambda s: s.error)
            iterations += 1
        found = problem.found(nearest, tilting)
        if best is None or found.error < best.error:
            best = found
        if best.error <= goal or iterations >= max_iterations:
            break
        iterations += 1
        problem.applications += 1  # of the slope
        aim = max(goal, EASE * found.tilt)
        offset = points.next(found.state.offset, found.wrong, found.state.force != 0)
        plan.refresh(x + offset)
        state = problem.at(found.state.overlap, offset)
    if spheres is not None:
        plan.warn_of_points(spheres.contact_radius(best.state.force))
    result = Equilibrium(
        force=best.state.force,
        overlap=best.state.overlap,
        displacement=best.state.displacement,
        slope=best.slope,
        tangent=best.state.tangent,
        iterations=iterations,
        applications=problem.applications,
        residual=best.error / scale if scale > 0 else 0.0,
        converged=best.error <= goal,
        softening=int(np.count_nonzero(best.state.tangent < 0)),
        contact_radius=None if spheres is None else spheres.contact_radius(best.state.force),
        shift=best.state.offset,
    )
    if not result.converged:
        hint = problem.hint
        if result.softening:
            hint += f"; the law softens at {result.softening} contacts, which may be about to jump"
        raise NotConverged(
            f"residual = {residual:.3g}: reached {result.residual:.3g} after "
            f"{iterations} iterations, {problem.applications} applications{hint}",
            result,
        )
    return result


@dataclass(frozen=True)
class Spheres:
    """What presses on the surface: radius and composite modulus `E*` of the contacts, (n,)."""

    radius: Array
    modulus: Array

    @classmethod
    def of(
        cls,
        ground: HalfSpace,
        law: Law,
        radius: ArrayLike | None,
        modulus: ArrayLike | None,
        count: int,
    ) -> Spheres | None:
        """As told, or as the law knows, or None."""
        if radius is None:
            radius = getattr(law, "radius", None)
        if radius is None:
            return None
        if modulus is None:
            modulus = getattr(law, "modulus", ground.modulus)
        given = {"radius": (radius, "m"), "modulus": (modulus, "Pa")}
        return cls(*(checks.positive(name, *value, count) for name, value in given.items()))

    def contact_radius(self, force: Array) -> Array:
        """Hertz's `a = (3 f R/(4 E*))^(1/3)`, m, zero where a contact pulls."""
        a: Array = np.cbrt(0.75 * np.maximum(force, 0.0) * self.radius / self.modulus)
        return a

    def tilt(self, wrong: Array, slope: Array, force: Array) -> float:
        """The overlap, m, that points of contact `wrong` (n, 2) by so much are wrong by, at most.

        A contact's own overlap is stationary there; those of its neighbours are not.
        """
        felt = np.abs((wrong * slope).sum(axis=1)) + (wrong**2).sum(axis=1) / (2 * self.radius)
        return float(felt[force != 0].max(initial=0.0))


@dataclass(frozen=True)
class _State:
    """A guess and what follows from it: `defect` is F, `error` the largest that counts, m."""

    overlap: Array
    force: Array
    tangent: Array
    displacement: Array
    defect: Array
    error: float
    offset: Array  # of the points of contact

    @property
    def merit(self) -> float:
        return float(np.abs(self.defect).max(initial=0.0))


@dataclass(frozen=True)
class _Found:
    """Forces in equilibrium for given points of contact, and how wrong these are, (n, 2), m.

    tilt, m: what that makes of the overlaps, at most.
    """

    state: _State
    slope: Array
    wrong: Array
    tilt: float

    @property
    def error(self) -> float:
        return max(self.state.error, self.tilt)


class Points:
    """Where spheres touch, round by round: substitution, by what the last rounds taught of it.

    D. G. Anderson, J. ACM 12, 547, 1965. Where contacts overlap, bare substitution may not
    contract.
    """

    def __init__(self) -> None:
        self._past: list[tuple[Array, Array]] = []

    def next(self, here: Array, wrong: Array, loaded: Array) -> Array:
        """The next shifts, after `here` (n, 2) were found `wrong` (n, 2) by so much."""
        step = here + wrong
        if self._past:
            moved = np.stack([(here - c).ravel() for c, _ in self._past], axis=1)
            turned = np.stack([(wrong - w).ravel() for _, w in self._past], axis=1)
            counts = np.repeat(loaded, 2)
            share = np.linalg.lstsq(turned[counts], wrong.ravel()[counts], rcond=1e-8)[0]
            step = step - ((moved + turned) @ share).reshape(here.shape)
        self._past = [*self._past, (here, wrong)][-MEMORY:]
        return step


class _Problem:
    def __init__(
        self, plan: Plan, delta: Array, law: Law, opening: Array, spheres: Spheres | None
    ) -> None:
        self._plan, self._law, self._spheres = plan, law, spheres
        self._delta, self._opening = delta, opening
        self.applications = 0
        self.hint = ""

    def _size(self, f: Array) -> Array | None:
        if self._spheres is None or self._plan.coupling == "point":
            return None
        return self._spheres.contact_radius(f)

    def apply(self, f: Array) -> Array:
        if not f.any():
            return np.zeros(len(f))
        self.applications += 1
        return self._plan.apply(f, self._size(f))

    def linear(self, f: Array) -> Callable[[Array], Array]:
        """`df -> dw` at the forces f."""
        tangent = self._plan.tangent(f, self._size(f))

        def apply(df: Array) -> Array:
            if not df.any():
                return np.zeros(len(df))
            self.applications += 1
            return tangent(df)

        return apply

    def open(self, offset: Array) -> _State:
        """No contact can carry load: the surface is flat."""
        zero = np.zeros(len(self._delta))
        return _State(self._delta.copy(), zero, zero, zero, zero, 0.0, np.zeros_like(offset))

    def found(self, state: _State, tilting: bool) -> _Found:
        slope = self._plan.slope(state.force, self._size(state.force))
        wrong, tilt = np.zeros_like(slope), 0.0
        if tilting and self._spheres is not None:
            wrong = self._spheres.radius[:, None] * slope - state.offset
            tilt = self._spheres.tilt(wrong, slope, state.force)
        return _Found(state, slope, wrong, tilt)

    def at(self, d: Array, offset: Array) -> _State:
        force, tangent = self._forces(d)
        w = self.apply(force)
        reached = self._delta - w
        if self._spheres is not None:
            reached = reached - (offset**2).sum(axis=1) / (2 * self._spheres.radius)
        # An open contact that stays open solves its equation outright.
        d = np.where(np.maximum(d, reached) <= self._opening, reached, d)
        error = np.maximum(d, self._opening) - np.maximum(reached, self._opening)
        largest = float(np.abs(error).max(initial=0.0))
        return _State(d, force, tangent, w, d - reached, largest, offset)

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
        linear = self.linear(state.force)
        step, definite = _conjugate_gradients(linear, stiffness, -state.defect, share * merit)
        ceiling = np.maximum(state.overlap, self._delta) + scale
        full = trial = self.at(np.minimum(state.overlap + step, ceiling), state.offset)
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
            trial = self.at(np.minimum(state.overlap + size * step, ceiling), state.offset)
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
