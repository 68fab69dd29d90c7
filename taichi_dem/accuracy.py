"""How far one run is from another, by what users publish.

Two runs of a chaotic scene part whatever their accuracy. Up to where a perturbation has grown by
``GROWTH`` they are compared place by place and force by force; beyond, only means over an ensemble
of perturbed runs say something, and they carry their uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from taichi_dem.record import Record
from taichi_dem.spheres import Spheres

PERTURBATION = 1e-7  # of a sphere's radius, of the starts of an ensemble
GROWTH = 100.0  # of a perturbation, up to which trajectories are comparable
FEWEST = 4  # samples that a comparison in time needs
LATE = 0.25  # the last part of a run, over which statistics are taken

TINY = np.finfo(float).tiny


def perturbed(spheres: Spheres, member: int) -> np.ndarray | None:
    """Where the spheres of the ``member``-th run of an ensemble start, (n, 3) m; None for member 0,
    which starts as the scene says."""
    if member == 0:
        return None
    away = np.random.default_rng(member).normal(size=spheres.position.shape)
    return spheres.position + PERTURBATION * spheres.radius[:, None] * away


def comparable(first: Record, second: Record) -> int:
    """The last sample at which two runs from nearly the same start are within ``GROWTH`` times
    their first distance."""
    apart = np.sqrt(np.square(first.position - second.position).sum(axis=(1, 2)))
    grown = ~(apart <= GROWTH * apart[0])
    return int(np.argmax(grown)) - 1 if grown.any() else first.samples


def errors(run: Record, reference: Record, last: int) -> dict[str, float]:
    """Relative errors of ``run`` up to sample ``last``, by name.

    trajectory: rms distance of the spheres over their rms displacement; contact force: rms of the
    differences over the rms force, a contact that one of the two lacks counting in full; energy
    drift: largest error of the balance over the energy turned over; depression (of the whole run
    only) and force on walls: rms difference over rms value. What is nowhere different from zero in
    the reference is left out.
    """
    whole = last == reference.samples
    run, reference = run.until(last), reference.until(last)
    moved = reference.position - reference.position[0]
    forces = _matched_forces(run, reference)
    found = {
        "trajectory": _share(run.position - reference.position, moved),
        "contact force": _share(forces[0] - forces[1], forces[1]),
        "energy drift": _drift(run, reference),
        "force on walls": _share(run.push - reference.push, reference.push),
    }
    if whole:
        found["depression"] = _share(run.depression - reference.depression, reference.depression)
    return {name: value for name, value in found.items() if value is not None}


def drift_between(run: Record, other: Record, last: int) -> float:
    """The largest difference between the balances of two runs up to sample ``last``, over the
    energy that the second has turned over."""
    run, other = run.until(last), other.until(last)
    return float(np.abs(run.balance - other.balance).max() / other.turnover.max())


def statistics(run: Record) -> dict[str, float]:
    """Numbers that stay meaningful when trajectories have parted: means over all spheres, and over
    the last part of the run."""
    late = run.contact[:, 0] >= (1 - LATE) * run.samples
    count = 1 + run.samples - int(np.ceil((1 - LATE) * run.samples))
    around = run.position[-1] - run.position[-1].mean(axis=0)
    found = {
        "radius of gyration": float(np.sqrt(np.square(around).sum(axis=1).mean())),
        "contact force": float(np.linalg.norm(run.force[late], axis=1).sum()) / count,
        "energy turned over": float(run.turnover[-1]),
        "force on walls": float(np.sqrt(np.square(run.push).sum(axis=(1, 2)).mean())),
    }
    if len(run.depression):
        found["depression"] = float(run.depression.mean())
    return {name: value for name, value in found.items() if abs(value) > TINY}


def ensemble_errors(
    runs: Sequence[Record], references: Sequence[Record]
) -> dict[str, tuple[float, float]]:
    """Relative error of the means of :func:`statistics` over an ensemble, and the standard
    uncertainty of that error, by name: the standard error, times how far the ensembles are
    :func:`apart`."""
    means = [[statistics(run) for run in ensemble] for ensemble in (runs, references)]
    found, more = {}, apart(runs, references)
    for name in means[1][0]:
        here, there = (np.array([each.get(name, 0.0) for each in part]) for part in means)
        scale = abs(there.mean())
        if scale > TINY:
            spread = more * np.sqrt(_square_of_mean(here) + _square_of_mean(there))
            found[name] = (abs(here.mean() - there.mean()) / scale, float(spread / scale))
    return found


def apart(runs: Sequence[Record], references: Sequence[Record]) -> float:
    """How much farther apart the mean places in two ensembles are, late in their runs, than the
    scatter within them explains; at least 1.

    Runs whose starts differ by ``PERTURBATION`` part later than runs of different steps do. Until
    then their scatter says nothing of how far chaos takes the latter apart.
    """
    first = int(np.ceil((1 - LATE) * references[0].samples))
    here, there = (np.array([run.position[first:] for run in part]) for part in (runs, references))
    scatter = sum(_square_of_mean(part) for part in (here, there))
    between = float(np.square(here.mean(axis=0) - there.mean(axis=0)).sum())
    return max(1.0, float(np.sqrt(between / scatter))) if scatter > TINY else 1.0


def worst(found: Mapping[str, float]) -> float:
    """The largest of all errors; infinite where there is none or one is not a number."""
    values = np.array(list(found.values()))
    return float(values.max()) if len(values) and np.isfinite(values).all() else float("inf")


def worst_mean(found: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    """The largest of :func:`ensemble_errors`, and its uncertainty; infinite where there is none or
    one is not a number."""
    if not found or not np.isfinite(list(found.values())).all():
        return float("inf"), 0.0
    return max(found.values())


def _share(difference: np.ndarray, value: np.ndarray) -> float | None:
    scale = float(np.linalg.norm(value))
    return float(np.linalg.norm(difference)) / scale if scale > TINY else None


def _drift(run: Record, reference: Record) -> float | None:
    scale = float(reference.turnover.max())
    if not np.isfinite(run.balance).all() or scale <= TINY:
        return None
    return float(np.abs(run.balance).max()) / scale


def _matched_forces(run: Record, reference: Record) -> tuple[np.ndarray, np.ndarray]:
    """Forces of the contacts that either run has, (c, 3) each, zero where one has none."""
    both = np.concatenate([run.contact, reference.contact])
    each, place = np.unique(both, axis=0, return_inverse=True)
    place = place.reshape(-1)
    here, there = np.zeros((2, len(each), 3))
    here[place[: len(run.contact)]] = run.force
    there[place[len(run.contact) :]] = reference.force
    return here, there


def _square_of_mean(values: np.ndarray) -> float:
    """The squared standard uncertainty of the mean over the first axis, summed over all others."""
    return float(values.var(axis=0, ddof=1).sum()) / len(values) if len(values) > 1 else 0.0
