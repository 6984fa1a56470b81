"""Compute the charges of both films, their complex ratio and covariances from samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hw.common.samples import Complexes, Floats, Samples
from hw.signal.amplifier import ChargeAmplifier, compute_parts_covariance, multiplication_matrix
from hw.signal.sine_fit import SineFit
from hw.signal.stretches import fit_sine
from hw.signal.waveform import Flawed, assess_waveform

FILM_NAMES = ("inner", "outer")
FORCE_CHANNEL = "force"
MIN_DETECTED_STRENGTH = 6.0  # amplitude over its standard deviation: the strongest line of noise alone stays below
MIN_CALIBRATION_STRENGTH = 20.0  # amplitude over its standard deviation that a calibration needs
RELATIVE_STEP = 1e-6  # relative step of the central differences that propagate covariances


@dataclass(frozen=True)
class Losses:
    """The losses of a reading.

    Attributes
    ----------
    saturated
        Number of saturated rows, which are left out.
    gaps
        Number of gaps.
    overruns
        Number of overflows of the device's buffer.
    notes
        Other remarks on the source.
    """

    saturated: int = 0
    gaps: int = 0
    overruns: int = 0
    notes: tuple[str, ...] = ()

    @classmethod
    def from_samples(cls, samples: Samples) -> Losses:
        """Count the losses of samples."""
        return cls(int(samples.saturated.any(axis=1).sum()), len(samples.gaps), samples.overruns, samples.notes)

    def __add__(self, other: Losses) -> Losses:
        """Return the losses of two consecutive parts; the second part's notes include the first's."""
        counts = (self.saturated + other.saturated, self.gaps + other.gaps, self.overruns + other.overruns)
        return Losses(*counts, other.notes)


@dataclass(frozen=True)
class Measurement:
    """The amplitudes of one reading under a sinusoidal load; phases count from the middle of the record.

    Attributes
    ----------
    fit
        Of the volts.
    charges
        (2,) complex amplitudes of the films' charges, inner and outer, C.
    covariance
        Of (re, im) of both charges in turn, C^2, shape (4, 4), due to noise and deviations of the waveform.
    tolerance
        Likewise due to tolerances of the amplifiers' parts, common to all readings at this frequency.
    force
        Amplitude of the reference force, N, or None without that channel.
    force_sd
        Standard deviation of ``force`` due to noise, N.
    saturated
        Number of saturated rows, which are left out.
    lost
        Number of gaps in the record.
    overruns
        Number of overflows of the device's buffer.
    warnings
        Deviations of the waveform that the covariance counts, one line each.
    force_doubt
        Relative error of ``force`` that a lag of the force channel may cause.
    """

    fit: SineFit
    charges: Complexes
    covariance: Floats
    tolerance: Floats
    force: float | None
    force_sd: float | None
    saturated: int
    lost: int
    overruns: int
    warnings: tuple[str, ...] = ()
    force_doubt: float = 0.0

    @property
    def ratio(self) -> complex:
        """Complex ratio of inner to outer charge."""
        return complex(self.charges[0] / self.charges[1])

    @property
    def ratio_covariance(self) -> Floats:
        """Covariance of (re, im) of the ratio due to noise, shape (2, 2), by the delta method."""
        return propagate_covariance(_compute_quotient, _split_parts(self.charges), self.covariance)

    @property
    def in_phase(self) -> Floats:
        """Components of the charges in phase with their sum, C, shape (2,); their sum is positive."""
        return _project_in_phase(_split_parts(self.charges))

    @property
    def in_phase_covariance(self) -> Floats:
        """Covariance of ``in_phase`` due to noise, C^2, shape (2, 2), by the delta method."""
        return propagate_covariance(_project_in_phase, _split_parts(self.charges), self.covariance)

    @property
    def in_phase_tolerance(self) -> Floats:
        """Covariance of ``in_phase`` due to the amplifiers' tolerances, C^2, shape (2, 2)."""
        return propagate_covariance(_project_in_phase, _split_parts(self.charges), self.tolerance)

    @property
    def lag(self) -> tuple[float, float]:
        """Phase by which the inner charge leads the outer, rad, and its standard deviation due to noise and tolerances."""
        covariance = self.covariance + self.tolerance
        return float(_compute_lag(_split_parts(self.charges))[0]), float(
            np.sqrt(propagate_covariance(_compute_lag, _split_parts(self.charges), covariance)[0, 0])
        )


def measure(
    samples: Samples,
    amplifier: ChargeAmplifier,
    frequency: float | None = None,
    sensitivity: float | None = None,
    calibrated_at: float | None = None,
) -> Measurement:
    """Fit a sinusoidal load to samples and divide by the amplifier's response.

    Parameters
    ----------
    samples
        With channels "inner" and "outer", and optionally "force".
    amplifier
        Of each film's channel.
    frequency
        Of the load, Hz; None: searched.
    sensitivity
        Of the force channel, V/N; None: the channel is not used.
    calibrated_at
        Frequency at which gains were calibrated, Hz.

    Raises
    ------
    HardwareError
        A channel is missing, no sinusoid can be fitted, or the load is not steady or too slow for the amplifier.
    """
    used = samples.select_channels(choose_channels(samples, sensitivity is not None))
    return build_measurement(fit_sine(used, frequency), Losses.from_samples(used), amplifier, sensitivity, calibrated_at)


