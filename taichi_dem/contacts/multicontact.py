"""Multi-contact: what presses on a sphere in one place displaces its surface in all others.

Contact k of a sphere lies at the distance a_k = R - d_k/2 from its centre and presses with the
elastic force F_k along the unit vector n_k into the sphere.  At contact j of the same sphere it
raises the surface by M_jk F_k; with u the unit vector and r the distance from k to j

    M_jk = -gamma (1+nu) / (2 pi E r) [ (n_k.u)(n_j.u) + (3-4nu) n_k.n_j
                                        - (1-2nu) (n_k+u).n_j / (1+n_k.u) ]                 (B)

the displacement by a point load on a half-space that is laid on the sphere at k.  A contact's
effective overlap is d plus what both surfaces have risen by, and its forces are those of that
overlap:  D = d + e_i + e_j,  e = M F(D).

Of two contacts at one distance a, an angle t apart, s = sin(t/2), (B) is

    M = -gamma (1+nu) / (4 pi E a) [ 2(1-nu)/s + 2(1-2nu) - (7-8nu) s ]                     (S)

which is the same from j to k.  Otherwise (B) is not, and no energy belongs to it.  ``implicit``
therefore takes (S) with the mean of 1/a_j and 1/a_k, solves for D at every step, and adds the force
that the change of M with the place of the contacts makes: with U(D) the energy of a contact,

    energy = sum U(D) - 1/2 sum F e,    force = -its derivative = F n - 1/2 F (dM/dx) F

``lagged`` takes (B) and the forces of the step before, as LIGGGHTS does.  There the one of two
spheres that comes later (here: the later id) has the radius R + e in R* and for the place of the
contact, where d is R_i + R_j + e_j - distance, and the other has not.  In both, r is no smaller
than the contact radius sqrt(R* d).

``implicit`` starts from expansions that are predicted from the last three and corrected in the way
of J. Kolafa, J. Comput. Chem. 25 (2004) 335, which is stable without a solve: most steps need none.

Source, gamma included: N. Brodu, J. A. Dijksman and R. P. Behringer, Phys. Rev. E 91 (2015) 032201.
"""

import math
from dataclasses import dataclass
from typing import Any

from taichi_dem.material import Material
from taichi_dem.types import real, ti, vec2, vec3
from taichi_dem.validation import Problem, parameter, validate

EXCHANGES = ("implicit", "lagged")
PAST = 3  # expansions kept, from which the next one is expected
EXPECTED = (2.5, -2.0, 0.5)  # that many of each
SHARE = 0.6  # of what an expected one is corrected by where it was good enough to be kept


