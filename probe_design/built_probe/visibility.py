"""What a check can see: which variables, off by many tolerances, it would find, and which pairs of them cancel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from geometry.common.arrays import Floats
from probe_design.built_probe.deviation import LEVEL, Deviation

FAR = 5.0  # tolerances by which a variable that should be found is off
POWER = 0.5  # probability with which it then is
TOLD = 1.0  # tolerances below which the smaller of a pair is no part of it


@dataclass(frozen=True)
class CancellingPair:
    """Two variables that may be off together without being seen, though either alone would be.

    Attributes:
        variables: their names.
        tolerances: by how many each is off, the larger one ``FAR``; of the other sign also.
    """

    variables: tuple[str, str]
    tolerances: tuple[float, float]


def unseen(deviation: Deviation) -> tuple[str, ...]:
    """Return the variables with a tolerance that may be off by ``FAR`` of it and are found less often than ``POWER``."""
    least = _least(len(deviation.logs))
    return tuple(name for name in _movable(deviation) if FAR**2 * _seen(deviation, [name])[0, 0] < least)


def cancelling(deviation: Deviation) -> tuple[CancellingPair, ...]:
    """Return the pairs of seen variables that cancel, the least visible first."""
    least, hidden = _least(len(deviation.logs)), unseen(deviation)
    found = []
    for pair in combinations([name for name in _movable(deviation) if name not in hidden], 2):
        sizes, directions = np.linalg.eigh(_seen(deviation, pair))
        way = directions[:, 0] * FAR / np.abs(directions[:, 0]).max()
        visible = float(sizes[0] * (way @ way))
        if visible < least and np.abs(way).min() >= TOLD:
            found.append((visible, CancellingPair(pair, (float(way[0]), float(way[1])))))
    return tuple(one for _, one in sorted(found, key=lambda entry: entry[0]))


def _movable(deviation: Deviation) -> list[str]:
    return [name for name, column in deviation.workshop.items() if np.any(column != 0)]


def _seen(deviation: Deviation, names: Sequence[str]) -> Floats:
    """Information on variables in units of their tolerances, (n, n): their deviations' chi-square is its quadratic form."""
    columns = np.stack([deviation.workshop[name] for name in names], axis=1)
    return np.asarray(columns.T @ deviation.weight(*names) @ columns)


def _least(blocks: int) -> float:
    """The noncentral chi-square that is found with ``POWER``."""
    found = chi2.isf(LEVEL, blocks)
    return float(brentq(lambda size: ncx2.sf(found, blocks, size) - POWER, 1e-6, 10 * found))
