"""Random packings of spheres."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_dem.overlaps import overlapping
from taichi_dem.periodic import Period, narrow_problem, nearest_image, wrapped
from taichi_dem.validation import InputError, Problem, Range, as_numbers, number_problem, unknown

DENSEST = 0.58  # volume fraction; random packings jam at 0.64, and take ever longer before
CLEARANCE = 1e-3  # of a radius: how far spheres that push each other apart aim beyond touching
REDRAWS = 10  # rounds in which overlapping spheres are placed anew
PUSHES = 500  # rounds in which they push each other apart
MOMENTUM = 0.8  # share of the last push that is made again: seven times fewer rounds when dense
SKIN = 0.1  # of a radius: how far a sphere may move before neighbours are looked up again

DISTRIBUTIONS = {
    "uniform": ("low", "high"),
    "normal": ("mean", "sigma", "low", "high"),
    "lognormal": ("median", "sigma", "low", "high"),
}


def generate(
    radius: float | tuple[Any, ...],
    region: tuple[ArrayLike, ArrayLike],
    count: int | None = None,
    volume_fraction: float | None = None,
    seed: int = 0,
    periodic: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 3) and radii (n,), m, of spheres at random inside a box, none overlapping.

    ``radius`` is a number or a distribution by number, cut off at its ends: ``("uniform", low,
    high)``, ``("normal", mean, sigma, low, high)`` or ``("lognormal", median, sigma, low, high)``,
    sigma being the standard deviation, in m, or that of the logarithm. ``region`` is the box, (low,
    high) in m. There are ``count`` spheres, or as many as come nearest to ``volume_fraction`` of
    the region. With ``periodic`` the region repeats itself along x and y: centres are everywhere
    in it, and none overlaps an image of another. Equal arguments give equal packings. Raises
    ``InputError`` for what is out of range or does not fit.
    """
    problems = [
        _region_problem(region),
        *_radius_problems(radius),
        *_amount_problems(count, volume_fraction),
        None if _is_count(seed, 0) else Problem("seed", seed, "must be a whole number >= 0"),
        None
        if isinstance(periodic, bool)
        else Problem("periodic", periodic, "must be true or false"),
    ]
    if found := [problem for problem in problems if problem]:
        raise _refused(*found)
    low, high = np.array(region, dtype=float)
    volume = float(np.prod(high - low))
    rng = np.random.default_rng(seed)
    if volume_fraction is not None:
        amount = Problem("volume_fraction", volume_fraction, "")
        radii = _fill(radius, rng, volume_fraction * volume)
    elif count is not None:
        amount, radii = Problem("count", count, ""), _draw(radius, rng, count)
    fraction = _volume(radii).sum() / volume
    largest = 2 * (1 + CLEARANCE) * radii.max(initial=0)
    if not len(radii):
        raise _refused(amount._replace(rule="is less than one sphere in this region"))
    if (largest > high - low).any():
        rule = f"must be wider than the largest sphere, {largest:.4g} m with clearance"
        raise _refused(Problem("region", region, rule))
    period = tuple((high - low)[:2].tolist()) if periodic else None
    if problem := narrow_problem(period, radii.max()):
        raise _refused(Problem("region", region, f"its sides x and y {problem.rule}"))
    if fraction > DENSEST:
        most = (
            f"at most {DENSEST} is reachable, about {int(len(radii) * DENSEST / fraction)} spheres"
        )
        raise _refused(amount._replace(rule=f"fills {fraction:.4g} of the region; {most}"))
    position, factor = place(radii, low, high, rng, periodic)
    if factor < 1:
        rule = (
            f"fills {fraction:.4g} of the region, which was not reached; with radii {factor:.4g} "
            f"times as large, {fraction * factor**3:.4g} of it, the spheres fit"
        )
        raise _refused(amount._replace(rule=rule))
    return position, radii


def _refused(*problems: Problem) -> InputError:
    return InputError([problem.under("generate") for problem in problems], "spheres")


def _is_count(value: Any, least: int) -> bool:
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and bool(value >= least)


def _region_problem(region: Any) -> Problem | None:
    corners = as_numbers(region)
    if corners is None or corners.shape != (2, 3) or not np.isfinite(corners).all():
        return Problem("region", region, "must be two corners of three finite numbers, in m")
    if (corners[0] >= corners[1]).any():
        return Problem("region", region, "the first corner must be below the second on each axis")
    return None


def _amount_problems(count: Any, volume_fraction: Any) -> list[Problem]:
    if (count is None) == (volume_fraction is None):
        return [Problem("count", count, "exactly one of count and volume_fraction must be given")]
    if count is not None:
        good, problem = _is_count(count, 1), Problem("count", count, "must be a whole number >= 1")
        return [] if good else [problem]
    allowed = Range("-", "share of the region", above=0.0, at_most=DENSEST)
    return [p for p in [number_problem("volume_fraction", volume_fraction, allowed)] if p]


