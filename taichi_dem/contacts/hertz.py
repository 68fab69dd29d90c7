"""Hertz normal contact with viscous damping.

    F   = (4/3) E* sqrt(R*) d^(3/2) - c v_n
    k   = dF/dd = 2 E* sqrt(R* d)
    c   = 2 sqrt(5/6) beta sqrt(k m*),   beta = -ln e / sqrt(ln^2 e + pi^2)

The damping makes the coefficient of restitution e independent of the impact speed.
Sources: K. L. Johnson, Contact Mechanics (1985), eq. 4.23; Y. Tsuji, T. Tanaka and T. Ishida,
Powder Technology 71 (1992) 239; S. M. Antypov and J. A. Elliott, EPL 94 (2011) 50004.
"""

import math
from dataclasses import dataclass

from taichi_dem.contacts.contact import NormalForce
from taichi_dem.contacts.elasticity import damping_ratio, effective_youngs_modulus
from taichi_dem.material import Material
from taichi_dem.types import ti
from taichi_dem.validation import parameter, validate


@dataclass(frozen=True)
class Hertz:
    """Elastic spheres after Hertz, damped so that they rebound with ``restitution``."""

    restitution: float = parameter("-", "rebound speed / impact speed", above=0, at_most=1)

    history = ()
    coefficient_names = ("effective_modulus", "damping")
    adhesive = plastic = False
    of_two_solids = True  # whose compliances add up: on ground that creeps its share creeps along

    def __post_init__(self) -> None:
        validate(self)

    @property
    def dissipates(self) -> bool:
        """Whether a closed cycle of loading can lose energy."""
        return self.restitution < 1

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """E* (Pa) and 2 sqrt(5/6) beta (-) for a contact of materials ``a`` and ``b``."""
        return {
            "effective_modulus": effective_youngs_modulus(a, b),
            "damping": 2 * math.sqrt(5 / 6) * damping_ratio(self.restitution),
        }

    @staticmethod
    @ti.func
    def force(contact, k, history: ti.template()):
        stiffness = 2 * k.effective_modulus * ti.sqrt(contact.effective_radius * contact.overlap)
        elastic = (2.0 / 3.0) * stiffness * contact.overlap
        damping = k.damping * ti.sqrt(stiffness * contact.effective_mass)
        return NormalForce(
            total=elastic - damping * contact.normal_velocity,
            elastic=elastic,
            stiffness=stiffness,
            damping=damping,
            area_stiffness=stiffness,
        )

    @staticmethod
    @ti.func
    def energy(contact, k, history: ti.template()):
        """(8/15) E* sqrt(R*) d^(5/2), the integral of the elastic force."""
        stiffness = 2 * k.effective_modulus * ti.sqrt(contact.effective_radius * contact.overlap)
        return (4.0 / 15.0) * stiffness * contact.overlap**2

    @staticmethod
    def stiffness(k: dict[str, float], effective_radius: float, overlap: float) -> float:
        """Largest tangent stiffness (N/m) up to ``overlap``, for the time step."""
        return 2 * k["effective_modulus"] * math.sqrt(effective_radius * overlap)

    @staticmethod
    def dashpot(
        k: dict[str, float], effective_radius: float, effective_mass: float, overlap: float
    ) -> float:
        """c (N s/m) at ``overlap``, for the time step."""
        stiffness = Hertz.stiffness(k, effective_radius, overlap)
        return k["damping"] * math.sqrt(stiffness * effective_mass)
