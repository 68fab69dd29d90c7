"""The work of surfaces that do not answer to the forces of the present step.

A contact with the elastic force f on a surface that has risen by e and tilts by s, of a sphere that
moves by dx, changes what is in motion and in the contact by f de - f s.dx beyond what leaves one
for the other. Where e and s follow from the present forces this is what the surface itself gives;
where they are those of forces before, it comes from nothing, and is all that does.
"""

import numpy as np

import taichi_dem as dem


class LateSurfaces:
    """Runs ``sim`` and sums up, by the trapezoidal rule that makes Verlet's own work exact,

    work    J, what a substrate has put in that is lagged or extrapolated
    unsure  J, the most that lagged surfaces of spheres can have: their forces are known with their
            dashpots only, and R*, too, swells by e while the energy is that of R*
    without  the parts of the energy that have no meaning then
    """

    def __init__(self, sim: dem.Simulation):
        self.sim, self.work, self.unsure = sim, 0.0, 0.0
        ground, surface = sim.scene.substrate, sim.scene.law.surface
        late = ground is not None and (ground.exchange == "lagged" or ground.exchange_every > 1)
        self.ground, self.spheres = late, surface is not None and surface.lagged
        self.present = self.ground or self.spheres
        self.without = ["substrate"] * self.ground + ["expansion"] * self.spheres
        self._before = self._look()

    def run(self, steps: int) -> None:
        """So many steps; one at a time where there is something to be summed up."""
        if not self.present:
            self.sim.run(steps=steps)
            return
        for _ in range(steps):
            self.sim.run(steps=1)
            before, self._before = self._before, self._look()
            for ends in before.keys() | self._before.keys():
                self._add(ends, before.get(ends), self._before.get(ends))

    def _look(self) -> dict:
        """By contact: f, e, s, x of those with late ground; F, e, D of those of late spheres."""
        found = {}
        if self.ground:
            now = self.sim.substrate
            rows = zip(now.force, now.expansion, now.slope, now.position, strict=True)
            found |= dict(zip(now.particle.tolist(), rows, strict=True))
        if self.spheres:
            for one in self.sim.contacts():
                values = np.linalg.norm(one["force"]), one["expansion"].sum(), one["overlap"]
                found[int(one["i"]), int(one["j"]), int(one["face"])] = np.array(values)
        return found

    def _add(self, ends, before, now) -> None:
        if not isinstance(ends, tuple):
            if before is not None and now is not None:  # else one of the forces is none
                (f, e, s, x), (after, risen, tilted, there) = before, now
                self.work += 0.5 * (f + after) * (risen - e)
                self.work -= 0.5 * (f * s + after * tilted) @ (there - x)
            return
        before, now = (np.zeros(3) if each is None else each for each in (before, now))
        force, rise, _ = np.maximum(np.abs(before), np.abs(now))
        _, rises, closes = np.abs(now - before)
        radius = self.sim.scene.spheres.radius
        least = min(radius[end] for end in ends[:2] if end >= 0)
        self.unsure += force * (rises + rise / least * closes)
