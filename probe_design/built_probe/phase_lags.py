"""Compare the phases of force channel and films: on elastic references a lag is a fault of a channel, which loses amplitude.

With the films' charges q, divided by their amplifiers' responses, and the force channel F, delayed by d, the lag at the frequency
f is

    phi = arg(q_inner + q_outer) - arg F - 2 pi f d                                                        (BP.6)

for any tissue and probe; a reversed sensor adds pi, which is subtracted. A low-pass of first order loses 1 - cos phi
of the amplitude. Play (backlash, dry friction beside a spring) of half-width r at the amplitude A loses more: by its describing
function [1] phi = 4 r / (pi A) and the loss is 16 / (3 pi) (r / A)^(3/2), both to lowest order, together

    loss = 16 / (3 pi) (pi phi / 4)^(3/2)                                                                  (BP.7)

which no other lag of this list exceeds up to 1 rad, and which is used for all.

Between the films: elastic tissue shifts the phase of neither film, so that a lag means viscous tissue or a fault.
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

from hw.common.samples import Complexes, Floats
from hw.signal.amplifier import compute_parts_covariance
from hw.signal.measure import FILM_NAMES, Measurement, propagate_covariance
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import SIGNIFICANT_SD, Bench, Reference

MIN_LOSS = 1e-3  # relative loss from which a warning reports it
MAX_FORCE_LAG_RAD = 0.2  # rad, beyond which the channel is not used: the loss would be a tenth
MAX_FILM_LAG_RAD = 0.02  # beyond three standard deviations a warning reports it: a film loses 2e-4 of its amplitude by that


def add_force_lag(measurement: Measurement, bench: Bench) -> Measurement:
    """Add the loss that the force channel's lag may cause to a measurement, and a warning if it is more than 0.1 %.

    Parameters
    ----------
    measurement
        With charges by each film's own amplifier.
    bench
        For the amplifiers' tolerances and the channel's delay.

    Raises
    ------
    Flawed
        The lag is above 0.2 rad.
    """
    if measurement.force is None or bench.force is None:
        return measurement
    lag, spread = compute_force_lag(measurement, bench)
    if abs(lag) <= SIGNIFICANT_SD * spread:  # its loss is then smaller than the amplitudes' noise
        return measurement
    text = f"the force channel {'lags' if lag > 0 else 'leads'} the films by {abs(lag):.2g} rad"
    if abs(lag) > MAX_FORCE_LAG_RAD:
        raise Flawed(f"{text}: a filter, play or friction before the sensor, or amplifiers that are not the bench's")
    doubt = estimate_amplitude_loss(lag)
    new_warnings = (f"{text}: its amplitude may be off by {100 * doubt:.2g} %, which is counted; a delay that is known stands in "
            "force.delay of the bench",) if doubt > MIN_LOSS else ()  # fmt: skip
    return replace(measurement, force_doubt=doubt, warnings=measurement.warnings + new_warnings)


def compute_force_lag(measurement: Measurement, bench: Bench) -> tuple[float, float]:
    """Return the lag of eq. BP.6, rad, from -pi/2 to pi/2, and its standard deviation due to noise, parts and sampling."""
    charges, force = measurement.charges, measurement.fit.amplitudes[2:3]
    frequency = measurement.fit.frequency
    spread = measurement.covariance + compute_parts_covariance(charges, bench.amplifier.build_films(), frequency)
    noise = _compute_phase_variance(charges, spread) + _compute_phase_variance(force, measurement.fit.covariance[4:6, 4:6])
    turn = 2 * math.pi * frequency
    lag = float(np.angle(charges.sum() * np.conj(force[0]))) - turn * (0.0 if bench.force is None else bench.force.delay)
    unreversed_lag = math.remainder(lag, math.pi)
    return unreversed_lag, math.hypot(math.sqrt(noise), turn * bench.sampling.skew_tolerance)


def estimate_amplitude_loss(lag: float) -> float:
    """Return the fraction of its amplitude that a channel with this lag (rad) may have lost, eq. BP.7."""
    return 16 / (3 * math.pi) * math.pow(math.pi * abs(lag) / 4, 1.5)


def _compute_phase_variance(values: Complexes, covariance: Floats) -> float:
    """Return the variance of the phase of the sum of amplitudes (n,), from the covariance of (re, im) of each in turn."""
    scale = float(np.abs(values).max())
    parts = np.stack([values.real, values.imag], axis=1).ravel() / scale
    return float(propagate_covariance(_compute_phase, parts, covariance / scale**2)[0, 0])


def _compute_phase(parts: Floats) -> Floats:
    return np.array([math.atan2(parts[1::2].sum(), parts[0::2].sum())])


def list_lag_warnings(measurements: Sequence[Measurement], references: Sequence[Reference], bench: Bench) -> list[str]:
    """List a warning for each film that lags on tissue, with the names of the references.

    Parameters
    ----------
    measurements
        One for each reference, with charges by each film's own amplifier.
    references
        In the same order.
    bench
        For the channels' sampling and the force channel.
    """
    lags: dict[str, list[tuple[str, float]]] = {}
    for measurement, reference in zip(measurements, references, strict=True):
        if reference.on != "tissue":
            continue
        lag, spread = compute_film_lag(measurement, bench)
        if abs(lag) - SIGNIFICANT_SD * spread > MAX_FILM_LAG_RAD:
            lags.setdefault(_describe_late_film(measurement, bench, lag), []).append((reference.name, abs(lag)))
    return [
        f"{', '.join(name for name, _ in entries)}: {fault} by up to {max(lag for _, lag in entries):.2g} rad: tissue "
        "that flows, "
        "or that film's amplifier, filter or cable; the gains are of the parts in phase with the load"
        for fault, entries in lags.items()
    ]


def compute_film_lag(measurement: Measurement, bench: Bench) -> tuple[float, float]:
    """Return by how much the inner film leads the outer one, eq. BP.8, and its standard deviation, both in rad."""
    lag, spread = measurement.lag
    turn = 2 * math.pi * measurement.fit.frequency
    return lag + turn * bench.sampling.skew, math.hypot(spread, turn * bench.sampling.skew_tolerance)


def _describe_late_film(measurement: Measurement, bench: Bench, lag: float) -> str:
    """Describe which film lags; a force channel shows which of both is out of phase."""
    late, early = reversed(FILM_NAMES) if lag > 0 else FILM_NAMES
    text = f"the {late} film lags the {early} film"
    if measurement.force is None or bench.force is None:
        return text
    turn = 2 * math.pi * measurement.fit.frequency
    force = measurement.fit.amplitudes[2] * np.exp(1j * turn * bench.force.delay)
    charges = measurement.charges * np.exp([0.0, -1j * turn * bench.sampling.skew])
    phase_errors = [
        abs(math.remainder(float(np.angle(charge * np.conj(force))), math.pi)) for charge in charges
    ]  # a sensor may be reversed
    return f"{text} (the {FILM_NAMES[int(np.argmax(phase_errors))]} film is out of phase with the force channel)"
