"""Count the errors of wrong times: a wrong sampling rate, a lag of the force channel, a lag between the films.

**Sampling rate.** A rate with a relative error delta gives all frequencies f the same error d ln f = delta, and the amplifiers'
response H is then computed at the wrong frequency:

    d ln H = d ln f / (1 + j w tau)                                                                       (BP.10)

with w = 2 pi f and the amplifier's time constant tau, eq. SI.1; delta is the same in both films and in all readings. It is
estimated as the larger of the drive's tolerance and the difference between the load's frequency as read and as the bench states.

**Force channel.** On elastic references a lag is a fault of a channel, which loses amplitude. With the films' charges q, divided
by their amplifiers' responses, and the force channel F, delayed by d, the lag at the frequency f is

    phi = arg(q_inner + q_outer) - arg F - 2 pi f d                                                        (BP.6)

for any tissue and probe; a reversed sensor adds pi, which is subtracted. A low-pass of first order loses 1 - cos phi
of the amplitude. Play (backlash, dry friction beside a spring) of half-width r at the amplitude A loses more: by its describing
function [1] phi = 4 r / (pi A) and the loss is 16 / (3 pi) (r / A)^(3/2), both to lowest order, together

    loss = 16 / (3 pi) (pi phi / 4)^(3/2)                                                                  (BP.7)

which no other lag of this list exceeds up to 1 rad, and which is used for all.

**Films.** Elastic tissue shifts the phase of neither film, so that a lag between them means viscous tissue or a fault.
With both charges q, divided by their amplifiers' responses, and the outer channel sampled later than the inner by s, the inner
leads by

    phi = arg(q_inner / q_outer) + 2 pi f s                                                                (BP.8)

On a pin or a ring the film that is not pressed shows cross-talk, which may have either sign, and whose phase is no lag.

[1] A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design (1968), appendix B.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.common.percent import format_percent
from hw.common.samples import FILM_NAMES, Complexes, Floats
from hw.signal.amplifier import compute_parts_covariance
from hw.signal.covariance import propagate_complex_covariance, split_parts
from hw.signal.measurement import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import SIGNIFICANT_SD, Bench, Reference
from probe_design.built_probe.gains import Gains

MIN_WARNED_LOSS = 1e-3  # fraction of the amplitude
MAX_FORCE_LAG_RAD = 0.2  # rad, beyond which the channel is not used: the loss would be a tenth
MAX_FILM_LAG_RAD = 0.02  # beyond three standard deviations a warning reports it: a film loses 2e-4 of its amplitude by that


def count_rate_error(measurement: Measurement, bench: Bench, calibrated_at: float | None = None) -> Measurement:
    """Add the error of a wrong sampling rate to a measurement's tolerance, and a warning if the drive's frequency shows one.

    Parameters
    ----------
    measurement
        Of both films.
    bench
        For the drive's frequency and the amplifiers.
    calibrated_at
        Frequency of the calibration, Hz, recorded at the same sampling rate, or None. The gains have absorbed the error at this
        frequency, which is therefore subtracted.
    """
    change = _differentiate_responses(bench, measurement.fit.frequency)
    if calibrated_at is not None:
        change = change - _differentiate_responses(bench, calibrated_at)
    shift = split_parts(measurement.charges * change * _estimate_rate_sd(measurement, bench))
    warnings = (*measurement.warnings, *_warn_of_wrong_rate(measurement, bench))
    return replace(measurement, tolerance=measurement.tolerance + np.outer(shift, shift), warnings=warnings)


def count_rate_error_of_gains(gains: Gains, measurements: Sequence[Measurement], bench: Bench) -> Gains:
    """Add the error of a wrong sampling rate, common to all readings, to the covariance of the gains."""
    rate_sd = max(_estimate_rate_sd(measurement, bench) for measurement in measurements)
    frequency = float(np.mean([measurement.fit.frequency for measurement in measurements]))
    shift = (_differentiate_responses(bench, frequency).real[:, None] * gains.matrix).ravel() * rate_sd
    return replace(gains, covariance=gains.covariance + gains.pad_entries(np.outer(shift, shift)))


def _estimate_rate_sd(measurement: Measurement, bench: Bench) -> float:
    """Return the relative standard deviation of the sampling rate, delta in eq. BP.10."""
    return max(bench.load.frequency_tolerance, abs(measurement.fit.frequency / bench.load.frequency - 1))


def _differentiate_responses(bench: Bench, frequency: float) -> Complexes:
    """Return the derivative d ln H / d ln f of both films' amplifiers, eq. BP.10, shape (2,)."""
    time_constants = np.array([amplifier.time_constant for amplifier in bench.amplifier.build_films()])
    return np.asarray(1 / (1 + 2j * math.pi * frequency * time_constants))


def _warn_of_wrong_rate(measurement: Measurement, bench: Bench) -> list[str]:
    """Return a warning if the load's frequency differs significantly from the drive's."""
    fit = measurement.fit
    error = fit.frequency / bench.load.frequency - 1
    if abs(error) <= SIGNIFICANT_SD * math.hypot(bench.load.frequency_tolerance, fit.frequency_sd / fit.frequency):
        return []
    side = "above" if error > 0 else "below"
    return [
        f"the load reads {format_percent(abs(error))} {side} the {bench.load.frequency:g} Hz of the bench: the sampling rate or "
        "the unit of the times is off as much, or load.frequency of the bench is not the drive's; counted in the uncertainties"
    ]


