"""The charge amplifier: from volts back to charge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hw.common.errors import HardwareError
from hw.common.samples import Complexes, Floats

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # what multiplication with j does to (re, im)
LEAST = 0.5  # of the corner frequency: below it less than 45 % of the charge is seen, and the corner's error with all its weight


class TooSlow(HardwareError):  # noqa: N818 - says what is wrong with the load
    """A load so slow that its charge leaks away before it is read."""


@dataclass(frozen=True)
class ChargeAmplifier:
    """A high-pass of first order: V = -Q / Cf * j w tau / (1 + j w tau), tau = Rf Cf (SI.1).

    Attributes:
        resistance: Rf, ohm.
        capacitance: Cf, F.
        resistance_tolerance, capacitance_tolerance: relative standard deviations of the parts, of each channel on its own.
    """

    resistance: float = 1e9
    capacitance: float = 1e-9
    resistance_tolerance: float = 0.05
    capacitance_tolerance: float = 0.02

    @property
    def time_constant(self) -> float:
        """tau, s."""
        return self.resistance * self.capacitance

    @property
    def corner(self) -> float:
        """Frequency at which 1/sqrt(2) of the charge is seen, Hz."""
        return 1 / (2 * np.pi * self.time_constant)

    def response(self, frequency: float) -> complex:
        """Volts per coulomb at a frequency (Hz), eq. SI.1.

        Raises:
            TooSlow: it lies far below the corner.
        """
        if not frequency >= LEAST * self.corner:
            text = f"{frequency:.3g} Hz lies far below the charge amplifier's corner of {self.corner:.3g} Hz"
            raise TooSlow(f"{text}: load at {10 * self.corner:.2g} Hz or faster, or take a larger feedback resistance")
        turn = 2j * np.pi * frequency * self.time_constant
        return complex(-turn / (1 + turn) / self.capacitance)

    def tolerance(self, frequency: float, calibrated_at: float | None = None) -> Floats:
        """Covariance of (re, im) of ln of the response by the parts' tolerances, shape (2, 2).

        d ln H = -dC/C + (dR/R + dC/C) / (1 + j w tau) (SI.2). What a calibration at another frequency has seen is subtracted:
        where both are far above the corner nothing is left.

        Args:
            frequency: Hz.
            calibrated_at: Hz; None: gains are nominal.
        """
        by_resistance = 1 / (1 + 2j * np.pi * frequency * self.time_constant)
        by_capacitance = by_resistance - 1
        if calibrated_at is not None:
            calibrated = 1 / (1 + 2j * np.pi * calibrated_at * self.time_constant)
            by_resistance, by_capacitance = by_resistance - calibrated, by_resistance - calibrated
        parts = np.array([by_resistance * self.resistance_tolerance, by_capacitance * self.capacitance_tolerance])
        both = np.stack([parts.real, parts.imag])
        return np.asarray(both @ both.T)


def of_parts(
    charges: Complexes, amplifiers: Sequence[ChargeAmplifier], frequency: float, calibrated_at: float | None = None
) -> Floats:
    """Return the covariance of (re, im) of charges (n,) in turn by their amplifiers' tolerances, eq. SI.2, C^2, (2 n, 2 n)."""
    turn = multiplied(charges)
    return np.asarray(turn @ block_diag(*(one.tolerance(frequency, calibrated_at) for one in amplifiers)) @ turn.T)


def multiplied(factors: Complexes) -> Floats:
    """Return the matrix by which multiplication with complex numbers (n,) turns (re, im) in turn, shape (2 n, 2 n)."""
    return np.asarray(np.kron(np.diag(factors.real), np.eye(2)) + np.kron(np.diag(factors.imag), QUARTER))
