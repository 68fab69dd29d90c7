"""The substrate's contacts through the host: for more of them than a kernel solves by itself, and
for all substrates that the kernel does not know.
"""

import warnings
from collections.abc import Callable

import numpy as np

import halfspace
from taichi_dem.contact_list import ContactList
from taichi_dem.control import UNSOLVED
from taichi_dem.creep import Creep
from taichi_dem.doubts import CLOSE_POINTS
from taichi_dem.exchange import Exchange
from taichi_dem.members import Members, MembersOnHost
from taichi_dem.periodic import wrapped
from taichi_dem.substrate import Relaxation
from taichi_dem.types import ti, vec2

MOST_OF_LAYER = 0.6  # of its thickness, a contact's radius: beyond, thinner would come out softer
NO_EQUILIBRIUM = (
    "the contacts with the substrate found no equilibrium. Try a smaller time step or a larger "
    "residual"
)
NO_EQUILIBRIUM_ON_LAYER = (
    "the contacts with the layer found no equilibrium. Where one is wide for the layer, or its law "
    "stiffer than the layer's own, there is none: try a thicker layer, Hertz's law, or "
    'coupling="finite"; else a smaller time step'
)
MOST_TURNS = 50
NO_EQUILIBRIUM_TOGETHER = (
    f"the substrate and the surfaces of the spheres found no equilibrium in {MOST_TURNS} turns. "
    "Try a larger residual, a smaller time step, or to compress less"
)
TOO_WIDE_FOR_LAYER = (
    f"a contact is wider than {MOST_OF_LAYER:g} of the thickness of the layer below it, and its "
    "force no longer to be believed. Try a thicker or stiffer layer, or a smaller load"
)


