"""Weights of sums of features that are never below some values: an envelope, as low as linear programming makes it."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from geometry.common.arrays import Floats

DESCENT_ROUNDS = 10
RANDOM_STARTS = 6
MAX_WEIGHT = 1e3  # weight


def compute_weights(table: Floats, lower_bound: Floats, floor: float) -> Floats:
    """Return weights w >= 0 with table w >= lower_bound and the mean of ln(table w + floor) small, three digits, rounded up.

    Args:
        table: values of features (columns) of scenes (rows).
        lower_bound: the error that each scene must be stated at least.
        floor: told errors below are all as good.
    """
    likely = np.median(lower_bound) / (np.quantile(table, 0.9, axis=0) + 1e-6)
    starts = likely * np.exp(
        np.random.default_rng(0).normal(0, 2, (RANDOM_STARTS, table.shape[1]))
    )  # what is descended to is local
    w = min(
        (_descend(table, lower_bound, floor, start) for start in starts), key=lambda w: float(np.log(table @ w + floor).mean())
    )
    digits = 10.0 ** (np.floor(np.log10(np.maximum(w, 1e-30))) - 2)
    rounded: Floats = np.where(w > 1e-6, np.ceil(w / digits) * digits, 0.0)
    return rounded


def _descend(table: Floats, lower_bound: Floats, floor: float, start: Floats) -> Floats:
    """Each round weighs a scene by what it was told before: the logarithm's slope, which lies above it."""
    w = start
    for _ in range(DESCENT_ROUNDS):
        price = table.T @ (1 / (table @ w + floor))
        solution = linprog(price, A_ub=-table, b_ub=-lower_bound, bounds=(0, MAX_WEIGHT)).x
        assert solution is not None
        w = solution
    return w
