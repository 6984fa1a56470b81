"""Distribute nodes of a fixed number of cells as smooth functions of the sizes to which the cells are graded.

All functions take and return floats or complex numbers (for derivatives by complex steps), shape
(...,), one entry per design.
"""

from __future__ import annotations

from math import log1p

import numpy as np

from geometry.common.arrays import Numeric


def smooth_min(*lengths: Numeric) -> Numeric:
    """Return a smooth lower bound of the smallest of ``lengths`` s_i, all positive.

    (sum_i s_i^-2)^(-1/2) (ME.1). For n lengths it is at least the smallest over the root of n; unlike the minimum it has no kink.
    """
    return sum(length**-2 for length in lengths) ** -0.5


def smooth_max(a: Numeric, b: Numeric, blur: Numeric) -> Numeric:
    """Return a smooth upper bound of the larger of two lengths, by at most ``blur / 2`` larger.

    Unlike the maximum it has no kink.
    """
    return (a + b + ((a - b) ** 2 + blur**2) ** 0.5) / 2


def count_folds(low: float, high: float, low_size: float | None = None, high_size: float | None = None) -> float:
    """Return how many times cells grow e-fold from both ends ``low`` and ``high`` on: the integral that ``grade_nodes`` divides.

    ``low_size`` and ``high_size`` are the sizes of cells at the ends, None where an end attracts no cells.
    """
    return float(sum(log1p((high - low) / size) for size in (low_size, high_size) if size is not None))


def grade_nodes(
    low: Numeric, high: Numeric, cells: int, low_size: Numeric | None = None, high_size: Numeric | None = None
) -> Numeric:
    """Return the ``cells + 1`` nodes on ``low .. high``, shape (..., cells + 1), whose cells grow away from the ends.

    Each cell has the same part of the integral of 1 / (x - low + low_size) + 1 / (high - x + high_size) (ME.2); an end without a
    size attracts no cells. With a = low_size, b = high_size, t = x - low and L = high - low, the integral up to t is ln[(t + a)
    (L + b) / (a (L - t + b))], which is solved for t.
    """
    t = np.arange(cells + 1) / cells  # fraction of the integral, not the t of the docstring: that is share * length below
    low, length = np.asarray(low)[..., None], np.asarray(high - low)[..., None]
    a, b = (None if size is None else np.asarray(size)[..., None] for size in (low_size, high_size))
    if a is None and b is None:
        share = t + 0 * length
    elif b is None:
        share = np.expm1(t * np.log1p(length / a)) * a / length
    elif a is None:
        share = 1 - np.expm1((1 - t) * np.log1p(length / b)) * b / length
    else:
        total = np.log1p(length / a) + np.log1p(length / b)
        c = a / (length + b) * np.exp(t * total)
        share = (c * (length + b) - a) / (1 + c) / length
    nodes = low + share * length
    nodes[..., 0], nodes[..., -1] = low[..., 0], high
    return nodes