@ti.data_oriented
class HostedExchange:
    """Does for ``exchange`` what its in-kernel solve does, by ``halfspace``."""

    def __init__(self, exchange: Exchange, relaxation: Relaxation | None):
        self.exchange, self.particles = exchange, exchange.particles
        self._members = MembersOnHost(exchange)
        self._plan: halfspace.Plan | None = None  # of the sums, kept from step to step
        layer = exchange.halfspace.layer
        self._widest = np.inf if layer is None else MOST_OF_LAYER * layer.thickness
        self.trouble = NO_EQUILIBRIUM  # why the run is to be stopped, if it is
        self.creep: Creep | None = None
        if relaxation is not None:
            self.creep = Creep(exchange.halfspace, relaxation, exchange.residual)
        self.in_dents = 0.0  # J, stored where nobody presses any more

    def restart(self) -> None:
        """Begin anew, with sums that know nothing of those before."""
        self.exchange.restart()
        self._plan = None
        if self.creep is not None:
            self.creep.forget()

    def update(
        self, contacts: ContactList, time_step: float, settle: Callable[[], None] | None = None
    ) -> None:
        """Expansions and slopes for where the particles are now, ``time_step``, s, after the last
        ones, unless these are to be extrapolated; ``settle`` solves for the surfaces of spheres on
        the substrate as it is, if they are to be solved for together."""
        if self.exchange.extrapolates and self.steps_to_next(self.exchange.control.step[None]) > 0:
            return
        opening = np.empty(self.exchange.count)
        self._settle(len(opening), contacts, opening)
        now = self._members.now()
        if self._plan is None:
            self._plan = self.exchange.halfspace.plan(now.place)
        if self.exchange.lagged:
            self._lagged(now, self._plan)
            return
        try:
            with warnings.catch_warnings():  # the exchange says it itself, and counts
                warnings.filterwarnings("ignore", ".*(wide for a layer|size counts)")
                if self.creep is None:
                    found = self._elastic(now, opening)
                    if settle is not None:
                        now, found = self._by_turns(now, found, opening, contacts, settle)
                else:
                    found = self._creeping(self.creep, now, time_step)
        except halfspace.NotConverged as error:
            self.give_up(NO_EQUILIBRIUM_ON_LAYER if self.exchange.layered else NO_EQUILIBRIUM)
            found = error.state
        self.exchange.solver.exact_sums[None] += found.applications
        depth = effective = found.overlap
        if self.creep is not None:
            spheres = now.pressed
            effective = self.creep.accept(spheres, found, time_step)
            depth = self.creep.depth(spheres, found.force)
        if self._widest < np.inf and (self._members.radii(depth) > self._widest).any():
            self.give_up(TOO_WIDE_FOR_LAYER)
        self._take(len(depth), depth, effective - now.overlap, found.force, found.slope)
        self._look_for_close_points(now, effective)
        if self.exchange.extrapolates:
            self._write_stored()
            self._note_course(len(depth))

    def steps_to_next(self, step: int) -> int:
        """How many steps can be made from ``step`` on, which has been solved for."""
        return int(self.exchange.between.next[None]) - step if self.exchange.extrapolates else 1

    def give_up(self, why: str) -> None:
        """Have the run stopped."""
        self.exchange.control.flags[UNSOLVED], self.trouble = 1, why

    def note_energy(self) -> None:
        """Write down what is stored in the surface: more work than every step should do."""
        if not self.exchange.extrapolates:  # or it is known of every exchange
            self._write_stored()

    def _write_stored(self) -> None:
        now, plan = self._members.now(), self._plan
        if plan is None:
            plan = self.exchange.halfspace.plan(now.place)
        if self.creep is not None:
            stored, self.in_dents = self.creep.stored(now.pressed, now.force, plan)
        else:
            a = self._size(now)
            stored = now.force * plan.apply(now.force, a) - plan.energy(now.force, a)
        self._store(len(stored), stored)

    def _lagged(self, now: Members, plan: halfspace.Plan) -> None:
        """The surface as the forces of the last step leave it."""
        plan.refresh(now.place + now.shift)
        sunk, slope = plan.displacement(now.force, self._size(now))
        depth = now.overlap - sunk - (now.shift**2).sum(axis=1) / (2 * now.radius)
        self._take(len(depth), depth, depth - now.overlap, self._members.law(depth)[0], slope)
        self._look_for_close_points(now, depth)

    def _look_for_close_points(self, now: Members, effective: np.ndarray) -> None:
        """Count those that are too close for points, as the kernel does."""
        if self.exchange.finite:
            return
        widest = float(self._members.radii(effective).max(initial=0.0))
        if self._plan.closest >= CLOSE_POINTS * widest:
            return
        from scipy.spatial import cKDTree  # slow to import, and seldom needed

        place, period = now.place, self.exchange.halfspace.period
        tree = cKDTree(wrapped(place, period), boxsize=period)
        apart = tree.query(tree.data, k=2)[0][:, 1]
        self._watch_neighbours(len(apart), apart**2)

    @ti.kernel
    def _watch_neighbours(self, n: ti.i32, square: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for k in range(n):
            self.exchange.watch_neighbours(self.exchange.members[k], square[k])

    def _size(self, now: Members) -> np.ndarray | None:
        """Contact radii (n,) m, where they count."""
        return now.contact_radius if self.exchange.finite else None

    def _elastic(self, now: Members, opening: np.ndarray) -> halfspace.Equilibrium:
        return halfspace.solve(
            self.exchange.halfspace,
            now.place,
            now.overlap,
            self._members.law,
            residual=self.exchange.residual,
            start=now.overlap - now.expected,
            opening=opening,
            plan=self._plan,
            radius=now.radius,
            modulus=now.modulus,
            shift=now.shift,
        )

    def _by_turns(
        self,
        now: Members,
        found: halfspace.Equilibrium,
        opening: np.ndarray,
        contacts: ContactList,
        settle: Callable[[], None],
    ) -> tuple[Members, halfspace.Equilibrium]:
        """The substrate as the spheres' surfaces are, these as the substrate is, and so on, until
        neither changes by more than the residual."""
        exchange, n = self.exchange, len(opening)
        before, after = np.empty((2, n))
        self._bulges(n, contacts, before)
        bare = now.overlap - before
        residual = min(exchange.residual, exchange.surface_residual)
        for _ in range(MOST_TURNS):
            self._lend(n, found.overlap - now.overlap)
            settle()
            self._bulges(n, contacts, after)
            change = np.abs(bare + after - now.overlap)
            if change.max() <= residual * max(now.overlap.max(), found.overlap.max(), 0.0):
                return now, found
            now = now._replace(overlap=bare + after, shift=found.shift)
            now = now._replace(expected=now.overlap - found.overlap)
            found = self._elastic(now, opening)
        self.give_up(NO_EQUILIBRIUM_TOGETHER)
        return now, found

    def _creeping(self, creep: Creep, now: Members, time_step: float) -> halfspace.Equilibrium:
        assert self._plan is not None
        return creep.solve(now.pressed, now.overlap, now.expected, time_step, self._plan)

    @ti.kernel
    def _settle(self, n: ti.i32, contacts: ti.template(), opening: ti.types.ndarray()):
        ti.loop_config(serialize=self.particles.few)
        for k in range(n):
            opening[k] = self.exchange.settle(k, contacts)

    @ti.kernel
    def _take(
        self,
        n: ti.i32,
        depth: ti.types.ndarray(),
        expansion: ti.types.ndarray(),
        force: ti.types.ndarray(),
        slope: ti.types.ndarray(),
    ):
        ti.loop_config(serialize=True)
        for k in range(n):
            i = self.exchange.members[k]
            fall = vec2(slope[k, 0], slope[k, 1])
            self.exchange.receive(i, depth[k], expansion[k], -expansion[k], force[k], fall)

    @ti.kernel
    def _note_course(self, n: ti.i32):
        for _ in range(1):
            self.exchange.note_course(n)

    @ti.kernel
    def _bulges(self, n: ti.i32, contacts: ti.template(), bulge: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for k in range(n):
            i, p = self.exchange.members[k], self.exchange.entry[k]
            bulge[k] = self.exchange.expansion_of(i, p, contacts)
            self.exchange.ground[i].bulge = bulge[k]

    @ti.kernel
    def _lend(self, n: ti.i32, expansion: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for k in range(n):
            self.exchange.ground[self.exchange.members[k]].expansion = expansion[k]

    @ti.kernel
    def _store(self, n: ti.i32, stored: ti.types.ndarray()):
        ti.loop_config(serialize=self.particles.few)
        for k in range(n):
            self.exchange.ground[self.exchange.members[k]].stored = stored[k]
