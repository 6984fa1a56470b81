"""Refuse, or count as uncertainty, deviations from a steady sine: nonlinear channels, a changing load, outliers.

Small deviations are counted as if they were standard deviations: a change of one channel cannot be separated from a change of
the load, and it is unknown which part of a reading is the true one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hw.common.errors import HardwareError
from hw.common.samples import FORCE_CHANNEL, Floats
from hw.signal.amplifier import FilmAmplifiers
from hw.signal.covariance import split_parts
from hw.signal.sine_fit import SineFit
from hw.signal.spectrum import MAINS_HZ
from hw.signal.steadiness import assess_steadiness

MAX_LOAD_CHANGE = 0.1  # relative change of the load's amplitude
MAX_PHASE_CHANGE_RAD = 0.2  # rad, change of the load's phase
MAX_CHANNEL_CHANGE = 0.02  # relative change of one channel against the others
MAX_BENDING = 0.05  # relative error of a channel's amplitude that its nonlinearity may cause
WEAK_FILM_RATIO = 0.1  # of the other film's amplitude: a weaker film shows cross-talk, which may change by more
BENDING_FACTOR = 3.0  # d a_1 / d a_3 of a cubic; of cut peaks 1, of a dead zone 3; d a_1 / d a_2 of cut half-waves up to 2.4
DETECTED_SD = 5.0  # standard deviations from which a harmonic is significant
GRID_TOLERANCE_HZ = 0.2  # Hz: grids keep the mains within it but for minutes a year; beyond it the sampling rate is doubted
MIN_WARNED_SD = 1e-4  # relative standard deviation of an amplitude from which a warning reports it


class Flawed(HardwareError):  # noqa: N818 - says what is wrong
    """The reading cannot be used, or not for a calibration."""


@dataclass(frozen=True)
class WaveformUncertainty:
    """Standard deviations that deviations of the waveform add to the noise.

    Attributes
    ----------
    common
        Relative, common to all amplitudes.
    channels
        (c,) independent in each channel's amplitude, V.
    warnings
        One line each.
    """

    common: float
    channels: Floats
    warnings: tuple[str, ...]

    def compute_covariance(self, fit: SineFit) -> Floats:
        """Return the covariance of (re, im) of each channel's amplitude in turn, V^2, like ``SineFit.covariance``."""
        parts = split_parts(fit.amplitudes)
        return np.asarray(np.diag(np.repeat(self.channels**2, 2)) + self.common**2 * np.outer(parts, parts))


def assess_waveform(fit: SineFit, channels: tuple[str, ...], amplifiers: FilmAmplifiers) -> WaveformUncertainty:
    """Assess a fit's waveform: refuse large deviations from a steady sine, and count small ones.

    Parameters
    ----------
    fit
        Of all channels.
    channels
        Their names; the films are the first two.
    amplifiers
        Of the films: their responses differ from harmonic to harmonic.

    Raises
    ------
    Flawed
        The load is not one steady sinusoid, or a channel is too nonlinear.
    """
    noise = np.diag(fit.density)
    steadiness = assess_steadiness(fit.amplitudes, fit.blocks, fit.blocks_variance, noise)
    if steadiness.load > MAX_LOAD_CHANGE:
        raise Flawed(f"the load's amplitude changes by up to {100 * steadiness.load:.2g} % during the reading: keep it steady")
    if steadiness.phase > MAX_PHASE_CHANGE_RAD:
        change = f"the load's phase changes by up to {steadiness.phase:.2g} rad during the reading"
        raise Flawed(f"{change}: hold its frequency, or samples are missing that nobody counted")
    channel_bending, common_bending = _estimate_bending(_divide_harmonics(fit, amplifiers), noise, FORCE_CHANNEL in channels)
    bending = np.hypot(channel_bending, fit.bending)
    sizes = np.abs(fit.amplitudes)
    sizes[:2] = np.maximum(sizes[:2], WEAK_FILM_RATIO * sizes[:2].max())
    flaws = {
        "changes by up to {} % beside the others during the reading": (steadiness.channels / sizes, MAX_CHANNEL_CHANGE),
        "has harmonics that the load has not, worth {} %: is it cut off or overloaded?": (bending / sizes, MAX_BENDING),
    }
    for text, (relative_changes, limit) in flaws.items():
        worst = int(np.argmax(relative_changes))
        if relative_changes[worst] > limit:
            raise Flawed(f"channel {channels[worst]} " + text.format(f"{100 * relative_changes[worst]:.2g}"))
    common_sd = float(np.sqrt(steadiness.load**2 + (steadiness.phase**2 / 2) ** 2 + common_bending**2))
    channel_sds = np.sqrt(steadiness.channels**2 + bending**2 + fit.spikes**2)
    return WaveformUncertainty(common_sd, channel_sds, tuple(_list_warnings(fit, channels, common_sd, channel_sds / sizes)))