def _radius_problems(radius: Any) -> list[Problem]:
    allowed = Range("m", "radius", above=0.0)
    if not isinstance(radius, (list, tuple)):
        return [p for p in [number_problem("radius", radius, allowed)] if p]
    kind, *numbers = radius or [None]
    if kind not in DISTRIBUTIONS:
        return [unknown("radius[0]", kind, kind, DISTRIBUTIONS, "distribution")]
    names = DISTRIBUTIONS[kind]
    if len(numbers) != len(names):
        return [Problem("radius", radius, f"must be ('{kind}', {', '.join(names)})")]
    found = [
        number_problem(f"radius[{k}]", numbers[k - 1], dataclasses.replace(allowed, meaning=name))
        for k, name in enumerate(names, start=1)
    ]
    low, high = numbers[-2:]
    if not any(found) and not low <= (low if kind == "uniform" else numbers[0]) <= high:
        found.append(Problem("radius", radius, f"must have {names[0]} from low to high"))
    return [problem for problem in found if problem]


def _draw(radius: Any, rng: np.random.Generator, n: int) -> np.ndarray:
    """n radii; the cut-off distributions by the inverse of their cumulative one."""
    kind, *numbers = radius if isinstance(radius, (list, tuple)) else ("uniform", radius, radius)
    low, high = numbers[-2:]
    if kind == "uniform" or low == high:
        return rng.uniform(low, high, n)
    from scipy.special import ndtr, ndtri  # slow to import, and seldom needed

    middle, deviation = numbers[:2]
    scale = np.log if kind == "lognormal" else np.asarray
    first, last = ndtr((scale([low, high]) - scale(middle)) / deviation)
    drawn = scale(middle) + deviation * ndtri(rng.uniform(first, last, n))
    return np.clip(np.exp(drawn) if kind == "lognormal" else drawn, low, high)


def _fill(radius: Any, rng: np.random.Generator, volume: float) -> np.ndarray:
    """As many radii as come nearest to a total volume."""
    radii = _draw(radius, rng, 64)
    while _volume(radii).sum() < 2 * volume:
        radii = np.concatenate([radii, _draw(radius, rng, len(radii))])
    total = np.concatenate([[0.0], np.cumsum(_volume(radii))])
    return radii[: np.argmin(np.abs(total - volume))]


def _volume(radius: np.ndarray) -> np.ndarray:
    return 4 / 3 * math.pi * radius**3


def place(
    radius: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    rng: np.random.Generator,
    periodic: bool = False,
) -> tuple[np.ndarray, float]:
    """Centres of spheres inside a box, whose sides x and y may repeat themselves, and the factor on
    their radii with which none overlap: 1 if they were placed.

    Overlapping spheres are drawn anew, of two the smaller (random sequential addition, all at
    once); when this no longer pays, those that are left push each other apart.
    """
    order = np.argsort(-radius, kind="stable")
    radius = radius[order]
    margin = np.repeat(radius[:, None] * (1 + CLEARANCE), 3, axis=1)
    corner, period = low, None
    if periodic:
        margin[:, :2], period = 0.0, tuple((high - low)[:2])
    low, high = low + margin, high - margin
    x = rng.uniform(low, high)
    for _ in range(REDRAWS):
        again = np.unique(np.maximum(*overlapping(x, radius, period)))
        x[again] = rng.uniform(low[again], high[again])
        if not len(again):
            break
    if periodic:
        low[:, :2], high[:, :2] = -np.inf, np.inf
    x, factor = _push_apart(x, radius, low, high, period)
    if periodic:
        x = corner + wrapped(x - corner, period)
    return x[np.argsort(order)], factor


def _push_apart(
    x: np.ndarray,
    radius: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    period: Period | None,
) -> tuple[np.ndarray, float]:
    """Centres between low and high, moved by pairs until none overlap, the larger one less."""
    n, volume = len(radius), radius**3
    listed = np.full_like(x, np.inf)
    step = np.zeros_like(x)
    for _ in range(PUSHES):
        if (np.square(x - listed).sum(axis=1) > (SKIN * radius) ** 2).any():
            i, j = overlapping(x, radius * (1 + CLEARANCE + SKIN), period)
            touching = radius[i] + radius[j]
            share = (volume[j] / (volume[i] + volume[j]))[:, None]
            listed = x
        between = nearest_image(x[i] - x[j], period)
        distance = np.sqrt(np.einsum("ij,ij->i", between, between))
        together = distance == 0  # two that were pushed into one corner
        between[together, 0] = distance[together] = CLEARANCE * radius.min()
        if (distance >= touching).all():
            return x, 1.0
        wanted = np.maximum(touching * (1 + CLEARANCE) / distance - 1, 0)
        on_i = between * wanted[:, None] * share
        on_j = between * wanted[:, None] - on_i
        push = [np.bincount(i, on_i[:, k], n) - np.bincount(j, on_j[:, k], n) for k in range(3)]
        moved = np.clip(x + MOMENTUM * step + np.stack(push, axis=1), low, high)
        x, step = moved, moved - x
    return x, float((distance / touching).min())
