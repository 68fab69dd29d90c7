"""Random EEPA contacts and load paths, and a compiled law to put them through."""

from itertools import pairwise

import numpy as np
from law_paths import Paths
from law_twins import EEPA
from setups import GLASS

import taichi_dem as dem

N, TURNS, PER_TURN = 1000, 8, 9
KINDS = {  # d_ex, c_ex, options
    "linear": (1.0, 1.0, {}),
    "Hertzian": (1.5, 1.5, {}),
    "Hertzian, linear pull": (1.5, 1.0, {}),
    "constant dashpot": (1.5, 3.0, {"damping": "constant"}),
    "any exponents": (1.3, 0.7, {}),
    "no pull at all": (1.5, 1.0, {"limit_force": True}),
}


def log_uniform(rng, low, high, n=N):
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def random_contacts(rng, n, c, options, count=N):
    """Contacts of every size, hardness and stickiness: 3/2 pi gamma a from far below the limit on
    F_min to far above; a third elastic, a third without adhesion, a third on walls."""
    some = {"n": count}
    radius_i = log_uniform(rng, 1e-8, 10, **some)
    radius_j = np.where(
        rng.random(count) < 1 / 3, np.inf, radius_i * log_uniform(rng, 0.05, 20, **some)
    )
    depth = radius_i * np.minimum(1, radius_j / radius_i) * log_uniform(rng, 1e-6, 0.05, **some)
    ratio = np.where(rng.random(count) < 1 / 3, 1.0, log_uniform(rng, 1.01, 1e3, **some))
    sticks = (rng.random(count) < 2 / 3) * (not options.get("limit_force", False))
    one = EEPA(
        modulus=log_uniform(rng, 1e3, 1e12, **some),
        restitution=rng.uniform(0.01, 1, count),
        stiffness_ratio=ratio,
        surface_energy=np.zeros(count),
        pull_off=np.zeros(count),
        radius_i=radius_i,
        radius_j=radius_j,
        mass=1e4 * radius_i**3,
        overlap_exponent=n,
        adhesion_exponent=c,
        **options,
    )
    force = one.first * depth**n
    energy = sticks * force * log_uniform(rng, 1e-3, 1e2, **some) / one.chord(depth)
    pull_off = -1.0 * sticks * (rng.random(count) < 0.5) * force * rng.random(count)
    return one._replace(surface_energy=energy, pull_off=pull_off), depth


def bench_of(contacts):
    """The kernel for the exponents and options of ``contacts``, filled with their numbers."""
    options = {name: getattr(contacts, name) for name in dem.EEPA.options}
    law = dem.EEPA(0.5, 2.0, **options)
    return fill(Paths(law, len(contacts.modulus)), contacts)


def fill(bench, contacts):
    linear = contacts.overlap_exponent == 1
    laws = [
        dem.EEPA(e, 2.0, **{n: getattr(contacts, n) for n in dem.EEPA.options})
        for e in contacts.restitution
    ]
    bench.fill(
        modulus=contacts.modulus * (2 if linear else 4 / 3),
        stiffness_ratio=contacts.stiffness_ratio,
        damping=[law.coefficients(GLASS, GLASS)["damping"] for law in laws],
        surface_energy=contacts.surface_energy,
        pull_off=contacts.pull_off,
    )
    return bench


def run(bench, contacts, overlaps, velocities=0.0):
    reach = np.where(np.isinf(contacts.radius_j), 0, 1 / (contacts.radius_i + contacts.radius_j))
    return bench.run(overlaps, contacts.radius, velocities, contacts.mass, reach)


def random_paths(rng, depth, per_turn=PER_TURN, turns=TURNS):
    """Overlaps that wander between random turning points, also apart, over many scales."""
    ends = rng.uniform(-0.2, 1, (turns, len(depth))) * 10.0 ** -rng.choice(
        [0, 0, 0, 1, 2], (turns, len(depth))
    )
    ends = np.vstack([np.full(len(depth), -0.01), ends, np.full(len(depth), -0.01)]) * depth
    share = np.linspace(0, 1, per_turn, endpoint=False)[:, None]
    parts = [low + (high - low) * share for low, high in pairwise(ends)]
    return np.vstack([*parts, ends[-1:]])


def plastic_of(contacts, depth):
    """d_p,max after a load to ``depth``."""
    return (1 - 1 / contacts.stiffness_ratio) ** (1 / contacts.overlap_exponent) * depth


def cycles(contacts, depth, steps, low=None, high=None):
    """Load to ``depth``, unload to ``low``, reload to ``high``, and pull off; (4 steps + 1, n).

    Turning points apart from ``depth`` are drawn at random; overlaps lie closer near them.
    """
    rng = np.random.default_rng(9)
    low = rng.uniform(0.02, 0.95, len(depth)) if low is None else low
    high = np.maximum(low, rng.uniform(0, 1.3, len(depth))) if high is None else high
    zero, one = np.zeros(len(depth)), np.ones(len(depth))
    ends = np.stack([1e-12 * one, one, low, high, zero]) * depth
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(steps) / steps)[:, None]
    parts = [start + (end - start) * share for start, end in pairwise(ends)]
    return np.vstack([*parts, ends[-1:]])


def work_of(force, overlaps):
    """Cumulative work put in, by the trapezoidal rule."""
    return np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(overlaps, axis=0), axis=0)
