"""Spheres on the surface: how large their contacts are, and where they touch it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from . import checks
from .arrays import Array, Kind, kind_of, largest
from .ground import HalfSpace

MEMORY = 4  # rounds
ALIKE = 1e-8  # rounds that differ by less teach nothing


@dataclass(frozen=True)
class Spheres:
    """What presses on the surface: radius and composite modulus `E*` of the contacts, (n,)."""

    radius: Array
    modulus: Array

    @classmethod
    def of(
        cls,
        ground: HalfSpace,
        law: Any,
        radius: ArrayLike | None,
        modulus: ArrayLike | None,
        count: int,
        kind: Kind,
    ) -> Spheres | None:
        """As told, or as the law knows, or None."""
        if radius is None:
            radius = getattr(law, "radius", None)
        if radius is None:
            return None
        if modulus is None:
            modulus = getattr(law, "modulus", ground.modulus)
        given = {"radius": (radius, "m"), "modulus": (modulus, "Pa")}
        return cls(*(checks.positive(name, *value, count, kind) for name, value in given.items()))

    def contact_radius(self, force: Array) -> Array:
        """Hertz's `a = (3 f R/(4 E*))^(1/3)`, m, zero where a contact pulls."""
        pressing = force.clip(0.0)
        a: Array = kind_of(force).cbrt(0.75 * pressing * self.radius / self.modulus)
        return a

    def tilt(self, wrong: Array, slope: Array, force: Array) -> float:
        """The overlap, m, that points of contact `wrong` (n, 2) by so much are wrong by, at most.

        A contact's own overlap is stationary there; those of its neighbours are not.
        """
        felt = abs((wrong * slope).sum(axis=1)) + (wrong**2).sum(axis=1) / (2 * self.radius)
        return largest(felt[force != 0])


class Points:
    """Where spheres touch, round by round: substitution, by what the last rounds taught of it.

    D. G. Anderson, J. ACM 12, 547, 1965. Where contacts overlap, bare substitution may not
    contract.
    """

    def __init__(self) -> None:
        self._past: list[tuple[Array, Array]] = []

    def next(self, here: Array, wrong: Array, loaded: Array) -> Array:
        """The next shifts, after `here` (n, 2) were found `wrong` (n, 2) by so much."""
        step, kind = here + wrong, kind_of(here)
        if self._past:
            moved = kind.stack([here - c for c, _ in self._past], -1)
            turned = kind.stack([wrong - w for _, w in self._past], -1)
            felt = turned[loaded].reshape(-1, len(self._past)), wrong[loaded].reshape(-1)
            step = step - (moved + turned) @ kind.least_squares(*felt, ALIKE)
        self._past = [*self._past, (here, wrong)][-MEMORY:]
        return step
