"""The coupled contact solve: forces in equilibrium with the surface that they deform.

Contacts with overlaps `delta` over the undeformed surface, a law `f = H(d)` and a substrate that
sinks by `w = C f` have the effective overlaps `d` that solve

    F(d) = d + C H(d) - delta = 0.

Semismooth Newton: with `K = H'(d)`, solve `(I + C K) s = -F`. In terms of `y = K s` that is the
symmetric `(K^-1 + C) y = -F` on the contacts that carry load; the others follow by
`d = delta - C f - C y`. Conjugate gradients with K as the preconditioner are, in terms of s,
conjugate gradients for `I + C K` in the inner product of K, which never divide by a stiffness that
vanishes; on soft ground a grid of a few nodes helps them (`coarse`). Where the matrix is not
positive (contacts closer than their size), they stop short, and the potential of which F is the
gradient guides the step.

Spheres whose radii R are known (`coupling="finite"`) are contacts of finite size: `C` is the
derivative of `w(f)`, see `finite`. And where the surface is tilted they do not touch it at x, under
their lowest point, but at `y = x + c`. Of all points, the effective overlap
`delta + e(x + c) - c^2/(2R)` is greatest at

    c = R grad e(y),

uphill. Both follow from one potential, `f.(delta - c^2/(2R)) - E_c(f, x + c) - E_local(f)`, which
is stationary in f and in c; its derivative by x, at constant overlap, is `f grad e(y) = f c/R`, so
that the force on the sphere is `f` along the normal of the tilted surface, through the centre.
Newton's method finds f, and substitution, at the same time, c: it contracts by about
`R f/(pi E' r^3) ~ (a/r)^3/2` a step.
"""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from . import checks
from .arrays import Array, kind_of, largest
from .ground import HalfSpace
from .newton import Law, Problem
from .plan import Plan
from .spheres import Spheres


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
    relative to the largest `overlap - opening`, the most that a contact has to lose (or `-opening`,
    of one that is made at the start); a contact that stays open has none. start: (n,) a guess of
    the effective overlaps, m; plan: one that
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
    n, kind = len(x), kind_of(x)
    spheres = Spheres.of(ground, law, radius, modulus, n, kind)
    offset = kind.zeros((n, 2))
    if shift is not None and spheres is not None and ground.coupling == "finite":
        offset = checks.vectors("shift", shift, kind)
    if offset.shape != x.shape:
        shapes = tuple(offset.shape), tuple(x.shape)
        raise ValueError("shift has shape {}: must be {}, one per contact".format(*shapes))
    if plan is None:
        plan = ground.plan(x + offset)
    else:
        plan.refresh(x + offset)
    delta = checks.scalars("overlap", overlap, n, kind)
    guess = delta if start is None else checks.scalars("start", start, n, kind)
    floor = checks.each("opening", opening, n, "a finite overlap, m", kind)
    wanted = "a number between 0 and 1"
    if not 0 < checks.number("residual", residual, wanted) < 1:
        raise ValueError(f"residual = {residual!r}: must be {wanted}")
    checks.whole("max_iterations", max_iterations)

    # What adheres may hold beyond its own opening, on a surface that the others pull up.
    made = kind.where(guess > floor, -floor, 0.0)
    scale = largest(kind.maximum(delta - floor, made).clip(0.0))
    goal = residual * scale
    problem = Problem(plan, x, delta, law, floor, spheres, offset)
    state = problem.at(guess, offset) if scale > 0 else problem.open(offset)
    best, iterations = state, 0
    while state.error > goal and iterations < max_iterations:
        state = problem.next(state, goal, scale)
        best = min(best, state, key=lambda s: s.error)
        iterations += 1
    radii = None if spheres is None else spheres.contact_radius(best.force)
    if radii is not None:
        plan.warn_of_points(radii)
    result = Equilibrium(
        force=best.force,
        overlap=best.overlap,
        displacement=best.displacement,
        slope=problem.slope(best),
        tangent=best.tangent,
        iterations=iterations,
        applications=problem.applications,
        residual=best.error / scale if scale > 0 else 0.0,
        converged=best.error <= goal,
        softening=int((best.tangent < 0).sum()),
        contact_radius=radii,
        shift=best.offset,
    )
    if not result.converged:
        hint = problem.hint
        if best is problem.dead_end:
            hint += "; no step improves the nearest state: there is no equilibrium close to it"
        if result.softening:
            hint += f"; the law softens at {result.softening} contacts, which may be about to jump"
        raise NotConverged(
            f"residual = {residual:.3g}: reached {result.residual:.3g} after "
            f"{iterations} iterations, {problem.applications} applications{hint}",
            result,
        )
    return result
