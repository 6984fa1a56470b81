"""Divide charges by each film's own amplifier response, and count the error of a wrong sampling rate.

A sampling rate with a relative error delta gives all frequencies f the same error d ln f = delta, and the amplifiers' response H
is then computed at the wrong frequency:

    d ln H = d ln f / (1 + j w tau)                                                                       (BP.10)

with w = 2 pi f and the amplifier's time constant tau, eq. SI.1; delta is the same in both films and in all readings. It is
estimated as the larger of the drive's tolerance and the difference between the load's frequency as read and as the bench states.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from hw.common.samples import Complexes
from hw.signal.amplifier import compute_parts_covariance, multiplication_matrix
from hw.signal.measure import Measurement
from probe_design.built_probe.bench import SIGNIFICANT_SD, Amplifier, Bench
from probe_design.built_probe.gain_matrix import Gains


def divide_own_amplifiers(measurement: Measurement, amplifier: Amplifier, calibrated_at: float | None = None) -> Measurement:
    """Replace the common amplifier's response by each film's own in the charges of a measurement.

    Parameters
    ----------
    measurement
        With charges by the common amplifier.
    amplifier
        Of the bench.
    calibrated_at
        Frequency at which gains were calibrated, Hz.

    Raises
    ------
    TooSlow
        The load's frequency is far below a corner frequency.
    """
    common, films, frequency = amplifier.build_common(), amplifier.build_films(), measurement.fit.frequency
    if films == (common, common):
        return measurement
    factors = np.array([common.response(frequency) / film_amplifier.response(frequency) for film_amplifier in films])
    charges = measurement.charges * factors
    turn = multiplication_matrix(factors)
    return replace(
        measurement,
        charges=charges,
        covariance=np.asarray(turn @ measurement.covariance @ turn.T),
        tolerance=compute_parts_covariance(charges, films, frequency, calibrated_at),
    )


def add_rate_doubt(measurement: Measurement, bench: Bench, calibrated_at: float | None = None) -> Measurement:
    """Add the error of a wrong sampling rate to a measurement's tolerance, and a warning if the drive's frequency shows one.

    Parameters
    ----------
    measurement
        With charges by each film's own amplifier.
    bench
        For the drive's frequency and the amplifiers.
    calibrated_at
        Frequency of the calibration, Hz, at the same rate: the error that the gains have absorbed is subtracted.
    """
    change = _compute_response_change(bench, measurement.fit.frequency)
    if calibrated_at is not None:
        change = change - _compute_response_change(bench, calibrated_at)
    shift = measurement.charges * change * estimate_rate_doubt(measurement, bench)
    parts = np.stack([shift.real, shift.imag], axis=1).ravel()
    tolerance = measurement.tolerance + np.outer(parts, parts)
    return replace(measurement, tolerance=tolerance, warnings=measurement.warnings + _list_warnings(measurement, bench))


def add_rate_doubt_to_gains(gains: Gains, measurements: Sequence[Measurement], bench: Bench) -> Gains:
    """Add the error of a wrong sampling rate, common to all readings, to the covariance of the gains."""
    doubt = max(estimate_rate_doubt(measurement, bench) for measurement in measurements)
    frequency = float(np.mean([measurement.fit.frequency for measurement in measurements]))
    shift = (_compute_response_change(bench, frequency).real[:, None] * gains.matrix).ravel() * doubt
    return replace(gains, covariance=gains.covariance + np.outer(shift, shift))


def estimate_rate_doubt(measurement: Measurement, bench: Bench) -> float:
    """Return the relative standard deviation of the sampling rate."""
    return max(bench.load.frequency_tolerance, abs(_compute_rate_error(measurement, bench)))


def _compute_rate_error(measurement: Measurement, bench: Bench) -> float:
    return measurement.fit.frequency / bench.load.frequency - 1


def _compute_response_change(bench: Bench, frequency: float) -> Complexes:
    """Return the derivative d ln H / d ln f of both films' amplifiers, eq. BP.10, shape (2,)."""
    taus: Floats = np.array([amplifier.time_constant for amplifier in bench.amplifier.build_films()])
    return np.asarray(1 / (1 + 2j * math.pi * frequency * taus))


def _list_warnings(measurement: Measurement, bench: Bench) -> tuple[str, ...]:
    rate_error, fit = _compute_rate_error(measurement, bench), measurement.fit
    if abs(rate_error) <= SIGNIFICANT_SD * math.hypot(bench.load.frequency_tolerance, fit.frequency_sd / fit.frequency):
        return ()
    side = "above" if rate_error > 0 else "below"
    text = f"the load reads {100 * abs(rate_error):.2g} % {side} the {bench.load.frequency:g} Hz of the bench"
    return (
        f"{text}: the sampling rate or the unit of the times is off as much, or load.frequency of the bench is not the drive's; "
        "counted in the uncertainties",
    )
