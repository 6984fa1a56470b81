"""Estimate errors of the amplitude from a fit's residuals: outliers, and products of load and mains by a curved characteristic.

Where the mains exceed the load, an overloaded amplifier reduces the load's amplitude but adds hardly any of its harmonics. The
residuals then resemble the square or the cube of the fitted signal.
"""

from __future__ import annotations

import numpy as np

from hw.common.samples import Floats
from hw.signal.sine_model import Lines, build_normal_equations, compute_residual

OUTLIER_SD = 6.0  # standard deviations of the noise from which a row is an outlier
SD_PER_MEDIAN = 1.4826  # ratio of the standard deviation to the median absolute value, of normal noise
DETECTED_SD = 6.0  # standard deviations from which a correlation is significant
BENDING_POWERS = (2, 3)  # of the fitted signal that are searched in the residuals
MIN_MEAN_SQUARE = (
    2e-3  # mean square of a power (of maximum 1) outside the fit's columns: below it the load's harmonics show the bending
)


def estimate_spike_error(residuals: Floats, period: float) -> Floats:
    """Return the error of each amplitude that outliers may cause, V, (channels,); bursts of outliers count as independent.

    Parameters
    ----------
    residuals
        (n, channels) of a fit, V.
    period
        Of the load, rows; outliers closer than half of it are one burst.
    """
    size = np.abs(residuals)
    outliers = size > OUTLIER_SD * SD_PER_MEDIAN * np.median(size, axis=0)
    errors = []
    for column, standing in zip(size.T, outliers.T, strict=True):
        rows = np.flatnonzero(standing)
        burst = np.cumsum(np.diff(rows, prepend=rows[:1]) > period / 2)
        errors.append(np.sqrt((np.bincount(burst, column[rows]) ** 2).sum()) * 2 / len(residuals))
    return np.array(errors)


def estimate_bending_error(lines: Lines, t: Floats, fitted: Floats, residuals: Floats) -> Floats:
    """Return the error of each amplitude that a curved characteristic may cause, V, (channels,); 0 where none is significant.

    Parameters
    ----------
    lines
        Of the fit.
    t
        (n,) times from the middle of the record, s.
    fitted
        (n, channels) the fitted signal, V.
    residuals
        (n, channels), V.
    """
    scaled: Floats = np.asarray(fitted / np.maximum(np.abs(fitted).max(axis=0), np.finfo(float).tiny), dtype=float)
    errors = np.zeros(residuals.shape[1])
    for power in BENDING_POWERS:
        coefficients: Floats = np.linalg.solve(*build_normal_equations(lines, t, scaled**power)).astype(float)
        remainder = compute_residual(lines, t, scaled**power, coefficients)
        square = (remainder**2).sum(axis=0)
        clear = square > MIN_MEAN_SQUARE * len(t)
        share = np.where(clear, (remainder * residuals).sum(axis=0) / np.where(clear, square, 1.0), 0.0)
        spread = np.sqrt((residuals**2).mean(axis=0) / np.where(clear, square, 1.0))
        detected = np.abs(share) > DETECTED_SD * spread
        errors = np.hypot(errors, np.where(detected, np.abs(share) * np.hypot(*coefficients[:2]), 0.0))
    return errors
