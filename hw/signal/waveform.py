"""Refuse, or count as uncertainty, deviations from a steady sine: nonlinear channels, a changing load, outliers.

Small deviations are counted as if they were standard deviations: a change of one channel cannot be separated from a change of
the load, and it is unknown which part of a reading is the true one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hw.common.errors import HardwareError
from hw.common.samples import Floats
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
MIN_WARNED_DOUBT = 1e-4  # relative doubt of an amplitude from which a warning reports it


class Flawed(HardwareError):  # noqa: N818 - says what is wrong
    """The reading cannot be used, or not for a calibration."""


@dataclass(frozen=True)
class Doubt:
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
        parts = np.stack([fit.amplitudes.real, fit.amplitudes.imag], axis=1).ravel()
        return np.asarray(np.diag(np.repeat(self.channels**2, 2)) + self.common**2 * np.outer(parts, parts))


def assess_waveform(fit: SineFit, channels: tuple[str, ...], response: Callable[[float], complex]) -> Doubt:
    """Assess a fit's waveform: refuse large deviations from a steady sine, and count small ones.

    Parameters
    ----------
    fit
        Of all channels.
    channels
        Their names; the films are the first two.
    response
        Of the films' amplifiers, V/C, as a function of frequency in Hz.

    Raises
    ------
    Flawed
        The load is not one steady sinusoid, or a channel is too nonlinear.
    """
    noise = np.diag(fit.density)
    steady = assess_steadiness(fit.amplitudes, fit.blocks, fit.blocks_variance, noise)
    if steady.load > MAX_LOAD_CHANGE:
        raise Flawed(f"the load's amplitude changes by up to {100 * steady.load:.2g} % during the reading: keep it steady")
    if steady.phase > MAX_PHASE_CHANGE_RAD:
        raise Flawed(f"the load's phase changes by up to {steady.phase:.2g} rad during the reading: hold its frequency, or "
                     "samples are missing that nobody counted")  # fmt: skip
    sizes = np.abs(fit.amplitudes)
    films = np.where(np.arange(len(sizes)) < 2, np.maximum(sizes, WEAK_FILM_RATIO * sizes[:2].max()), sizes)
    orders = np.arange(1, 2 + len(fit.harmonics))
    responses = np.array([response(order * fit.frequency) / response(fit.frequency) for order in orders])
    relative = np.where(np.arange(len(channels)) < 2, responses[1:, None], 1.0)
    harmonic, shared = _estimate_bending(replace(fit, harmonics=fit.harmonics / relative), noise, "force" in channels)
    bent = np.hypot(harmonic, fit.bending)
    flaws = {"changes by up to {} % beside the others during the reading": (steady.channels, MAX_CHANNEL_CHANGE),
             "has harmonics that the load has not, worth {} %: is it cut off or overloaded?": (bent, MAX_BENDING)}  # fmt: skip
    for text, (changes, limit) in flaws.items():
        worst = int(np.argmax(changes / films))
        if changes[worst] > limit * films[worst]:
            raise Flawed(f"channel {channels[worst]} " + text.format(f"{100 * changes[worst] / films[worst]:.2g}"))
    common = float(np.hypot(np.hypot(steady.load, steady.phase**2 / 2), shared))
    channel_doubts = np.sqrt(steady.channels**2 + bent**2 + fit.spikes**2)
    return Doubt(common, channel_doubts, tuple(_list_warnings(fit, channels, common, channel_doubts / films)))


def _estimate_bending(fit: SineFit, noise: Floats, force: bool) -> tuple[Floats, float]:
    """Return the error that each channel's nonlinearity may cause, V, and that of a nonlinearity common to all, relative.

    A harmonic of the load itself is the same fraction a_h / a_1 of every channel (a_h: amplitude of the h-th harmonic).
    """
    spread = np.sqrt(noise * fit.variance)
    weights = np.abs(fit.amplitudes) ** 2 / np.maximum(noise, np.finfo(float).tiny)
    bent, shared = np.zeros(len(noise)), 0.0
    for order, harmonic in enumerate(fit.harmonics, 2):
        share = harmonic / fit.amplitudes
        mean = (share * weights).sum() / weights.sum()
        channel_part = np.abs(share - mean) * np.abs(fit.amplitudes)
        bent = np.hypot(bent, np.where(channel_part > DETECTED_SD * spread, BENDING_FACTOR * channel_part, 0.0))
        if order % 2 and not force and abs(mean) > DETECTED_SD / np.sqrt(weights.sum() / fit.variance):
            shared = BENDING_FACTOR * float(abs(mean))  # only a force channel shows that the load has it
    return bent, shared


def _list_warnings(fit: SineFit, channels: tuple[str, ...], common: float, doubts: Floats) -> list[str]:
    warnings = []
    if common > 0:
        warnings.append(f"the load changes or is bent by up to {100 * common:.2g} %: counted in the uncertainties")
    warnings += [
        f"channel {name} changes, is bent or has stray rows, worth up to {100 * doubt:.2g} %: counted in the uncertainties"
        for name, doubt in zip(channels, doubts.tolist(), strict=True)
        if doubt > MIN_WARNED_DOUBT
    ]
    if fit.left_out:
        warnings.append(f"{fit.left_out} samples between gaps of unknown length are too few cycles: left out")
    deviation = None if fit.mains is None else min((fit.mains - nominal for nominal in MAINS_HZ), key=abs)
    if fit.mains is not None and deviation is not None and abs(deviation) > GRID_TOLERANCE_HZ:
        text = f"a line like the mains stands at {fit.mains:.4g} Hz"
        warnings.append(f"{text}: the sample rate may be off by {100 * deviation / (fit.mains - deviation):.2g} %")
    return warnings
