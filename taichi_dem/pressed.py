"""Hertz's law for many spheres that press on one ground: forces, overlaps, radii, energies.

K. L. Johnson, Contact Mechanics (1985), section 4.2: `f = (4/3) E* sqrt(R) d^(3/2)`, `a^2 = R d`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Pressed(NamedTuple):
    """Spheres by ``ids`` (n,), at ``place`` (n, 2) m, of ``radius`` (n,) m and contact ``modulus``
    (n,) E*, Pa."""

    ids: np.ndarray
    place: np.ndarray
    radius: np.ndarray
    modulus: np.ndarray

    @classmethod
    def nobody(cls) -> Pressed:
        """None of them."""
        return cls(np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty(0))

    def those(self, which: np.ndarray) -> Pressed:
        """Some of them, by indices or a mask."""
        return Pressed(*(column[which] for column in self))

    def and_those(self, others: Pressed) -> Pressed:
        """These, then ``others``."""
        return Pressed(*(np.concatenate(pair) for pair in zip(self, others, strict=True)))

    def force(self, overlap: np.ndarray) -> np.ndarray:
        """H (n,) N."""
        return self._strength * np.maximum(overlap, 0.0) ** 1.5

    def law(self, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """H (n,) N, and its derivative, N/m."""
        return self.force(overlap), 1.5 * self._strength * np.sqrt(np.maximum(overlap, 0.0))

    def overlap(self, force: np.ndarray) -> np.ndarray:
        """G, the inverse of H, (n,) m."""
        return np.cbrt((force / self._strength) ** 2)

    def contact_radius(self, force: np.ndarray) -> np.ndarray:
        """(n,) m; that of a force that pulls is zero."""
        return np.cbrt(0.75 * np.maximum(force, 0.0) * self.radius / self.modulus)

    def energy(self, overlap: np.ndarray) -> np.ndarray:
        """E, the integral of H, (n,) J."""
        return 0.4 * self.force(overlap) * overlap

    def complement(self, force: np.ndarray) -> np.ndarray:
        """E*, the integral of G, (n,) J."""
        return 0.6 * force * self.overlap(force)

    @property
    def _strength(self) -> np.ndarray:
        return 4 / 3 * self.modulus * np.sqrt(self.radius)
