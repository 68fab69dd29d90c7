"""Mindlin tangential spring with a Coulomb limit.

    dT = -k_t v_t dt,   k_t = 8 G* a = (4 G*/E*) k_n,   |T - c_t v_t| <= mu F_n

The force itself is the history, so that it stays right when the contact radius changes: a load
that grows stiffens the contact for what follows, a load that falls releases tangential force in
proportion to k_t (without this, energy would be made from nothing).  The force turns with the
contact: it follows the normal, keeping its length, and spins with the two bodies about it.
Sources: R. D. Mindlin, J. Appl. Mech. 16 (1949) 259; C. Thornton, S. J. Cummins and P. W. Cleary,
Powder Technology 233 (2013) 30, for release on unloading.
"""

from dataclasses import dataclass

from taichi_dem.contacts.elasticity import effective_shear_modulus, effective_youngs_modulus
from taichi_dem.material import Material
from taichi_dem.types import real, ti, vec3
from taichi_dem.validation import parameter, validate


@dataclass(frozen=True)
class Mindlin:
    """Friction through an elastic tangential spring with a dashpot beside it."""

    friction: float = parameter("-", "Coulomb coefficient", at_least=0)
    damping: float = parameter("-", "tangential / normal dashpot", default=1.0, at_least=0)

    history = (("tangential_force", vec3), ("tangential_stiffness", real))
    coefficient_names = ("stiffness_ratio", "friction", "damping")

    def __post_init__(self) -> None:
        validate(self)

    @property
    def idle(self) -> str:
        """Why it makes no force, if so: the dashpot too is held to the Coulomb limit."""
        return "" if self.friction else "friction coefficient is 0"

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """k_t/k_n = 4 G*/E* (Mindlin 1949), friction, and c_t/c_n."""
        return {
            "stiffness_ratio": 4 * effective_shear_modulus(a, b) / effective_youngs_modulus(a, b),
            "friction": self.friction,
            "damping": self.damping,
        }

    @staticmethod
    @ti.func
    def force(contact, normal, k, history: ti.template()):
        stiffness = k.stiffness_ratio * normal.area_stiffness
        stored = history.tangential_force
        turned = (
            stored
            - stored.dot(contact.normal) * contact.normal
            + contact.spin * contact.time_step * contact.normal.cross(stored)
        )
        square = turned.dot(turned)
        if square > 0.0:
            kept = ti.min(stiffness / history.tangential_stiffness, 1.0)
            turned *= kept * ti.sqrt(stored.dot(stored) / square)
        spring = turned - stiffness * contact.time_step * contact.tangential_velocity

        limit = k.friction * ti.max(normal.total, 0.0)
        total = spring - k.damping * normal.damping * contact.tangential_velocity
        excess = total.dot(total)
        if excess > limit * limit:
            total *= limit / ti.sqrt(excess)
            length = spring.dot(spring)
            if length > limit * limit:
                spring *= limit / ti.sqrt(length)
        history.tangential_force = spring
        history.tangential_stiffness = stiffness
        return total

    @staticmethod
    @ti.func
    def energy(history):
        """T^2 / (2 k_t), what the spring would give back."""
        stored = history.tangential_force
        energy = 0.0
        if history.tangential_stiffness > 0.0:
            energy = 0.5 * stored.dot(stored) / history.tangential_stiffness
        return energy
