"""Analyse the spectrum of a record: find the load and the mains, and estimate the noise's density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.common.samples import Complexes, Floats, Samples

REDUCED_RATE_HZ = 500.0  # Hz: faster samples are summed down to about this rate; load and mains are well below
PADDING_FACTOR = 4  # zero padding, times the record's length: bins are 1/4 of a line's width apart
EXCLUDED_LINE_WIDTHS = 1.5  # on each side of a fitted line: they hold what its fit leaves
MAINS_HZ = (50.0, 60.0)  # Hz
MAINS_TOLERANCE_HZ = 0.5  # Hz by which the mains may deviate from 50 or 60 Hz
MAINS_NEIGHBOURHOOD_HZ = 8.0  # Hz about the mains in which the median power is taken as noise
DETECTION_FACTOR = 12.0  # times the median power: noise exceeds it in 1 of 4 000 records
NEIGHBOUR_LINES = 25  # lines on either side of the load from which the noise is estimated
MIN_LINES = 8  # lines needed for an estimate
DENSITY_PADDING = 2  # zero padding of the density: a line between two bins then falls on one
RATE_TOLERANCE = 0.1  # relative deviation of the mains that a wrong sampling rate may cause
CLEAR_LINE_FACTOR = 100.0  # times the median power: so strong a line within that range is the mains at a wrong rate


@dataclass(frozen=True)
class Spectrum:
    """A spectrum |sum_n w_n v_n e^(-j 2 pi f t_n)|^2 at evenly spaced frequencies f: v_n values, t_n times, w_n window.

    Attributes
    ----------
    frequencies
        (k,), Hz.
    sums
        (k, channels), complex, V; their squares are the spectrum's power.
    width
        Of a line, 1 / length of the record, Hz.
    """

    frequencies: Floats
    sums: Complexes
    width: float

    @property
    def power(self) -> Floats:
        """Power, V^2, shape (k, channels)."""
        return np.abs(self.sums) ** 2

    def exclude_lines(self, lines: Floats) -> Spectrum:
        """Return the part that is more than ``EXCLUDED_LINE_WIDTHS`` line widths away from given frequencies (Hz)."""
        far = np.min(np.abs(self.frequencies[:, None] - lines), axis=1) > EXCLUDED_LINE_WIDTHS * self.width
        return Spectrum(self.frequencies[far], self.sums[far], self.width)

    def select_band(self, low: float, high: float) -> Spectrum:
        """Return the part from ``low`` to ``high``, Hz."""
        inside = (self.frequencies >= low) & (self.frequencies <= high)
        return Spectrum(self.frequencies[inside], self.sums[inside], self.width)


def compute_spectrum(samples: Samples, values: Floats, padding: int = PADDING_FACTOR, hann: bool = True) -> Spectrum:
    """Compute the spectrum of values at the samples' indices; gaps count as zeros, fast samples are summed.

    Parameters
    ----------
    samples
        For index and rate.
    values
        (n, channels), V.
    padding
        Length with zeros appended, over the record's length.
    hann
        Whether to use a Hann window; if not, none.
    """
    samples_per_bin = max(1, int(samples.rate // REDUCED_RATE_HZ))
    bins = (samples.index - samples.index[0]) // samples_per_bin
    sums = np.stack([np.bincount(bins, weights=column) for column in values.T], axis=1)
    window = np.hanning(len(sums) + 2)[1:-1, None] if hann else 1.0
    waves = np.fft.rfft(window * sums, n=padding * len(sums), axis=0)
    rate = samples.rate / samples_per_bin
    frequencies = np.asarray(np.fft.rfftfreq(padding * len(sums), 1 / rate), dtype=float)
    return Spectrum(frequencies, waves, rate / len(sums))


def find_strongest(samples: Samples, low: float, high: float) -> float | None:
    """Return the frequency from ``low`` to ``high`` (Hz) with the maximum power, or None if the spectrum has none there.

    The power is summed over channels, each scaled to unit variance.
    """
    centred = samples.volts - samples.volts.mean(axis=0)
    quiet = centred / np.maximum(np.sqrt((centred**2).mean(axis=0)), np.finfo(float).tiny)
    band = compute_spectrum(samples, quiet).select_band(low, min(high, 0.4 * REDUCED_RATE_HZ))
    return float(band.frequencies[np.argmax(band.power.sum(axis=1))]) if len(band.frequencies) else None


def find_mains(samples: Samples, residual: Floats, fitted: Floats) -> float | None:
    """Return a first estimate of the mains' frequency, Hz, or None if no line of the mains is significant.

    Parameters
    ----------
    samples
        For index and rate.
    residual
        (n, channels) of a fit, V.
    fitted
        Frequencies that were fitted, Hz, which are left out of the search.
    """
    remaining = compute_spectrum(samples, residual).exclude_lines(fitted)
    candidates = []
    for nominal in MAINS_HZ:
        neighbourhood, line = (
            remaining.select_band(nominal - reach, nominal + reach) for reach in (MAINS_NEIGHBOURHOOD_HZ, MAINS_TOLERANCE_HZ)
        )
        if len(line.frequencies) and len(neighbourhood.frequencies) > len(line.frequencies):
            floor = np.maximum(np.median(neighbourhood.power, axis=0), np.finfo(float).tiny)
            rise = (line.power / floor).max(axis=1)
            candidates.append((float(rise.max()), float(line.frequencies[np.argmax(rise)])))
    highest, frequency = max(candidates, default=(0.0, 0.0))
    return frequency if highest > DETECTION_FACTOR else _find_misplaced_mains(remaining)


def _find_misplaced_mains(remaining: Spectrum) -> float | None:
    """Return the frequency of a very strong line near 50 or 60 Hz, the mains at a wrong sampling rate, or None."""
    for nominal in MAINS_HZ:
        band = remaining.select_band(nominal * (1 - RATE_TOLERANCE), nominal * (1 + RATE_TOLERANCE))
        if len(band.frequencies) > MIN_LINES:
            rise = (band.power / np.maximum(np.median(band.power, axis=0), np.finfo(float).tiny)).max(axis=1)
            if rise.max() > CLEAR_LINE_FACTOR:
                return float(band.frequencies[np.argmax(rise)])
    return None


def estimate_density(samples: Samples, residual: Floats, frequency: float, fitted: Floats, white: Floats) -> Floats:
    """Estimate the noise near a frequency f as the covariance of white noise of equal density, V^2, (channels, channels).

    The amplitude of a line at f in noise of spectral density S has the variance that white noise of density S(f) would give. This
    is more than the residual's variance suggests if noise rises towards low frequencies, and less if most of it is wandering
    mains. The estimate at f is used where it differs significantly from ``white``.

    Parameters
    ----------
    samples
        Of the record.
    residual
        (n, channels), V.
    frequency
        f, Hz.
    fitted
        Frequencies that were fitted and removed from the residual, Hz.
    white
        Covariance of the residual's samples, V^2.
    """
    spectrum = compute_spectrum(samples, residual, padding=DENSITY_PADDING, hann=False)
    reach = NEIGHBOUR_LINES * spectrum.width
    lines = spectrum.exclude_lines(fitted).select_band(max(2 * spectrum.width, frequency - reach), frequency + reach)
    total, count = (residual**2).sum(axis=0), len(lines.frequencies) // DENSITY_PADDING
    if count < MIN_LINES or not np.all(total > 0):
        return white
    mean_products = (lines.sums.T @ lines.sums.conj()).real / len(lines.frequencies)
    colours = np.diag(mean_products) / total  # power near f over that of white noise of the same variance
    if np.all(np.abs(colours - 1) < 3 / np.sqrt(count)):  # 3 standard deviations of a mean of so many lines
        return white
    scale = np.sqrt(np.diag(white) / total)
    return np.asarray(mean_products * np.outer(scale, scale) * (1 + 2 / count))  # enlarged, since few lines are averaged
