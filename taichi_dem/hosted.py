"""The substrate's contacts through the host: for more of them than a kernel solves by itself."""

import numpy as np

import halfspace
from taichi_dem.contact_list import ContactList
from taichi_dem.control import UNSOLVED
from taichi_dem.exchange import Exchange
from taichi_dem.types import ti, vec2


@ti.data_oriented
class HostedExchange:
    """Does for ``exchange`` what its in-kernel solve does, by ``halfspace``."""

    def __init__(self, exchange: Exchange):
        self.exchange, self.particles = exchange, exchange.particles
        self._plan: halfspace.Plan | None = None  # of the sums, kept from step to step

    def restart(self) -> None:
        """Begin anew, with sums that know nothing of those before."""
        self.exchange.restart()
        self._plan = None

    def update(self, contacts: ContactList) -> None:
        """Expansions and slopes for where the particles are now."""
        exchange, n = self.exchange, self.exchange.count
        opening = np.empty(n)
        self._settle(n, contacts, opening)
        place, shift = np.empty((n, 2)), np.zeros((n, 2))
        overlap, expected, before, radius, modulus = np.empty((5, n))
        self._send(n, place, shift, overlap, expected, before, radius, modulus)
        if self._plan is None:
            self._plan = exchange.halfspace.plan(place)
        if exchange.lagged:
            self._plan.refresh(place + shift)
            sunk, slope = self._plan.displacement(before, _hertz_radius(before, radius, modulus))
            effective = overlap - sunk - (shift**2).sum(axis=1) / (2 * radius)
            force = self._law(effective)[0]
        else:
            try:
                result = halfspace.solve(
                    exchange.halfspace,
                    place,
                    overlap,
                    self._law,
                    residual=exchange.residual,
                    start=overlap - expected,
                    opening=opening,
                    plan=self._plan,
                    radius=radius,
                    modulus=modulus,
                    shift=shift,
                )
            except halfspace.NotConverged as error:
                exchange.control.flags[UNSOLVED] = 1
                result = error.state
            effective, force, slope = result.overlap, result.force, result.slope
            exchange.solver.applications[None] += result.applications
        self._take(n, effective - overlap, force, slope)

    def note_energy(self) -> None:
        """Write down what is stored in the surface: more work than every step should do."""
        n = self.exchange.count
        place, shift = np.empty((n, 2)), np.zeros((n, 2))
        overlap, expected, force, radius, modulus = np.empty((5, n))
        self._send(n, place, shift, overlap, expected, force, radius, modulus)
        assert self._plan is not None
        a = _hertz_radius(force, radius, modulus)
        stored = force * self._plan.apply(force, a) - self._plan.energy(force, a)
        self._store(n, stored)

    def _law(self, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        force, tangent = np.empty((2, len(overlap)))
        self._evaluate_law(len(overlap), np.ascontiguousarray(overlap), force, tangent)
        return force, tangent

    @ti.kernel
    def _settle(self, n: ti.i32, contacts: ti.template(), opening: ti.types.ndarray()):
        for k in range(n):
            opening[k] = self.exchange.settle(k, contacts)

    @ti.kernel
    def _send(
        self,
        n: ti.i32,
        place: ti.types.ndarray(),
        shift: ti.types.ndarray(),
        overlap: ti.types.ndarray(),
        expected: ti.types.ndarray(),
        force: ti.types.ndarray(),
        radius: ti.types.ndarray(),
        modulus: ti.types.ndarray(),
    ):
        for k in range(n):
            i = self.exchange.members[k]
            body = self.particles.body[i]
            place[k, 0], place[k, 1] = body.position[0], body.position[1]
            overlap[k], radius[k] = body.radius - body.position[2], body.radius
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
        for k in range(n):
            answer = self.exchange.law(k, overlap[k])
            force[k], tangent[k] = answer[0], answer[1]

    @ti.kernel
    def _take(
        self,
        n: ti.i32,
        expansion: ti.types.ndarray(),
        force: ti.types.ndarray(),
        slope: ti.types.ndarray(),
    ):
        ti.loop_config(serialize=True)
        for k in range(n):
            i = self.exchange.members[k]
            fall = vec2(slope[k, 0], slope[k, 1])
            self.exchange.receive(i, expansion[k], -expansion[k], force[k], fall)

    @ti.kernel
    def _store(self, n: ti.i32, stored: ti.types.ndarray()):
        for k in range(n):
            self.exchange.ground[self.exchange.members[k]].stored = stored[k]


def _hertz_radius(force: np.ndarray, radius: np.ndarray, modulus: np.ndarray) -> np.ndarray:
    return np.cbrt(0.75 * np.maximum(force, 0.0) * radius / modulus)
