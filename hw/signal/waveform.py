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
from hw.signal.spectrum import MAINS
from hw.signal.steadiness import steadiness

MOST_LOAD = 0.1  # relative change of the load's amplitude
MOST_PHASE = 0.2  # rad, change of the load's phase
MOST_OWN = 0.02  # relative change of one channel against the others
MOST_BENT = 0.05  # relative error of a channel's amplitude that its nonlinearity may cause
WEAK = 0.1  # of the other film's amplitude: a weaker film shows cross-talk, which may change by more
BENDS = 3.0  # d a_1 / d a_3 of a cubic; of cut peaks 1, of a dead zone 3; d a_1 / d a_2 of cut half-waves up to 2.4
SEEN = 5.0  # standard deviations from which a harmonic is significant
HELD = 0.2  # Hz: grids keep the mains within it but for minutes a year; beyond it the sampling rate is doubted
TOLD = 1e-4  # relative doubt of an amplitude from which a warning reports it


class Flawed(HardwareError):  # noqa: N818 - says what is wrong
    """The reading cannot be used, or not for a calibration."""


@dataclass(frozen=True)
class Doubt:
    """Standard deviations that deviations of the waveform add to the noise.

    Attributes:
        common: relative, common to all amplitudes.
        own: (c,) independent in each channel's amplitude, V.
        warnings: one line each.
    """

    common: float
    own: Floats
    warnings: tuple[str, ...]

    def covariance(self, fit: SineFit) -> Floats:
        """Return the covariance of (re, im) of each channel's amplitude in turn, V^2, like ``SineFit.covariance``."""
        parts = np.stack([fit.amplitudes.real, fit.amplitudes.imag], axis=1).ravel()
        return np.asarray(np.diag(np.repeat(self.own**2, 2)) + self.common**2 * np.outer(parts, parts))


def doubt(fit: SineFit, channels: tuple[str, ...], response: Callable[[float], complex]) -> Doubt:
    """Assess a fit's waveform: refuse large deviations from a steady sine, and count small ones.

    Args:
        fit: of all channels.
        channels: their names; the films are the first two.
        response: of the films' amplifiers, V/C, as a function of frequency in Hz.

    Raises:
        Flawed: the load is not one steady sinusoid, or a channel is too nonlinear.
    """
    noise = np.diag(fit.density)
    steady = steadiness(fit.amplitudes, fit.blocks, fit.blocks_variance, noise)
    if steady.load > MOST_LOAD:
        raise Flawed(f"the load's amplitude changes by up to {100 * steady.load:.2g} % during the reading: keep it steady")
    if steady.phase > MOST_PHASE:
        raise Flawed(f"the load's phase changes by up to {steady.phase:.2g} rad during the reading: hold its frequency, or "
                     "samples are missing that nobody counted")  # fmt: skip
    sizes = np.abs(fit.amplitudes)
    films = np.where(np.arange(len(sizes)) < 2, np.maximum(sizes, WEAK * sizes[:2].max()), sizes)
    orders = np.arange(1, 2 + len(fit.harmonics))
    seen = np.array([response(order * fit.frequency) / response(fit.frequency) for order in orders])
    relative = np.where(np.arange(len(channels)) < 2, seen[1:, None], 1.0)
    harmonic, shared = _bent(replace(fit, harmonics=fit.harmonics / relative), noise, "force" in channels)
    bent = np.hypot(harmonic, fit.bent)
    flaws = {"changes by up to {} % beside the others during the reading": (steady.channels, MOST_OWN),
             "has harmonics that the load has not, worth {} %: is it cut off or overloaded?": (bent, MOST_BENT)}  # fmt: skip
    for text, (found, most) in flaws.items():
        worst = int(np.argmax(found / films))
        if found[worst] > most * films[worst]:
            raise Flawed(f"channel {channels[worst]} " + text.format(f"{100 * found[worst] / films[worst]:.2g}"))
    common = float(np.hypot(np.hypot(steady.load, steady.phase**2 / 2), shared))
    own = np.sqrt(steady.channels**2 + bent**2 + fit.spikes**2)
    return Doubt(common, own, tuple(_warnings(fit, channels, common, own / films)))


def _bent(fit: SineFit, noise: Floats, force: bool) -> tuple[Floats, float]:
    """Return the error that each channel's nonlinearity may cause, V, and that of a nonlinearity common to all, relative.

    A harmonic of the load itself is the same fraction a_h / a_1 of every channel (a_h: amplitude of the h-th harmonic).
    """
    spread = np.sqrt(noise * fit.variance)
    weights = np.abs(fit.amplitudes) ** 2 / np.maximum(noise, np.finfo(float).tiny)
    bent, shared = np.zeros(len(noise)), 0.0
    for order, harmonic in enumerate(fit.harmonics, 2):
        share = harmonic / fit.amplitudes
        mean = (share * weights).sum() / weights.sum()
        own = np.abs(share - mean) * np.abs(fit.amplitudes)
        bent = np.hypot(bent, np.where(own > SEEN * spread, BENDS * own, 0.0))
        if order % 2 and not force and abs(mean) > SEEN / np.sqrt(weights.sum() / fit.variance):
            shared = BENDS * float(abs(mean))  # only a force channel shows that the load has it
    return bent, shared


def _warnings(fit: SineFit, channels: tuple[str, ...], common: float, own: Floats) -> list[str]:
    warnings = []
    if common > 0:
        warnings.append(f"the load changes or is bent by up to {100 * common:.2g} %: counted in the uncertainties")
    warnings += [
        f"channel {name} changes, is bent or has stray rows, worth up to {100 * one:.2g} %: counted in the uncertainties"
        for name, one in zip(channels, own.tolist(), strict=True)
        if one > TOLD
    ]
    if fit.left_out:
        warnings.append(f"{fit.left_out} samples between gaps of unknown length are too few cycles: left out")
    off = None if fit.mains is None else min((fit.mains - nominal for nominal in MAINS), key=abs)
    if fit.mains is not None and off is not None and abs(off) > HELD:
        text = f"a line like the mains stands at {fit.mains:.4g} Hz"
        warnings.append(f"{text}: the sample rate may be off by {100 * off / (fit.mains - off):.2g} %")
    return warnings
