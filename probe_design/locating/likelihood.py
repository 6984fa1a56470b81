"""Compute the likelihood of tumours given the readings of a scan.

With r_k the residual of reading k after subtracting the signal s_k that the tumours cause, in each channel,

    r_k = sum_j (a_jk + b_jk s_k) u_j + w_k,   w_k ~ N(0, v_k),
    v_k = white^2 + sum_j (pose_j d s_k / d x_j)^2 + (e s_k)^2 + d_k^2                                  (LO.1)

where the u_j are what all readings have in common (``common_errors``): the gain, errors of the model, what is not known of the
tissue. pose_j is the standard deviation of the probe's place along axis j, e the relative error of each signal by
itself, and d_k the error by the reading's load, eq. LO.6. Several tumours exchange fields, which a sum of their effects leaves
out: e contains c sum_(i<j) (R_i R_j)^(3/2) / d_ij^3 with their radii R and distances d. The u_j are integrated out, eq. LO.2.

With a rate q of wild readings each density N(r_k - b, v_k) becomes (1 - q) N(r_k - b, v_k) + q N(r_k - b, v_k + s^2), with the
common errors b of the readings without tumours as one gain of each channel, and those of the signals in v_k; b is then integrated
by Laplace's method about its most probable value.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal
from probe_design.locating.common_errors import CommonErrors, Rows, Sums
from probe_design.locating.prior import ForwardModel, TumourPrior
from probe_design.locating.scan_data import ScanData

TUMOUR_SETS_AT_ONCE = 512  # sets of tumours at once, whose arrays fit the processor's cache
WILD_SD = 0.5  # of ln reading: standard deviation s of a wild reading, a factor of 1.6
EXCHANGE_FACTOR = 0.3  # c of LO.1: root mean square 0.26 in both channels over 46 narrow pairs of benchmarks.locating
GAIN_STEPS = 8  # of Newton's method for the gain with wild readings: it converges in 4
MIN_GAIN_SD_RELATIVE = 1e-6  # of a gain that is known: Newton's method divides by its variance


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
    models
        Predict signals, one at each load.
    prior
        Turns points of a cube into tumours.
    outlier_rate
        Fraction of wild readings, from 0.
    """

    data: ScanData
    models: tuple[ForwardModel, ...]
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

    def predict_possible(self, tumours: Floats) -> Floats:
        """Return the readings' signals, shape (n, k, 2), nan where tumours (n, m, 5) would take all of a film's load."""
        try:
            return self.predict(tumours)[0]
        except Refusal:
            if len(tumours) == 1:
                return np.full((1, len(self.data), 2), np.nan)
            parts = np.array_split(tumours, min(len(tumours), 8))
            return np.concatenate([self.predict_possible(part) for part in parts])

    def evaluate_tumours(self, tumours: Floats) -> Floats:
        """Return ln L of sets of tumours, shape (n, m, 5); m may be 0. Shape (n,)."""
        if self.outlier_rate:
            return self._integrate_gain(*self.compute_residuals(tumours))
        return self.sum_readings(tumours).compute_log_likelihood()

    def sum_readings(self, tumours: Floats) -> Sums:
        """Return the sums of eq. LO.2 for sets of tumours, shape (n, m, 5); wild readings count the less, the more probable."""
        residuals, variance = self.weigh_readings(tumours)
        return Sums.from_readings(self.rows, residuals, variance, self.data.values - residuals)

    def weigh_readings(self, tumours: Floats) -> tuple[Floats, Floats]:
        """Return ``compute_residuals`` without what the common errors change, variances the larger, the more probably wild."""
        residuals, variance = self.compute_residuals(tumours, with_scale=False)
        if self.outlier_rate:
            variance = _widen(variance, self.compute_wild_probability(*self.compute_residuals(tumours)))
        return residuals, variance

    @cached_property
    def common_errors(self) -> CommonErrors:
        """All that the readings have in common, the models' errors included."""
        scale = np.stack([model.scale_error for model in self.models])
        return self.data.errors.join(CommonErrors.from_channels("model_signal", 0 * scale, scale))

    @cached_property
    def rows(self) -> Rows:
        """The common errors of each reading."""
        return Rows.from_errors(self.common_errors, self.data.weights)

    def predict(self, tumours: Floats) -> tuple[Floats, Floats]:
        """Return the readings' signals by tumours (n, m, 5), (n, k, 2), and their variance by the loads, d_k^2 of LO.1.

        The variance has the same shape, or (1, 1, 1) where no load lies between those of the models.
        """
        data, shape = self.data, (len(tumours), len(self.data), 2)
        signal, spread = np.zeros(shape), np.zeros(shape if np.any(data.spreads) else (1, 1, 1))
        if tumours.shape[1]:
            for model, weights, spreads in zip(self.models, data.weights.T, data.spreads.T, strict=True):
                rows = np.flatnonzero((weights != 0) & ~data.is_baseline)
                if not len(rows):
                    continue
                part = model.predict(tumours, data.positions[rows])
                if np.any(spreads[rows]):
                    spread[:, rows] += part * spreads[rows, None]
                if np.all(weights[rows] == 1):
                    signal[:, rows] = part
                else:
                    signal[:, rows] += part * weights[rows, None]
        return signal, spread**2

    def compute_slopes(self, tumours: Floats) -> Floats:
        """Return the derivatives of the signals with respect to the probe's place, 1/m, shape (n, k, 2, 2)."""
        data, slopes = self.data, np.zeros((len(tumours), len(self.data), 2, 2))
        for model, weights in zip(self.models, data.weights.T, strict=True):
            rows = np.flatnonzero((weights != 0) & ~data.is_baseline)
            if len(rows):
                slopes[:, rows] += model.slopes(tumours, data.positions[rows]) * weights[rows, None, None]
        return slopes

    def compute_residuals(self, tumours: Floats, with_scale: bool = True) -> tuple[Floats, Floats]:
        """Return residuals r_k and variances v_k, inf where nothing is read, for tumours (n, m, 5); shape (n, k, 2) each.

        With ``with_scale`` the variances contain what the common errors change of the signals, as if each was off by itself.
        """
        data = self.data
        signal, spread = self.predict(tumours)
        variance = np.empty_like(signal)
        variance[:] = data.variance
        if np.any(data.spreads):
            variance += spread
        if tumours.shape[1] and not np.all(data.is_baseline):
            error = data.weights @ np.stack([model.error for model in self.models])
            scale = self.rows.total_scale if with_scale else 0.0
            exchange = compute_exchange(tumours)[:, None, None]
            variance += (error**2 + scale**2 + exchange**2) * signal**2
            if np.any(data.pose_sd[~data.is_baseline]):
                variance += ((self.compute_slopes(tumours) * data.pose_sd[:, None, :]) ** 2).sum(axis=-1)
        return data.values - signal, variance

    def solve_common(self, tumours: Floats) -> tuple[Floats, Floats]:
        """Return mean and covariance of the common errors given tumours (n, m, 5), in standard deviations: (n, q), (n, q, q)."""
        return self.sum_readings(tumours).solve()

    def estimate_offsets(self, residuals: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Return what the common errors move of each reading without tumours, (n, k, 2), and these errors, (n, q).

        ``variance`` contains what they change of the signals.
        """
        rows = Rows(self.rows.constant, np.zeros_like(self.rows.scale))
        if self.outlier_rate and len(self.data):
            variance = _widen(variance, self.compute_wild_probability(residuals, variance))
        means = Sums.from_readings(rows, residuals, variance, 0 * residuals).solve()[0]
        return np.einsum("nq,qkc->nkc", means, rows.constant), means

    def compute_wild_probability(self, residuals: Floats, variance: Floats) -> Floats:
        """Return the probability that each reading is wild, shape (n, k, 2), with the gain at its most probable value."""
        gain = self.find_gain(residuals, variance)
        return self._compare_densities(residuals - gain[:, None], variance)[1]

    @cached_property
    def _is_read(self) -> Bools:
        return self.data.is_read

    @cached_property
    def _gain_sd(self) -> Floats:
        """Standard deviation of all that moves the readings without tumours, as one gain of each channel, shape (2,)."""
        return np.asarray(np.maximum(self.rows.total_constant.max(axis=0, initial=0.0), MIN_GAIN_SD_RELATIVE))

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
            gain = (weights * residuals).sum(axis=1) / (weights.sum(axis=1) + self._gain_sd**-2.0)
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
        terms = densities.sum(axis=1) - gain**2 / self._gain_sd**2 / 2 - np.log1p(self._gain_sd**2 * curvature) / 2
        return np.asarray(terms.sum(axis=-1))


def _widen(variance: Floats, wild: Floats) -> Floats:
    """Return variances of readings that are wild with some probability: those of the mean precision; inf stays."""
    precision = (1 - wild) / variance + wild / (variance + WILD_SD**2)
    return np.divide(1.0, precision, where=precision > 0, out=np.full_like(variance, np.inf))
