"""JKR: adhesive elastic spheres.

With the contact radius a, the work of adhesion W and a_m^3 = pi W R*^2 / (8 E*), a at pull-off:

    d = a^2/R* - sqrt(2 pi W a/E*)                    = (t^4 - 4 t_m^3 t) / R*
    F = 4 E* a^3/(3 R*) - sqrt(8 pi W E* a^3) - c v_n = 4 E*/(3 R*) (t^6 - 6 t_m^3 t^3) - c v_n
    c = 2 sqrt(5/6) beta sqrt(2 E* a m*),               t = sqrt(a), t_m = sqrt(a_m)

The contact is made at d = 0 and held down to d = -3 a_m^2/R*, where the tangent dF/dd is infinite
and F is 5/9 of the largest pull, -3/2 pi W R*.  Only the branch a >= a_m is stable.

From pull-off, t = t_m + z and z^2 (z^2 + 4 t_m z + 6 t_m^2) = R* d + 3 t_m^4: here the root z does
not lose its digits where t is stationary.  A guess within 0.2 % for every load, one step of Halley
and one of Newton give it to rounding.

Source: K. L. Johnson, K. Kendall and A. D. Roberts, Proc. R. Soc. A 324 (1971) 301; the dashpot is
that of the Hertz law at the radius of the adhesive contact, so that W = 0 is the Hertz law.
"""

import math
from dataclasses import dataclass

from taichi_dem.contacts.contact import NormalForce
from taichi_dem.contacts.elasticity import damping_ratio, effective_youngs_modulus
from taichi_dem.contacts.roots import cube_root
from taichi_dem.material import Material
from taichi_dem.types import ti, vec2
from taichi_dem.validation import parameter, validate

# r = g (g + p t_m^2) / (g + q t_m^2) with g^2 = R* d + 3 t_m^4 guesses (t_m + z)^2 - t_m^2.
_P, _Q = 3.025, 3.7


