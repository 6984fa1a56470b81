"""The force channel's phase beside the films': both feel one load, so that what lags is the channel, and loses amplitude too.

With the films' charges q, their amplifiers divided out, and the force channel F, delayed by d, the lag at the frequency f is

    phi = arg(q_inner + q_outer) - arg F - 2 pi f d                                                        (BP.6)

whatever tissue and probe are; a reversed sensor turns it by pi, which is taken off. A low-pass of first order loses 1 - cos phi
of the amplitude. Play (backlash, dry friction beside a spring) of half-width r at the amplitude A loses more: by its describing
function [1] phi = 4 r / (pi A) and the loss is 16 / (3 pi) (r / A)^(3/2), both to lowest order, together

    loss = 16 / (3 pi) (pi phi / 4)^(3/2)                                                                  (BP.7)

which no other lag of this list exceeds up to 1 rad, and which counts for all.

[1] A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design (1968), appendix B.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hw.common.samples import Complexes, Floats
from hw.signal.amplifier import of_parts
from hw.signal.measure import Measurement, carried
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import Bench

SEEN = 3.0  # standard deviations of a lag; of one that is not seen the loss is below the noise of the amplitudes
TOLD = 1e-3  # loss from which a warning tells it
MOST = 0.2  # rad, beyond which the channel is not used: the loss would be a tenth


def with_force_lag(measurement: Measurement, bench: Bench) -> Measurement:
    """Return a reading with what its force channel's lag leaves in doubt, and a warning where that is more than 0.1 %.

    Args:
        measurement: with each film's own amplifier divided out.
        bench: for the amplifiers' tolerances and the channel's delay.

    Raises:
        Flawed: the lag is above 0.2 rad.
    """
    if measurement.force is None or bench.force is None:
        return measurement
    lag, spread = force_lag(measurement, bench)
    if abs(lag) <= SEEN * spread:
        return measurement
    words = f"the force channel {'lags' if lag > 0 else 'leads'} the films by {abs(lag):.2g} rad"
    if abs(lag) > MOST:
        raise Flawed(f"{words}: a filter, play or friction before the sensor, or amplifiers that are not the bench's")
    doubt = loss(lag)
    told = (f"{words}: its amplitude may be off by {100 * doubt:.2g} %, which is counted; a delay that is known stands in "
            "force.delay of the bench",) if doubt > TOLD else ()  # fmt: skip
    return replace(measurement, force_doubt=doubt, warnings=measurement.warnings + told)


def force_lag(measurement: Measurement, bench: Bench) -> tuple[float, float]:
    """Return the lag of eq. BP.6, rad, from -pi/2 to pi/2, and its standard deviation by noise, parts and sampling."""
    charges, force = measurement.charges, measurement.fit.amplitudes[2:3]
    frequency = measurement.fit.frequency
    spread = measurement.covariance + of_parts(charges, bench.amplifier.of_films(), frequency)
    noise = _phase_variance(charges, spread) + _phase_variance(force, measurement.fit.covariance[4:6, 4:6])
    turn = 2 * math.pi * frequency
    lag = float(np.angle(charges.sum() * np.conj(force[0]))) - turn * (0.0 if bench.force is None else bench.force.delay)
    reversed_off = math.remainder(lag, math.pi)
    return reversed_off, math.hypot(math.sqrt(noise), turn * bench.sampling.skew_tolerance)


def loss(lag: float) -> float:
    """Return the share of its amplitude that a channel of this lag (rad) may have lost, eq. BP.7."""
    return 16 / (3 * math.pi) * math.pow(math.pi * abs(lag) / 4, 1.5)


def _phase_variance(values: Complexes, covariance: Floats) -> float:
    """Of the phase of a sum of amplitudes, (n,), from the covariance of (re, im) of each in turn."""
    scale = float(np.abs(values).max())
    parts = np.stack([values.real, values.imag], axis=1).ravel() / scale
    return float(carried(_phase, parts, covariance / scale**2)[0, 0])


def _phase(parts: Floats) -> Floats:
    return np.array([math.atan2(parts[1::2].sum(), parts[0::2].sum())])
