"""CDT: constant directional torque against rolling.

    M_max = mu_r F_n R*

F_n is the elastic part of the normal force, mu_r the tangent of the slope on which a sphere comes
to rest; how the torque behaves at rest says :mod:`taichi_dem.contacts.rolling`.  The spring has
k_r = 9/4 k_n mu_r^2 R*, with k_n = 2 E* a.  Where a growing load stiffens it, its displacement
shrinks at constant energy.

Sources: Y. C. Zhou, B. D. Wright, R. Y. Yang, B. H. Xu and A. B. Yu, Physica A 269 (1999) 536;
J. Ai, J.-F. Chen, J. M. Rotter and J. Y. Ooi, Powder Technology 206 (2011) 269, for k_r.
"""

from dataclasses import dataclass
from typing import Any

from taichi_dem.contacts.rolling import (
    OPTIONS,
    displacement_squared,
    option_problems,
    rolling_history,
    spring,
    stop,
)
from taichi_dem.material import Material
from taichi_dem.types import real, ti
from taichi_dem.validation import parameter, validate


@dataclass(frozen=True)
class CDT:
    """A rolling resistance in proportion to the load."""

    rolling_friction: float = parameter("-", "mu_r, torque / (load * R*)", at_least=0)
    torsion_torque: bool = False
    regularization: str = "stop"
    rolling_damping: float = parameter("-", "share of the critical", default=0.0, at_least=0)

    coefficient_names = ("friction", "damping")
    options = OPTIONS
    asks_for = ("relative_spin", "rolling_inertia")

    def __post_init__(self) -> None:
        validate(self, *option_problems(self))

    @property
    def idle(self) -> str:
        """Why it makes no torque, if so: M_max limits spring, dashpot and torsion alike."""
        return "" if self.rolling_friction else "rolling friction coefficient is 0"

    @property
    def history(self) -> tuple[tuple[str, Any], ...]:
        """The spring's displacement (m) and stiffness (N), if there is one."""
        parts = rolling_history(self)
        return (*parts, ("rolling_stiffness", real)) if parts else ()

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """mu_r and twice the damping ratio; the same for every pair unless ``pairs`` says other."""
        return {"friction": self.rolling_friction, "damping": 2 * self.rolling_damping}

    @staticmethod
    def stiffness(k: dict[str, float], effective_radius: float, normal_stiffness: float) -> float:
        """k_r (N), for the time step; ``normal_stiffness`` (N/m) is 2 E* a or more."""
        return 2.25 * normal_stiffness * k["friction"] ** 2 * effective_radius

    @ti.func
    def torque(self, contact, normal, k, history: ti.template()):
        lever = k.friction * contact.effective_radius
        limit = lever * ti.max(normal.elastic, 0.0)
        torque = 0.0 * contact.normal
        if ti.static(self.regularization == "stop"):
            torque = stop(contact, limit, self.torsion_torque)
        else:
            stiffness = 2.25 * normal.area_stiffness * k.friction * lever
            some = stiffness > 0.0
            softer = history.rolling_stiffness / ti.select(some, stiffness, 1.0)
            kept = ti.sqrt(ti.min(softer, 1.0))
            history.rolling_displacement *= kept
            if ti.static(self.torsion_torque):
                history.torsion_displacement *= kept
            swing = contact.rolling_inertia * stiffness * contact.effective_radius
            damping = k.damping * ti.sqrt(swing)
            torque = spring(contact, limit, stiffness, damping, history, self.torsion_torque)
            history.rolling_stiffness = stiffness
        return torque

    @ti.func
    def energy(self, contact, k, history: ti.template()):
        """k_r xi^2 / (2 R*), what the spring would give back."""
        energy = 0.0
        if ti.static(self.regularization == "spring"):
            square = displacement_squared(history, self.torsion_torque)
            energy = 0.5 * history.rolling_stiffness * square / contact.effective_radius
        return energy
