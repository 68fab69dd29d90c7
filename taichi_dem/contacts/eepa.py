"""Edinburgh elasto-plastic adhesion (EEPA).

With d the overlap, n = d_ex its exponent, and P = d_p,max^n, the plastic overlap to that power:

    k_1 = 4/3 E* sqrt(R*)   (n = 1: 2 E* R*),   k_2 = kappa_21 k_1                          (1)
    P = max over time of (1 - 1/kappa_21) d^n                                               (3)
    F_el = min(k_1 d^n, max(k_2 (d^n - P), -k_c d^c))                                       (7)
    F_n = F_el - gamma_n v_n + F_0                                                          (9)

Pull, with the contact radius a of two spheres that overlap:

    F_min = min(3/2 pi gamma_s a, k_2 P/2),   k_c = F_min / d_min^c                         (5, 6)
    d_min = d_p,max/2 where F_min is at its limit, else d_min^n = P - F_min/k_2

The branch -k_c d^c does not reverse: when the overlap grows on it, the contact reloads along k_2
from where it is, P <- d^n + (k_c/k_2) d^c.  All forces end at d = 0, so a contact ends there.

Dashpot, with beta = -ln e / sqrt(ln^2 e + pi^2):

    constant   gamma_n = 2 beta sqrt(m* k_1)                                                (8)
    tangent    gamma_n = sqrt(2 (n + 1)/n) beta sqrt(m* k_t),   k_t = n k_1 d^(n - 1)

For n = 1 these are one; else the former has not the units of a damping coefficient, and only the
latter gives the restitution e at any speed: with u = d^((n+1)/2) for d it is the damped oscillator.

Sources: J. P. Morrissey, PhD thesis, Edinburgh (2013); S. C. Thakur, J. P. Morrissey, J. Sun,
J. F. Chen and J. Y. Ooi, Granular Matter 16 (2014) 383.
"""

import math
from dataclasses import dataclass

from taichi_dem.contacts.contact import NormalForce
from taichi_dem.contacts.elasticity import damping_ratio, effective_youngs_modulus
from taichi_dem.contacts.roots import power
from taichi_dem.material import Material
from taichi_dem.types import real, ti
from taichi_dem.validation import Problem, parameter, validate

DAMPING = ("tangent", "constant")


