"""Where what the model of the substrate assumes does not hold: when it is noticed of a contact, how
often it has been, and the words for it."""

from taichi_dem.substrate import Substrate
from taichi_dem.types import real, ti

FAST_IMPACT = 0.1  # of the substrate's shear wave speed: beyond, it is not quasi-static
WIDE_CONTACT = 0.3  # contact radius over sphere radius: beyond, strains are not small
CLOSE_POINTS = 6.0  # contact radii: closer, a contact is not a point for its neighbours
WIDE_FOR_LAYER = {"finite": 0.4, "point": 0.2}  # of its thickness: beyond, forces err by a percent
STEEP_PHASE = 0.3  # rad of a contact's own oscillation between exchanges: 1 % of its energy each
RISKY = 0.5  # spectral radius of a lagged exchange

# What is noticed of a contact, once from when it is made to when it opens: doubt k sets the bit
# 1 << k of what is known of it.  An impact is fast, or not, when the contact is made.
FAST, WIDE, CLOSE, OUTGROWN, STEEP, UNSEEN = range(6)
TOUCHED = 1 << FAST

WORDS = {
    "fast_impacts": f"a sphere hit the substrate at more than {FAST_IMPACT:g} of its shear wave "
    "speed: the substrate is taken as quasi-static, and waves that carry energy away are left out",
    "wide_contacts": f"a contact with the substrate is wider than {WIDE_CONTACT:g} of its sphere's "
    "radius: strains are not small",
    "close_points": f"contacts with the substrate are closer than {CLOSE_POINTS:g} of their radii: "
    'coupling="point" neglects their size, coupling="finite" does not',
    "wide_for_layer": "a contact is wide for the thickness of the layer below it: beyond "
    f"{WIDE_FOR_LAYER['finite']:g} of it ({WIDE_FOR_LAYER['point']:g} for points) forces err by a "
    "percent and more",
    "sparse_exchange": "a contact with the substrate turns by more than "
    f"{STEEP_PHASE:g} rad of its own oscillation between two exchanges: extrapolation takes or "
    "gives some percent of its energy in each of its periods; a smaller exchange_every or time "
    "step does less",
    "unseen_contacts": "a sphere met the substrate between two exchanges of which the last one did "
    "not know it, and found the surface undeformed: exchange_every times the step is long for "
    "spheres so fast",
    "lagged_exchange": "the lagged exchange is close to divergence, with a spectral radius above "
    f'{RISKY:g}: it damps some motions and feeds others; exchange="implicit" does not',
}
NAMES = tuple(WORDS)  # in the order of the doubts; the last is noticed of no single contact


@ti.data_oriented
class Doubts:
    """Counts them for the contacts with ``substrate``.

    noticed     how often each
    wave_speed  of shear waves in the substrate, m/s
    """

    def __init__(self, substrate: Substrate, builder: "ti.FieldsBuilder"):
        self.finite, self.layered = substrate.coupling == "finite", substrate.layer is not None
        if self.layered:
            self._widest = WIDE_FOR_LAYER[substrate.coupling] * substrate.layer.thickness
        self._speed = substrate.material.shear_wave_speed
        self._names = NAMES[: UNSEEN + 1] if substrate.exchange_every > 1 else NAMES[:STEEP]
        self.noticed, self.wave_speed = ti.field(ti.i64), ti.field(real)
        builder.dense(ti.i, len(self._names)).place(self.noticed)
        builder.place(self.wave_speed)

    def fill(self) -> None:
        """Write the constants, after the fields have been placed."""
        self.wave_speed[None] = self._speed

    def restart(self) -> None:
        """Count from zero again."""
        self.noticed.fill(0)

    def counts(self) -> dict[str, int]:
        """How often so far, by name."""
        return {name: int(self.noticed[k]) for k, name in enumerate(self._names)}

    @ti.func
    def note(self, doubt: ti.template(), touched):
        """Count a doubt about a contact of which ``touched`` is known; returns that with it."""
        if touched & (1 << doubt) == 0:
            self.noticed[doubt] += 1
        return touched | (1 << doubt)

    @ti.func
    def about(self, body, square, known: ti.i32):
        """Look at a contact of ``body`` with this squared radius (m2) and of which so much is
        ``known``; returns what is known of it now."""
        touched = known
        if touched == 0 and -body.velocity[2] > FAST_IMPACT * self.wave_speed[None]:
            self.noticed[FAST] += 1
        if square > (WIDE_CONTACT * body.radius) ** 2:
            touched = self.note(WIDE, touched)
        if ti.static(self.layered):
            limit = ti.static(self._widest * self._widest)
            if square > limit:
                touched = self.note(OUTGROWN, touched)
        return touched | TOUCHED

    @ti.func
    def about_neighbours(self, square, nearest, known: ti.i32):
        """Look at a point contact whose squared radius (m2) and squared distance from the
        ``nearest`` other (m2) are these; returns what is known of it now."""
        touched = known
        if nearest < CLOSE_POINTS**2 * square:
            touched = self.note(CLOSE, touched)
        return touched
