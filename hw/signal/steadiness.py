"""Estimate how far a record deviates from one steady sine: a load that changes, outliers, and curved characteristics.

**A load that changes.** B_kc = g_k a_c + r_kc: block k's amplitude B_kc in channel c is the whole record's amplitude a_c times
the load's change g_k, plus a change r_kc of this channel only. g_k is an average over channels, weighted by their noise. Both
are tested against noise, in total and along a cubic trend.

**Curved characteristics.** Where the mains exceed the load, an overloaded amplifier reduces the load's amplitude but adds hardly
any of its harmonics. The residuals then resemble the square or the cube of the fitted signal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from hw.common.samples import Complexes, Floats
from hw.signal.sine_model import DRIFT_COEFFICIENTS, Lines, build_normal_equations, compute_residual

MAX_BLOCKS = 12  # blocks
MIN_BLOCK_CYCLES = 2.0  # minimum periods in a block, of the load and of each beat between two lines
MIN_ROWS_PER_UNKNOWN = 4  # minimum rows in a block for each unknown
FALSE_ALARM_PROBABILITY = 1e-4  # probability of taking noise for a change
TREND_DEGREE = 3  # of the polynomial along which changes are tested
OUTLIER_SD = 6.0  # standard deviations of the noise from which a row is an outlier
SD_PER_MEDIAN = 1.4826  # ratio of the standard deviation to the median absolute value, of normal noise
DETECTED_SD = 6.0  # standard deviations from which a correlation is significant
BENDING_POWERS = (2, 3)  # of the fitted signal that are searched in the residuals
# mean square of a power (of maximum 1) outside the fit's columns: below it the load's harmonics show the bending
MIN_MEAN_SQUARE = 2e-3


@dataclass(frozen=True)
class Steadiness:
    """Changes during a record, as largest deviations from its mean; 0 where noise explains them.

    Attributes
    ----------
    load
        Change of the load's amplitude, relative.
    phase
        Change of the load's phase, rad.
    channels
        (c,) change of each channel's amplitude in addition to the load's, V.
    """

    load: float
    phase: float
    channels: Floats


def fit_blocks(lines: Lines, t: Floats, volts: Floats) -> tuple[Complexes, Floats]:
    """Fit consecutive blocks; return their amplitudes, (k, c), and variances relative to a sample's noise, (k,).

    Parameters
    ----------
    lines
        The record's, fitted; phases count from its middle.
    t
        (n,) times from the middle of the record, s, increasing.
    volts
        (n, c).
    """
    unknowns = 2 * len(lines.frequencies) + DRIFT_COEFFICIENTS
    edges = np.linspace(-lines.half, lines.half, _count_blocks(lines, len(t), unknowns) + 1)
    bounds = np.append(np.searchsorted(t, edges[:-1]), len(t)).tolist()
    fits = [
        _fit_block(lines, t[low:high], volts[low:high], middle, half=edges[1] / 2 - edges[0] / 2)
        for low, high, middle in zip(bounds[:-1], bounds[1:], (edges[1:] + edges[:-1]) / 2, strict=True)
        if high - low > max(MIN_ROWS_PER_UNKNOWN * unknowns, len(t) // (4 * len(edges)))
    ]
    if not fits:
        return np.empty((0, volts.shape[1]), complex), np.empty(0)
    amplitudes, variances = zip(*fits, strict=True)
    return np.array(amplitudes), np.array(variances)


def _count_blocks(lines: Lines, rows: int, unknowns: int) -> int:
    """Return the number of blocks that are long enough to separate all lines, and have enough rows for the unknowns."""
    frequencies = np.sort(lines.frequencies)
    slowest = min([lines.load, *np.diff(frequencies)])  # Hz, of the load and the beats between neighbouring lines
    return int(
        max(1, min(MAX_BLOCKS, 2 * lines.half * slowest / MIN_BLOCK_CYCLES, rows / (1.5 * MIN_ROWS_PER_UNKNOWN * unknowns)))
    )


def _fit_block(lines: Lines, t: Floats, volts: Floats, middle: float, half: float) -> tuple[Complexes, float]:
    """Fit one block; return its amplitudes (c,), V, with phases from the record's middle, and their relative variance.

    Parameters
    ----------
    lines
        The record's, fitted.
    t
        (n,) times of the block's rows from the middle of the record, s.
    volts
        (n, c).
    middle
        Time of the block's middle from that of the record, s.
    half
        Half of the block's length, s.
    """
    block_lines = Lines(lines.load, lines.harmonics, lines.mains, lines.hums, half)
    normal, right = build_normal_equations(block_lines, t - middle, volts)
    inverse = np.linalg.pinv(normal, hermitian=True)
    re, im = (inverse @ right)[:2]
    amplitude = (re + 1j * im) * np.exp(-2j * np.pi * lines.load * middle)
    return amplitude, float(max(inverse[0, 0], inverse[1, 1]))


def assess_steadiness(amplitudes: Complexes, block_amplitudes: Complexes, variances: Floats, noise: Floats) -> Steadiness:
    """Find significant changes of the load and of single channels from the amplitudes of blocks.

    Parameters
    ----------
    amplitudes
        Of the whole record, (c,), V.
    block_amplitudes
        Of its blocks, (k, c), V.
    variances
        Of their re and im, relative to a sample's noise, (k,).
    noise
        Variance of a sample of each channel, V^2, (c,).
    """
    weights = 1 / np.maximum(noise, np.finfo(float).tiny)
    total = float((np.abs(amplitudes) ** 2 * weights).sum())
    load_factors = (block_amplitudes * np.conj(amplitudes) * weights).sum(axis=1) / total  # g_k
    remainders = block_amplitudes - load_factors[:, None] * amplitudes  # r_kc
    channel_changes = [
        np.hypot(estimate_change(changes.real, variances * variance), estimate_change(changes.imag, variances * variance))
        for changes, variance in zip(remainders.T, noise, strict=True)
    ]
    return Steadiness(
        load=estimate_change(np.abs(load_factors), variances / total),
        phase=estimate_change(np.unwrap(np.angle(load_factors)), variances / total),
        channels=np.array(channel_changes),
    )


def estimate_change(values: Floats, variances: Floats) -> float:
    """Return the largest deviation of values (k,) from their mean; 0 where noise of the given variances explains it."""
    if len(values) < 2:
        return 0.0
    deviations = (values - np.average(values, weights=1 / variances)) / np.sqrt(variances)
    degree = min(TREND_DEGREE, len(values) - 1)
    basis, _ = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, len(values)), degree)[:, 1:])
    trend = basis @ (basis.T @ deviations)
    change = 0.0
    # two tests: a slow trend stands out earlier than in the total, an irregular change in the total only
    if chdtrc(basis.shape[1], float(trend @ trend)) < FALSE_ALARM_PROBABILITY:
        change = float(np.abs(trend * np.sqrt(variances)).max())
    if chdtrc(len(values) - 1, float(deviations @ deviations)) < FALSE_ALARM_PROBABILITY:
        irregular_variance = np.mean(np.maximum(deviations**2 - 1, 0) * variances)
        change = max(change, float(np.sqrt(3 * irregular_variance)))  # the bound of an even distribution of this variance
    return change


def estimate_spike_error(residuals: Floats, period: float) -> Floats:
    """Return the error of each channel's fitted amplitude that outliers may cause, V, (channels,).

    Outliers close to each other are one burst, whose errors add; the errors of bursts are independent.

    Parameters
    ----------
    residuals
        (n, channels) of a fit, V.
    period
        Of the load, rows; outliers closer than half of it are one burst.
    """
    sizes = np.abs(residuals)
    is_outlier = sizes > OUTLIER_SD * SD_PER_MEDIAN * np.median(sizes, axis=0)
    errors = []
    for channel_sizes, channel_outliers in zip(sizes.T, is_outlier.T, strict=True):
        rows = np.flatnonzero(channel_outliers)
        # number of each outlier's burst: the next one begins after a pause of more than half a period
        burst_index = np.cumsum(np.diff(rows, prepend=rows[:1]) > period / 2)
        burst_sums = np.bincount(burst_index, channel_sizes[rows])
        errors.append(np.sqrt((burst_sums**2).sum()) * 2 / len(residuals))  # 2 / n: weight of a row in an amplitude
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
        pattern = compute_residual(lines, t, scaled**power, coefficients)  # what the fit's columns leave of this power
        square = (pattern**2).sum(axis=0)
        is_clear = square > MIN_MEAN_SQUARE * len(t)
        divisor = np.where(is_clear, square, 1.0)
        factor = np.where(is_clear, (pattern * residuals).sum(axis=0) / divisor, 0.0)  # V of the pattern in the residuals
        is_detected = np.abs(factor) > DETECTED_SD * np.sqrt((residuals**2).mean(axis=0) / divisor)
        errors = np.hypot(errors, np.where(is_detected, np.abs(factor) * np.hypot(*coefficients[:2]), 0.0))
    return errors
