"""Effective moduli of two bodies in contact, and the damping for a restitution (no Taichi).

Sources: K. L. Johnson, Contact Mechanics (1985), eqs. 4.2b and 7.43;
T. Schwager and T. Poeschel, Granular Matter 9 (2007) 465 and S. M. Antypov and J. A. Elliott,
EPL 94 (2011) 50004, eq. 17, for the damping ratio.
"""

from __future__ import annotations

import math

from taichi_dem.material import Material


def effective_youngs_modulus(a: Material, b: Material) -> float:
    """E* in Pa: 1/E* = (1 - nu_a^2)/E_a + (1 - nu_b^2)/E_b."""
    return 1 / sum((1 - m.poissons_ratio**2) / m.youngs_modulus for m in (a, b))


def effective_shear_modulus(a: Material, b: Material) -> float:
    """G* in Pa: 1/G* = 2(2 - nu_a)(1 + nu_a)/E_a + 2(2 - nu_b)(1 + nu_b)/E_b."""
    return 1 / sum(
        2 * (2 - m.poissons_ratio) * (1 + m.poissons_ratio) / m.youngs_modulus for m in (a, b)
    )


def damping_ratio(restitution: float) -> float:
    """beta = -ln e / sqrt(ln^2 e + pi^2), the fraction of critical damping; 0 for e = 1."""
    logarithm = math.log(restitution)
    return -logarithm / math.hypot(logarithm, math.pi)
