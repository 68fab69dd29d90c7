"""Linear spring and dashpot.

    F = k_n d - c v_n,   c = 2 beta sqrt(k_n m*),   beta = -ln e / sqrt(ln^2 e + pi^2)

Source: P. A. Cundall and O. D. L. Strack, Geotechnique 29 (1979) 47; the damped oscillator's half
period gives the restitution e exactly.
"""

import math
from dataclasses import dataclass

from taichi_dem.contacts.contact import NormalForce
from taichi_dem.contacts.elasticity import damping_ratio
from taichi_dem.material import Material
from taichi_dem.types import ti
from taichi_dem.validation import parameter, validate


@dataclass(frozen=True)
class Hooke:
    """A linear spring, damped so that spheres rebound with ``restitution``."""

    normal_stiffness: float = parameter("N/m", "force per overlap", above=0)
    restitution: float = parameter("-", "rebound speed / impact speed", above=0, at_most=1)

    history = ()
    coefficient_names = ("stiffness", "damping")
    adhesive = plastic = False

    def __post_init__(self) -> None:
        validate(self)

    @property
    def dissipates(self) -> bool:
        """Whether a closed cycle of loading can lose energy."""
        return self.restitution < 1

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """k_n (N/m) and 2 beta (-); the same for every pair unless ``pairs`` says otherwise."""
        return {
            "stiffness": self.normal_stiffness,
            "damping": 2 * damping_ratio(self.restitution),
        }

    @staticmethod
    @ti.func
    def force(contact, k, history: ti.template()):
        elastic = k.stiffness * contact.overlap
        damping = k.damping * ti.sqrt(k.stiffness * contact.effective_mass)
        return NormalForce(
            total=elastic - damping * contact.normal_velocity,
            elastic=elastic,
            stiffness=k.stiffness,
            damping=damping,
            area_stiffness=k.stiffness,
        )

    @staticmethod
    @ti.func
    def energy(contact, k, history: ti.template()):
        """k_n d^2 / 2."""
        return 0.5 * k.stiffness * contact.overlap**2

    @staticmethod
    def stiffness(k: dict[str, float], effective_radius: float, overlap: float) -> float:
        """Largest tangent stiffness (N/m) up to ``overlap``, for the time step."""
        return k["stiffness"]

    @staticmethod
    def dashpot(
        k: dict[str, float], effective_radius: float, effective_mass: float, overlap: float
    ) -> float:
        """c (N s/m), for the time step."""
        return k["damping"] * math.sqrt(k["stiffness"] * effective_mass)
