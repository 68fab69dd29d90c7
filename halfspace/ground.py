"""The elastic half-space: what the forces on some contacts do to the surface under the others."""

from __future__ import annotations

from dataclasses import dataclass
from types import NoneType

from numpy.typing import ArrayLike

from . import checks, direct, fields, greens
from .arrays import Array, host, kind_of, on_host
from .choice import Choice, choose
from .layer_kernel import LayerKernel
from .layer_sums import Pairs, correction_of
from .layers import Layer
from .periodic import PeriodicSum
from .plan import Plan


@dataclass(frozen=True)
class HalfSpace:
    """An elastic substrate `z < 0`, loaded normally at points of its surface.

    It stands for the substrate alone: `w_k = sum_{j != k} f_j / (pi E' r_kj)`, with
    `E' = E/(1 - nu^2)` of the substrate, whatever presses on it. (In terms of the contact's
    composite modulus `E*` that is `chi/(pi E* r)`, `chi = E*/E'`.) What a contact does to itself
    belongs to the contact law. With `coupling="finite"` contacts whose radii are known are Hertz
    pressures, and spheres touch a tilted surface beside their lowest point (`halfspace.finite`,
    `halfspace.solve`); with "point", or where nobody says how large contacts are, they are points.
    Both conserve energy.

    youngs_modulus: Pa, > 0; poissons_ratio: -1 < nu <= 1/2; tolerance: the error allowed to fast
    sums, of `f_rms/(pi E' s)` with the spacing `s = sqrt(area/n)` of the contacts where they are
    densest (direct sums are exact to rounding); coupling: "finite" or "point"; period:
    (Lx, Ly), m, the sides of a cell that repeats itself along x and y, or None (the mean depression
    of a periodic half-space is zero, and a contact feels its own images: `periodic`); layer: a
    `Layer` of finite thickness on a rigid base, or None (a contact then feels the base by its own
    force too, and the mean depression of a periodic layer is what it is: `layers`); workers:
    threads of Fourier transforms, as in `scipy.fft`. Raises ValueError for arguments without sense.
    """

    youngs_modulus: float
    poissons_ratio: float
    tolerance: float = 1e-4
    coupling: str = "finite"
    period: tuple[float, float] | None = None
    layer: Layer | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        wanted = {
            "youngs_modulus": "a number > 0 Pa",
            "poissons_ratio": "a number with -1 < nu <= 0.5",
            "tolerance": "a number between 0 and 1",
        }
        for name, words in wanted.items():
            value = checks.number(name, getattr(self, name), words)
            good = {
                "youngs_modulus": value > 0,
                "poissons_ratio": -1 < value <= 0.5,
                "tolerance": 0 < value < 1,
            }
            if not good[name]:
                raise ValueError(f"{name} = {value!r}: must be {words}")
            object.__setattr__(self, name, value)
        checks.one_of("coupling", self.coupling, ("finite", "point"))
        if self.period is not None:
            object.__setattr__(self, "period", checks.sides("period", self.period))
        if not isinstance(self.layer, (Layer, NoneType)):
            raise ValueError(f"layer = {self.layer!r}: must be a halfspace.Layer or None")
        if self.workers is not None:
            checks.whole("workers", abs(self.workers))
            if self.workers == 0:
                raise ValueError("workers = 0: must be None or a whole number, not 0")

    @property
    def modulus(self) -> float:
        """The plane-strain modulus `E' = E/(1 - nu^2)`, Pa."""
        return greens.plane_strain_modulus(self.youngs_modulus, self.poissons_ratio)

    def plan(
        self, x: ArrayLike, radius: ArrayLike | None = None, method: str | None = None
    ) -> Plan:
        """The sums over one layout, for many sets of forces: `.apply(f)`, `.slope(f)`,
        `.displacement(f)`, and `.refresh(x)` for contacts that have moved.

        x: (n, 2) m; radius: (n,) m or None, as for `displacement`; method: "direct" or "mesh", or
        None for the cheaper. Contacts of a periodic half-space may lie anywhere. Raises MemoryError
        for a mesh that was asked for and is too large.
        """
        checks.one_of("method", method, (None, "direct", "mesh"))
        arguments = self.modulus, self.tolerance, self.period, self.workers, method
        return Plan(x, radius, *arguments, self.coupling, self._kernel)

    def explain(self, x: ArrayLike, method: str | None = None) -> Choice:
        """How `plan` would sum over the contacts `x` (n, 2), m, and why: print it.

        Of finite size, where the half-space's `coupling` is: that takes more than points do.
        """
        checks.one_of("method", method, (None, "direct", "mesh"))
        thickness = None if self.layer is None else self.layer.thickness
        return choose(
            host(checks.vectors("x", x)), self.tolerance, self.period, method,
            thickness=thickness, sized=self.coupling == "finite",
        )  # fmt: skip

    def displacement(
        self, x: ArrayLike, f: ArrayLike, radius: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Depression and slope of the surface at the contacts, by the forces on the OTHER contacts.

        x: (n, 2) positions, m; f: (n,) normal forces, N, positive pressing down; radius: (n,)
        contact radii, m, under these forces: for `coupling="finite"`, where without them contacts
        are points. Returns

        - w (n,), m: the depression, positive downward, >= 0 under forces that press. It is
          `dE_c/df_k` of the coupling energy `E_c = 1/2 sum f_j f_k/(pi E' r)
          [1 + (a_j^2 + a_k^2)/(10 r^2)]` with Hertz radii `a(f)`, so that each force acts by
          `1/(pi E' r) [1 + (a_j^2/10 + a_k^2/6)/r^2]`: the depression of the surface in the mean
          over contact k, with what growing costs it;
        - slope (n, 2): the gradient of the expansion `e = -w` as the contact feels it,
          `-(dE_c/dx_k)/f_k`. It points uphill, away from loads. The normal of the surface is
          `(-slope, 1)`, so that the force along it on sphere k has the lateral part
          `-f_k slope_k`: downhill, into the dents of the others.

        Contacts that overlap or coincide act by the saturated energy of `halfspace.finite`, and
        coincident points not at all.

        Raises ValueError for wrong shapes and values that are not finite.
        """
        plan = self.plan(x, radius)
        f = checks.scalars("f", f, len(plan.x), kind_of(plan.x))
        return plan.displacement(f)

    @on_host
    def field(
        self, x: ArrayLike, f: ArrayLike, points: ArrayLike, radius: ArrayLike | None = None
    ) -> Array:
        """Depression (m,), m, positive downward, at any `points` (m, 2), by ALL the forces.

        x: (n, 2) m; f: (n,) N; radius: (n,) contact radii, m: each force is then a Hertz pressure
        over its contact, and the depression is finite everywhere (K. L. Johnson, Contact Mechanics,
        1985, eqs 3.41a, 3.42a). Without, the forces are points, and where one of them acts the
        depression is infinite. Raises ValueError as `displacement` does.
        """
        x, points = checks.vectors("x", x), checks.vectors("points", points)
        f = checks.scalars("f", f, len(x))
        a = None if radius is None else checks.radii("radius", radius, len(x))
        w = fields.surface(x, f, points, self.modulus, a, self.period)
        moment = None if a is None else f * a**2 / 10
        return w if self._kernel is None else w + self._extra(x).at(points, f, moment)

    @on_host
    def field_slope(
        self, x: ArrayLike, f: ArrayLike, points: ArrayLike, radius: ArrayLike | None = None
    ) -> Array:
        """Slope (m, 2) of the surface at any `points` (m, 2): the gradient of -1 times `field`.

        It points uphill; where a point force acts it is that of all others. Raises
        NotImplementedError for a layer.
        """
        if self._kernel is not None:
            raise NotImplementedError(f"layer = {self.layer!r}: slopes of its field are not there")
        x, points = checks.vectors("x", x), checks.vectors("points", points)
        f = checks.scalars("f", f, len(x))
        a = None if radius is None else checks.radii("radius", radius, len(x))
        return fields.surface(x, f, points, self.modulus, a, self.period, slopes=True)

    @on_host
    def pressure(self, x: ArrayLike, f: ArrayLike, radius: ArrayLike, points: ArrayLike) -> Array:
        """Pressure (m,), Pa, at any `points` (m, 2), of Hertz contacts at `x` (n, 2).

        `3 f/(2 pi a^2) sqrt(1 - r^2/a^2)` within the contact radii `a` (n,), m, and nothing
        outside; infinite at the centre of a force without extent. Raises ValueError as
        `displacement` does.
        """
        x, points = checks.vectors("x", x), checks.vectors("points", points)
        f, a = checks.scalars("f", f, len(x)), checks.radii("radius", radius, len(x))
        return fields.pressure(x, f, points, a, self.period)

    @on_host
    def matrix(self, x: ArrayLike) -> Array:
        """The dense influence matrix (n, n), m/N, of points, with `w = C f`; symmetric.

        Its diagonal is zero, or in a periodic half-space what a contact's own images do to it, and
        on a layer what its base does.
        """
        x = checks.vectors("x", x)
        if self.period is None:
            c = direct.DirectSum(x, self.modulus).matrix()
        else:
            c = PeriodicSum(x, self.modulus, self.period).matrix()
        return c if self._kernel is None else c + self._extra(x).matrix()

    @property
    def _kernel(self) -> LayerKernel | None:
        return None if self.layer is None else LayerKernel(self.layer, self.poissons_ratio)

    def _extra(self, x: Array) -> Pairs:
        """What the layer adds to the sums."""
        assert self._kernel is not None
        return correction_of(x, self.modulus, self._kernel, self.period)
