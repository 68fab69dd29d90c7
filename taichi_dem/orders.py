"""The order of convergence of an error, fitted to what was measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ORDERS = np.linspace(0.25, 5.0, 476)
STRAY = 0.4  # rms, of the logarithm of an error
NOISE = 1e-11  # relative errors below it are those of rounding


def fit(
    steps: Sequence[float], errors: Sequence[float], reference: float = 0.0
) -> tuple[float, float] | None:
    """Order p and constant C of errors C (h^p - h_ref^p) at steps h, in the least squares of the
    logarithms: a reference that is itself computed with step ``reference`` hides part of the error.

    None where fewer than two errors are finite and above rounding, where the first or the last of
    ``ORDERS`` fits best, and where errors stray farther than ``STRAY`` from what fits best: such
    errors do not go with the step.
    """
    h, e = np.asarray(steps, dtype=float), np.asarray(errors, dtype=float)
    usable = np.isfinite(e) & (e > NOISE) & (h > reference)
    if usable.sum() < 2:
        return None
    h, e = h[usable], e[usable]
    shapes = h[:, None] ** ORDERS - (reference**ORDERS if reference > 0 else 0.0)
    away = np.log(e)[:, None] - np.log(shapes)
    spread = away.var(axis=0)
    best = int(np.argmin(spread))
    if best in (0, len(ORDERS) - 1) or spread[best] > STRAY**2:
        return None
    return float(ORDERS[best]), float(np.exp(away[:, best].mean()))
