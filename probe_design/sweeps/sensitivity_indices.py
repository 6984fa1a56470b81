"""How much of an output's variance each variable of a sweep explains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from probe_design.sweeps.results import extra

BINS = 10
SEED = 1  # of the bootstrap


def main_effect(values: Sequence[object], y: Floats) -> float | None:
    """Return the variance of the means of ``y`` over one variable as a share of its variance, from 0 to 1.

    For a sample, means are over bins of equally many designs, so that noise of about bins / designs is added; for a grid over
    its values. Cut at one design a bin, where every variable would seem to explain everything: then None.

    Args:
        values: of the variable, one for each design.
        y: the output, shape (designs,), not all the same.
    """
    levels, bins = np.unique(np.array(values), return_inverse=True)
    if len(levels) > 2 * BINS:
        bins = np.empty(len(y), dtype=int)
        bins[np.argsort(np.array(values), kind="stable")] = np.arange(len(y)) * BINS // len(y)
    counts = np.bincount(bins)
    if np.mean(counts) < 2:
        return None
    means = np.bincount(bins, weights=y - np.mean(y)) / counts
    return float(np.sum(counts * means**2) / np.sum((y - np.mean(y)) ** 2))


def sobol_indices(y: Floats, d: int) -> list[tuple[float, float, float, float]]:
    """Return for each variable its first-order index, its 95 % half-width, its total index, its half-width.

    Args:
        y: the output of all designs of a Saltelli sample, in its order, shape (n (d + 2),).
        d: how many variables.

    Raises:
        MissingLibrary: SALib is not installed.

    Source: Saltelli et al., Computer Physics Communications 181 (2010) 259-270, table 2, eqs. (b) and (f), as in SALib.
    """
    problem = {"num_vars": d, "names": [str(one) for one in range(d)], "bounds": [[0.0, 1.0]] * d}
    indices = extra("SALib.analyze.sobol").analyze(problem, y, calc_second_order=False, conf_level=0.95, seed=SEED)
    columns = (map(float, indices[name]) for name in ("S1", "S1_conf", "ST", "ST_conf"))
    return list(zip(*columns, strict=True))
