"""Compare readings and predictions on the blocks statistically, and compute which deviations a check can detect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, chdtri, ndtri

from geometry.common.arrays import Floats
from probe_design.inference.linear_gaussian import LinearGaussian

SIGNIFICANCE_LEVEL = 0.01  # p-value below which a deviation is significant, and the probe fails
DETECTED_TOLERANCES = 5.0  # tolerances: a deviation that a check should detect
MIN_POWER = 0.5  # probability of its detection from which a variable counts as tested
MIN_PAIR_TOLERANCES = 2.0  # tolerances: if the smaller deviation of a pair is less, it is not unusual, and the pair is no pair
EXACT_FACTOR = 1e-6  # factor on standard deviations that makes them negligible
MIN_INFORMATION = 1e-12  # information, in units of tolerances, below which a direction is not determined
NORMAL_QUANTILES = ndtri((np.arange(100) + 0.5) / 100)  # a unit normal variable at equal steps of its probability


@dataclass(frozen=True)
class Deviation:
    """The readings and predictions on k blocks, with their errors.

    Attributes
    ----------
    logs
        ln(F_inner / F_outer) as read, shape (k,).
    drawn
        As predicted for the probe as drawn, shape (k,).
    noise
        Variances of ``logs`` by noise, shape (k,).
    gains
        Changes of ``logs`` by one standard deviation of each of g independent errors of gains and loads, shape (k, g).
    model
        Variances of ``drawn`` for the probe as drawn, shape (k,).
    calibration_bias
        G S of eq. PC.2 by variable, shape (k,) each; 0 for missing variables.
    workshop
        (J - G S) t of eq. PC.2 by variable, t its workshop tolerance, shape (k,) each.
    """

    logs: Floats
    drawn: Floats
    noise: Floats
    gains: Floats
    model: Floats
    calibration_bias: Mapping[str, Floats]
    workshop: Mapping[str, Floats] = field(default_factory=dict)

    def build_errors(self, *excluded: str) -> LinearGaussian:
        """Return the errors of ``difference``, whose covariance is C of eq. PC.1, without those variables' tolerances."""
        columns = [column for name, column in self.workshop.items() if name not in excluded]
        return LinearGaussian.from_shared_errors(np.column_stack([self.gains, *columns]), self.noise + self.model)

    @property
    def difference(self) -> Floats:
        """Readings less predictions, shape (k,)."""
        return self.logs - self.drawn

    @property
    def reading_sd(self) -> Floats:
        """Standard deviations of ``logs`` by noise and gains, shape (k,)."""
        return np.asarray(np.sqrt(self.noise + (self.gains**2).sum(axis=1)))

    @property
    def chi_square(self) -> float:
        """Chi-square for a probe within the workshop's tolerances, eq. PC.1 of ``probe_design.probe_check.check``."""
        return float(self.build_errors().compute_chi_square(self.difference))

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chdtrc(len(self.logs), self.chi_square))

    def get_bias(self, name: str) -> Floats:
        """Return G S of a variable, shape (k,), the shift of ln rho by the calibration's wrong assumption."""
        return self.calibration_bias.get(name, np.zeros(len(self.logs)))

    def shrink_errors(self, *names: str) -> Deviation:
        """Return the deviation with the errors of the named attributes (of ``noise``, ``gains``, ``model``) made negligible."""
        # noise and model are variances; of gains, standard deviations, the square is more than enough
        return replace(self, **{name: EXACT_FACTOR**2 * getattr(self, name) for name in names})

    def drop_block(self, k: int) -> Deviation:
        """Return the deviation without block k."""
        arrays = {name: np.delete(getattr(self, name), k, axis=0) for name in ("logs", "drawn", "noise", "gains", "model")}
        bias, workshop = (
            {name: np.delete(column, k) for name, column in columns.items()} for columns in (self.calibration_bias, self.workshop)
        )
        return replace(self, **arrays, calibration_bias=bias, workshop=workshop)


