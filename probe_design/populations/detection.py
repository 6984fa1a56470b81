"""Compute the probability of detection of each tumour, for a detector that knows the population but not the tumour.

With C the readings' covariance, L its Cholesky factor, u_k = L^-1 (signal of tumour k of a reference sample) and z = L^-1
(readings), the likelihood ratio averaged over K tumours is

    Lambda(z) = 1/K sum_k exp(u_k . z - |u_k|^2 / 2)                                               (PO.4)

The detector reports a tumour where ln Lambda exceeds a threshold, which a fraction ``false_alarm`` of the scans without tumours
exceeds. If all u_k are equal to u, this is a threshold of u . z. With v_i = L^-1 (signal of tumour i), the tumour is detected
with the probability

    P_i = Phi(d' - z_a) with d' = u . v_i / |u|, and z_a the normal quantile of 1 - false_alarm                (PO.5)

Here Phi is the normal distribution function. For v_i = u, d' = |u| is the deflection: no detector has a higher probability for a
known tumour, so that it bounds P_i of all detectors. Where the signals s_j have error bounds e_j, the signals within these bounds
that are detected most and least often are, to first order,

    s_j +- e_j sign(d ln Lambda / d y_j),   d ln Lambda / d y = L^-T sum_k w_k u_k,   w_k ~ exp(u_k . z - |u_k|^2 / 2)   (PO.11)

with y the readings, here y = s without noise, and weights w_k normalised to sum_k w_k = 1.
If the u_k differ, threshold and P_i are computed from random draws of z. The random numbers are always the same, so that the
difference of two designs has a smaller error than each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtr, ndtri, softmax

from geometry.common.arrays import Floats
from probe_design.inference.linear_gaussian import Array

TUMOUR_FREE_SCANS = 32_768  # scans without tumours that determine the threshold
THRESHOLD_SEED, SCAN_SEED = (0, 1), (0, 2)  # of the draws of noise
SCANS_PER_TUMOUR = 256  # over each tumour
MAX_SCANS_AT_ONCE = 8192  # scans at once, which limits memory
SMALL_EXPONENT = 0.1  # exponents below which expm1 computes the mean, as its difference from 1
SAME_TEMPLATE_TOLERANCE_RELATIVE = 1e-12  # templates that differ less count as equal


@dataclass(frozen=True)
class Detector:
    """Eq. PO.4 with its threshold.

    Attributes
    ----------
    factor
        L, shape (m, m).
    templates
        u_k, shape (K, m).
    false_alarm
        Fraction of scans without tumours above the threshold.
    threshold
        Threshold of ln Lambda; of u . z / |u| with a single template.
    tie
        Fraction of the scans exactly at the threshold that count as above it; all scans are at it if no tumour has a signal.
    lower_threshold
        Threshold lower by one standard error of the false alarms.
    """

    factor: Floats
    templates: Floats
    false_alarm: float
    threshold: float
    tie: float
    lower_threshold: float

    @classmethod
    def train(cls, signals: Floats, covariance: Floats, false_alarm: float, *, blanks: int = TUMOUR_FREE_SCANS) -> Detector:
        """Return the detector for a reference sample of tumours.

        Parameters
        ----------
        signals
            Signals of the tumours, shape (K, m).
        covariance
            Covariance of the readings, shape (m, m).
        false_alarm
            Probability of a false alarm in a whole scan.
        blanks
            Number of scans without tumours that are drawn.
        """
        factor = np.asarray(np.linalg.cholesky(covariance), dtype=float)
        templates = whiten(factor, signals)
        if np.ptp(templates, axis=0).max() <= SAME_TEMPLATE_TOLERANCE_RELATIVE * np.abs(templates).max():
            threshold = float(ndtri(1 - false_alarm))
            return cls(factor, templates[:1], false_alarm, threshold, false_alarm, threshold)
        # z: whitened readings of scans without tumours, which contain only noise
        z = np.random.default_rng(THRESHOLD_SEED).standard_normal((blanks, len(factor)))
        statistic = np.sort(compute_log_likelihood_ratio(templates, z))
        spread = np.sqrt(false_alarm * (1 - false_alarm) / blanks)
        threshold, lower_threshold = (
            float(np.quantile(statistic, 1 - fraction, method="higher")) for fraction in (false_alarm, false_alarm + spread)
        )
        fraction_above, fraction_tied = float((statistic > threshold).mean()), float((statistic == threshold).mean())
        tie = (false_alarm - fraction_above) / fraction_tied
        return cls(factor, templates, false_alarm, threshold, tie, lower_threshold)

    def compute_probabilities(self, signals: Floats, *, scans: int = SCANS_PER_TUMOUR, threshold: float | None = None) -> Floats:
        """Return the probability of detection of each of n tumours, under the same draws of noise in each call.

        Parameters
        ----------
        signals
            Signals of the tumours, shape (n, m).
        scans
            Number of scans drawn over each tumour.
        threshold
            Threshold in place of the detector's own; not used with a single template.

        Returns
        -------
        Floats
            P_i, shape (n,), each with a standard error of sqrt(P_i (1 - P_i) / scans), or exact by eq. PO.5.
        """
        v = whiten(self.factor, signals)  # v_i of eq. PO.5
        if len(self.templates) == 1:
            return self._compute_known_tumour(v)
        threshold = self.threshold if threshold is None else threshold
        chunk, probabilities = max(1, MAX_SCANS_AT_ONCE // scans), np.empty(len(v))
        rng = np.random.default_rng(SCAN_SEED)
        for low in range(0, len(v), chunk):
            z = rng.standard_normal((min(chunk, len(v) - low), scans, v.shape[1])) + v[low : low + chunk, None]
            statistic = compute_log_likelihood_ratio(self.templates, z.reshape(-1, v.shape[1])).reshape(z.shape[:2])
            above, tied = (statistic > threshold).mean(axis=1), (statistic == threshold).mean(axis=1)
            probabilities[low : low + chunk] = above + self.tie * tied
        return probabilities

    def compute_derivatives(self, signals: Floats) -> Floats:
        """Return the derivatives of ln Lambda by the readings at n signals without noise, eq. PO.11, shape (n, m)."""
        exponents = whiten(self.factor, signals) @ self.templates.T - (self.templates**2).sum(axis=1) / 2
        weights = softmax(exponents, axis=1) @ self.templates
        return np.asarray(solve_triangular(self.factor, weights.T, lower=True, trans="T").T)

    def _compute_known_tumour(self, v: Floats) -> Floats:
        """Return eq. PO.5 for whitened signals, shape (n,), of a detector with a single template."""
        u = self.templates[0]
        size = float(np.linalg.norm(u))
        if size == 0.0:
            return np.full(len(v), self.false_alarm)
        return np.asarray(ndtr(v @ (u / size) - self.threshold))


def whiten(factor: Floats, signals: Floats) -> Floats:
    """Return L^-1 s, signals whose noise is independent and of unit variance.

    Parameters
    ----------
    factor
        Cholesky factor L of the readings' covariance, shape (m, m).
    signals
        Signals s, one in each row, shape (n, m).
    """
    return np.asarray(solve_triangular(factor, signals.T, lower=True).T)


def compute_log_likelihood_ratio(templates: Floats, z: Floats) -> Floats:
    """Return ln Lambda of eq. PO.4, accurately for large and tiny exponents alike.

    Parameters
    ----------
    templates
        u_k, whitened signals of the reference tumours, shape (K, m).
    z
        Whitened readings of s scans, shape (s, m).

    Returns
    -------
    Floats
        ln Lambda, shape (s,).
    """
    result = np.empty(len(z))
    for low in range(0, len(z), MAX_SCANS_AT_ONCE):
        exponents = z[low : low + MAX_SCANS_AT_ONCE] @ templates.T - (templates**2).sum(axis=1) / 2
        max_exponent = exponents.max(axis=1)
        tiny = (max_exponent < SMALL_EXPONENT) & (exponents.min(axis=1) > -SMALL_EXPONENT)
        log_mean = np.empty(len(max_exponent))
        log_mean[tiny] = np.log1p(np.expm1(exponents[tiny]).mean(axis=1))
        log_mean[~tiny] = max_exponent[~tiny] + np.log(np.exp(exponents[~tiny] - max_exponent[~tiny, None]).mean(axis=1))
        result[low : low + MAX_SCANS_AT_ONCE] = log_mean
    return result


def compute_known_probabilities(deflection: Array, false_alarm: float) -> Array:
    """Return the probability of detection of a known tumour, which no detector exceeds: eq. PO.5 with d' = ``deflection``.

    Deflections have any shape, and are real or complex.
    """
    return np.asarray(ndtr(deflection - ndtri(1 - false_alarm)))
