"""Estimate errors of the amplitude from a fit's residuals: outliers, and products of load and mains by a curved characteristic.

Where the mains exceed the load, an overloaded amplifier reduces the load's amplitude but adds hardly any of its harmonics. The
residuals then resemble the square or the cube of the fitted signal.
"""

from __future__ import annotations

import numpy as np

from hw.common.samples import Floats
from hw.signal.sine_model import Lines, normal_equations, residual

OUT = 6.0  # standard deviations of the noise from which a row is an outlier
MEDIAN = 1.4826  # ratio of the standard deviation to the median absolute value, of normal noise
SEEN = 6.0  # standard deviations from which a correlation is significant
POWERS = (2, 3)  # of the fitted signal that are searched in the residuals
LEAST = 2e-3  # mean square of a power (of maximum 1) outside the fit's columns: below it the load's harmonics show the bending


def spikes(left: Floats, period: float) -> Floats:
    """Return the error of each amplitude that outliers may cause, V, (channels,); bursts of outliers count as independent.

    Args:
        left: (n, channels) residuals of a fit, V.
        period: of the load, rows; outliers closer than half of it are one burst.
    """
    size = np.abs(left)
    out = size > OUT * MEDIAN * np.median(size, axis=0)
    most = []
    for column, standing in zip(size.T, out.T, strict=True):
        at = np.flatnonzero(standing)
        burst = np.cumsum(np.diff(at, prepend=at[:1]) > period / 2)
        most.append(np.sqrt((np.bincount(burst, column[at]) ** 2).sum()) * 2 / len(left))
    return np.array(most)


def bending(lines: Lines, t: Floats, fitted: Floats, left: Floats) -> Floats:
    """Return the error of each amplitude that a curved characteristic may cause, V, (channels,); 0 where none is significant.

    Args:
        lines: of the fit.
        t: (n,) times from the middle of the record, s.
        fitted: (n, channels) the fitted signal, V.
        left: (n, channels) residuals, V.
    """
    scaled: Floats = np.asarray(fitted / np.maximum(np.abs(fitted).max(axis=0), np.finfo(float).tiny), dtype=float)
    most = np.zeros(left.shape[1])
    for power in POWERS:
        coefficients: Floats = np.linalg.solve(*normal_equations(lines, t, scaled**power)).astype(float)
        rest = residual(lines, t, scaled**power, coefficients)
        square = (rest**2).sum(axis=0)
        clear = square > LEAST * len(t)
        share = np.where(clear, (rest * left).sum(axis=0) / np.where(clear, square, 1.0), 0.0)
        spread = np.sqrt((left**2).mean(axis=0) / np.where(clear, square, 1.0))
        seen = np.abs(share) > SEEN * spread
        most = np.hypot(most, np.where(seen, np.abs(share) * np.hypot(*coefficients[:2]), 0.0))
    return most
