"""Compare readings and predictions on the blocks statistically, and compute which deviations a check can detect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, chdtri, ndtri

from geometry.common.arrays import Floats

LEVEL = 0.01  # p-value below which a deviation is significant, and the probe fails
FAR = 5.0  # tolerances: a deviation that a check should detect
POWER = 0.5  # probability of its detection from which a variable counts as tested
TOLD = 2.0  # tolerances: if the smaller deviation of a pair is less, it is not unusual, and the pair is no pair
NOTHING = 1e-12  # information, in units of tolerances, below which a direction is not determined
EVENLY = ndtri((np.arange(100) + 0.5) / 100)  # a unit normal variable at equal steps of its probability


@dataclass(frozen=True)
class Deviation:
    """The readings and predictions on k blocks, with their covariances.

    Attributes:
        logs: ln(F_inner / F_outer) as read, shape (k,).
        drawn: as predicted for the probe as drawn, shape (k,).
        read: covariance of ``logs``, shape (k, k).
        model: variances of ``drawn`` for the probe as drawn, shape (k,).
        calibration_bias: G S of eq. PC.2 by variable, shape (k,) each; 0 for missing variables.
        workshop: (J - G S) t of eq. PC.2 by variable, t its workshop tolerance, shape (k,) each.
    """

    logs: Floats
    drawn: Floats
    read: Floats
    model: Floats
    calibration_bias: Mapping[str, Floats]
    workshop: Mapping[str, Floats] = field(default_factory=dict)

    def covariance(self, *without: str) -> Floats:
        """Return C of eq. PC.1 without the tolerances of the named variables, shape (k, k)."""
        columns = [column for name, column in self.workshop.items() if name not in without]
        allowed = np.array(columns).reshape(len(columns), len(self.logs))
        return np.asarray(self.read + np.diag(self.model) + allowed.T @ allowed)

    def weight(self, *without: str) -> Floats:
        """Return the inverse of ``compute_covariance``, shape (k, k)."""
        return np.asarray(np.linalg.inv(self.covariance(*without)), dtype=float)

    @property
    def chi_square(self) -> float:
        """Chi-square for a probe within the workshop's tolerances, eq. PC.1 of ``probe_design.probe_check.check``."""
        off = self.logs - self.drawn
        return float(off @ self.weight() @ off)

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chdtrc(len(self.logs), self.chi_square))

    def bias(self, name: str) -> Floats:
        """Return G S of a variable, shape (k,), the shift of ln rho by the calibration's wrong assumption."""
        return self.calibration_bias.get(name, np.zeros(len(self.logs)))

    def without(self, k: int) -> Deviation:
        """Return the deviation without block k."""

        def kept(by_name: Mapping[str, Floats]) -> dict[str, Floats]:
            return {name: np.delete(column, k) for name, column in by_name.items()}

        return Deviation(
            np.delete(self.logs, k), np.delete(self.drawn, k), np.delete(np.delete(self.read, k, 0), k, 1),
            np.delete(self.model, k), kept(self.calibration_bias), kept(self.workshop),
        )  # fmt: skip


@dataclass(frozen=True)
class CancellingPair:
    """Two variables whose joint deviation is not detected, although that of one of them alone would be.

    Attributes:
        variables: their names.
        tolerances: the deviations in tolerances, the larger one 5; the opposite signs as well.
    """

    variables: tuple[str, str]
    tolerances: tuple[float, float]


def power(deviation: Deviation, tolerances: Mapping[str, float]) -> float:
    """Return the probability that the check detects deviations of variables, with all others within their tolerances.

    Eq. PC.1 allows these variables their tolerances, too: along their own deviations, whose information S has the eigenvalues
    s_i, it divides squares of unit variance by 1 + s_i. What is left is a chi-square (PC.4).

    Args:
        deviation: for its covariances.
        tolerances: deviation of one or two variables of ``deviation.workshop``, in tolerances.
    """
    sizes, directions = np.linalg.eigh(_seen(deviation, list(tolerances)))
    told = sizes > NOTHING
    middle = np.sqrt(sizes[told]) * (directions.T @ np.array(list(tolerances.values())))[told]
    spread = np.stack(np.meshgrid(*[EVENLY] * len(middle), indexing="ij"), axis=-1) if len(middle) else np.zeros(0)
    rest = float(chdtri(len(deviation.logs), LEVEL)) - np.sum((middle + spread) ** 2 / (1 + sizes[told]), axis=-1)
    freedom = len(deviation.logs) - len(middle)
    return float(np.mean(chdtrc(freedom, np.maximum(rest, 0.0)) if freedom else rest < 0))


def unseen(deviation: Deviation) -> tuple[str, ...]:
    """List the variables of which a deviation of five tolerances is detected with a probability below 0.5."""
    return tuple(name for name in _movable(deviation) if power(deviation, {name: FAR}) < POWER)


def cancelling(deviation: Deviation) -> tuple[CancellingPair, ...]:
    """Find the pairs that hide each other, the least detectable first; at least one of each is detected alone."""
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
    """Return the information matrix of n variables in units of their tolerances, (n, n): chi-square is its quadratic form."""
    columns = np.stack([deviation.workshop[name] for name in names], axis=1)
    return np.asarray(columns.T @ deviation.weight(*names) @ columns)
