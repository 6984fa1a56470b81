"""Does a record hold one steady load? Amplitudes of its blocks one by one, and how far they differ beyond noise.

B_kc = g_k a_c + r_kc: block k's amplitude in channel c is the whole record's, a_c, times what the load did, g_k, plus what this
channel alone did. g is weighed by the channels' noise. Both are judged against noise, as a whole and along a cubic trend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from hw.common.samples import Complexes, Floats
from hw.signal.sine_model import DRIFT, Lines, normal_equations

MOST = 12  # blocks
CYCLES = 2.0  # of the load in a block, at least, and of each beat between two lines
ROWS_EACH = 4  # rows in a block for each unknown, at least
CHANCE = 1e-4  # of calling noise a change
TREND = 3  # degree


@dataclass(frozen=True)
class Steadiness:
    """Largest deviations from the record's mean that noise does not explain; 0 where it does.

    Attributes:
        load: of the load's amplitude, relative.
        phase: of its phase, rad.
        channels: (c,) of each channel's amplitude beside the load's, V.
    """

    load: float
    phase: float
    channels: Floats


def blocks(lines: Lines, t: Floats, volts: Floats) -> tuple[Complexes, Floats]:
    """Return amplitudes of consecutive blocks, (k, c), and their variance over that of a sample, (k,).

    Args:
        lines: the record's, fitted; phases count from its middle.
        t: (n,) times from the middle of the record, s, increasing.
        volts: (n, c).
    """
    unknowns = 2 * len(lines.frequencies) + DRIFT
    edges = np.linspace(-lines.half, lines.half, _count(lines, len(t), unknowns) + 1)
    bounds = np.append(np.searchsorted(t, edges[:-1]), len(t)).tolist()
    found = [
        _block(lines, t[low:high], volts[low:high], middle, half=edges[1] / 2 - edges[0] / 2)
        for low, high, middle in zip(bounds[:-1], bounds[1:], (edges[1:] + edges[:-1]) / 2, strict=True)
        if high - low > max(ROWS_EACH * unknowns, len(t) // (4 * len(edges)))
    ]
    if not found:
        return np.empty((0, volts.shape[1]), complex), np.empty(0)
    amplitudes, variances = zip(*found, strict=True)
    return np.array(amplitudes), np.array(variances)


def _count(lines: Lines, rows: int, unknowns: int) -> int:
    """How many blocks tell all lines apart."""
    frequencies = np.sort(lines.frequencies)
    slowest = min([lines.load, *np.diff(frequencies)])
    return int(max(1, min(MOST, 2 * lines.half * slowest / CYCLES, rows / (1.5 * ROWS_EACH * unknowns))))


def _block(lines: Lines, t: Floats, volts: Floats, middle: float, half: float) -> tuple[Complexes, float]:
    own = Lines(lines.load, lines.harmonics, lines.mains, lines.hums, half)
    normal, right = normal_equations(own, t - middle, volts)
    inverse = np.linalg.pinv(normal, hermitian=True)
    re, im = (inverse @ right)[:2]
    turned = (re + 1j * im) * np.exp(-2j * np.pi * lines.load * middle)
    return turned, float(max(inverse[0, 0], inverse[1, 1]))


def steadiness(amplitudes: Complexes, each: Complexes, variances: Floats, noise: Floats) -> Steadiness:
    """Judge blocks.

    Args:
        amplitudes: of the whole record, (c,), V.
        each: of its blocks, (k, c).
        variances: of their re and im over the noise's, (k,).
        noise: variance of a sample of each channel, V^2, (c,).
    """
    weights = 1 / np.maximum(noise, np.finfo(float).tiny)
    total = float((np.abs(amplitudes) ** 2 * weights).sum())
    common = (each * np.conj(amplitudes) * weights).sum(axis=1) / total
    beside = each - common[:, None] * amplitudes
    own = [
        np.hypot(changed(one.real, variances * sample), changed(one.imag, variances * sample))
        for one, sample in zip(beside.T, noise, strict=True)
    ]
    return Steadiness(
        load=changed(np.abs(common), variances / total),
        phase=changed(np.unwrap(np.angle(common)), variances / total),
        channels=np.array(own),
    )


def changed(values: Floats, variances: Floats) -> float:
    """Return by how much values (k,) leave their mean beyond noise of the given variances; 0 where noise explains it."""
    if len(values) < 2:
        return 0.0
    off = (values - np.average(values, weights=1 / variances)) / np.sqrt(variances)
    basis, _ = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, len(values)), min(TREND, len(values) - 1))[:, 1:])
    trend = basis @ (basis.T @ off)
    size = 0.0
    if chdtrc(basis.shape[1], float(trend @ trend)) < CHANCE:
        size = float(np.abs(trend * np.sqrt(variances)).max())
    if chdtrc(len(values) - 1, float(off @ off)) < CHANCE:  # a share of the time may be far off: as if evenly spread
        size = max(size, float(np.sqrt(3 * np.mean(np.maximum(off**2 - 1, 0) * variances))))
    return size
