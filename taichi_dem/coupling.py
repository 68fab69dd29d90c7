"""The coupled solve for a few hundred contacts, inside a kernel and in one thread.

The same equations as ``halfspace.solve``: the effective overlaps d of contacts with overlaps
delta over the undeformed surface satisfy

    F(d) = d + C H(d) - delta = 0,   C_kj = 1 / (pi E' r_kj),

by semismooth Newton.  Its step s solves (I + C K) s = -F, K = H'(d), by conjugate gradients in the
inner product of K: nothing is divided by a stiffness that may vanish, open contacts follow without
a case of their own, and C K s comes with the solution.
"""

import math

from taichi_dem.types import real, ti, vec2

MOST_ITERATIONS = 60
FORCING = 0.02  # how far a Newton step is solved, as a share of the residual


@ti.data_oriented
class CoupledSolve:
    """Scratch fields for at most ``capacity`` contacts; ``law(k, d)`` gives what H and H' are.

    position (m), overlap delta (m), effective d (m) and the d at which a contact opens (0, or less
    where it adheres) are the caller's to set; force H(d) (N),
    displacement C H(d) (m) and slope (the gradient of -w) come back.
    """

    def __init__(self, capacity: int, modulus: float, builder: "ti.FieldsBuilder"):
        self.capacity = capacity
        self.count, self.applications = ti.field(ti.i32), ti.field(ti.i64)
        self.influence, self.residual = ti.field(real), ti.field(real)
        self.compliance = ti.field(real)  # 1 / (pi E')
        builder.place(self.count, self.applications, self.residual, self.compliance)
        builder.dense(ti.ij, capacity).place(self.influence)
        self.position, self.slope = ti.Vector.field(2, real), ti.Vector.field(2, real)
        for field in (self.position, self.slope):
            builder.dense(ti.i, capacity).place(field)
        for name in (
            "overlap opening effective force tangent displacement defect step remainder"
            " direction image loaded"
        ).split():
            setattr(self, name, ti.field(real))
            builder.dense(ti.i, capacity).place(getattr(self, name))
        self._modulus = modulus

    def fill(self, residual: float) -> None:
        """Write the constants, after the fields have been placed."""
        self.compliance[None] = 1 / (math.pi * self._modulus)
        self.residual[None] = residual

    @ti.func
    def influence_of_positions(self):
        """C; coincident points do not act on each other, no more than a point acts on itself."""
        for k in range(self.count[None]):
            self.influence[k, k] = 0.0
            for j in range(k):
                apart = self.position[k] - self.position[j]
                square = apart.dot(apart)
                value = 0.0
                if square > 0.0:
                    value = self.compliance[None] / ti.sqrt(square)
                self.influence[k, j] = value
                self.influence[j, k] = value

    @ti.func
    def apply(self, loads: ti.template(), result: ti.template()):
        """result = C loads."""
        n = self.count[None]
        self.applications[None] += 1
        for k in range(n):
            result[k] = 0.0
        for j in range(n):
            load = loads[j]
            if load != 0.0:
                for k in range(n):
                    result[k] += self.influence[j, k] * load

    @ti.func
    def slopes(self):
        """The gradient of the surface's height under each contact, by the forces on the others."""
        n = self.count[None]
        scale = 1.0 / (self.compliance[None] * self.compliance[None])
        for k in range(n):
            slope = vec2(0.0)
            for j in range(n):
                if self.force[j] != 0.0:
                    weight = self.influence[k, j]
                    slope += (
                        self.force[j]
                        * scale
                        * (weight * weight * weight)
                        * (self.position[k] - self.position[j])
                    )
            self.slope[k] = slope

    @ti.func
    def solve(self, law: ti.template()) -> ti.i32:
        """Equilibrium from the guess in ``effective``; 1 if the residual was reached, else 0."""
        n = self.count[None]
        scale = 0.0
        for k in range(n):
            scale = ti.max(scale, self.overlap[k] - self.opening[k])
            if self.effective[k] > self.opening[k]:
                scale = ti.max(scale, -self.opening[k])
        goal = self.residual[None] * scale
        solved, iteration, before, share = 0, 0, 0.0, 1.0
        while solved == 0 and iteration < MOST_ITERATIONS:
            largest = self.balance(law)
            if largest <= goal:
                solved = 1
            else:
                share = 1.0
                if iteration > 0 and not (largest < before):
                    share = 0.5  # across a kink of the law a full step may overshoot
                before = largest
                self.newton_step(ti.max(FORCING * largest, 0.5 * goal))
                for k in range(n):
                    self.effective[k] = ti.min(
                        self.effective[k] + share * self.step[k],
                        ti.max(self.effective[k], self.overlap[k]) + scale,
                    )
            iteration += 1
        return solved

    @ti.func
    def balance(self, law: ti.template()):
        """Force, tangent and defect F of the present d; returns the largest |F| that counts."""
        n = self.count[None]
        for k in range(n):
            answer = law(k, self.effective[k])
            self.force[k] = answer[0]
            self.tangent[k] = answer[1]
        self.apply(self.force, self.displacement)
        largest = 0.0
        for k in range(n):
            reached, opening = self.overlap[k] - self.displacement[k], self.opening[k]
            if self.effective[k] <= opening and reached <= opening:
                self.effective[k] = reached  # open, and stays open: solved outright
            self.defect[k] = self.effective[k] - reached
            error = ti.max(self.effective[k], opening) - ti.max(reached, opening)
            if not (ti.abs(self.defect[k]) < math.inf):  # not-a-number must not pass for solved
                error = math.inf
            largest = ti.max(largest, ti.abs(error))
        return largest

    @ti.func
    def newton_step(self, goal):
        """(I + C K) step = -defect by conjugate gradients, to within ``goal`` where loaded."""
        n = self.count[None]
        product = 0.0
        for k in range(n):
            self.step[k] = 0.0
            self.remainder[k] = -self.defect[k]
            self.direction[k] = -self.defect[k]
            product += self.tangent[k] * self.defect[k] * self.defect[k]
        rounds, left = 0, 2.0 * goal
        while left > goal and product > 0.0 and rounds < 2 * n + 2:
            curvature = 0.0
            for k in range(n):
                self.loaded[k] = self.tangent[k] * self.direction[k]
            self.apply(self.loaded, self.image)
            for k in range(n):
                self.image[k] += self.direction[k]
                curvature += self.loaded[k] * self.image[k]
            if curvature > 0.0:
                length = product / curvature
                after = 0.0
                left = 0.0
                for k in range(n):
                    self.step[k] += length * self.direction[k]
                    self.remainder[k] -= length * self.image[k]
                    if self.tangent[k] > 0.0:
                        left = ti.max(left, ti.abs(self.remainder[k]))
                    after += self.tangent[k] * self.remainder[k] * self.remainder[k]
                for k in range(n):
                    self.direction[k] = self.remainder[k] + (after / product) * self.direction[k]
                product = after
            else:
                product = 0.0  # contacts closer than their size: keep what there is
            rounds += 1
        for k in range(n):
            if self.tangent[k] <= 0.0:
                self.step[k] += self.remainder[k]
