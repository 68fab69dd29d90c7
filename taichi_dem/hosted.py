"""The substrate's contacts through the host: for more of them than a kernel solves by itself, and
for all substrates that the kernel does not know.
"""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

import halfspace
from taichi_dem.contact_list import ContactList
from taichi_dem.control import UNSOLVED
from taichi_dem.creep import Creep, Pressed
from taichi_dem.exchange import Exchange
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


class Members(NamedTuple):
    """Spheres near the surface: ids; place (n, 2) m; shift (n, 2) m, where they are expected to
    touch, seen from there; overlap with the undeformed surface, expected displacement of it, m;
    force of the last step, N; radius, m; contact modulus E*, Pa; (n,) each."""

    ids: np.ndarray
    place: np.ndarray
    shift: np.ndarray
    overlap: np.ndarray
    expected: np.ndarray
    force: np.ndarray
    radius: np.ndarray
    modulus: np.ndarray

    @property
    def contact_radius(self) -> np.ndarray:
        """Hertz's, (n,) m."""
        return np.cbrt(0.75 * np.maximum(self.force, 0.0) * self.radius / self.modulus)

    @property
    def pressed(self) -> Pressed:
        """What the ground's creep has to know of them."""
        return Pressed(self.ids, self.radius, self.modulus)


@ti.data_oriented
class HostedExchange:
    """Does for ``exchange`` what its in-kernel solve does, by ``halfspace``."""

    def __init__(self, exchange: Exchange, relaxation: Relaxation | None):
        self.exchange, self.particles = exchange, exchange.particles
        self._plan: halfspace.Plan | None = None  # of the sums, kept from step to step
        layer = exchange.halfspace.layer
        self._widest = np.inf if layer is None else MOST_OF_LAYER * layer.thickness
        self.trouble = NO_EQUILIBRIUM  # why the run is to be stopped, if it is
        self.creep = None if relaxation is None else Creep(exchange.halfspace, relaxation)

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
        ones; ``settle`` solves for the surfaces of spheres on the substrate as it is, if they are
        to be solved for together."""
        opening = np.empty(self.exchange.count)
        self._settle(len(opening), contacts, opening)
        now = self._sent()
        if self._plan is None:
            self._plan = self.exchange.halfspace.plan(now.place)
        if self.exchange.lagged:
            self._lagged(now, self._plan)
            return
        try:
            with warnings.catch_warnings():  # the exchange says it itself, and counts
                warnings.filterwarnings("ignore", ".*wide for a layer")
                if self.creep is None:
                    found = self._elastic(now, opening)
                    if settle is not None:
                        now, found = self._by_turns(now, found, opening, contacts, settle)
                else:
                    found = self._creeping(self.creep, now, time_step)
        except halfspace.NotConverged as error:
            self.give_up(NO_EQUILIBRIUM_ON_LAYER if self.exchange.layered else NO_EQUILIBRIUM)
            found = error.state
        self.exchange.solver.applications[None] += found.applications
        depth = effective = found.overlap
        if self.creep is not None:
            spheres = now.pressed
            effective = self.creep.accept(spheres, now.overlap, found, time_step)
            depth = self.creep.depth(spheres, found.force)
        if (np.sqrt(depth.clip(0) * now.radius) > self._widest).any():
            self.give_up(TOO_WIDE_FOR_LAYER)
        self._take(len(depth), depth, effective - now.overlap, found.force, found.slope)

    def give_up(self, why: str) -> None:
        """Have the run stopped."""
        self.exchange.control.flags[UNSOLVED], self.trouble = 1, why

    def note_energy(self) -> None:
        """Write down what is stored in the surface: more work than every step should do."""
        now, plan = self._sent(), self._plan
        assert plan is not None
        if self.creep is not None:
            stored = self.creep.stored(now.pressed, now.force, plan)
        else:
            a = now.contact_radius
            stored = now.force * plan.apply(now.force, a) - plan.energy(now.force, a)
        self._store(len(stored), stored)

    def _lagged(self, now: Members, plan: halfspace.Plan) -> None:
        """The surface as the forces of the last step leave it."""
        plan.refresh(now.place + now.shift)
        sunk, slope = plan.displacement(now.force, now.contact_radius)
        depth = now.overlap - sunk - (now.shift**2).sum(axis=1) / (2 * now.radius)
        self._take(len(depth), depth, depth - now.overlap, self._law(depth)[0], slope)

    def _elastic(self, now: Members, opening: np.ndarray) -> halfspace.Equilibrium:
        return halfspace.solve(
            self.exchange.halfspace,
            now.place,
            now.overlap,
            self._law,
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
        found = creep.solve(
            now.pressed,
            now.place,
            now.overlap,
            now.expected,
            time_step,
            residual=self.exchange.residual,
            plan=self._plan,
        )
        assert self._plan is not None
        self._plan.warn_of_points(np.sqrt(now.radius * np.maximum(found.overlap, 0.0)))
        return found

    def _sent(self) -> Members:
        """The members as they are now."""
        n = self.exchange.count
        now = Members(np.empty(n, np.int32), np.empty((n, 2)), np.zeros((n, 2)), *np.empty((5, n)))
        self._send(n, *now)
        return now

    def _law(self, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        force, tangent = np.empty((2, len(overlap)))
        self._evaluate_law(len(overlap), np.ascontiguousarray(overlap), force, tangent)
        return force, tangent

    @ti.kernel
    def _settle(self, n: ti.i32, contacts: ti.template(), opening: ti.types.ndarray()):
        ti.loop_config(serialize=self.particles.few)
        for k in range(n):
            opening[k] = self.exchange.settle(k, contacts)

    @ti.kernel
    def _send(
        self,
        n: ti.i32,
        ids: ti.types.ndarray(),
        place: ti.types.ndarray(),
        shift: ti.types.ndarray(),
        overlap: ti.types.ndarray(),
        expected: ti.types.ndarray(),
        force: ti.types.ndarray(),
        radius: ti.types.ndarray(),
        modulus: ti.types.ndarray(),
    ):
        ti.loop_config(serialize=self.particles.few)
        for k in range(n):
            i = self.exchange.members[k]
            body, ids[k] = self.particles.body[i], self.particles.spin[i].id
            place[k, 0], place[k, 1] = body.position[0], body.position[1]
            overlap[k], radius[k] = self.exchange.overlap(i), body.radius
            expected[k], force[k] = self.exchange.expected(i), self.exchange.ground[i].force
            modulus[k] = 0.75 * body.radius / self.exchange.size(i)
            if ti.static(self.exchange.finite):
                moved = self.exchange.expected_shift(i)
                shift[k, 0], shift[k, 1] = moved[0], moved[1]

    @ti.kernel
    def _evaluate_law(
        self,
        n: ti.i32,
        overlap: ti.types.ndarray(),
        force: ti.types.ndarray(),
        tangent: ti.types.ndarray(),
    ):
        ti.loop_config(serialize=self.particles.few)
        for k in range(n):
            answer = self.exchange.law(k, overlap[k])
            force[k], tangent[k] = answer[0], answer[1]

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
