"""Films with amplifiers of their own: charges that were found with the common one, as their own one gives them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hw.signal.amplifier import multiplied, of_parts
from hw.signal.measure import Measurement
from probe_design.built_probe.bench import Amplifier


def with_own_amplifiers(measurement: Measurement, amplifier: Amplifier, calibrated_at: float | None = None) -> Measurement:
    """Return a measurement whose charges are those behind each film's own amplifier.

    Args:
        measurement: with the common amplifier divided out.
        amplifier: of the bench.
        calibrated_at: frequency at which gains were calibrated, Hz.

    Raises:
        TooSlow: the load lies far below a corner.
    """
    common, films, frequency = amplifier.built(), amplifier.of_films(), measurement.fit.frequency
    if films == (common, common):
        return measurement
    factors = np.array([common.response(frequency) / one.response(frequency) for one in films])
    charges = measurement.charges * factors
    turn = multiplied(factors)
    return replace(
        measurement,
        charges=charges,
        covariance=np.asarray(turn @ measurement.covariance @ turn.T),
        tolerance=of_parts(charges, films, frequency, calibrated_at),
    )
