"""JKR: adhesive elastic spheres.

With the contact radius a, the work of adhesion W and a_m^3 = pi W R*^2 / (8 E*), a at pull-off:

    d = a^2/R* - sqrt(2 pi W a/E*)                    = (t^4 - 4 t_m^3 t) / R*
    F = 4 E* a^3/(3 R*) - sqrt(8 pi W E* a^3) - c v_n = 4 E*/(3 R*) (t^6 - 6 t_m^3 t^3) - c v_n
    c = 2 sqrt(5/6) beta sqrt(2 E* a m*),               t = sqrt(a), t_m = sqrt(a_m)

The contact is made at d = 0 and held down to d = -3 a_m^2/R*, where the tangent dF/dd is infinite
and F is 5/9 of the largest pull, -3/2 pi W R*.  Only the branch a >= a_m is stable.

With p = R* d and q = t_m^3 it is a root of t^4 - 4 q t = p.  Either of two rational functions, for
overlaps below and above p = t_m^4, guesses it within 2e-8; one step of Newton's then gives it to
rounding:

    above   t = p^(1/4) T(q/p^(3/4)),   T^4 - 4 r T = 1
    below   t = t_m (1 + z),            z^2 (z^2 + 4 z + 6) = x^2,   x^2 = 3 + p/t_m^4

The latter is counted from pull-off, where t is stationary, so that its digits are not lost there.

Source: K. L. Johnson, K. Kendall and A. D. Roberts, Proc. R. Soc. A 324 (1971) 301; the dashpot is
that of the Hertz law at the radius of the adhesive contact, so that W = 0 is the Hertz law.
"""

import math
from dataclasses import dataclass

from taichi_dem.contacts.contact import NormalForce
from taichi_dem.contacts.elasticity import damping_ratio, effective_youngs_modulus
from taichi_dem.contacts.roots import cube_root, polynomial
from taichi_dem.material import Material
from taichi_dem.types import ti
from taichi_dem.validation import parameter, validate

# Coefficients of rising powers, numerator and denominator: T of r in 0..1, and z/x of x in 0..2.
_ABOVE = (1.0, 4.64173659, 8.67053854, 6.37139881, 0.957318675)
_ABOVE_OVER = (1.0, 3.64173735, 5.52876486, 2.66415826, 0.176593056)
_BELOW = (0.4082482983, 0.09408148881, 0.001980540246)
_BELOW_OVER = (1.0, 0.3665353154, 0.02231596733)


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
    def root(product, least):
        """t, the square root of the contact radius, from p and q; t_m where no contact holds."""
        half = ti.sqrt(ti.max(product, 0.0))
        quarter = ti.sqrt(half)
        root = 0.0
        if least < half * quarter:
            r = least / (half * quarter)
            root = quarter * polynomial(r, _ABOVE) / polynomial(r, _ABOVE_OVER)
            cube = root * root * root
            root -= (root * (cube - 4.0 * least) - product) / (4.0 * (cube - least))
        else:
            root = cube_root(least)
            area = root * root
            beyond = product + 3.0 * area * area
            if beyond > 0.0:
                x = ti.sqrt(beyond) / area
                z = x * polynomial(x, _BELOW) / polynomial(x, _BELOW_OVER)
                value = z * z * (z * (z + 4.0) + 6.0) - x * x
                z -= value / (4.0 * z * (z * (z + 3.0) + 3.0))
                root += root * z
        return root

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
        # Roots and quotients of what does not change stand apart: they need not wait for t.
        least = k.root_radius**3 * contact.effective_radius
        scale = (4.0 / 3.0) * k.effective_modulus / contact.effective_radius
        impedance = ti.sqrt(2.0 * k.effective_modulus * contact.effective_mass)
        root = JKR.root(contact.effective_radius * contact.overlap, least)
        cube, punch = root**3, 2.0 * k.effective_modulus * root * root
        elastic = scale * cube * (cube - 6.0 * least)
        softer = cube - least
        tangent = punch * (cube - 3.0 * least) / ti.select(softer > 0.0, softer, 1.0)
        damping = k.damping * impedance * root
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
        least = k.root_radius**3 * contact.effective_radius
        root = JKR.root(contact.effective_radius * contact.overlap, least)
        cube = root**3
        shape = 0.1 * cube * cube - least * cube + 1.5 * least * least
        scale = (16.0 / 3.0) * k.effective_modulus / contact.effective_radius**2
        return scale * root**4 * shape

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
