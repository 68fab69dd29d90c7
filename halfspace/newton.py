"""One equation for all contacts, and a step towards its solution; `solve` says what it solves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .arrays import Array, host, inner, kind_of, largest
from .plan import Plan
from .spheres import Points, Spheres

Law = Callable[[Array], tuple[Array, Array]]
Preconditioner = Callable[[Array], Array]

HALVINGS = 10  # of a Newton step that does not improve the state
MATTER = 0.3  # share of the residual from which on points of contact come first
LOOSE = 3.0  # what a step leaves of the residual because it is not linear, over its square
RELIED = 0.05  # of a residual is left by the preconditioner alone, at best
EASE = 0.03  # residual of the forces, over that of the points of contact, until these are found


@dataclass(frozen=True)
class State:
    """A guess and what follows from it: `defect` is F, `missing` the largest that counts, m.

    offset (n, 2), m: of the points of contact; wrong (n, 2), m: by how much, and tilt, m, what that
    makes of the overlaps, at most; slope (n, 2), or None where nothing depends on it.
    """

    overlap: Array
    force: Array
    tangent: Array
    displacement: Array
    defect: Array
    missing: float
    offset: Array
    wrong: Array
    tilt: float
    slope: Array | None

    @property
    def error(self) -> float:
        return max(self.missing, self.tilt)

    @property
    def merit(self) -> float:
        return largest(self.defect)


class Problem:
    """`F(d) = 0` for n contacts at x (n, 2), m, of overlaps delta (n,), m, that open at `opening`.

    spheres: what presses, or None for points; offset (n, 2), m: where the plan has the contacts,
    seen from x. `applications` counts those of C; `hint` says, if anything, why it may not go on;
    `dead_end` is the best state from which no part of Newton's step was an improvement.
    """

    def __init__(
        self,
        plan: Plan,
        x: Array,
        delta: Array,
        law: Law,
        opening: Array,
        spheres: Spheres | None,
        offset: Array,
    ) -> None:
        self._plan, self._law = plan, law
        self._spheres = spheres if plan.coupling == "finite" else None
        self._x, self._delta, self._opening = x, delta, opening
        self._kind = kind_of(x)
        self._offset = offset  # of the plan
        self._points, self._together, self._relies = Points(), True, True
        self.applications = 0
        self.hint = ""
        self.dead_end: State | None = None

    def linear(self, f: Array) -> Callable[[Array], Array]:
        """`df -> dw` at the forces f."""
        size = None if self._spheres is None else self._spheres.contact_radius(f)
        tangent = self._plan.tangent(f, size)

        def apply(df: Array) -> Array:
            if not df.any():
                return self._kind.zeros(len(df))
            self.applications += 1
            return tangent(df)

        return apply

    def open(self, offset: Array) -> State:
        """No contact can carry load: the surface is flat."""
        zero, flat = (self._kind.zeros_like(a) for a in (self._delta, offset))
        return State(self._delta, zero, zero, zero, zero, 0.0, flat, flat, 0.0, flat)

    def at(self, d: Array, offset: Array) -> State:
        force, tangent = self._forces(d)
        self._go_to(offset)
        kind, spheres, n = self._kind, self._spheres, len(d)
        w, slope, lost = kind.zeros(n), None, kind.zeros(n)
        wrong, tilt = kind.zeros_like(offset), 0.0
        if force.any():
            self.applications += 1
            if spheres is None:
                w = self._plan.apply(force)
            else:
                w, slope = self._plan.displacement(force, spheres.contact_radius(force))
        if spheres is not None:
            lost = (offset**2).sum(axis=1) / (2 * spheres.radius)
            slope = wrong if slope is None else slope
            wrong = spheres.radius[:, None] * slope - offset
            tilt = spheres.tilt(wrong, slope, force)
        reached = self._delta - w - lost
        # An open contact that stays open solves its equation outright.
        d = kind.where(kind.maximum(d, reached) <= self._opening, reached, d)
        error = kind.maximum(d, self._opening) - kind.maximum(reached, self._opening)
        missing = largest(error)
        return State(
            d, force, tangent, w, d - reached, missing, offset, wrong, tilt, slope
        )  # fmt: skip

    def _go_to(self, offset: Array) -> None:
        """Have the plan for contacts there."""
        if offset is not self._offset:
            self._plan.refresh(self._x + offset)
            self._offset = offset

    def slope(self, state: State) -> Array:
        """At a state found before."""
        if state.slope is not None:
            return state.slope
        return self._plan.slope(state.force)

    def _forces(self, d: Array) -> tuple[Array, Array]:
        kind, closed = self._kind, d > self._opening
        values = self._law(kind.maximum(d, self._opening))
        if not isinstance(values, tuple) or len(values) != 2:
            raise ValueError(f"law returned {type(values).__name__}: must be (force, tangent)")
        result = []
        for name, value in zip(("force", "tangent"), values, strict=True):
            value = kind.array(value)
            if value.shape != d.shape:
                shapes = tuple(value.shape), tuple(d.shape)
                raise ValueError("law returned a {} of shape {}, not {}".format(name, *shapes))
            value = kind.where(closed, value, 0.0)
            good = kind.isfinite(value)
            if not good.all():
                k = host(good).argmin()
                raise ValueError(
                    f"law returned {name}[{k}] = {float(value[k])!r} at overlap {float(d[k])!r} m"
                )
            result.append(value)
        return result[0], result[1]

    def next(self, state: State, goal: float, scale: float) -> State:
        """The state after one Newton step, and with better points of contact.

        Both at once if that brings it on, or points alone where they matter more. If not, first
        forces for the same points, then points.
        """
        if self._together and state.tilt > max(goal, MATTER * state.missing):
            shifted = self.at(state.overlap, state.offset + state.wrong)
            if shifted.tilt < 0.5 * state.tilt:
                return shifted
            self._together = False
        precondition = None
        if not self.hint:  # of a matrix that is not positive it knows nothing
            precondition = self._plan.preconditioner(state.tangent.clip(0.0))
        ceiling = self._kind.maximum(state.overlap, self._delta) + scale
        moving = self._together and state.tilt > 0.5 * goal
        # What better points change comes on top: forces need not be found better than that.
        enough = max(goal, state.tilt) if moving else max(goal, EASE * state.tilt)
        offset = state.offset + state.wrong if moving else state.offset
        wanted = moving or state.missing > enough
        if precondition and wanted and self._relies and enough > RELIED * state.merit:
            step = precondition(-state.defect)
            if trial := self._tried(state, step, offset, ceiling, goal):
                return trial
            self._relies = False
        if moving:
            step, definite = self._step(state, enough, scale, precondition)
            if definite and (trial := self._tried(state, step, offset, ceiling, goal)):
                return trial
            self._together = False
            enough = max(goal, EASE * state.tilt)
        if state.missing > enough:
            step, definite = self._step(state, enough, scale, precondition)
            return self._newton(state, step, definite, ceiling, goal)
        offset = self._points.next(state.offset, state.wrong, state.force != 0)
        return self.at(state.overlap, offset)

    def _tried(
        self, state: State, step: Array, offset: Array, ceiling: Array, goal: float
    ) -> State | None:
        """Where a step leads, if that is good enough to go on from."""
        trial = self.at(self._kind.minimum(state.overlap + step, ceiling), offset)
        better = max(trial.merit, trial.tilt) < 0.5 * max(state.merit, state.tilt)
        return trial if trial.error <= goal or better else None

    def _step(
        self, state: State, goal: float, scale: float, precondition: Preconditioner | None
    ) -> tuple[Array, bool]:
        """Newton's step, and whether the matrix was positive."""
        merit = state.merit
        if merit <= 0.5 * goal:
            return self._kind.zeros_like(state.defect), True
        self._go_to(state.offset)
        share = min(max(LOOSE * merit / scale, 0.5 * goal / merit), 0.1)
        # Where the law softens, its force is held while the others adapt.
        stiffness = state.tangent.clip(0.0)
        found = self.linear(state.force), stiffness, -state.defect, share * merit
        step, definite = _conjugate_gradients(*found, precondition)
        if not definite:
            self.hint = "; contacts may be closer together than their size allows"
            self.hint += ", or too wide for the layer" * (self._plan.layer is not None)
        return step, definite

    def _newton(
        self, state: State, step: Array, definite: bool, ceiling: Array, goal: float
    ) -> State:
        """The state after a step, halved until it is an improvement.

        An improvement is a smaller defect, or, where the matrix was not positive and the defect is
        no guide, a larger potential `U(f)`: its gradient is `-F`, so its change is
        `-(F_0 + F_1)/2 . (f_1 - f_0)` to third order.
        """
        size = 1.0
        full = trial = self.at(self._kind.minimum(state.overlap + step, ceiling), state.offset)
        for _ in range(HALVINGS):
            if definite:
                better = trial.merit < (1 - 1e-4 * size) * state.merit
            else:
                loss = inner(state.defect + trial.defect, trial.force - state.force)
                better = bool(loss < 0)
            if better or trial.missing <= goal:
                return trial
            size /= 2
            trial = self.at(self._kind.minimum(state.overlap + size * step, ceiling), state.offset)
        if self.dead_end is None or state.error < self.dead_end.error:
            self.dead_end = state
        return full  # across a kink of the law the residual may have to grow


def _conjugate_gradients(
    apply: Callable[[Array], Array],
    k: Array,
    b: Array,
    goal: float,
    precondition: Preconditioner | None,
) -> tuple[Array, bool]:
    """Solve `(I + C K) s = b` to within `goal`, and tell whether `K + K C K` was positive.

    If not, this is what it came to before that showed; at the first step, the fixed-point step `b`.
    K times what `precondition` makes of it is to be about what `(K^-1 + C)^-1` does; without one,
    K itself is.
    """
    precondition = precondition or (lambda r: r)
    where = kind_of(b).where
    s, r = kind_of(b).zeros_like(b), b
    loaded = k > 0
    p = precondition(r)
    rr = inner(r, k * p)
    for _ in range(2 * len(b)):
        if largest(r[loaded]) <= goal:
            break
        q = p + apply(k * p)
        curvature = inner(k * p, q)
        if not curvature > 0:
            return where(loaded, s, s + r) if s.any() else b, False
        s = s + (rr / curvature) * p
        r = r - (rr / curvature) * q
        better = precondition(r)
        rr, previous = inner(r, k * better), rr
        p = better + (rr / previous) * p
    return where(loaded, s, s + r), True
