"""What stops a run before it computes nonsense, and the words for it."""

import math
from typing import Any

import numpy as np

from taichi_dem.boundaries import Boundaries
from taichi_dem.particles import Particles
from taichi_dem.types import real, ti
from taichi_dem.views import relative_overlaps

Reason = tuple[str, int | None]  # the words for it, and the sphere that it is about
Setting = tuple[str, Any]  # an entry of a scene, and its value
FARTHEST_STEP = 0.25  # of its radius that a sphere may move in one step


class SimulationStopped(RuntimeError):
    """The run was stopped; what was computed before is kept.

    The simulation goes back to ``last_good``, its contacts remembering what they did then.

    ``last_good`` holds time, step, position, velocity and omega of the last state that was known
    to be sound; ``particle`` is the sphere that gave the reason, or None; ``setting`` the entry of
    the scene that did, with its value, or None.
    """

    def __init__(
        self,
        message: str,
        particle: int | None,
        last_good: dict[str, Any],
        setting: Setting | None = None,
    ):
        super().__init__(message)
        self.particle, self.last_good, self.setting = particle, last_good, setting

    def __reduce__(self) -> tuple[Any, ...]:
        """What another process needs to raise it there."""
        return type(self), (str(self), self.particle, self.last_good, self.setting)


@ti.kernel
def first_offender(
    particles: ti.template(), boundaries: ti.template(), time_step: real, smallest: real
) -> ti.i32:
    """The first id whose numbers are not finite or which moves too far in a step; else the first
    boundary b that does, measured by the ``smallest`` radius (m), as -2 - b; or -1."""
    offender = particles.count
    ti.loop_config(serialize=particles.few)
    for i in range(particles.count):
        body = particles.body[i]
        step = time_step * body.velocity.norm()
        finite = body.position.norm() < math.inf
        if not (finite and step < FARTHEST_STEP * body.radius):
            ti.atomic_min(offender, particles.spin[i].id)
    found = offender if offender < particles.count else -1
    if ti.static(boundaries.any_moves):
        ti.loop_config(serialize=True)
        for b in range(boundaries.count):
            slow = time_step * ti.abs(boundaries.motion[b].speed) < FARTHEST_STEP * smallest
            if found == -1 and not slow:
                found = -2 - b
    return found


def nonsense(
    particles: Particles, boundaries: Boundaries, time_step: float, smallest: float
) -> Reason | None:
    """What :func:`first_offender` finds, and the words for it."""
    found = first_offender(particles, boundaries, time_step, smallest)
    if found >= 0:
        return _describe_offender(particles, found, time_step), found
    if found < -1:
        b = -2 - found
        return _describe_boundary(b, boundaries.motion[b].speed, time_step, smallest), None
    return None


def _describe_offender(particles: Particles, row: int, time_step: float) -> str:
    """Why :func:`first_offender` found sphere ``row``."""
    state = particles.read()
    position, velocity = state["position"][row], state["velocity"][row]
    if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
        return (
            f"sphere {row} is at {_point(position)} with velocity {_point(velocity)} m/s: not a "
            "number. Two centres may have met, or the time step may be too large"
        )
    return (
        f"sphere {row} at {_point(position)} m moves {np.linalg.norm(velocity) * time_step:.3g} m "
        f"in one step at {np.linalg.norm(velocity):.3g} m/s, more than {FARTHEST_STEP:g} of its "
        "radius: it could pass through others. Try a smaller time step"
    )


def _describe_boundary(b: int, speed: float, time_step: float, smallest: float) -> str:
    """Why :func:`first_offender` found boundary ``b``, at ``speed`` (m/s)."""
    limit = FARTHEST_STEP * smallest / time_step
    return (
        f"boundary {b} moves at {speed:.3g} m/s, more than {FARTHEST_STEP:g} of the smallest "
        f"radius in one step ({limit:.3g} m/s): it could pass through spheres. Try a smaller time "
        "step or, under a load, a heavier plate"
    )


def too_deep(records: np.ndarray, radius: np.ndarray, limit: float) -> Reason:
    """The deepest of the contacts, and its sphere; ``limit``: share of the smaller radius."""
    i, j, share = records["i"], records["j"], relative_overlaps(records, radius)
    k = int(np.argmax(share))
    other = (
        f"sphere {j[k]}"
        if j[k] >= 0
        else "the substrate"
        if j[k] == -1
        else f"boundary {-2 - j[k]}"
    )
    return (
        f"sphere {i[k]} overlaps {other} by {records['overlap'][k]:.3g} m at "
        f"{_point(records['position'][k])} m, {share[k]:.2g} of the smaller radius (limit "
        f"{limit:g}): the model of small strains fails. Try a lower load or speed, stiffer "
        "material or, where that does not help, a smaller time step; in Python, "
        "dem.Simulation(max_overlap=...) sets the limit"
    ), int(i[k])


def overpressed(records: np.ndarray) -> Reason:
    """Spheres that give way, and the one whose surface has risen most."""
    expansion = records["expansion"]
    k = int(np.argmax(expansion.max(axis=1)))
    side = int(np.argmax(expansion[k]))
    sphere = int(records["ij"[side]][k])
    return (
        f"the contacts found no equilibrium: the surface of sphere {sphere} has risen by "
        f"{expansion[k, side]:.3g} m at an overlap of {records['overlap'][k]:.3g} m. Beyond a "
        "compression of some tenths of the radius there is none under the multi-contact law, as "
        "each contact is pressed more by what the others raise than it can bear. Try to "
        "compress less, or a smaller time step or prefactor"
    ), sphere


def _point(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
