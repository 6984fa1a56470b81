"""What was read and predicted of the blocks, how far apart these may be, and which deviations a check can see at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.special import ndtri
from scipy.stats import chi2

from geometry.common.arrays import Floats

LEVEL = 0.01  # p-value below which a deviation is one, and the probe fails
FAR = 5.0  # tolerances by which a variable that should be found is off
POWER = 0.5  # probability with which it then is
TOLD = 2.0  # tolerances below which the smaller of a pair is nothing unusual, and no part of it
NOTHING = 1e-12  # information, in units of tolerances, below which a direction is not told
EVENLY = ndtri((np.arange(100) + 0.5) / 100)  # a unit normal variable at equal steps of its probability


@dataclass(frozen=True)
class Deviation:
    """What was read and what was predicted of k blocks.

    Attributes:
        logs: ln(F_inner / F_outer) as read, shape (k,).
        drawn: as predicted for the probe as drawn, shape (k,).
        read: covariance of ``logs``, shape (k, k).
        model: variances of ``drawn`` for the probe as drawn, shape (k,).
        calibration_bias: G S of eq. PC.2 by variable, shape (k,) each; 0 where one is missing.
        workshop: (J - G S) t of eq. PC.2 by variable, t what the workshop's tolerance allows it, shape (k,) each.
    """

    logs: Floats
    drawn: Floats
    read: Floats
    model: Floats
    calibration_bias: Mapping[str, Floats]
    workshop: Mapping[str, Floats] = field(default_factory=dict)

    def covariance(self, *without: str) -> Floats:
        """Return C of a probe within the workshop's tolerances, those of the named variables left out, shape (k, k)."""
        columns = [column for name, column in self.workshop.items() if name not in without]
        allowed = np.array(columns).reshape(len(columns), len(self.logs))
        return np.asarray(self.read + np.diag(self.model) + allowed.T @ allowed)

    def weight(self, *without: str) -> Floats:
        """Return the inverse of ``covariance``, shape (k, k)."""
        return np.asarray(np.linalg.inv(self.covariance(*without)), dtype=float)

    @property
    def chi_square(self) -> float:
        """Of a probe within the workshop's tolerances, eq. PC.1 of ``probe_design.probe_check.check``."""
        off = self.logs - self.drawn
        return float(off @ self.weight() @ off)

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chi2.sf(self.chi_square, len(self.logs)))

    def bias(self, name: str) -> Floats:
        """G S of a variable, shape (k,)."""
        return self.calibration_bias.get(name, np.zeros(len(self.logs)))

    def without(self, k: int) -> Deviation:
        """Return it without block k."""

        def kept(by_name: Mapping[str, Floats]) -> dict[str, Floats]:
            return {name: np.delete(column, k) for name, column in by_name.items()}

        return Deviation(
            np.delete(self.logs, k), np.delete(self.drawn, k), np.delete(np.delete(self.read, k, 0), k, 1),
            np.delete(self.model, k), kept(self.calibration_bias), kept(self.workshop),
        )  # fmt: skip


@dataclass(frozen=True)
class CancellingPair:
    """Two variables that may be off together without being seen, though one of them alone would be, or either.

    Attributes:
        variables: their names.
        tolerances: by how many each is off, the larger one ``FAR``; of the other sign also.
    """

    variables: tuple[str, str]
    tolerances: tuple[float, float]


def power(deviation: Deviation, tolerances: Mapping[str, float]) -> float:
    """Return how likely the check is to find variables that are off, all others within their tolerances.

    Eq. PC.1 allows these variables their tolerances, too: along their own deviations, whose information S has the eigenvalues
    s_i, it divides squares of unit variance by 1 + s_i. What is left is a chi-square (PC.4).

    Args:
        deviation: for its covariances.
        tolerances: by how many each variable is off, of one or two of ``deviation.workshop``.
    """
    sizes, directions = np.linalg.eigh(_seen(deviation, list(tolerances)))
    told = sizes > NOTHING
    middle = np.sqrt(sizes[told]) * (directions.T @ np.array(list(tolerances.values())))[told]
    spread = np.stack(np.meshgrid(*[EVENLY] * len(middle), indexing="ij"), axis=-1) if len(middle) else np.zeros(0)
    rest = float(chi2.isf(LEVEL, len(deviation.logs))) - np.sum((middle + spread) ** 2 / (1 + sizes[told]), axis=-1)
    freedom = len(deviation.logs) - len(middle)
    return float(np.mean(chi2.sf(rest, freedom) if freedom else rest < 0))


def unseen(deviation: Deviation) -> tuple[str, ...]:
    """Return the variables with a tolerance that may be off by ``FAR`` of it and are found less often than ``POWER``."""
    return tuple(name for name in _movable(deviation) if power(deviation, {name: FAR}) < POWER)


def cancelling(deviation: Deviation) -> tuple[CancellingPair, ...]:
    """Return the pairs that hide each other, the least visible first, of variables of which one at least is seen alone."""
    hidden, found = unseen(deviation), []
    for pair in combinations(_movable(deviation), 2):
        way = np.linalg.eigh(_seen(deviation, pair))[1][:, 0]
        way = way * FAR / np.abs(way).max()
        if set(pair) <= set(hidden) or np.abs(way).min() < TOLD:
            continue
        visible = power(deviation, dict(zip(pair, way.tolist(), strict=True)))
        if visible < POWER:
            found.append((visible, CancellingPair(pair, (float(way[0]), float(way[1])))))
    return tuple(one for _, one in sorted(found, key=lambda entry: entry[0]))


def _movable(deviation: Deviation) -> list[str]:
    return [name for name, column in deviation.workshop.items() if np.any(column != 0)]


def _seen(deviation: Deviation, names: Sequence[str]) -> Floats:
    """Information on variables in units of their tolerances, (n, n): their deviations' chi-square is its quadratic form."""
    columns = np.stack([deviation.workshop[name] for name in names], axis=1)
    return np.asarray(columns.T @ deviation.weight(*names) @ columns)
