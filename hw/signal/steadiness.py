"""Test whether the load is steady: fit consecutive blocks of a record, and find changes that noise does not explain.

B_kc = g_k a_c + r_kc: block k's amplitude B_kc in channel c is the whole record's amplitude a_c times the load's change g_k, plus
a change r_kc of this channel only. g_k is an average over channels, weighted by their noise. Both are tested against noise, in
total and along a cubic trend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from hw.common.samples import Complexes, Floats
from hw.signal.sine_model import DRIFT_COEFFICIENTS, Lines, build_normal_equations

MAX_BLOCKS = 12  # blocks
MIN_BLOCK_CYCLES = 2.0  # minimum periods in a block, of the load and of each beat between two lines
MIN_ROWS_PER_UNKNOWN = 4  # minimum rows in a block for each unknown
FALSE_ALARM_PROBABILITY = 1e-4  # probability of taking noise for a change
TREND_DEGREE = 3  # degree of the polynomial


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
    """Return the number of blocks that are long enough to separate all lines."""
    frequencies = np.sort(lines.frequencies)
    slowest = min([lines.load, *np.diff(frequencies)])
    return int(
        max(1, min(MAX_BLOCKS, 2 * lines.half * slowest / MIN_BLOCK_CYCLES, rows / (1.5 * MIN_ROWS_PER_UNKNOWN * unknowns)))
    )


def _fit_block(lines: Lines, t: Floats, volts: Floats, middle: float, half: float) -> tuple[Complexes, float]:
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
    common = (block_amplitudes * np.conj(amplitudes) * weights).sum(axis=1) / total
    channel_parts = block_amplitudes - common[:, None] * amplitudes
    channel_changes = [
        np.hypot(estimate_change(part.real, variances * sample), estimate_change(part.imag, variances * sample))
        for part, sample in zip(channel_parts.T, noise, strict=True)
    ]
    return Steadiness(
        load=estimate_change(np.abs(common), variances / total),
        phase=estimate_change(np.unwrap(np.angle(common)), variances / total),
        channels=np.array(channel_changes),
    )


def estimate_change(values: Floats, variances: Floats) -> float:
    """Return the largest deviation of values (k,) from their mean; 0 where noise of the given variances explains it."""
    if len(values) < 2:
        return 0.0
    deviations = (values - np.average(values, weights=1 / variances)) / np.sqrt(variances)
    basis, _ = np.linalg.qr(
        np.polynomial.legendre.legvander(np.linspace(-1, 1, len(values)), min(TREND_DEGREE, len(values) - 1))[:, 1:]
    )
    trend = basis @ (basis.T @ deviations)
    size = 0.0
    if chdtrc(basis.shape[1], float(trend @ trend)) < FALSE_ALARM_PROBABILITY:
        size = float(np.abs(trend * np.sqrt(variances)).max())
    if (
        chdtrc(len(values) - 1, float(deviations @ deviations)) < FALSE_ALARM_PROBABILITY
    ):  # irregular changes: bound of an even distribution
        size = max(size, float(np.sqrt(3 * np.mean(np.maximum(deviations**2 - 1, 0) * variances))))
    return size
