"""The sums over one layout of contacts, by whichever way is cheapest for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from numpy.typing import ArrayLike

from . import checks
from .checks import Array
from .choice import Choice, choose
from .direct import DirectSum

if TYPE_CHECKING:
    from .layer_kernel import LayerKernel

SIMILAR = 1.25  # ratio of numbers of contacts up to which a choice is not thought over


class Sum(Protocol):
    """What every way of summing offers; see `Plan`."""

    def apply(self, f: Array) -> Array: ...
    def displacement(self, f: Array) -> tuple[Array, Array]: ...
    def refresh(self, x: Array, radius: Array | None = None) -> bool: ...


class Plan:
    """Sums for many sets of forces on the same contacts, and for the same contacts moved on.

    Made by `HalfSpace.plan`. `x` (n, 2) are the contacts, m; `choice` says how they are summed, and
    why (print it).
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
        layer: LayerKernel | None = None,
    ) -> None:
        self._layer = layer
        self._modulus, self._tolerance, self._period = modulus, tolerance, period
        self._workers, self._method = workers, method
        self._check(x, radius)
        self._begin()

    def apply(self, f: Array) -> Array:
        """Depression `w = C f` of every contact by the forces `f` (n,), N: (n,), m."""
        return self._sum.apply(f)

    def slope(self, f: Array) -> Array:
        """Gradient of the expansion `e = -w` at every contact, (n, 2)."""
        return self._sum.displacement(f)[1]

    def displacement(self, f: Array) -> tuple[Array, Array]:
        """Depression, as `apply`, and slope from the same sums."""
        return self._sum.displacement(f)

    def refresh(self, x: ArrayLike, radius: ArrayLike | None = None) -> None:
        """The same for contacts that have moved, or of which some have come or gone.

        x: (n, 2) m; radius: (n,) m or None. A grid is kept while the contacts stay on it, and with
        it the energy is a smooth function of their positions; a new one changes it by something of
        the order of the tolerance. Raises ValueError as `HalfSpace.plan` does.
        """
        self._check(x, radius)
        n, before = len(self.x), self.choice.count
        similar = n <= SIMILAR * before and before <= SIMILAR * n
        if not (similar and self._sum.refresh(self.x, self._radius)):
            self._begin()

    def _check(self, x: ArrayLike, radius: ArrayLike | None) -> None:
        self.x = checks.vectors("x", x)
        self._radius = None if radius is None else checks.radii("radius", radius, len(self.x))

    def _begin(self) -> None:
        thickness = None if self._layer is None else self._layer.thickness
        self.choice: Choice = choose(self.x, self._tolerance, self._period, self._method, thickness)
        self._sum = self._summing()(self.x, self._modulus)
        if self._layer is not None and self.choice.grid is None:
            from .layer_sums import LayerSum, correction_of

            extra = correction_of(self.x, self._modulus, self._layer, self._period)
            self._sum = LayerSum(self._sum, extra)

    def _summing(self) -> Callable[[Array, float], Sum]:
        """Imported where needed: the mesh starts the compiler of its loops."""
        grid, radius, layer = self.choice.grid, self._radius, self._layer
        if grid is not None:
            from .mesh import MeshSum

            return lambda x, modulus: MeshSum(x, modulus, grid, radius, self._workers, layer)
        period = self._period
        if period is not None:
            from .periodic import PeriodicSum

            return lambda x, modulus: PeriodicSum(x, modulus, period, radius)
        return lambda x, modulus: DirectSum(x, modulus, radius)