@dataclass(frozen=True)
class EEPA:
    """Spheres that yield, unload stiffer than they were loaded, and stick where they yielded.

    ``pull_off_force`` is F_0 of eq. (9): it acts as long as the overlap is positive, and is
    negative, an attraction.  ``limit_force`` cuts off what the dashpot would pull.
    """

    restitution: float = parameter("-", "rebound / impact speed if elastic", above=0, at_most=1)
    stiffness_ratio: float = parameter("-", "kappa_21 = k_2/k_1, 1 if elastic", at_least=1)
    overlap_exponent: float = parameter("-", "d_ex, 1.5 as Hertz", default=1.5, at_least=1)
    adhesion_exponent: float = parameter("-", "c_ex", default=1.0, above=0)
    surface_energy: float = parameter("J/m2", "gamma_s", default=0.0, at_least=0)
    pull_off_force: float = parameter("N", "F_0, attraction is negative", default=0.0, at_most=0)
    damping: str = "tangent"
    limit_force: bool = False

    history = (("plastic_overlap", real), ("last_overlap", real))  # P = d_p,max^n, and d
    coefficient_names = ("modulus", "stiffness_ratio", "damping", "surface_energy", "pull_off")
    options = ("overlap_exponent", "adhesion_exponent", "damping", "limit_force")
    adhesive = False  # what sticks lets go at zero overlap

    def __post_init__(self) -> None:
        validate(self, *self._problems())

    def _problems(self) -> list[Problem | None]:
        wrong: list[Problem | None] = []
        if self.damping not in DAMPING:
            wrong.append(Problem("damping", self.damping, f"must be one of {', '.join(DAMPING)}"))
        if not isinstance(self.limit_force, bool):
            wrong.append(Problem("limit_force", self.limit_force, "must be true or false"))
        elif self.limit_force and (self.surface_energy or self.pull_off_force):
            rule = (
                "must be false with adhesion (surface_energy or pull_off_force), whose pull it cuts"
            )
            wrong.append(Problem("limit_force", self.limit_force, rule))
        return wrong

    @property
    def dissipates(self) -> bool:
        """Whether a closed cycle of loading can lose energy."""
        return self.restitution < 1 or self.stiffness_ratio > 1

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """k_1 / sqrt(R*) (n = 1: / R*) in Pa, kappa_21, gamma_n / sqrt(m* k), gamma_s and F_0."""
        modulus = effective_youngs_modulus(a, b)
        n = self.overlap_exponent
        factor = 2.0 if self.damping == "constant" else math.sqrt(2 * (n + 1) / n)
        return {
            "modulus": 2 * modulus if n == 1 else 4 / 3 * modulus,
            "stiffness_ratio": self.stiffness_ratio,
            "damping": factor * damping_ratio(self.restitution),
            "surface_energy": self.surface_energy,
            "pull_off": self.pull_off_force,
        }

    @ti.func
    def first_stiffness(self, contact, k):
        """k_1."""
        radius = contact.effective_radius
        size = ti.sqrt(radius)
        if ti.static(self.overlap_exponent == 1):
            size = radius
        return k.modulus * size

    @ti.func
    def pull(self, contact, second, k, raised, plastic):
        """k_c d^c and its slope, from k_2, d^n and P."""
        n, c = ti.static(self.overlap_exponent, self.adhesion_exponent)
        overlap, radius = ti.max(contact.overlap, 0.0), contact.effective_radius
        x, g = overlap / radius, overlap * contact.inverse_reach
        shape = 4.0 - 2.0 * x + x * g
        squared = radius * overlap * shape * (2.0 - g) / (4.0 * (1.0 - g) ** 2)
        free = 1.5 * math.pi * k.surface_energy * ti.sqrt(ti.max(squared, 0.0))
        most = 0.5 * second * plastic
        limited = free > most
        least = ti.select(limited, most, free)
        turn = ti.select(limited, 0.5**n * plastic, plastic - least / second)  # d_min^n
        some = turn > 0.0
        force = ti.select(some, least, 0.0) * power(raised / ti.select(some, turn, 1.0), c / n)

        # d ln F / d ln d: of d^c, and of a, which moves d_min too while F_min is free
        widening = 0.5 * (1.0 - 2.0 * x * (1.0 - g) / shape - g / (2.0 - g) + 2.0 * g / (1.0 - g))
        moving = 1.0 + c / n * least / (second * ti.select(some, turn, 1.0))
        rate = c + ti.select(limited, 0.0, widening * moving)
        return force, rate * force / ti.select(overlap > 0.0, overlap, 1.0)

    @ti.func
    def force(self, contact, k, history: ti.template()):
        n = ti.static(self.overlap_exponent)
        overlap = ti.max(contact.overlap, 0.0)
        raised = power(overlap, n)
        first = self.first_stiffness(contact, k)
        second = k.stiffness_ratio * first
        plastic = ti.max(history.plastic_overlap, (1.0 - 1.0 / k.stiffness_ratio) * raised)
        pull, falling = self.pull(contact, second, k, raised, plastic)

        load, reload = first * raised, second * (raised - plastic)
        slides = reload <= -pull
        force = ti.min(load, ti.max(reload, -pull))
        loading = n * first * power(overlap, n - 1)
        yields = reload >= load
        tangent = ti.select(
            yields, loading, ti.select(slides, -falling, k.stiffness_ratio * loading)
        )

        grows = overlap > history.last_overlap
        history.plastic_overlap = ti.select(slides & grows, raised + pull / second, plastic)
        history.last_overlap = overlap

        elastic = force + k.pull_off
        damping = k.damping * ti.sqrt(contact.effective_mass * loading)
        if ti.static(self.damping == "constant"):
            damping = k.damping * ti.sqrt(contact.effective_mass * first)
        total = elastic - damping * contact.normal_velocity
        if ti.static(self.limit_force):
            total = ti.max(total, 0.0)
        return NormalForce(
            total=total,
            elastic=elastic,
            stiffness=tangent,
            damping=damping,
            area_stiffness=loading,
        )

    @ti.func
    def energy(self, contact, k, history: ti.template()):
        """What the k_2 branch through the present force stores, from the plastic overlap where it
        has none, and the work of F_0:  k_2 [(d^(n+1) - p^(n+1))/(n + 1) - p^n (d - p)] + F_0 d.

        The rest of the work is lost when P grows (yielding) and when it falls (sticking surfaces
        part): never is any given back.
        """
        n = ti.static(self.overlap_exponent)
        overlap = ti.max(contact.overlap, 0.0)
        raised = power(overlap, n)
        second = k.stiffness_ratio * self.first_stiffness(contact, k)
        plastic = ti.max(history.plastic_overlap, (1.0 - 1.0 / k.stiffness_ratio) * raised)
        pull, _ = self.pull(contact, second, k, raised, plastic)
        plastic = ti.min(plastic, raised + pull / second)
        free = plastic ** (1.0 / n)
        stored = (raised * overlap - plastic * free) / (n + 1) - plastic * (overlap - free)
        return second * stored + k.pull_off * overlap

    def stiffness(self, k: dict[str, float], effective_radius: float, overlap: float) -> float:
        """Largest tangent stiffness (N/m) up to ``overlap``, for the time step: that of k_2."""
        n = self.overlap_exponent
        size = effective_radius if n == 1 else math.sqrt(effective_radius)
        return n * k["stiffness_ratio"] * k["modulus"] * size * overlap ** (n - 1)
