"""The half-space under forces: reciprocity, and contacts in nearly one place."""

import numpy as np

import halfspace
from tests.hard.kit import Figure, hard
from tests.taichi_dem.setups import EPS

GROUND = {"free": None, "periodic": (2.0, 2.5)}
SUMS = {"direct": 300, "mesh": 1500}  # contacts
SERIAL = ("serial",)  # no driver takes part


@hard(
    "reciprocity of {0[0]} sums on {0[1]} ground",
    *((sums, ground) for sums in SUMS for ground in GROUND),
    drivers=SERIAL,
)
def reciprocity(_, what):
    """f C g = g C f, to the rounding of sums of so many terms."""
    sums, ground = what
    rng, n = np.random.default_rng(3), SUMS[sums]
    place, f, g = rng.uniform(0, 2, (n, 2)), rng.normal(size=n), rng.uniform(0, 2, n)
    space = halfspace.HalfSpace(1.0, 0.3, coupling="point", period=GROUND[ground])
    plan = space.plan(place, method=sums)
    both = np.abs(f) @ np.abs(plan.apply(np.abs(g)))
    off = abs(f @ plan.apply(g) - g @ plan.apply(f)) / both
    yield Figure("difference", float(off), n * EPS)


@hard("two contacts {} radii apart on the half-space", 0.0, 1e-300, 1e-12, 1e-3, drivers=SERIAL)
def coincident(_, gap):
    """Each raises the other as if it lay in the same place but for (gap/a)^2; a third feels both
    as one."""
    a = 0.1
    together = np.array([[0.0, 0.0], [0.0, 0.0], [20.0, 0.0]]) * a
    apart = together + np.array([[0, 0], [gap, 0], [0, 0]]) * a
    force, radius = np.array([0.01, 0.03, 0.02]), np.full(3, a)
    ground = halfspace.HalfSpace(1.0, 0.0)
    (expected, _), (w, slope) = (ground.displacement(x, force, radius) for x in (together, apart))
    yield Figure("numbers not finite", float((~np.isfinite([*w, *slope.ravel()])).sum()), 0)
    bound = gap**2 + gap / 20 + 8 * EPS  # by what they do to each other, and by the third
    yield Figure("difference to one place", float(np.abs(w / expected - 1).max()), bound)
    if gap < EPS:
        yield Figure("slopes unlike", float(np.abs(slope[0] - slope[1]).max()), 0)
