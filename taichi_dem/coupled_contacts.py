"""What an elastic surface makes of the forces on a few thousand contacts with it, inside a kernel.

Contacts with overlaps delta over the undeformed surface, at the points x + c, are left the overlaps

    delta - w(f, x + c) - c^2/(2R),    c = R grad(-w)

(points: without c).  w is summed exactly (an evaluation), which is dear; its derivative dw/df is
kept as a matrix that is a little old, which is cheap.  From the last state whose w is known, the
model is `w + (dw/df) (f - f_known)`.

What is summed is shared out in blocks, by one thread or a team, in the phases that call for it.

Loops over contacts count by themselves: of a ``for`` the compiler would make copies, unrolled and
vectorised, that gain nothing here and take a third of the time to load the kernel.
"""

from taichi_dem.contacts.roots import inverse_cube_root
from taichi_dem.pair_sums import PairSums, of
from taichi_dem.types import real, ti

DONE, START, RENEW, MODEL, DIRECTION, EVALUATE = range(6)  # what is to be done next
MOVED = 0.02  # sphere radii: contacts that have moved so far get a new matrix
GROWN = 0.1  # squared sphere radii: those whose squared radius has changed by so much, too


@ti.data_oriented
class CoupledContacts:
    """Scratch fields for at most ``capacity`` contacts; ``law(k, d)`` gives what the force H and
    its tangent H' >= 0 are at the effective overlap d.

    The caller sets, for each of ``count`` contacts, home_x, home_y (m), overlap delta (m), a guess
    of effective d (m), radius R (m), size 3 R/(4 E*) (m2/N), opening (the d at which a contact
    lets go, m), a guess shift_x, shift_y of c (m), and from the last step force (N) and base, the d
    that the surface would leave if the forces stayed the same (m).  Come back force, effective and
    shifts; gain (m), what the matrix made of the change of forces; and what the sums give.

    A contact is live if it is not a gap already over the undeformed surface, which forces that
    press can but widen.  The others are told what the surface does, and nothing else: so no bit
    depends on how many gaps there are.  The matrix knows live contacts where they were when they
    became it, or had moved on too far (``anchored``, and old places of the sums).
    """

    def __init__(self, capacity: int, modulus: float, finite: bool, builder: "ti.FieldsBuilder"):
        self.capacity, self.finite = capacity, finite
        self.sums = PairSums(capacity, modulus, finite, builder)
        self.count, self.force = self.sums.count, self.sums.force
        self.phase, self.tries, self.stale = (ti.field(ti.i32) for _ in range(3))
        self.residual = ti.field(real)
        # How often since the start: exact sums, and products of the kept matrix.
        self.exact_sums, self.products = ti.field(ti.i64), ti.field(ti.i64)
        builder.place(self.phase, self.tries, self.stale, self.residual)
        builder.place(self.exact_sums, self.products)
        self.live, self.anchored = ti.field(ti.i32), ti.field(ti.i32)
        builder.dense(ti.i, capacity).place(self.live, self.anchored)
        for name in (
            "home_x home_y overlap effective radius size opening shift_x shift_y"
            " tangent known base gain defect loaded"
        ).split():
            setattr(self, name, ti.field(real))
            builder.dense(ti.i, capacity).place(getattr(self, name))

    def fill(self, residual: float) -> None:
        """Write the constants, after the fields have been placed."""
        self.sums.fill()
        self.residual[None] = residual

    @ti.func
    def blocks(self):
        """How many there are to share out in this phase."""
        return ti.select(self.phase[None] == START, 0, self.sums.blocks())

    @ti.func
    def share(self, block):
        """What there is to do in this phase for a block of contacts."""
        phase = self.phase[None]
        if phase == EVALUATE:
            self.sums.evaluate(block)
        elif phase == RENEW:
            self.sums.renew(block)
        else:
            self.sums.apply(block)

    # -- evaluations -----------------------------------------------------------------------------

    @ti.func
    def place(self, k):
        """Where and how large contact ``k`` is with its present force."""
        self.sums.x[k], self.sums.y[k] = self.home_x[k], self.home_y[k]
        if ti.static(self.finite):
            self.sums.x[k] = self.sums.x[k] + self.shift_x[k]
            self.sums.y[k] = self.sums.y[k] + self.shift_y[k]
            square = 0.0
            if self.force[k] > 0.0:
                cube = self.size[k] * self.force[k]
                square = cube * inverse_cube_root(cube)
            self.sums.square[k] = square

    @ti.func
    def meet(self, k):
        """Contact ``k`` as the caller has set it."""
        self.known[k], self.gain[k] = self.force[k], 0.0
        self.place(k)
        live = self.overlap[k] > self.opening[k] or self.force[k] != 0.0
        self.live[k] = ti.cast(live, ti.i32)

    @ti.func
    def load(self, law: ti.template()):
        """Force and tangent of the present d."""
        k = 0
        while k < self.count[None]:
            force, tangent = 0.0, 0.0
            if self.effective[k] > self.opening[k]:
                answer = law(k, self.effective[k])
                force, tangent = answer[0], answer[1]
            self.force[k], self.tangent[k] = force, tangent
            k += 1

    @ti.func
    def call_evaluation(self):
        """Of the present forces, at the present points of contact."""
        k = 0
        while k < self.count[None]:
            self.place(k)
            k += 1
        self.sums.gather_sources()
        self.exact_sums[None] += 1
        self.phase[None] = EVALUATE

    @ti.func
    def reached(self, k):
        """The effective overlap that the surface leaves contact ``k``."""
        reached = self.overlap[k] - of(self.sums.displacement, k)
        if ti.static(self.finite):
            square = self.shift_x[k] * self.shift_x[k] + self.shift_y[k] * self.shift_y[k]
            reached -= 0.5 * square / self.radius[k]
        return reached

    @ti.func
    def tilt(self, k):
        """What a wrong point of contact ``k`` makes of overlaps, at most."""
        wrong_x = self.radius[k] * of(self.sums.slope_x, k) - self.shift_x[k]
        wrong_y = self.radius[k] * of(self.sums.slope_y, k) - self.shift_y[k]
        felt = ti.abs(wrong_x * of(self.sums.slope_x, k) + wrong_y * of(self.sums.slope_y, k))
        return felt + 0.5 * (wrong_x * wrong_x + wrong_y * wrong_y) / self.radius[k]

    # -- the model -------------------------------------------------------------------------------

    @ti.func
    def improve(self, k):
        """What the surface would leave to a contact that touches it where it is now tilted to."""
        base = self.overlap[k] - of(self.sums.displacement, k)
        if ti.static(self.finite):
            slope_x, slope_y = of(self.sums.slope_x, k), of(self.sums.slope_y, k)
            x, y = self.radius[k] * slope_x, self.radius[k] * slope_y
            base += slope_x * (x - self.shift_x[k]) + slope_y * (y - self.shift_y[k])
            base -= 0.5 * (x * x + y * y) / self.radius[k]
            self.shift_x[k], self.shift_y[k] = x, y
        self.base[k], self.known[k] = base, self.force[k]
        if self.live[k] != 0:
            self.defect[k] = self.effective[k] - base

    @ti.func
    def keep_up(self, k, at_once):
        """The matrix is to be for a live contact as it is now, if it has moved or grown too far."""
        sums = self.sums
        dx, dy = sums.x[k] - sums.old_x[k], sums.y[k] - sums.old_y[k]
        square = self.radius[k] * self.radius[k]
        far = dx * dx + dy * dy > MOVED * MOVED * square
        grown = ti.abs(sums.square[k] - sums.old_square[k]) > GROWN * square
        if self.live[k] != 0 and (at_once or far or grown):
            sums.old_x[k], sums.old_y[k] = sums.x[k], sums.y[k]
            sums.old_square[k], sums.moved[k] = sums.square[k], 1
            self.stale[None] = 1

    @ti.func
    def renewed(self):
        k = 0
        while k < self.count[None]:
            self.sums.moved[k] = 0
            k += 1
        self.stale[None], self.phase[None] = 0, MODEL

    @ti.func
    def note_gain(self):
        """What the matrix has just been asked for is as good as true."""
        k = 0
        while k < self.count[None]:
            self.gain[k] = self.gain[k] + of(self.sums.image, k)
            k += 1
