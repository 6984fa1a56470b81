"""Model the charge amplifier: from volts back to charge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.common.errors import HardwareError
from hw.common.samples import Complexes, Floats
from hw.signal.covariance import build_multiplication_matrix

# of the corner frequency: below it under 45 % of the charge is read, and the corner's error counts fully
MIN_FREQUENCY_RATIO = 0.5


class TooSlow(HardwareError):  # noqa: N818 - says what is wrong with the load
    """The load is so slow that its charge leaks away before it is read."""


@dataclass(frozen=True)
class ChargeAmplifier:
    """A charge amplifier, which is a high-pass filter of first order.

    A high-pass of first order: V = -Q / Cf * j w tau / (1 + j w tau), tau = Rf Cf (SI.1). V is the output in V, Q the charge in
    C, w the angular frequency in rad/s, tau the time constant in s.

    Attributes
    ----------
    resistance
        Feedback resistance Rf, ohm.
    capacitance
        Feedback capacitance Cf, F.
    resistance_tolerance, capacitance_tolerance
        Relative standard deviations of the parts, independent in each channel.
    """

    resistance: float = 1e9
    capacitance: float = 1e-9
    resistance_tolerance: float = 0.05
    capacitance_tolerance: float = 0.02

    @property
    def time_constant(self) -> float:
        """Time constant tau, s."""
        return self.resistance * self.capacitance

    @property
    def corner(self) -> float:
        """Corner frequency, Hz, at which 1/sqrt(2) of the charge is read."""
        return 1 / (2 * np.pi * self.time_constant)

    def response(self, frequency: float) -> complex:
        """Return the complex response at a frequency (Hz), V/C, eq. SI.1.

        Raises
        ------
        TooSlow
            The frequency is far below the corner.
        """
        if not frequency >= MIN_FREQUENCY_RATIO * self.corner:
            text = f"{frequency:.3g} Hz lies far below the charge amplifier's corner of {self.corner:.3g} Hz"
            raise TooSlow(f"{text}: load at {10 * self.corner:.2g} Hz or faster, or take a larger feedback resistance")
        j_w_tau = 2j * np.pi * frequency * self.time_constant
        return complex(-j_w_tau / (1 + j_w_tau) / self.capacitance)

    def compute_tolerance(self, frequency: float, calibrated_at: float | None = None) -> Floats:
        """Return the covariance of (re, im) of ln H that the parts' tolerances cause, shape (2, 2).

        d ln H = -dC/C + (dR/R + dC/C) / (1 + j w tau) (SI.2). H is the response, R and C are the feedback resistance and
        capacitance, w and tau as in eq. SI.1. The error at the frequency of a calibration is subtracted, since the gains have
        absorbed it: where both frequencies are far above the corner nothing is left.

        Parameters
        ----------
        frequency
            Of the load, Hz.
        calibrated_at
            Frequency of the calibration, Hz; None: gains are nominal.
        """
        d_resistance = 1 / (1 + 2j * np.pi * frequency * self.time_constant)  # d ln H / d ln R
        d_capacitance = d_resistance - 1  # d ln H / d ln C
        if calibrated_at is not None:
            calibrated = 1 / (1 + 2j * np.pi * calibrated_at * self.time_constant)
            # the same difference for both: the -1 of the capacitance cancels
            d_resistance, d_capacitance = d_resistance - calibrated, d_resistance - calibrated
        parts = np.array([d_resistance * self.resistance_tolerance, d_capacitance * self.capacitance_tolerance])
        columns = np.stack([parts.real, parts.imag])
        return np.asarray(columns @ columns.T)


FilmAmplifiers = tuple[ChargeAmplifier, ChargeAmplifier]  # of the inner and the outer film


def compute_parts_covariance(
    charges: Complexes, amplifiers: FilmAmplifiers, frequency: float, calibrated_at: float | None = None
) -> Floats:
    """Return the covariance of charges that the tolerances of the amplifiers' parts cause, C^2, shape (2 n, 2 n).

    It is that of (re, im) of each charge in turn, from eq. SI.2.

    Parameters
    ----------
    charges
        (n,) complex amplitudes, C.
    amplifiers
        Of these charges, n of them.
    frequency, calibrated_at
        As of ``ChargeAmplifier.compute_tolerance``, Hz.
    """
    relative = np.zeros((2 * len(amplifiers), 2 * len(amplifiers)))
    for k, amplifier in enumerate(amplifiers):
        relative[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = amplifier.compute_tolerance(frequency, calibrated_at)
    multiplication = build_multiplication_matrix(charges)
    return np.asarray(multiplication @ relative @ multiplication.T)
