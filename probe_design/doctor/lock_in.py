"""Fit the load in every channel by plain least squares, simpler than ``hw.signal`` and independent of it, for a check."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw.common.samples import Floats, Samples
from hw.signal.spectrum import MAINS_HZ, MAINS_TOLERANCE_HZ

HARMONIC_COUNT = 3
DRIFT_COEFFICIENTS = 4  # coefficients of the drift polynomial
MAX_ROWS = 100_000  # rows used of a long record: enough for a diagnosis


@dataclass(frozen=True)
class LockIn:
    """The load, the mains and the noise in a record.

    Attributes
    ----------
    frequency
        Of the load, Hz.
    load
        (channels,) complex amplitudes, V.
    mains
        Frequency of the mains, Hz: the stronger of the lines near 50 and 60 Hz.
    hum
        (channels,) amplitudes of the mains, V.
    noise
        (channels,) standard deviation of the residual, V.
    rows
        Number of rows used.
    """

    frequency: float
    load: NDArray[np.complex128]
    mains: float
    hum: Floats
    noise: Floats
    rows: int

    @property
    def strength(self) -> Floats:
        """Amplitudes of the load over their standard deviations, (channels,)."""
        spread = self.noise * np.sqrt(2 / self.rows)
        return np.asarray(np.abs(self.load) / np.maximum(spread, np.finfo(float).tiny))


def fit_lock_in(samples: Samples, nominal: float) -> LockIn:
    """Fit a load of about ``nominal`` Hz and the mains to the rows that are not saturated."""
    good = np.flatnonzero(~samples.saturated.any(axis=1))[:MAX_ROWS]
    times, volts = samples.times[good], samples.volts[good]
    times = times - times.mean()
    search_range = min(0.1 * nominal, 1.0)
    frequency = _find_strongest(times, volts, nominal - search_range, nominal + search_range)
    residual = _compute_residual(_build_columns(times, frequency, None, samples.rate), volts)
    lines = [
        _find_strongest(times, residual, mains_frequency - MAINS_TOLERANCE_HZ, mains_frequency + MAINS_TOLERANCE_HZ)
        for mains_frequency in MAINS_HZ
    ]
    mains = max(lines, key=lambda line: float(np.abs(_compute_amplitudes(times, residual, np.array([line]))).sum()))
    columns = _build_columns(times, frequency, mains if mains < 0.5 * samples.rate else None, samples.rate)
    coefficients, *_ = np.linalg.lstsq(columns, volts, rcond=None)
    noise = np.sqrt(((volts - columns @ coefficients) ** 2).sum(axis=0) / max(1, len(volts) - columns.shape[1]))
    hum = (
        np.abs(_compute_amplitudes(times, residual, np.array([mains])))[0]
        if mains < 0.5 * samples.rate
        else np.zeros(volts.shape[1])
    )
    return LockIn(frequency, coefficients[0] - 1j * coefficients[1], mains, hum, noise, len(volts))


def _compute_amplitudes(times: Floats, volts: Floats, frequencies: Floats) -> NDArray[np.complex128]:
    """Return the complex amplitudes at frequencies, (k, channels), with a Hann window over the record."""
    share = (times - times[0]) / max(times[-1] - times[0], np.finfo(float).tiny)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * share)
    turns = np.exp(-2j * np.pi * frequencies[:, None] * times)
    centred = volts - volts.mean(axis=0)
    return np.asarray(2 * (turns * window) @ centred / window.sum())


def _find_strongest(times: Floats, volts: Floats, low: float, high: float) -> float:
    """Return the frequency of maximum power over all channels, by a grid search that is refined about the best."""
    scale = np.maximum(volts.std(axis=0), np.finfo(float).tiny)
    step = 0.25 / max(times[-1] - times[0], np.finfo(float).tiny)
    grid = np.linspace(low, high, int(np.clip((high - low) / step, 9, 200)))
    for _ in range(3):
        power = (np.abs(_compute_amplitudes(times, volts / scale, grid)) ** 2).sum(axis=1)
        best = grid[int(np.argmax(power))]
        width = grid[1] - grid[0]
        grid = np.linspace(best - width, best + width, 9)
    return float(best)


def _build_columns(times: Floats, load: float, mains: float | None, rate: float) -> Floats:
    lines = [
        k * frequency
        for frequency in (load, mains)
        if frequency is not None
        for k in range(1, HARMONIC_COUNT + 1)
        if k * frequency < 0.45 * rate
    ]
    waves = [wave(2 * np.pi * line * times) for line in lines for wave in (np.cos, np.sin)]
    drift = np.polynomial.legendre.legvander(times / max(np.abs(times).max(), np.finfo(float).tiny), DRIFT_COEFFICIENTS - 1)
    return np.column_stack([*waves, drift])


def _compute_residual(columns: Floats, volts: Floats) -> Floats:
    coefficients, *_ = np.linalg.lstsq(columns, volts, rcond=None)
    return np.asarray(volts - columns @ coefficients)
