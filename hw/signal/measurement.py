"""Compute the charges of both films, their complex ratio and covariances from samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hw.common.samples import FILM_NAMES, FORCE_CHANNEL, Complexes, Floats
from hw.signal.amplifier import FilmAmplifiers, compute_parts_covariance
from hw.signal.covariance import build_multiplication_matrix, propagate_complex_covariance
from hw.signal.reading_fit import Losses, ReadingFit
from hw.signal.sine_fit import SineFit
from hw.signal.waveform import Flawed, assess_waveform

MIN_DETECTED_STRENGTH = 6.0  # amplitude over its standard deviation: the strongest line of noise alone stays below
MIN_CALIBRATION_STRENGTH = 20.0  # amplitude over its standard deviation that a calibration needs


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
    losses
        Of the reading.
    warnings
        Deviations of the waveform that the covariance counts, one line each.
    force_loss
        Fraction of ``force`` that a lag of the force channel may have removed.
    """

    fit: SineFit
    charges: Complexes
    covariance: Floats
    tolerance: Floats
    force: float | None
    force_sd: float | None
    losses: Losses
    warnings: tuple[str, ...] = ()
    force_loss: float = 0.0

    @property
    def in_phase(self) -> Floats:
        """Components of the charges in phase with their sum, C, shape (2,); their sum is positive."""
        return _project_in_phase(self.charges)

    @property
    def in_phase_covariance(self) -> Floats:
        """Covariance of ``in_phase`` due to noise, C^2, shape (2, 2), by the delta method."""
        return propagate_complex_covariance(_project_in_phase, self.charges, self.covariance)

    @property
    def in_phase_tolerance(self) -> Floats:
        """Covariance of ``in_phase`` due to the amplifiers' tolerances, C^2, shape (2, 2)."""
        return propagate_complex_covariance(_project_in_phase, self.charges, self.tolerance)

    @property
    def lag(self) -> tuple[float, float]:
        """Phase by which the inner charge leads the outer, rad, and its standard deviation due to noise and tolerances."""
        variance = propagate_complex_covariance(_compute_lag, self.charges, self.covariance + self.tolerance)
        return float(_compute_lag(self.charges)[0]), float(np.sqrt(variance[0, 0]))


def measure(
    reading: ReadingFit, amplifiers: FilmAmplifiers, sensitivity: float | None = None, calibrated_at: float | None = None
) -> Measurement:
    """Measure a reading: divide its amplitudes by the responses of the amplifiers.

    Parameters
    ----------
    reading
        The fit, to which all samples have been added.
    amplifiers
        Of the inner and the outer film.
    sensitivity
        Of the force channel, V/N; None: the channel is not used.
    calibrated_at
        Frequency at which gains were calibrated, Hz.

    Raises
    ------
    HardwareError
        No sinusoid can be fitted, no load exceeds the noise, it is not one steady sinusoid, or it is too slow for an amplifier.
    """
    fit, losses = reading.fit(), reading.losses
    responses = np.array([amplifier.response(fit.frequency) for amplifier in amplifiers])
    charges = fit.amplitudes[:2] / responses
    if _compute_strength(charges, _divide_covariance(responses, fit)) < MIN_DETECTED_STRENGTH:
        raise Flawed(f"no load of about {fit.frequency:.4g} Hz stands out from the noise: is it on, is its frequency right?")
    uncertainty = assess_waveform(fit, (*FILM_NAMES, FORCE_CHANNEL)[: len(fit.amplitudes)], amplifiers)
    fit = replace(fit, covariance=fit.covariance + uncertainty.compute_covariance(fit))
    force, force_sd = _compute_force(fit, sensitivity)
    return Measurement(
        fit=fit,
        charges=charges,
        covariance=_divide_covariance(responses, fit),
        tolerance=compute_parts_covariance(charges, amplifiers, fit.frequency, calibrated_at),
        force=force,
        force_sd=force_sd,
        losses=losses,
        warnings=losses.notes + uncertainty.warnings,
    )


def _divide_covariance(responses: Complexes, fit: SineFit) -> Floats:
    """Return the covariance of the films' charges, C^2, shape (4, 4): that of the fitted volts, divided by the responses."""
    division = build_multiplication_matrix(1 / responses)
    # of the fit's amplitudes the first four numbers are the real and imaginary parts of both films'
    return np.asarray(division @ fit.covariance[:4, :4] @ division.T)


def check_measurement(measurement: Measurement, min_cycles: float) -> Measurement:
    """Return the measurement unchanged if a calibration may use it.

    Raises
    ------
    Flawed
        The reading has gaps, overruns, saturation, too few periods of the load, or no load.
    """
    strength = _compute_strength(measurement.charges, measurement.covariance)
    losses, cycles = measurement.losses, measurement.fit.cycles
    flaws = {
        f"{losses.gaps} gaps: samples were lost; read again": losses.gaps > 0,
        f"{losses.overruns} overruns of the device: ask for a lower rate": losses.overruns > 0,
        f"{losses.saturated} samples are saturated: press less, or take a larger feedback capacitance": losses.saturated > 0,
        f"{cycles:.3g} cycles of the load: at least {min_cycles:g} are needed; read longer": cycles < min_cycles,
        f"the load's amplitude is {strength:.2g} of its standard deviation: is the load on?": strength < MIN_CALIBRATION_STRENGTH,
    }
    for text, flawed in flaws.items():
        if flawed:
            raise Flawed(text)
    return measurement


def _compute_strength(charges: Complexes, covariance: Floats) -> float:
    """Return the larger of both films' amplitudes over their standard deviations; ``covariance`` is of (re, im) in turn."""
    return float((np.abs(charges) / np.sqrt(np.diag(covariance)[::2])).max())


def _compute_force(fit: SineFit, sensitivity: float | None) -> tuple[float | None, float | None]:
    """Return the force's amplitude and its standard deviation by noise, N; None without a force channel."""
    if sensitivity is None or len(fit.amplitudes) < 3:
        return None, None
    variance = propagate_complex_covariance(np.abs, fit.amplitudes[2:3], fit.covariance[4:6, 4:6])
    return float(abs(fit.amplitudes[2]) / abs(sensitivity)), float(np.sqrt(variance[0, 0]) / abs(sensitivity))


def _project_in_phase(charges: Complexes) -> Floats:
    """Return the components of complex charges (n,) that are in phase with their sum, shape (n,)."""
    total = charges.sum()
    return np.asarray((charges * np.conj(total) / abs(total)).real)


def _compute_lag(charges: Complexes) -> Floats:
    """Return the phase by which the first of two charges leads the second, rad, shape (1,)."""
    return np.array([np.angle(charges[0] * np.conj(charges[1]))])