def choose_channels(samples: Samples, force: bool) -> tuple[str, ...]:
    """Choose the channels that a measurement uses: both films', and the force channel if ``force`` is true and it exists.

    Raises
    ------
    Flawed
        A film's channel is missing.
    """
    missing = [name for name in FILM_NAMES if name not in samples.channels]
    if missing:
        raise Flawed(f"no channel {missing[0]!r} among {', '.join(samples.channels)}: both films are needed")
    return (*FILM_NAMES, FORCE_CHANNEL) if force and FORCE_CHANNEL in samples.channels else FILM_NAMES


def build_measurement(
    fit: SineFit,
    losses: Losses,
    amplifier: ChargeAmplifier,
    sensitivity: float | None = None,
    calibrated_at: float | None = None,
) -> Measurement:
    """Build a measurement from a fit: divide by the amplifier's response. For the other arguments see ``measure``.

    Raises
    ------
    HardwareError
        No load exceeds the noise, it is not one steady sinusoid, or it is too slow for the amplifier.
    """
    response = amplifier.response(fit.frequency)
    charges = fit.amplitudes[:2] / response
    covariance = _divide_covariance(response, fit.covariance[:4, :4])
    if _compute_strength(charges, covariance) < MIN_DETECTED_STRENGTH:
        raise Flawed(f"no load of about {fit.frequency:.4g} Hz stands out from the noise: is it on, is its frequency right?")
    doubts = assess_waveform(fit, (*FILM_NAMES, FORCE_CHANNEL)[: len(fit.amplitudes)], amplifier.response)
    counted_fit = replace(fit, covariance=fit.covariance + doubts.compute_covariance(fit))
    force, force_sd = _compute_force(counted_fit, sensitivity)
    return Measurement(
        fit=counted_fit,
        charges=charges,
        covariance=_divide_covariance(response, counted_fit.covariance[:4, :4]),
        tolerance=compute_parts_covariance(charges, (amplifier, amplifier), fit.frequency, calibrated_at),
        force=force,
        force_sd=force_sd,
        saturated=losses.saturated,
        lost=losses.gaps,
        overruns=losses.overruns,
        warnings=losses.notes + doubts.warnings,
    )


def _divide_covariance(response: complex, covariance: Floats) -> Floats:
    turn = multiplication_matrix(np.full(2, 1 / response))
    return np.asarray(turn @ covariance @ turn.T)


def check_measurement(measurement: Measurement, min_cycles: float) -> Measurement:
    """Return the measurement unchanged if a calibration may use it.

    Raises
    ------
    Flawed
        The reading has gaps, overruns, saturation, too few periods of the load, or no load.
    """
    strength = _compute_strength(measurement.charges, measurement.covariance)
    flaws = {
        f"{measurement.lost} gaps: samples were lost; read again": measurement.lost > 0,
        f"{measurement.overruns} overruns of the device: ask for a lower rate": measurement.overruns > 0,
        f"{measurement.saturated} samples are saturated: press less, or take a larger feedback capacitance": measurement.saturated
        > 0,
        f"{measurement.fit.cycles:.3g} cycles of the load: at least {min_cycles:g} are needed; read longer": (
            measurement.fit.cycles < min_cycles
        ),
        f"the load's amplitude is {strength:.2g} of its standard deviation: is the load on?": strength < MIN_CALIBRATION_STRENGTH,
    }
    for text, flawed in flaws.items():
        if flawed:
            raise Flawed(text)
    return measurement


def _compute_strength(charges: Complexes, covariance: Floats) -> float:
    """Return the larger of both films' amplitudes over their standard deviations."""
    return float((np.abs(charges) / np.sqrt(np.diag(covariance)[::2])).max())


def propagate_covariance(function: Callable[[Floats], Floats], values: Floats, covariance: Floats) -> Floats:
    """Return the covariance of a function's values: delta method, with derivatives by central differences."""
    step = RELATIVE_STEP * float(np.abs(values).max())
    shifts = step * np.eye(len(values))
    derivatives = np.stack([(function(values + shift) - function(values - shift)) / (2 * step) for shift in shifts], axis=1)
    return np.asarray(derivatives @ covariance @ derivatives.T)


def _compute_force(fit: SineFit, sensitivity: float | None) -> tuple[float | None, float | None]:
    if sensitivity is None or len(fit.amplitudes) < 3:
        return None, None
    spread = propagate_covariance(_compute_amplitude, _split_parts(fit.amplitudes[2:3]), fit.covariance[4:6, 4:6])
    return float(abs(fit.amplitudes[2]) / abs(sensitivity)), float(np.sqrt(spread[0, 0]) / abs(sensitivity))


def _split_parts(values: Complexes) -> Floats:
    return np.stack([values.real, values.imag], axis=1).ravel()


def _join_parts(parts: Floats) -> Complexes:
    return np.asarray(parts[0::2] + 1j * parts[1::2])


def _compute_quotient(parts: Floats) -> Floats:
    inner, outer = _join_parts(parts)
    return np.array([(inner / outer).real, (inner / outer).imag])


def _project_in_phase(parts: Floats) -> Floats:
    charges = _join_parts(parts)
    total = charges.sum()
    return np.asarray((charges * np.conj(total) / abs(total)).real)


def _compute_lag(parts: Floats) -> Floats:
    inner, outer = _join_parts(parts)
    return np.array([np.angle(inner * np.conj(outer))])


def _compute_amplitude(parts: Floats) -> Floats:
    return np.abs(_join_parts(parts))