@dataclass(frozen=True)
class CancellingPair:
    """Two variables whose joint deviation is not detected, although that of one of them alone would be.

    Attributes
    ----------
    variables
        Their names.
    tolerances
        Their deviations in tolerances, the larger of them ``DETECTED_TOLERANCES``; with both signs reversed the same holds.
    """

    variables: tuple[str, str]
    tolerances: tuple[float, float]


def compute_power(deviation: Deviation, tolerances: Mapping[str, float]) -> float:
    """Return the probability that the check detects deviations of variables, with all others within their tolerances.

    Eq. PC.1 allows these variables their tolerances, too: along their own deviations, whose information S has the eigenvalues
    s_i, it divides squares of unit variance by 1 + s_i. What is left is a chi-square (PC.4).

    S is the information matrix of ``_compute_information``. The squares are those of normal variables, one along each eigenvector
    of S; their means are the deviations times sqrt(s_i). The rest is the sum over all other directions.

    Parameters
    ----------
    deviation
        For its covariances.
    tolerances
        Deviation of one or two variables of ``deviation.workshop``, in tolerances.
    """
    information, directions = np.linalg.eigh(_compute_information(deviation, list(tolerances)))
    is_determined = information > MIN_INFORMATION
    information = information[is_determined]  # s_i of eq. PC.4
    # along each eigenvector: the mean of the normal variable, and its noise at equal steps of probability, on a grid
    means = np.sqrt(information) * (directions.T @ np.array(list(tolerances.values())))[is_determined]
    noise = np.stack(np.meshgrid(*[NORMAL_QUANTILES] * len(means), indexing="ij"), axis=-1) if len(means) else np.zeros(0)
    limit = float(chdtri(len(deviation.logs), SIGNIFICANCE_LEVEL))  # of chi-square, above which the probe fails
    margin = limit - np.sum((means + noise) ** 2 / (1 + information), axis=-1)  # left to the other directions
    freedom = len(deviation.logs) - len(means)
    return float(np.mean(chdtrc(freedom, np.maximum(margin, 0.0)) if freedom else margin < 0))


def list_undetected(deviation: Deviation) -> tuple[str, ...]:
    """List variables: a change by ``DETECTED_TOLERANCES`` tolerances is detected with a probability below ``MIN_POWER``."""
    return tuple(name for name in _list_movable(deviation) if compute_power(deviation, {name: DETECTED_TOLERANCES}) < MIN_POWER)


def find_cancelling_pairs(deviation: Deviation) -> tuple[CancellingPair, ...]:
    """Find the pairs of variables that cancel each other's effect, the least detectable first.

    At least one variable of each pair is detected if it deviates alone.
    """
    hidden, pairs = list_undetected(deviation), []
    for pair in combinations(_list_movable(deviation), 2):
        # the joint deviation with the least information, scaled to DETECTED_TOLERANCES for the larger of both
        direction = np.linalg.eigh(_compute_information(deviation, pair))[1][:, 0]
        direction = direction * DETECTED_TOLERANCES / np.abs(direction).max()
        if set(pair) <= set(hidden) or np.abs(direction).min() < MIN_PAIR_TOLERANCES:
            continue
        visible = compute_power(deviation, dict(zip(pair, direction.tolist(), strict=True)))
        if visible < MIN_POWER:
            pairs.append((visible, CancellingPair(pair, (float(direction[0]), float(direction[1])))))
    return tuple(cancelling_pair for _, cancelling_pair in sorted(pairs, key=lambda entry: entry[0]))


def _list_movable(deviation: Deviation) -> list[str]:
    """List the variables that change any ratio."""
    return [name for name, column in deviation.workshop.items() if np.any(column != 0)]


def _compute_information(deviation: Deviation, names: Sequence[str]) -> Floats:
    """Return the information matrix S of n variables, shape (n, n): deviations x, in tolerances, have the chi-square x^T S x.

    The tolerances of these variables are not counted among the errors.
    """
    columns = np.stack([deviation.workshop[name] for name in names], axis=1)
    return deviation.build_errors(*names).compute_information(columns)
