"""What a fit leaves that is no noise: rows that do not belong, and products of load and mains that a curved characteristic makes.

Where mains outweigh the load, an amplifier that is overloaded leaves the load's harmonics alone and takes from its amplitude all
the same. What is left of the fit is then like the square or the cube of what was fitted.
"""

from __future__ import annotations

import numpy as np

from hw.common.samples import Floats
from hw.signal.sine_model import Lines, normal_equations, residual

OUT = 6.0  # standard deviations from which a row does not belong to the noise
MEDIAN = 1.4826  # standard deviations to the median of white noise's size
SEEN = 6.0  # standard deviations of a likeness
POWERS = (2, 3)
LEAST = 2e-3  # mean square of a power, its largest value 1, that the fit's columns leave: below it the load's harmonics tell all


def spikes(left: Floats, period: float) -> Floats:
    """Return by how much rows that stand out may have changed each amplitude, V, (channels,): bursts, independent of each other.

    Args:
        left: (n, channels) what a fit leaves, V.
        period: of the load, rows.
    """
    size = np.abs(left)
    out = size > OUT * MEDIAN * np.median(size, axis=0)
    most = []
    for column, standing in zip(size.T, out.T, strict=True):
        at = np.flatnonzero(standing)
        burst = np.cumsum(np.diff(at, prepend=at[:1]) > period / 2)
        most.append(np.sqrt((np.bincount(burst, column[at]) ** 2).sum()) * 2 / len(left))
    return np.array(most)


def bending(lines: Lines, t: Floats, fitted: Floats, left: Floats) -> Floats:
    """Return by how much bending may have changed each channel's amplitude, V, (channels,); 0 where none shows.

    Args:
        lines: of the fit.
        t: (n,) times from the middle of the record, s.
        fitted: (n, channels) what the fit explains, V.
        left: (n, channels) what it leaves.
    """
    scaled: Floats = np.asarray(fitted / np.maximum(np.abs(fitted).max(axis=0), np.finfo(float).tiny), dtype=float)
    most = np.zeros(left.shape[1])
    for power in POWERS:
        coefficients: Floats = np.linalg.solve(*normal_equations(lines, t, scaled**power)).astype(float)
        rest = residual(lines, t, scaled**power, coefficients)
        square = (rest**2).sum(axis=0)
        clear = square > LEAST * len(t)
        share = np.where(clear, (rest * left).sum(axis=0) / np.where(clear, square, 1.0), 0.0)
        spread = np.sqrt((left**2).mean(axis=0) / np.where(clear, square, 1.0))
        seen = np.abs(share) > SEEN * spread
        most = np.hypot(most, np.where(seen, np.abs(share) * np.hypot(*coefficients[:2]), 0.0))
    return most