@dataclass(frozen=True)
class JKR:
    """Elastic spheres that adhere; without adhesion they would rebound with ``restitution``."""

    work_of_adhesion: float = parameter("J/m2", "energy to part the surfaces", at_least=0)
    restitution: float = parameter("-", "rebound / impact speed if W = 0", above=0, at_most=1)

    history = ()
    coefficient_names = ("effective_modulus", "damping", "root_radius")
    adhesive = True  # a contact, once made, is held past zero overlap

    def __post_init__(self) -> None:
        validate(self)

    @property
    def dissipates(self) -> bool:
        """Whether a closed cycle of loading can lose energy."""
        return self.restitution < 1 or self.work_of_adhesion > 0

    @property
    def plastic(self) -> bool:
        """Whether the elastic force takes energy that it does not give back; it is lost, its work
        less the change of ``energy`` (which is 0 apart), from touch to parting."""
        return self.work_of_adhesion > 0

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """E* (Pa), 2 sqrt(5/6) beta (-) and t_m / R*^(1/3) = (pi W/(8 E*))^(1/6) (m^(1/6))."""
        modulus = effective_youngs_modulus(a, b)
        return {
            "effective_modulus": modulus,
            "damping": 2 * math.sqrt(5 / 6) * damping_ratio(self.restitution),
            "root_radius": (math.pi * self.work_of_adhesion / (8 * modulus)) ** (1 / 6),
        }

    @staticmethod
    @ti.func
    def roots(contact, k):
        """t_m and t, the square roots of the contact radius at pull-off and now."""
        least = k.root_radius * cube_root(contact.effective_radius)
        area = least * least
        beyond = contact.effective_radius * contact.overlap + 3.0 * area * area
        square = ti.select(beyond > 0.0, beyond, contact.effective_radius**2)
        g = ti.sqrt(square)
        guess = g * (g + _P * area) / (g + _Q * area)
        z = guess / (least + ti.sqrt(area + guess))
        for step in ti.static(range(2)):
            value = z * z * (z * z + 4.0 * least * z + 6.0 * area) - square
            slope = 4.0 * z * (z * z + 3.0 * least * z + 3.0 * area)
            if ti.static(step == 0):
                bend = 12.0 * (z + least) ** 2
                z -= 2.0 * value * slope / (2.0 * slope * slope - value * bend)
            else:
                z -= value / slope
        return vec2(least, least + ti.select(beyond > 0.0, z, 0.0))

    @staticmethod
    @ti.func
    def holds(contact, k, history: ti.template()):
        """1 if a contact that was made is still held at this overlap, else 0."""
        least = k.root_radius * cube_root(contact.effective_radius)
        return ti.cast(contact.effective_radius * contact.overlap > -3.0 * least**4, ti.i32)

    @staticmethod
    @ti.func
    def opening(contact, k):
        """The overlap (m) at which a contact opens, -3 a_m^2/R*; below it the force stays."""
        least = k.root_radius * cube_root(contact.effective_radius)
        return -3.0 * least**4 / contact.effective_radius

    @staticmethod
    @ti.func
    def force(contact, k, history: ti.template()):
        roots = JKR.roots(contact, k)
        least, root = roots[0] ** 3, roots[1] ** 3
        radius = roots[1] * roots[1]
        punch = 2.0 * k.effective_modulus * radius
        elastic = (
            (4.0 / 3.0) * k.effective_modulus * root * (root - 6.0 * least)
        ) / contact.effective_radius
        softer = root - least
        tangent = punch * (root - 3.0 * least) / ti.select(softer > 0.0, softer, 1.0)
        damping = k.damping * ti.sqrt(punch * contact.effective_mass)
        return NormalForce(
            total=elastic - damping * contact.normal_velocity,
            elastic=elastic,
            stiffness=tangent,
            damping=damping,
            area_stiffness=punch,
        )

    @staticmethod
    @ti.func
    def energy(contact, k, history: ti.template()):
        """Elastic energy less that of the closed surface, 0 for spheres apart: the integral of the
        force over the overlap, 16 E*/(3 R*^2) (t^10/10 - t_m^3 t^7 + 3/2 t_m^6 t^4).

        A contact is made at less than zero and opens above it: both differences are lost.
        """
        roots = JKR.roots(contact, k)
        least, root = roots[0] ** 3, roots[1] ** 3
        shape = 0.1 * root * root - least * root + 1.5 * least * least
        scale = (16.0 / 3.0) * k.effective_modulus / contact.effective_radius**2
        return scale * roots[1] ** 4 * shape

    @staticmethod
    def stiffness(k: dict[str, float], effective_radius: float, overlap: float) -> float:
        """Largest tangent stiffness (N/m) up to ``overlap``, for the time step: 2 E* a is above
        it, and differs little where the contact is pressed."""
        radius = JKR.contact_radius(k, effective_radius, overlap)
        return 2 * k["effective_modulus"] * radius

    @staticmethod
    def contact_radius(k: dict[str, float], effective_radius: float, overlap: float) -> float:
        """a (m) at ``overlap``, that at pull-off below it."""
        least = k["root_radius"] * effective_radius ** (1 / 3)
        product = max(effective_radius * overlap, -3 * least**4)
        root = max(product, 0.0) ** 0.25 + 4 ** (1 / 3) * least  # above that of the quartic
        for _ in range(60):  # a double root at pull-off is found by halves
            slope = 4 * (root**3 - least**3)
            if not slope > 0:
                break
            root -= (root**4 - 4 * least**3 * root - product) / slope
        return max(root, least) ** 2

    @staticmethod
    def dashpot(
        k: dict[str, float], effective_radius: float, effective_mass: float, overlap: float
    ) -> float:
        """c (N s/m) at ``overlap``, for the time step."""
        stiffness = JKR.stiffness(k, effective_radius, overlap)
        return k["damping"] * math.sqrt(stiffness * effective_mass)

    @staticmethod
    def reach(k: dict[str, float], effective_radius: float) -> float:
        """How far (m) past zero overlap a contact is held: 3 a_m^2/R*."""
        return 3 * k["root_radius"] ** 4 * effective_radius ** (1 / 3)
