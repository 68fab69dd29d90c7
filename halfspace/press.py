"""Spheres pressed into the half-space: forces, contacts and the dented surface, in equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .arrays import Array, kind_of, largest
from .ground import HalfSpace
from .plan import Plan
from .solve import Equilibrium, NotConverged, solve
from .spheres import Points, Spheres

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROUNDS = 60  # of substitution or of the secant method
INNER = 0.1  # residual of a solve, over that of the total load


@dataclass(frozen=True)
class Pressed:
    """Spheres in equilibrium with the surface that they dent; one row for each.

    force (n,) N; contact_radius (n,) m; approach (n,) m, how far the lowest point of each sphere,
    undeformed, is below the undeformed surface, or negative, above; displacement (n,) m, the
    depression by the other spheres, and slope (n, 2), the gradient of -1 times it, where the sphere
    touches: at `contact` (n, 2) m. The force along the surface is `-force slope`. x (n, 2) m and
    radius (n,) m are the spheres'; iterations, applications and residual those of the solution.
    """

    ground: HalfSpace
    x: Array
    radius: Array
    force: Array
    contact_radius: Array
    approach: Array
    displacement: Array
    slope: Array
    contact: Array
    iterations: int
    applications: int
    residual: float

    def pressure(self, points: ArrayLike) -> Array:
        """Pressure on the surface, Pa, at `points` (m, 2): (m,)."""
        return self.ground.pressure(self.contact, self.force, self.contact_radius, points)

    def depression(self, points: ArrayLike) -> Array:
        """Depression of the surface, m, at `points` (m, 2): (m,), positive downward."""
        pressing = self.force > 0
        load = self.contact[pressing], self.force[pressing]
        return self.ground.field(*load, points, self.contact_radius[pressing])

    def surface_slope(self, points: ArrayLike) -> Array:
        """Slope of the surface, the gradient of -1 times `depression`, at `points`: (m, 2)."""
        pressing = self.force > 0
        load = self.contact[pressing], self.force[pressing]
        return self.ground.field_slope(*load, points, self.contact_radius[pressing])

    def draw(self, axes: Axes | None = None, **options: Any) -> Axes:
        """The dents from above, as `halfspace.draw_dents`."""
        from .pictures import draw_dents

        load = self.contact, self.force, self.contact_radius
        return draw_dents(self.ground, *load, axes=axes, **options)


def press(
    ground: HalfSpace,
    x: ArrayLike,
    radius: ArrayLike,
    *,
    approach: ArrayLike | None = None,
    load: ArrayLike | None = None,
    youngs_modulus: float | None = None,
    poissons_ratio: float | None = None,
    residual: float = 1e-8,
    max_iterations: int = 100,
) -> Pressed:
    """Press n spheres into the surface, without friction or adhesion, and let it come to rest.

    x: (n, 2) m, where their centres are, seen from above; radius: of the spheres, scalar or (n,),
    m. Exactly one of

    - approach: how far they are pushed down from touching the flat surface, m, scalar for all or
      (n,) for each, negative for a sphere that is held above;
    - load: an array (n,), N, the force on each, >= 0; or one number, N, > 0, the force on all of
      them together, on one level. (A sphere without load is put where it just touches.)

    youngs_modulus, Pa, and poissons_ratio: of the spheres, or neither: they are rigid. residual:
    relative, of the largest approach, or of the load; max_iterations: of Newton's method.

    Contacts are Hertz's (K. L. Johnson, Contact Mechanics, 1985, section 4.2) on a surface that the
    others lower and tilt, as far as the ground's `coupling` says. Raises ValueError for arguments
    without sense and NotConverged where no equilibrium is found.
    """
    x = checks.vectors("x", x)
    n, kind = len(x), kind_of(x)
    if (approach is None) == (load is None):
        given = "neither" if load is None else "both"
        raise ValueError(f"approach, load: {given} given, must be exactly one of them")
    modulus = kind.zeros(n) + _modulus(ground, youngs_modulus, poissons_ratio)
    spheres = Spheres(checks.positive("radius", radius, "m", n, kind), modulus)
    if not 0 < checks.number("residual", residual, "a number between 0 and 1") < 1:
        raise ValueError(f"residual = {residual!r}: must be a number between 0 and 1")
    checks.whole("max_iterations", max_iterations)
    if approach is not None:
        level = checks.each("approach", approach, n, "a finite length, m", kind)
        state = _solve(ground, x, spheres, level, residual, max_iterations)
        return _pressed(ground, x, spheres, level, state)
    assert load is not None
    if np.ndim(load) > 0:
        force = checks.scalars("load", load, n, kind)
        checks.refuse("load", force, force < 0, "must be >= 0 N")
        return _under(ground, x, spheres, force, residual)
    total = checks.number("load", load, "a force > 0 N, or one for each sphere")
    if total <= 0:
        raise ValueError(f"load = {total!r}: must be a force > 0 N, or one for each sphere")
    if n == 0:
        raise ValueError("x has no rows: there must be a sphere to carry the load")
    return _together(ground, x, spheres, total, residual, max_iterations)


def _modulus(ground: HalfSpace, youngs_modulus: Any, poissons_ratio: Any) -> float:
    """The composite modulus of a sphere and the ground."""
    from .reference import composite_modulus

    if youngs_modulus is None and poissons_ratio is None:
        return ground.modulus
    values = {"youngs_modulus": youngs_modulus, "poissons_ratio": poissons_ratio}
    for name, value in values.items():
        if value is None:
            raise ValueError(f"{name} = None: must be given with the spheres' other constant")
    e = checks.number("youngs_modulus", youngs_modulus, "a number > 0 Pa")
    nu = checks.number("poissons_ratio", poissons_ratio, "a number with -1 < nu <= 0.5")
    if e <= 0:
        raise ValueError(f"youngs_modulus = {e!r}: must be a number > 0 Pa")
    if not -1 < nu <= 0.5:
        raise ValueError(f"poissons_ratio = {nu!r}: must be a number with -1 < nu <= 0.5")
    return composite_modulus(e, nu, ground.youngs_modulus, ground.poissons_ratio)


def _pressed(
    ground: HalfSpace, x: Array, spheres: Spheres, approach: Array, state: Equilibrium
) -> Pressed:
    assert state.contact_radius is not None
    return Pressed(
        ground, x, spheres.radius, state.force, state.contact_radius, approach,
        state.displacement, state.slope, x + state.shift,
        state.iterations, state.applications, state.residual,
    )  # fmt: skip


def _solve(
    ground: HalfSpace,
    x: Array,
    spheres: Spheres,
    approach: Array,
    residual: float,
    max_iterations: int,
    before: Equilibrium | None = None,
    plan: Plan | None = None,
) -> Equilibrium:
    from .reference import hertz_law

    return solve(
        ground,
        x,
        approach,
        hertz_law(spheres.radius, spheres.modulus),
        residual,
        None if before is None else before.overlap,
        max_iterations,
        plan=plan,
        shift=None if before is None else before.shift,
    )


def _together(
    ground: HalfSpace, x: Array, spheres: Spheres, total: float, residual: float, most: int
) -> Pressed:
    """On one level, under a total load P: the secant method for `P^(2/3)`, nearly linear in it."""
    n, plan = len(x), ground.plan(x)
    alone = float((spheres.radius**0.5 * spheres.modulus).sum()) * 4 / 3
    level, state = float((total / alone) ** (2 / 3)), None
    before: tuple[float, float] = (0.0, 0.0)
    iterations = applications = 0
    for _ in range(ROUNDS):
        approach = kind_of(x).zeros(n) + level
        state = _solve(ground, x, spheres, approach, INNER * residual, most, state, plan)
        iterations += state.iterations
        applications += state.applications
        carried = float(state.force.sum())
        error = abs(carried / total - 1)
        if error <= residual:
            result = _pressed(ground, x, spheres, approach, state)
            return replace(result, iterations=iterations, applications=applications, residual=error)
        here = (level, carried ** (2 / 3))
        if here[1] == before[1]:
            break
        steepness = (here[0] - before[0]) / (here[1] - before[1])
        level = level + steepness * (total ** (2 / 3) - here[1])
        before = here
    assert state is not None
    raise NotConverged(
        f"load = {total!r} N: {float(state.force.sum())!r} N at the approach {before[0]!r} m, "
        f"after {iterations} iterations",
        state,
    )


def _under(ground: HalfSpace, x: Array, spheres: Spheres, force: Array, residual: float) -> Pressed:
    """Under a given load each: the forces are known, and only where spheres touch is sought."""
    a = spheres.contact_radius(force)
    own = a * a / spheres.radius
    shift, points, plan = kind_of(x).zeros_like(x), Points(), ground.plan(x)
    tilting = ground.coupling == "finite"
    for rounds in range(1, ROUNDS + 1):
        w, slope = plan.displacement(force, a)
        wrong = (spheres.radius[:, None] * slope - shift) * tilting
        approach = own + w + (shift**2).sum(axis=1) / (2 * spheres.radius)
        scale = largest(approach)
        error = spheres.tilt(wrong, slope, force)
        if error <= residual * scale:
            share = error / scale if scale > 0 else 0.0
            return Pressed(
                ground, x, spheres.radius, force, a, approach, w, slope, x + shift,
                rounds, rounds, share,
            )  # fmt: skip
        shift = points.next(shift, wrong, force != 0)
        plan.refresh(x + shift)
    tangent = 2 * spheres.modulus * a
    state = Equilibrium(
        force, own, w, slope, tangent, ROUNDS, ROUNDS, error / scale, False, 0, a, shift
    )
    raise NotConverged(
        f"residual = {residual:.3g}: reached {error / scale:.3g} after {ROUNDS} rounds; contacts "
        "may be closer together than their size allows",
        state,
    )
