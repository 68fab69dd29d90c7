"""The sums over one layout of contacts, by whichever way is cheapest for it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from math import inf, pi
from typing import TYPE_CHECKING, Protocol, cast

from numpy.typing import ArrayLike

from . import checks, finite
from .arrays import NUMPY, Array, Kind, host, kind_of, largest
from .choice import Choice, choose
from .coarse import Coarse
from .direct import DirectSum
from .finite import Close

if TYPE_CHECKING:
    from .layer_kernel import LayerKernel

SIMILAR = 1.25  # ratio of numbers of contacts up to which a choice is not thought over
FAR = 6.0  # contact radii from which on contacts may pass for points
WIDE = {"finite": 0.4, "point": 0.2}  # a/h from which on forces on a layer err by a percent


class Sum(Protocol):
    """What every way of summing offers; see `direct.DirectSum`."""

    @property
    def closest(self) -> float: ...
    def apply(self, f: Array) -> Array: ...
    def displacement(self, f: Array) -> tuple[Array, Array]: ...
    def pair(self, f: Array, q: Array | None) -> tuple[Array, Array]: ...
    def pair_slope(self, f: Array, q: Array) -> tuple[Array, Array, Array, Array]: ...
    def close(self) -> Close: ...
    def refresh(self, x: Array, reach: float = 0.0) -> bool: ...


class Plan:
    """Sums for many sets of forces on the same contacts, and for the same contacts moved on.

    Made by `HalfSpace.plan`. `x` (n, 2) are the contacts, m; `choice` says how they are summed, and
    why (print it). Where a method takes `radius`, (n,) m, these are the contact radii under the
    forces given, which coupling of finite size needs; without, those that the plan was made with,
    and without these the contacts are points.
    """

    def __init__(
        self,
        x: ArrayLike,
        radius: ArrayLike | None,
        modulus: float,
        tolerance: float,
        period: tuple[float, float] | None = None,
        workers: int | None = None,
        method: str | None = None,
        coupling: str = "finite",
        layer: LayerKernel | None = None,
    ) -> None:
        self.layer = layer
        self._modulus, self._tolerance, self._period = modulus, tolerance, period
        self._workers, self._method = workers, method
        self.coupling, self._warned, self._warned_of_layer = coupling, False, False
        self._reach = 0.0
        self._kind: Kind = NUMPY
        self._seen: tuple[Array, Array, Array] | None = None  # forces, radii, their `_steep`
        self._check(x, radius)
        self._begin()

    def apply(self, f: Array, radius: Array | None = None) -> Array:
        """Depression `w` of every contact by the forces `f` (n,), N: (n,), m."""
        f, a = self._kind.array(f), self._sized(radius)
        if a is None:
            return self._sum.apply(f)
        return self._depression(f, a, *self._sum.pair(f, f * a * a / 10))

    def slope(self, f: Array, radius: Array | None = None) -> Array:
        """Gradient of the expansion `e = -w` at every contact, (n, 2)."""
        return self.displacement(f, radius)[1]

    def displacement(self, f: Array, radius: Array | None = None) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope: see `HalfSpace.displacement`."""
        f, a = self._kind.array(f), self._sized(radius)
        if a is None:
            return self._sum.displacement(f)
        near, steep, fall, steep_fall = self._sum.pair_slope(f, f * a * a / 10)
        self._seen = f + 0, a + 0, steep
        slope = fall + (a * a / 10)[:, None] * steep_fall
        if self._reach:
            slope += self._close.slope(f, a) / (pi * self._modulus)
        return self._depression(f, a, near, steep), slope

    def energy(self, f: Array, radius: Array | None = None) -> Array:
        """The contacts' parts of the coupling energy `E_c`, half of each pair's: (n,), J."""
        a = self._sized(radius)
        if a is None:
            return 0.5 * f * self._sum.apply(f)
        near, steep = self._sum.pair(f, f * a * a / 10)
        potential = near + a * a / 10 * steep
        if self._reach:
            potential += self._close.potential(f, a) / (pi * self._modulus)
        return 0.5 * f * potential

    def _depression(self, f: Array, a: Array, near: Array, steep: Array) -> Array:
        w = near + a * a / 6 * steep
        if self._reach:
            w += self._close.depression(f, a) / (pi * self._modulus)
        return w

    def tangent(self, f: Array, radius: Array | None = None) -> Callable[[Array], Array]:
        """`df -> dw`, the derivative of the depression by forces on which radii depend by Hertz.

        `a ~ f^(1/3)`. It is symmetric, as the second derivative of an energy; for points it is
        `apply`.
        """
        f, a = self._kind.array(f), self._sized(radius)
        if a is None:
            return self._sum.apply
        # d2q/df2 (laplacian of w): a contact's own size grows in the others' curvature.
        pressing = self._kind.where(f > 0, f, inf)
        own = a * a / (9 * pressing) * self._steep(f, a)
        close = self._close.tangent(f, a) if self._reach else None

        def apply(g: Array) -> Array:
            near, steep = self._sum.pair(g, a * a / 6 * g)
            dw = near + a * a / 6 * steep + own * g
            return dw if close is None else dw + close(g) / (pi * self._modulus)

        return apply

    def _steep(self, f: Array, a: Array) -> Array:
        """Laplacian of the depression: a sum by itself, unless the last one was of the same."""
        if self._seen is not None:
            force, radius, steep = self._seen
            if (force == f).all() and (radius == a).all():
                return steep
        return self._sum.pair(f, f * a * a / 10)[1]

    def preconditioner(self, stiffness: Array) -> Callable[[Array], Array] | None:
        """For the coupled solve with contacts of that stiffness (n,), N/m: see `coarse`."""
        plain = self._period is None and self.layer is None
        return Coarse(self.x, self._modulus).preconditioner(stiffness) if plain else None

    def refresh(self, x: ArrayLike, radius: ArrayLike | None = None) -> None:
        """The same for contacts that have moved, or of which some have come or gone.

        x: (n, 2) m; radius: (n,) m or None. A grid is kept while the contacts stay on it, and with
        it the energy is a smooth function of their positions; a new one changes it by something of
        the order of the tolerance. Raises ValueError as `HalfSpace.plan` does.
        """
        same = self._check(x, radius)
        n, before = len(self.x), self.choice.count
        similar = same and n <= SIMILAR * before and before <= SIMILAR * n
        if not (similar and self._sum.refresh(self.x, self._reach)):
            self._begin()
        elif self._reach:
            self._close = self._found()

    @property
    def closest(self) -> float:
        """The least distance between two contacts, m."""
        return self._sum.closest

    def warn_of_points(self, radius: Array) -> None:
        """Warn, once, if contacts that count as points are too large or too close for that.

        Or if contacts are too wide for a layer.
        """
        widest = largest(radius)
        thickness = inf if self.layer is None else self.layer.thickness
        if widest > WIDE[self.coupling] * thickness and not self._warned_of_layer:
            self._warned_of_layer = True
            warnings.warn(
                f"contacts of radius {widest:.3g} m are wide for a layer of {thickness:.3g} m: "
                f"beyond {WIDE[self.coupling] * thickness:.3g} m forces err by a percent and more",
                stacklevel=3,
            )
        if self.coupling == "point" and not self._warned and self._sum.closest < FAR * widest:
            self._warned = True
            warnings.warn(
                f'coupling = "point": contacts of radius {widest:.3g} m lie '
                f"{self._sum.closest:.3g} m apart; below {FAR:g} radii their size counts, and "
                'coupling = "finite" knows it',
                stacklevel=3,
            )

    def _sized(self, radius: Array | None) -> Array | None:
        """The contact radii if they count; pairs that overlap are taken out of the sums."""
        a = self._radius if radius is None else self._kind.array(radius)
        if a is None:
            return None
        if self.coupling == "point":
            self.warn_of_points(a)
            return None
        needed = finite.REACH * largest(a)
        if needed > self._reach and needed > self._sum.closest:
            self._reach = finite.SPARE * needed
            if not self._sum.refresh(self.x, self._reach):
                self._begin()
            self._close = self._found()
        return a

    def _check(self, x: ArrayLike, radius: ArrayLike | None) -> bool:
        """Takes up the arguments, and tells whether they are arrays of the same kind as before."""
        self.x = checks.vectors("x", x)
        self._seen = None
        kind = kind_of(self.x)
        same, self._kind = kind == self._kind, kind
        self._radius = None if radius is None else checks.radii("radius", radius, len(self.x), kind)
        return same

    def _begin(self) -> None:
        thickness = None if self.layer is None else self.layer.thickness
        self.choice: Choice = choose(
            host(self.x), self._tolerance, self._period, self._method, self._reach, thickness,
            sized=self.coupling == "finite",
        )  # fmt: skip
        self._sum: Sum = self._summing()
        if self._reach:
            self._close = self._found()

    def _found(self) -> Close:
        """The pairs that the sums leave out."""
        close: Close = self._kind.adapt(self._sum.close())
        return close

    def _summing(self) -> Sum:
        """Imported where needed: the mesh starts the compiler of its loops."""
        grid, period, layer = self.choice.grid, self._period, self.layer
        if grid is not None:
            from .mesh import MeshSum

            return MeshSum(self.x, self._modulus, grid, self._reach, self._workers, layer)
        x = host(self.x)
        if period is not None:
            from .periodic import PeriodicSum

            sums: Sum = PeriodicSum(x, self._modulus, period, self._reach)
        else:
            sums = DirectSum(x, self._modulus, self._reach)
        if layer is not None:
            from .layer_sums import LayerSum, correction_of

            sums = LayerSum(sums, correction_of(x, self._modulus, layer, period))
        return cast(Sum, self._kind.adapt(sums))
