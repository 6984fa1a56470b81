"""Compute the likelihood of tumours given the readings of a scan.

With r_k the residual of reading k after subtracting the signal that the tumours cause, in each channel

    r_k = b + a s_k + w_k,   b ~ N(0, g^2),   a ~ N(0, f^2),   w_k ~ N(0, v_k),
    v_k = white^2 + sum_j (pose_j d s_k / d x_j)^2 + (e s_k)^2                                          (LO.1)

where b is the logarithm of the gain, common to the scan and the baseline reading, g its standard deviation, a what the model is
off by in all signals s_k alike, as a tissue is stiffer than thought or a load changes them, pose_j the standard deviation of the
probe's place along axis j, and e the relative error of each signal by itself. Several tumours exchange fields, which a sum of
their effects leaves out: e contains c sum_(i<j) (R_i R_j)^(3/2) / d_ij^3 with their radii R and distances d. With a and b
integrated out, S_i = sum_k r_k^i / v_k, Q_0 = sum_k s_k / v_k, Q_1 = sum_k s_k r_k / v_k, Q_2 = sum_k s_k^2 / v_k,

    ln L = -1/2 sum over channels [S_2 - N / D + ln D + sum_k ln v_k],   D = (1 + g^2 S_0) (1 + f^2 Q_2) - g^2 f^2 Q_0^2,
    N = g^2 (1 + f^2 Q_2) S_1^2 - 2 g^2 f^2 Q_0 S_1 Q_1 + f^2 (1 + g^2 S_0) Q_1^2                       (LO.2)

With a rate q of wild readings each density N(r_k - b, v_k) becomes (1 - q) N(r_k - b, v_k) + q N(r_k - b, v_k + s^2), with
(f s_k)^2 in v_k; b is then integrated by Laplace's method about its most probable value.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal
from probe_design.locating.prior import ForwardModel, TumourPrior
from probe_design.locating.scan_data import ScanData

TUMOUR_SETS_AT_ONCE = 4096  # sets of tumours predicted at once, which limits memory
WILD_SD = 0.5  # of ln reading: standard deviation s of a wild reading, a factor of 1.6
EXCHANGE_FACTOR = 0.3  # c of LO.1: root mean square 0.26 in both channels over 46 narrow pairs of benchmarks.locating
GAIN_STEPS = 8  # of Newton's method for the gain with wild readings: it converges in 4


@dataclass(frozen=True)
class Sums:
    """Eq. LO.2 of n sets of tumours: all that streaming has to store.

    Attributes
    ----------
    moments
        S_0, S_1, S_2, Q_0, Q_1, Q_2 of each channel, shape (6, n, 2).
    log_variance
        Sum of ln v_k, shape (n, 2).
    """

    moments: Floats
    log_variance: Floats

    def __add__(self, other: Sums) -> Sums:
        """Return the sums over the readings of both."""
        return Sums(self.moments + other.moments, self.log_variance + other.log_variance)

    def compute_log_likelihood(self, gain_sd: Floats, scale_sd: Floats) -> Floats:
        """Return ln L for g and f of LO.1, shape (2,) each, up to a constant that is the same for all tumours; shape (n,)."""
        S0, S1, S2, Q0, Q1, Q2 = self.moments
        g2, f2 = gain_sd**2, scale_sd**2
        for_gain, for_scale, both = 1 + g2 * S0, 1 + f2 * Q2, g2 * f2 * Q0
        numerator = g2 * for_scale * S1**2 - 2 * both * S1 * Q1 + f2 * for_gain * Q1**2
        determinant = for_gain * for_scale - both * Q0
        terms = S2 - numerator / determinant + np.log(determinant) + self.log_variance
        return np.asarray(-terms.sum(axis=-1) / 2)


def compute_exchange(tumours: Floats) -> Floats:
    """Return the error by exchange between tumours, relative to the signals, of sets of tumours (n, m, 5); shape (n,)."""
    total = np.zeros(len(tumours))
    for first in range(tumours.shape[1]):
        for second in range(first):
            distance = np.linalg.norm(tumours[:, first, :3] - tumours[:, second, :3], axis=1)
            total += (tumours[:, first, 3] * tumours[:, second, 3] / 4 / distance**2) ** 1.5
    return EXCHANGE_FACTOR * total


@dataclass(frozen=True)
class Likelihood:
    """The likelihood of tumours given a scan.

    Attributes
    ----------
    data
        The readings.
    model
        Predicts readings.
    prior
        Turns points of a cube into tumours.
    outlier_rate
        Fraction of wild readings, from 0.
    """

    data: ScanData
    model: ForwardModel
    prior: TumourPrior
    outlier_rate: float = 0.0

    def evaluate(self, points: Floats) -> Floats:
        """Return ln L of sets of tumours given as points of the cube, shape (n, m, d); -inf where they do not fit. Shape (n,)."""
        result = np.full(len(points), -np.inf)
        for start in range(0, len(points), TUMOUR_SETS_AT_ONCE):
            tumours = self.prior.transform(points[start : start + TUMOUR_SETS_AT_ONCE])
            allowed = self.prior.find_allowed(tumours)
            if np.any(allowed):
                result[start : start + TUMOUR_SETS_AT_ONCE][allowed] = self._evaluate_predictable(tumours[allowed])
        return result

    def _evaluate_predictable(self, tumours: Floats) -> Floats:
        """Return ln L of tumours, -inf where they would take all of a film's load and the model refuses them."""
        try:
            return self.evaluate_tumours(tumours)
        except Refusal:
            if len(tumours) == 1:
                return np.full(1, -np.inf)
            return np.concatenate([self._evaluate_predictable(part) for part in np.array_split(tumours, 2)])

    def predict_possible(self, tumours: Floats, positions: Floats) -> Floats:
        """Return the model's signals, shape (n, k, 2), nan where tumours (n, m, 5) would take all of a film's load."""
        try:
            return self.model.predict(tumours, positions)
        except Refusal:
            if len(tumours) == 1:
                return np.full((1, len(positions), 2), np.nan)
            parts = np.array_split(tumours, min(len(tumours), 8))
            return np.concatenate([self.predict_possible(part, positions) for part in parts])

    def evaluate_tumours(self, tumours: Floats) -> Floats:
        """Return ln L of sets of tumours, shape (n, m, 5); m may be 0. Shape (n,)."""
        if self.outlier_rate:
            return self._integrate_gain(*self.compute_residuals(tumours))
        return self.sum_readings(tumours).compute_log_likelihood(self.data.gain_sd, self.scale_sd)

    def sum_readings(self, tumours: Floats) -> Sums:
        """Return the sums of eq. LO.2 for sets of tumours, shape (n, m, 5)."""
        residuals, variance = self.compute_residuals(tumours, with_scale=False)
        return self._sum(residuals, variance, self.data.values - residuals)

    @property
    def scale_sd(self) -> Floats:
        """Standard deviation of what all signals of a channel are off by alike, f of LO.1, shape (2,)."""
        return np.hypot(self.model.scale_error, self.data.scale_sd)

    def compute_residuals(self, tumours: Floats, with_scale: bool = True) -> tuple[Floats, Floats]:
        """Return residuals r_k and variances v_k, inf where nothing is read, for tumours (n, m, 5); shape (n, k, 2) each.

        With ``with_scale`` the variances contain (f s_k)^2, as if each signal was off by itself.
        """
        data, n = self.data, len(tumours)
        signal, variance = np.zeros((n, len(data), 2)), np.repeat(data.variance[None], n, axis=0)
        over_tissue = ~data.is_baseline
        if tumours.shape[1] and np.any(over_tissue):
            positions = data.positions[over_tissue]
            signal[:, over_tissue] = self.model.predict(tumours, positions)
            exchange = compute_exchange(tumours)[:, None, None]
            scale = self.scale_sd if with_scale else 0.0
            variance += (self.model.error**2 + scale**2 + exchange**2) * signal**2
            if np.any(data.pose_sd[over_tissue]):
                slopes = self.model.slopes(tumours, positions)
                variance[:, over_tissue] += ((slopes * data.pose_sd[over_tissue][:, None, :]) ** 2).sum(axis=-1)
        return data.values - signal, variance

    def estimate_gain(self, residuals: Floats, variance: Floats) -> Floats:
        """Return the posterior mean of ln gain for each set of tumours, shape (n, 2)."""
        S0, S1 = (1 / variance).sum(axis=1), (residuals / variance).sum(axis=1)
        return np.asarray(S1 / (S0 + self.data.gain_sd**-2.0))

    def compute_wild_probability(self, residuals: Floats, variance: Floats) -> Floats:
        """Return the probability that each reading is wild, shape (n, k, 2), with the gain at its most probable value."""
        gain = self.find_gain(residuals, variance)
        return self._compare_densities(residuals - gain[:, None], variance)[1]

    @cached_property
    def _is_read(self) -> Bools:
        return self.data.is_read

    def _sum(self, residuals: Floats, variance: Floats, signal: Floats) -> Sums:
        """Return the sums over all readings."""
        weights = 1 / variance
        weighted = residuals * weights
        moments = np.zeros((6, len(residuals), 2))
        moments[:3] = weights.sum(axis=1), weighted.sum(axis=1), (residuals * weighted).sum(axis=1)
        if np.any(self.scale_sd):
            scaled = signal * weights
            moments[3:] = scaled.sum(axis=1), (signal * weighted).sum(axis=1), (signal * scaled).sum(axis=1)
        log_variance = np.log(variance, where=np.isfinite(variance), out=np.zeros_like(variance)).sum(axis=1)
        return Sums(moments, log_variance)

    def _compare_densities(self, deviations: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Return the logarithm of the mixed density of each reading, and the probability that it is wild, shape (n, k, 2)."""
        finite = np.where(self._is_read, variance, 1.0)
        wide, q = finite + WILD_SD**2, self.outlier_rate
        good = np.log1p(-q) - deviations**2 / finite / 2 - np.log(finite) / 2
        wild = np.log(q) - deviations**2 / wide / 2 - np.log(wide) / 2
        total = np.logaddexp(good, wild)
        return np.where(self._is_read, total, 0.0), np.where(self._is_read, np.exp(wild - total), 0.0)

    def find_gain(self, residuals: Floats, variance: Floats) -> Floats:
        """Return the most probable ln gain with wild readings, shape (n, 2), by reweighting from the median."""
        read = np.where(self._is_read, residuals, np.nan)
        gain = np.zeros((len(residuals), 2))
        for channel in np.flatnonzero(self._is_read.any(axis=0)):
            gain[:, channel] = np.nanmedian(read[:, :, channel], axis=1)
        for _ in range(GAIN_STEPS):
            wild = self._compare_densities(residuals - gain[:, None], variance)[1]
            weights = (1 - wild) / variance + wild / (variance + WILD_SD**2)
            gain = (weights * residuals).sum(axis=1) / (weights.sum(axis=1) + self.data.gain_sd**-2.0)
        return gain

    def _integrate_gain(self, residuals: Floats, variance: Floats) -> Floats:
        """Return ln L with wild readings, shape (n,)."""
        gain = self.find_gain(residuals, variance)
        deviations, wide = residuals - gain[:, None], variance + WILD_SD**2
        densities, wild = self._compare_densities(deviations, variance)
        # second derivative of the logarithm of a mixture: the mean of both, less the variance of the first derivative
        mean = ((1 - wild) / variance + wild / wide).sum(axis=1)
        scores = deviations / variance - deviations / wide
        curvature = np.maximum(mean - (wild * (1 - wild) * scores**2).sum(axis=1), mean / 10)
        terms = densities.sum(axis=1) - gain**2 / self.data.gain_sd**2 / 2 - np.log1p(self.data.gain_sd**2 * curvature) / 2
        return np.asarray(terms.sum(axis=-1))