@dataclass(frozen=True)
class MultiContact:
    """A sphere's contacts feel each other through its bulk.

    ``exchange``: solved together at each step ("implicit") or by the forces of the step before
    ("lagged").  The implicit solve takes at most ``iterations`` steps of Newton's to bring the
    error of every effective overlap below ``residual`` of the largest overlap; an elastic substrate
    takes part (:mod:`taichi_dem.joint`).
    """

    prefactor: float = parameter("-", "gamma", default=1.125, at_least=0)
    exchange: str = "implicit"
    residual: float = parameter("-", "of the implicit solve", default=1e-6, above=0, below=1)
    iterations: int = parameter("-", "of the implicit solve", default=30, at_least=1)

    coefficient_names = ("compliance", "poissons_ratio")
    options = ("exchange", "residual", "iterations")

    def __post_init__(self) -> None:
        validate(self, *self._problems())

    def _problems(self) -> list[Problem]:
        wrong = []
        if self.exchange not in EXCHANGES:
            rule = f"must be one of {', '.join(EXCHANGES)}"
            wrong.append(Problem("exchange", self.exchange, rule))
        if isinstance(self.iterations, float) and not self.iterations.is_integer():
            wrong.append(Problem("iterations", self.iterations, "must be a whole number"))
        return wrong

    @property
    def lagged(self) -> bool:
        """Whether the forces of the step before make the expansions."""
        return self.exchange == "lagged"

    @property
    def idle(self) -> str:
        """Why it raises nothing, if so."""
        return "" if self.prefactor else "prefactor is 0"

    @property
    def history(self) -> tuple[tuple[str, Any], ...]:
        """What the surfaces of i and j have risen by (m), the normal force (N), and, to start the
        solve from, sums of the expansions (m) at the last steps and how many of them there are."""
        past = (("expansions_before", vec3), ("age", ti.i32))
        return (("expansion", vec2), ("normal_force", real), *(() if self.lagged else past))

    def coefficients(self, a: Material, b: Material) -> dict[str, float]:
        """gamma (1+nu) / (2 pi E) (1/Pa) and nu of a sphere of ``a``, whatever it touches."""
        compliance = (1 + a.poissons_ratio) / (2 * math.pi * a.youngs_modulus)
        return {
            "compliance": self.prefactor * compliance,
            "poissons_ratio": a.poissons_ratio,
        }

    @ti.func
    def expected(self, history):
        """The sum of both expansions that the past steps lead one to expect, m.  (A parabola, 3, -3
        and 1, errs less, but what a step leaves of its error grows until it has to be solved.)"""
        past = history.expansions_before
        expected = past[0]
        if history.age == 2:
            expected = 2.0 * past[0] - past[1]
        elif history.age >= 3:
            expected = past.dot(vec3(EXPECTED))
        return expected

    @ti.func
    def remember(self, normal, trust, history: ti.template()):
        """Keep what the next step needs of this one: the ``trust`` (0 to 1) says how much of what
        has been found, the rest of what had been expected."""
        if ti.static(self.lagged):
            history.normal_force = normal.total
        else:
            history.normal_force = normal.elastic
            both = history.expansion[0] + history.expansion[1]
            if history.age > 0:
                expected = self.expected(history)
                both = expected + trust * (both - expected)
            before = history.expansions_before
            history.expansions_before = vec3(both, before[0], before[1])
            history.age = ti.min(history.age + 1, PAST)

    @staticmethod
    @ti.func
    def published(k, cosine, here, there, least_square):
        """Both M of (B) over -gamma (1+nu) / (2 pi E), 1/m, of two contacts at the distances a_j =
        ``here`` and a_k = ``there``, by the load at k on j and by that at j on k; n_j.n_k is the
        ``cosine``, and r^2 at least ``least_square``.  With f = r n_k.u and g = n_j.u it is

            f g/r^2 + (3-4nu) n_k.n_j/r - (1-2nu) (n_k.n_j + g)/(r+f)

        and, the other way, the same with -r g for f and -f/r for g.
        """
        near = there - here * cosine  # f
        far = there * cosine - here  # r g
        square = there * near - here * far
        r = ti.sqrt(ti.select(square > least_square, square, least_square))
        ahead, back = r + near, r - far
        both = ahead * back
        third = 1.0 / (r * both)
        inverse, third_r = third * both, third * r
        nu, f_r, g = k.poissons_ratio, near * inverse, far * inverse
        straight = inverse * (f_r * g + (3.0 - 4.0 * nu) * cosine)
        bent = (1.0 - 2.0 * nu) * third_r
        return straight - bent * ((cosine + g) * back), straight - bent * ((cosine - f_r) * ahead)

    @staticmethod
    @ti.func
    def terms(k):
        """The factors of 1/s, 1 and -s in -a M of (S)."""
        nu, half = k.poissons_ratio, 0.5 * k.compliance
        return half * vec3(2.0 * (1.0 - nu), 2.0 * (1.0 - 2.0 * nu), 7.0 - 8.0 * nu)

    @staticmethod
    @ti.func
    def shape(terms, s):
        """-a M of (S), its derivative by s, and that by -4 s, which is the one by the cosine."""
        inverse = 1.0 / s
        near = terms[0] * inverse
        slope = -(near * inverse + terms[2])
        return vec3(near + terms[1] - terms[2] * s, slope, -0.25 * slope * inverse)

    @staticmethod
    @ti.func
    def half_sine(cosine):
        """s."""
        return ti.sqrt(ti.max(0.5 - 0.5 * cosine, 0.0))