def _divide_harmonics(fit: SineFit, amplifiers: FilmAmplifiers) -> SineFit:
    """Divide the films' harmonics by their amplifiers' responses, relative to that at the load's frequency."""
    harmonics = fit.harmonics.copy()
    for film, amplifier in enumerate(amplifiers):
        for k in range(len(harmonics)):
            harmonics[k, film] *= amplifier.response(fit.frequency) / amplifier.response((k + 2) * fit.frequency)
    return replace(fit, harmonics=harmonics)


def _estimate_bending(fit: SineFit, noise: Floats, has_force: bool) -> tuple[Floats, float]:
    """Return the error that each channel's nonlinearity may cause, V, and the relative error of one common to all channels.

    Parameters
    ----------
    fit
        With harmonics divided by the amplifiers' responses.
    noise
        Variance of a sample of each channel, V^2, shape (channels,).
    has_force
        Whether there is a force channel.

    A harmonic of the load itself is the same fraction a_h / a_1 of every channel (a_h: amplitude of the h-th harmonic).
    """
    amplitude_sds = np.sqrt(noise * fit.variance)
    weights = np.abs(fit.amplitudes) ** 2 / np.maximum(noise, np.finfo(float).tiny)
    channel_bending, common_bending = np.zeros(len(noise)), 0.0
    for order, harmonic in enumerate(fit.harmonics, 2):
        fractions = harmonic / fit.amplitudes
        mean = (fractions * weights).sum() / weights.sum()
        excess = np.abs(fractions - mean) * np.abs(fit.amplitudes)
        channel_bending = np.hypot(channel_bending, np.where(excess > DETECTED_SD * amplitude_sds, BENDING_FACTOR * excess, 0.0))
        # of odd harmonics in all channels only a force channel shows whether the load has them
        if order % 2 and not has_force and abs(mean) > DETECTED_SD / np.sqrt(weights.sum() / fit.variance):
            common_bending = BENDING_FACTOR * float(abs(mean))
    return channel_bending, common_bending


def _list_warnings(fit: SineFit, channels: tuple[str, ...], common_sd: float, relative_sds: Floats) -> list[str]:
    """List warnings: deviations that the uncertainties count, samples left out, and mains that suggest a wrong sampling rate.

    ``common_sd`` and ``relative_sds`` (channels,) are relative standard deviations, common to all amplitudes and of each.
    """
    warnings = []
    if common_sd > 0:
        warnings.append(f"the load changes or is bent by up to {100 * common_sd:.2g} %: counted in the uncertainties")
    warnings += [
        f"channel {name} changes, is bent or has stray rows, worth up to {100 * sd:.2g} %: counted in the uncertainties"
        for name, sd in zip(channels, relative_sds.tolist(), strict=True)
        if sd > MIN_WARNED_SD
    ]
    if fit.left_out:
        warnings.append(f"{fit.left_out} samples between gaps of unknown length are too few cycles: left out")
    mains = fit.mains
    if mains is not None:
        nominal = min(MAINS_HZ, key=lambda frequency: abs(mains - frequency))
        if abs(mains - nominal) > GRID_TOLERANCE_HZ:
            text = f"a line like the mains stands at {mains:.4g} Hz"
            warnings.append(f"{text}: the sample rate may be in error by {100 * (mains / nominal - 1):.2g} %")
    return warnings