def count_force_lag(measurement: Measurement, bench: Bench) -> Measurement:
    """Add the loss of amplitude that the force channel's lag may cause to a measurement.

    A warning is added if the loss is above ``MIN_WARNED_LOSS``.

    Parameters
    ----------
    measurement
        Of films and force channel.
    bench
        For the amplifiers' tolerances and the channel's delay.

    Raises
    ------
    Flawed
        The lag is above ``MAX_FORCE_LAG_RAD``.
    """
    if measurement.force is None or bench.force is None:
        return measurement
    lag, lag_sd = compute_force_lag(measurement, bench)
    if abs(lag) <= SIGNIFICANT_SD * lag_sd:  # its loss is then smaller than the amplitudes' noise
        return measurement
    text = f"the force channel {'lags' if lag > 0 else 'leads'} the films by {abs(lag):.2g} rad"
    if abs(lag) > MAX_FORCE_LAG_RAD:
        raise Flawed(f"{text}: a filter, play or friction before the sensor, or amplifiers that are not the bench's")
    loss, warnings = estimate_amplitude_loss(lag), measurement.warnings
    if loss > MIN_WARNED_LOSS:
        counted = f"its amplitude may be in error by {format_percent(loss)}, which is counted"
        warnings += (f"{text}: {counted}; a delay that is known stands in force.delay of the bench",)
    return replace(measurement, force_loss=loss, warnings=warnings)


def compute_force_lag(measurement: Measurement, bench: Bench) -> tuple[float, float]:
    """Return the lag of eq. BP.6, rad, from -pi/2 to pi/2, and its standard deviation due to noise, parts and sampling."""
    charges, force, frequency = measurement.charges, measurement.fit.amplitudes[2:3], measurement.fit.frequency
    charges_covariance = measurement.covariance + compute_parts_covariance(charges, bench.amplifier.build_films(), frequency)
    angular_frequency, delay = 2 * math.pi * frequency, 0.0 if bench.force is None else bench.force.delay
    lag = float(np.angle(charges.sum() * np.conj(force[0]))) - angular_frequency * delay
    variance = (
        propagate_complex_covariance(_compute_sum_phase, charges, charges_covariance)[0, 0]
        + propagate_complex_covariance(_compute_sum_phase, force, measurement.fit.covariance[4:6, 4:6])[0, 0]
        + (angular_frequency * bench.sampling.skew_tolerance) ** 2
    )
    return math.remainder(lag, math.pi), math.sqrt(variance)  # modulo pi: a reversed sensor adds pi


def _compute_sum_phase(values: Complexes) -> Floats:
    """Return the phase of the sum of complex values, rad, shape (1,)."""
    return np.array([np.angle(values.sum())])


def estimate_amplitude_loss(lag: float) -> float:
    """Return the fraction of its amplitude that a channel with this lag (rad) may have lost, eq. BP.7."""
    return 16 / (3 * math.pi) * math.pow(math.pi * abs(lag) / 4, 1.5)


def list_lag_warnings(measurements: Sequence[Measurement], references: Sequence[Reference], bench: Bench) -> list[str]:
    """List a warning for each film that lags on tissue, with the names of the references.

    Parameters
    ----------
    measurements
        One for each reference.
    references
        In the same order.
    bench
        For the channels' sampling and the force channel.
    """
    lags: dict[str, list[tuple[str, float]]] = {}  # name of the reference and lag, by fault
    for measurement, reference in zip(measurements, references, strict=True):
        if reference.on != "tissue":
            continue
        lag, lag_sd = compute_film_lag(measurement, bench)
        if abs(lag) - SIGNIFICANT_SD * lag_sd > MAX_FILM_LAG_RAD:
            lags.setdefault(_describe_late_film(measurement, bench, lag), []).append((reference.name, abs(lag)))
    return [
        f"{', '.join(name for name, _ in entries)}: {fault} by up to {max(lag for _, lag in entries):.2g} rad: tissue that "
        "flows, or that film's amplifier, filter or cable; the gains are of the parts in phase with the load"
        for fault, entries in lags.items()
    ]


def compute_film_lag(measurement: Measurement, bench: Bench) -> tuple[float, float]:
    """Return by how much the inner film leads the outer one, eq. BP.8, and its standard deviation, both in rad."""
    lag, lag_sd = measurement.lag
    angular_frequency = 2 * math.pi * measurement.fit.frequency
    return lag + angular_frequency * bench.sampling.skew, math.hypot(lag_sd, angular_frequency * bench.sampling.skew_tolerance)


def _describe_late_film(measurement: Measurement, bench: Bench, lag: float) -> str:
    """Describe which film lags; a force channel shows which of both is out of phase."""
    late, early = reversed(FILM_NAMES) if lag > 0 else FILM_NAMES  # a positive lag: the inner film leads
    text = f"the {late} film lags the {early} film"
    if measurement.force is None or bench.force is None:
        return text
    angular_frequency = 2 * math.pi * measurement.fit.frequency
    force = measurement.fit.amplitudes[2] * np.exp(1j * angular_frequency * bench.force.delay)
    phases = np.angle(measurement.charges * np.exp([0.0, -1j * angular_frequency * bench.sampling.skew]) * np.conj(force))
    phase_errors = [abs(math.remainder(phase, math.pi)) for phase in phases.tolist()]  # a sensor may be reversed
    return f"{text} (the {FILM_NAMES[int(np.argmax(phase_errors))]} film is out of phase with the force channel)"
