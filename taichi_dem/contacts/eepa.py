"""Edinburgh elasto-plastic adhesion (EEPA).

With d the overlap, n = d_ex its exponent, and Q = d_0^n, d_0 the overlap that is plastic:

    k_1 = 4/3 E* sqrt(R*)   (n = 1: 2 E* R*),   k_2 = kappa_21 k_1                          (1)
    Q = max over time of (1 - 1/kappa_21) d^n                                               (3)
    F_el = min(k_1 d^n, max(k_2 (d^n - Q), -k_c d^c))                                       (7)
    F_n = F_el - gamma_n v_n + F_0                                                          (9)

Pull, with P = d_p,max^n, the largest Q, and a the contact radius at that overlap, d_p,max:

    F_min = min(3/2 pi gamma_s a, k_2 P/2),   k_c = F_min / d_min^c                         (5, 6)
    d_min = d_p,max/2 where F_min is at its limit, else d_min^n = P - F_min/k_2

The branch -k_c d^c does not reverse: along it Q falls, Q = d^n + (k_c/k_2) d^c, and when the
overlap grows again, the contact reloads along k_2 from where it is, and P = Q from then on (from
when the pull that goes with it allows the present force, so that the force stays continuous; only
with c_ex < d_ex is that ever later).  All forces end at d = 0, so a contact ends there.

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

    history = (("plastic_overlap", real), ("deepest_plastic_overlap", real))  # Q and P
    coefficient_names = ("modulus", "stiffness_ratio", "damping", "surface_energy", "pull_off")
    options = ("overlap_exponent", "adhesion_exponent", "damping", "limit_force")
    adhesive = False  # what sticks lets go at zero overlap
    asks_for = ("inverse_reach",)

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

    @property
    def plastic(self) -> bool:
        """Whether the elastic force takes energy that it does not give back; it is lost, its work
        less the change of ``energy`` (which is 0 apart), from touch to parting."""
        return self.stiffness_ratio > 1

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
    def pull(self, contact, second, k, raised, deepest):
        """k_c d^c, from k_2, d^n and P."""
        n, c = ti.static(self.overlap_exponent, self.adhesion_exponent)
        plastic, radius = power(deepest, 1 / n), contact.effective_radius
        x, g = plastic / radius, plastic * contact.inverse_reach
        square = plastic * radius * (4.0 - 2.0 * x + x * g) * (2.0 - g)
        a = 0.5 * ti.sqrt(ti.max(square, 0.0)) / (1.0 - g)
        free, most = 1.5 * math.pi * k.surface_energy * a, 0.5 * second * deepest
        limited = free > most
        least = ti.select(limited, most, free)
        turn = ti.select(limited, 0.5**n * deepest, deepest - least / second)  # d_min^n
        some = turn > 0.0
        return ti.select(some, least, 0.0) * power(raised / ti.select(some, turn, 1.0), c / n)

    @ti.func
    def force(self, contact, k, history: ti.template()):
        n, c = ti.static(self.overlap_exponent, self.adhesion_exponent)
        overlap = ti.max(contact.overlap, 0.0)
        raised = power(overlap, n)
        first = self.first_stiffness(contact, k)
        second = k.stiffness_ratio * first
        loading = n * first * power(overlap, n - 1)

        yielded = (1.0 - 1.0 / k.stiffness_ratio) * raised
        yields = yielded >= history.plastic_overlap
        plastic = ti.max(yielded, history.plastic_overlap)
        deepest = ti.max(yielded, history.deepest_plastic_overlap)
        force = ti.select(yields, first * raised, second * (raised - plastic))
        tangent = ti.select(yields, loading, k.stiffness_ratio * loading)
        history.deepest_plastic_overlap = deepest
        reloads = plastic < deepest
        if raised <= plastic:  # else the adhesive branch is far, and it is dear
            pull = self.pull(contact, second, k, raised, deepest)
            stuck = raised + pull / second  # Q on the adhesive branch
            reloads &= stuck > plastic
            if ti.static(c < n):
                if reloads:
                    again = self.pull(contact, second, k, raised, plastic)
                    reloads = raised + again / second >= plastic
            if stuck < plastic:
                force = -pull
                tangent = -c * pull / ti.select(overlap > 0.0, overlap, 1.0)
                plastic = stuck
        if reloads:
            history.deepest_plastic_overlap = plastic
        history.plastic_overlap = plastic

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

        The rest of the work is lost where Q grows (yielding, d > d_0) and where it falls (sticking
        surfaces part, d < d_0): none is ever given back.
        """
        n = ti.static(self.overlap_exponent)
        overlap = ti.max(contact.overlap, 0.0)
        raised = power(overlap, n)
        second = k.stiffness_ratio * self.first_stiffness(contact, k)
        plastic = history.plastic_overlap
        free = power(plastic, 1 / n)
        stored = (raised * overlap - plastic * free) / (n + 1) - plastic * (overlap - free)
        return second * stored + k.pull_off * overlap

    def stiffness(self, k: dict[str, float], effective_radius: float, overlap: float) -> float:
        """Largest tangent stiffness (N/m) up to ``overlap``, for the time step: that of k_2."""
        n = self.overlap_exponent
        size = effective_radius if n == 1 else math.sqrt(effective_radius)
        return n * k["stiffness_ratio"] * k["modulus"] * size * overlap ** (n - 1)

    def dashpot(
        self, k: dict[str, float], effective_radius: float, effective_mass: float, overlap: float
    ) -> float:
        """gamma_n (N s/m) at ``overlap``, for the time step."""
        n = self.overlap_exponent if self.damping == "tangent" else 1.0
        size = effective_radius if self.overlap_exponent == 1 else math.sqrt(effective_radius)
        loading = n * k["modulus"] * size * overlap ** (n - 1)
        return k["damping"] * math.sqrt(loading * effective_mass)
