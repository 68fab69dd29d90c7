"""CDT-JKR: rolling resistance from the adhesion hysteresis of a JKR contact.

    a_0 = (9 pi W R*^2 / (2 E*))^(1/3)                                                      (2)
    mu_r = pi a_0 eta / (4 R*)                                                              (3)
    M_max = mu_r F_n R* = (pi/4) eta a_0 F_n                                                (8)

F_n is the elastic part of the normal force (7); how the torque behaves at rest, where (9) is not
defined, says :mod:`taichi_dem.contacts.rolling`.  The spring has the stiffness of a JKR contact at
its equilibrium radius, k_r = 4 F_c = 6 pi W R*, with the pull-off force F_c = 3/2 pi W R*.

Source of k_r: C. Dominik and A. G. G. M. Tielens, Philos. Mag. A 72 (1995) 783.
"""

import math
from dataclasses import dataclass
from typing import Any

from taichi_dem.contacts.elasticity import effective_youngs_modulus
from taichi_dem.contacts.rolling import (
    OPTIONS,
    displacement_squared,
    option_problems,
    rolling_history,
    spring,
    stop,
)
from taichi_dem.contacts.roots import inverse_cube_root
from taichi_dem.material import Material
from taichi_dem.types import ti
from taichi_dem.validation import parameter, validate


@dataclass(frozen=True)
class CDTJKR:
    """Rolling parts the surfaces behind and joins them ahead; ``adhesion_hysteresis`` scales what
    is lost in between.  Without ``work_of_adhesion`` it is that of the JKR normal law."""

    work_of_adhesion: float | None = parameter(
        "J/m2", "energy to part the surfaces", default=None, at_least=0
    )
    adhesion_hysteresis: float = parameter("-", "eta", default=1.0, at_least=0)
    torsion_torque: bool = False
    regularization: str = "stop"
    rolling_damping: float = parameter("-", "share of the critical", default=0.0, at_least=0)

    coefficient_names = ("lever", "stiffness", "damping")
    options = OPTIONS
    asks_for = ("relative_spin", "rolling_inertia")

    def __post_init__(self) -> None:
        validate(self, *option_problems(self))

    @property
    def idle(self) -> str:
        """Why it makes no torque, if so: M_max limits spring, dashpot and torsion alike."""
        if self.adhesion_hysteresis == 0:
            return "adhesion hysteresis is 0"
        return "work of adhesion is 0" if self.work_of_adhesion == 0 else ""

    @property
    def history(self) -> tuple[tuple[str, Any], ...]:
        """The spring's displacement (m), if there is one."""
        return rolling_history(self)

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """mu_r R* / R*^(2/3) (m^(1/3)), k_r / R* (N/m), and twice the damping ratio."""
        work = self.work_of_adhesion
        if work is None:
            raise ValueError("work_of_adhesion is not known: Law takes it from the normal law")
        radius = (9 * math.pi * work / (2 * effective_youngs_modulus(a, b))) ** (1 / 3)
        return {
            "lever": math.pi / 4 * self.adhesion_hysteresis * radius,
            "stiffness": 6 * math.pi * work,
            "damping": 2 * self.rolling_damping,
        }

    @staticmethod
    def stiffness(k: dict[str, float], effective_radius: float, normal_stiffness: float) -> float:
        """k_r (N), for the time step."""
        return k["stiffness"] * effective_radius

    @ti.func
    def torque(self, contact, normal, k, history: ti.template()):
        radius = contact.effective_radius
        lever = k.lever * radius * inverse_cube_root(radius)
        limit = lever * ti.max(normal.elastic, 0.0)
        torque = 0.0 * contact.normal
        if ti.static(self.regularization == "stop"):
            torque = stop(contact, limit, self.torsion_torque)
        else:
            stiffness = k.stiffness * radius
            damping = k.damping * ti.sqrt(contact.rolling_inertia * stiffness * radius)
            torque = spring(contact, limit, stiffness, damping, history, self.torsion_torque)
        return torque

    @ti.func
    def energy(self, contact, k, history: ti.template()):
        """k_r xi^2 / (2 R*), what the spring would give back."""
        energy = 0.0
        if ti.static(self.regularization == "spring"):
            energy = 0.5 * k.stiffness * displacement_squared(history, self.torsion_torque)
        return energy
