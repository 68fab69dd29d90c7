"""The substrate's contacts as the host sees them: arrays, and the law that holds for them."""

from typing import NamedTuple

import numpy as np

from taichi_dem.exchange import Exchange
from taichi_dem.pressed import Pressed
from taichi_dem.types import ti


class Members(NamedTuple):
    """Spheres near the surface: ids; place (n, 2) m; shift (n, 2) m, where they are expected to
    touch, seen from there; overlap with the undeformed surface, m; the displacement of it that is
    expected, and the expansion and force of the last step, m, N; radius, m; contact modulus E*, Pa;
    (n,) each."""

    ids: np.ndarray
    place: np.ndarray
    shift: np.ndarray
    overlap: np.ndarray
    expected: np.ndarray
    expansion: np.ndarray
    force: np.ndarray
    radius: np.ndarray
    modulus: np.ndarray

    @property
    def contact_radius(self) -> np.ndarray:
        """Hertz's, (n,) m."""
        return self.pressed.contact_radius(self.force)

    @property
    def pressed(self) -> Pressed:
        """What Hertz has to know of them."""
        return Pressed(self.ids, self.place, self.radius, self.modulus)


@ti.data_oriented
class MembersOnHost:
    """Brings the members of ``exchange`` to the host."""

    def __init__(self, exchange: Exchange):
        self.exchange, self.particles = exchange, exchange.particles

    def now(self) -> Members:
        """As they are now."""
        n = self.exchange.count
        now = Members(np.empty(n, np.int32), np.empty((n, 2)), np.zeros((n, 2)), *np.empty((6, n)))
        self._send(n, *now)
        return now

    def law(self, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Elastic force (n,) N and its tangent, N/m, at effective overlaps (n,) m."""
        force, tangent = np.empty((2, len(overlap)))
        self._evaluate_law(len(overlap), np.ascontiguousarray(overlap), force, tangent)
        return force, tangent

    def radii(self, depth: np.ndarray) -> np.ndarray:
        """Of contacts so deep (n,) m, (n,) m."""
        square = np.empty(len(depth))
        self._square_radii(len(depth), np.ascontiguousarray(depth), square)
        return np.sqrt(square.clip(0.0))

    @ti.kernel
    def _square_radii(self, n: ti.i32, depth: ti.types.ndarray(), square: ti.types.ndarray()):
        ti.loop_config(serialize=self.particles.few)
        for k in range(n):
            square[k] = self.exchange.squared_radius(self.exchange.members[k], depth[k])

    @ti.kernel
    def _send(
        self,
        n: ti.i32,
        ids: ti.types.ndarray(),
        place: ti.types.ndarray(),
        shift: ti.types.ndarray(),
        overlap: ti.types.ndarray(),
        expected: ti.types.ndarray(),
        expansion: ti.types.ndarray(),
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
            ground = self.exchange.ground[i]
            expected[k], expansion[k] = self.exchange.expected(i), ground.expansion
            force[k], modulus[k] = ground.force, 0.75 * body.radius / self.exchange.size(i)
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
