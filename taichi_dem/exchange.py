"""The substrate at every step: contacts out; expansion, slope and energy in.

Up to two thousand contacts or so on a half-space are solved inside the step's own kernel
(:mod:`taichi_dem.coupling`); more, and those on any other ground, go to :mod:`halfspace` through
the host (:mod:`taichi_dem.hosted`).  Which of the two depends on no driver.
"""

from collections.abc import Sequence

import halfspace
from taichi_dem.contact_list import SUBSTRATE, ContactList
from taichi_dem.control import UNSOLVED, Control
from taichi_dem.coupled_contacts import DONE, START
from taichi_dem.coupling import CoupledSolve
from taichi_dem.effects import Effects
from taichi_dem.extrapolation import Extrapolation
from taichi_dem.ground_contacts import GroundContacts
from taichi_dem.ground_past import DRIFTS
from taichi_dem.lagged_surface import LaggedSurface
from taichi_dem.material import Material
from taichi_dem.pair_sums import of
from taichi_dem.particles import Particles
from taichi_dem.past import extrapolated, shifted
from taichi_dem.periodic import Period
from taichi_dem.substrate import Substrate
from taichi_dem.types import PRECISION, ti, vec2, vec3

IN_KERNEL_CONTACTS = 2048  # their matrix takes 16 MB
ROUND_OFF = 1e-14 if PRECISION == "double" else 1e-5  # no residual can be asked to be smaller


def ground_of(substrate: Substrate, period: Period | None = None) -> halfspace.HalfSpace:
    """The half-space that the substrate of a scene with that period stands for."""
    material, layer = substrate.material, substrate.layer
    return halfspace.HalfSpace(
        material.youngs_modulus,
        material.poissons_ratio,
        tolerance=substrate.tolerance,
        coupling=substrate.coupling,
        period=period,
        layer=None if layer is None else halfspace.Layer(layer.thickness, layer.base),
    )


@ti.data_oriented
class Exchange(GroundContacts):
    """The contacts with ``substrate``, solved for at every step.

    solver    does it inside the kernel, for all if there are few enough of them
    between   what happens between two exchanges (absent unless steps are left out)
    on_host   whether somebody else solves
    enrolled  the ids of those that the solver knew when the last list was made
    """

    def __init__(
        self,
        substrate: Substrate,
        period: Period | None,
        particles: Particles,
        law,
        effects: Effects,
        coefficients,
        materials: Sequence[Material],
        control: Control,
        builder: "ti.FieldsBuilder",
    ):
        super().__init__(
            substrate, particles, law, effects, coefficients, materials, control, builder
        )
        self.halfspace = ground_of(substrate, period)
        # Only there where every pair of contacts has one and the same simple kernel.
        self.in_kernel = substrate.homogeneous and period is None
        self.layered = substrate.layer is not None
        self.residual = max(substrate.residual, ROUND_OFF)
        self.together = self.spreads and not law.surface.lagged
        self.surface_residual = law.surface.residual if self.together else 0.0
        if self.extrapolates:
            self.between, self._every = Extrapolation(self, builder), substrate.exchange_every
        n = particles.count
        self.enrolled, self.on_host = ti.field(ti.i32), ti.field(ti.i32)
        builder.dense(ti.i, n).place(self.enrolled)
        builder.place(self.on_host)
        most = IN_KERNEL_CONTACTS if self.in_kernel else 1
        way = LaggedSurface if self.lagged else CoupledSolve
        self.solver = way(min(n, most), self.halfspace.modulus, self.finite, builder)

    def fill(self) -> None:
        """Write the constants, after the fields have been placed."""
        super().fill()
        self.solver.fill(self.residual)
        if self.extrapolates:
            self.between.every[None] = self._every
            self.between.forget()

    def enrol(self, contacts: ContactList) -> None:
        """Find the members after the contact list has been rebuilt, and who solves for them."""
        self.count = self._enrol(contacts)
        self.hosted = self.count > (self.solver.capacity if self.in_kernel else 0)
        self.on_host[None] = int(self.hosted)

    @ti.kernel
    def _enrol(self, contacts: ti.template()) -> ti.i32:
        number, others = 0, 0
        ti.loop_config(serialize=True)
        for row in range(self.particles.count):
            i = self.particles.index_of[row]
            last = contacts.start[i + 1] - 1
            if last >= contacts.start[i] and contacts.ends[last].j == SUBSTRATE:
                self.members[number], self.entry[number] = i, last
                if self.enrolled[number] != row + 1:  # (0: nobody yet)
                    self.enrolled[number] = row + 1
                    others = 1
                number += 1
            else:
                self.ground[i] = self.Ground()
        count = ti.min(number, self.solver.capacity)
        if others != 0:
            for k in range(count):
                self.solver.sums.moved[k] = 1
            self.solver.stale[None] = 1
        self.solver.count[None] = count
        return number

    def forget(self) -> None:
        """Start without a past, as for a state that no step has led to; to be enrolled anew."""
        self.ground.fill(0)
        self.enrolled.fill(0)
        if self.extrapolates:
            self.between.forget()

    def restart(self) -> None:
        """:meth:`forget`, and count from zero again."""
        self.forget()
        self.doubts.restart()
        self.solver.exact_sums[None] = self.solver.products[None] = 0
        if self.extrapolates:
            self.between.largest[None] = 0.0

    # -- inside the step's kernel ----------------------------------------------------------------

    @ti.func
    def calls(self) -> ti.i32:
        """Whether blocks of the coupled solve are to be shared out."""
        return ti.atomic_or(self.solver.phase[None], 0) != DONE

    @ti.func
    def blocks(self):
        return self.solver.blocks()

    @ti.func
    def share(self, block):
        self.solver.share(block)

    @ti.func
    def begin(self):
        """Call for the coupled solve of a new step, if it is to have one."""
        calls = self.on_host[None] == 0
        if ti.static(self.extrapolates):
            calls = calls and self.between.due()
        if calls:
            self.solver.phase[None] = START

    @ti.func
    def proceed(self, contacts: ti.template()):
        """Go on with it after all blocks are done."""
        solver = self.solver
        if solver.phase[None] == START:
            for k in range(solver.count[None]):
                solver.opening[k] = self.settle(k, contacts)
                self.tell(k, self.members[k])
        if solver.proceed(self.law) == 0:
            self.control.raise_flag(UNSOLVED)
        if solver.phase[None] == DONE:
            for k in range(solver.count[None]):
                self.hear(k, self.members[k])
            if ti.static(self.extrapolates):
                self.note_course(solver.count[None])

    @ti.func
    def note_course(self, count):
        """What is to be extrapolated from, after an exchange; in one thread."""
        self.between.phase[None] = 0.0
        for k in range(count):
            self.between.note(k, self.members[k])
        if self.between.finish() == 0:
            self.control.raise_flag(UNSOLVED)

    @ti.func
    def tell(self, k, i):
        """Where particle ``i`` is now, and what its past lets expect."""
        solver, body, ground = self.solver, self.particles.body[i], self.ground[i]
        sums, anchor = solver.sums, ground.anchor
        sums.old_x[k], sums.old_y[k], sums.old_square[k] = anchor[0], anchor[1], anchor[2]
        solver.anchored[k] = ground.anchored
        solver.home_x[k], solver.home_y[k] = body.position[0], body.position[1]
        solver.radius[k], solver.overlap[k] = body.radius, self.overlap(i)
        solver.force[k] = ground.force
        if ti.static(self.extrapolates):  # that which the known displacement belongs to
            solver.force[k] = ground.solved
        solver.effective[k] = solver.overlap[k] - self.expected(i)
        drift = extrapolated(ground.drift, ground.drifts)
        solver.base[k] = solver.overlap[k] - ground.past[0] - drift
        if ti.static(self.finite):
            solver.size[k] = self.size(i)
            shift = self.expected_shift(i)
            solver.shift_x[k], solver.shift_y[k] = shift[0], shift[1]

    @ti.func
    def hear(self, k, i):
        """What the coupled solve found for particle ``i``."""
        solver, sums, before = self.solver, self.solver.sums, self.ground[i].past[0]
        slope, force = vec2(of(sums.slope_x, k), of(sums.slope_y, k)), solver.force[k]
        sunk = solver.overlap[k] - solver.reached(k)  # by the sums, to rounding
        if solver.live[k] == 0:
            solver.effective[k] = solver.overlap[k] - sunk
        expansion = solver.effective[k] - solver.overlap[k]
        self.receive(i, self.overlap(i) + expansion, expansion, sunk, force, slope)
        ground = self.ground[i]
        if solver.live[k] != 0 and ground.age > 1:
            ground.drift = shifted(ground.drift, sunk - before - solver.gain[k])
            ground.drifts = ti.min(ground.drifts + 1, DRIFTS)
        else:
            ground.drifts = 0
        ground.anchor = vec3(sums.old_x[k], sums.old_y[k], sums.old_square[k])
        ground.anchored = solver.live[k]
        # f.(delta - c^2/(2R) - d) - E_c: where f.w - E_c would err by the residual, this does not.
        lost = solver.overlap[k] - of(sums.displacement, k) - solver.reached(k)
        apart = solver.overlap[k] - lost - solver.effective[k]
        ground.stored = force * (apart - 0.5 * of(sums.potential, k))
        self.ground[i] = ground
        self.watch_neighbours(i, of(sums.nearest, k))
