"""From samples to the charges of both films, their complex ratio and everything's covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hw.common.errors import HardwareError
from hw.common.samples import Floats, Samples
from hw.signal.amplifier import ChargeAmplifier
from hw.signal.sine_fit import Complexes, SineFit, sine_fit

FILMS = ("inner", "outer")
FORCE = "force"
LEAST_SEEN = 6.0  # amplitude over its standard deviation: noise alone, looked for near a frequency, stays below
LEAST_STRENGTH = 20.0  # likewise, of a reading that calibrates
STEP = 1e-6  # of the central differences by which covariances are carried on, relative


class Flawed(HardwareError):  # noqa: N818 - says what is wrong
    """A reading that a calibration may not use."""


@dataclass(frozen=True)
class Measurement:
    """What one reading says of a sinusoidal load; phases count from the middle of the record.

    Attributes:
        fit: of the volts.
        charges: (2,) complex amplitudes of the films' charges, inner and outer, C.
        covariance: of (re, im) of both in turn, C^2, shape (4, 4): noise alone.
        tolerance: likewise what the amplifiers' parts may add, the same at every reading at this frequency.
        force: amplitude of the reference force, N, or None without that channel.
        force_sd: by noise, N.
        saturated: how many rows were, and were left out.
        lost: how many gaps the record has.
        overruns: of the device.
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

    @property
    def ratio(self) -> complex:
        """Inner over outer charge."""
        return complex(self.charges[0] / self.charges[1])

    @property
    def ratio_covariance(self) -> Floats:
        """Of (re, im) of the ratio by noise, shape (2, 2): delta method."""
        return carried(_quotient, _parts(self.charges), self.covariance)

    @property
    def in_phase(self) -> Floats:
        """The charges' parts in phase with their sum, C, shape (2,); their sum is positive."""
        return _in_phase(_parts(self.charges))

    @property
    def in_phase_covariance(self) -> Floats:
        """Of ``in_phase`` by noise, C^2, shape (2, 2): delta method."""
        return carried(_in_phase, _parts(self.charges), self.covariance)

    @property
    def in_phase_tolerance(self) -> Floats:
        """Of ``in_phase`` by the amplifiers' parts, C^2, shape (2, 2)."""
        return carried(_in_phase, _parts(self.charges), self.tolerance)

    @property
    def lag(self) -> tuple[float, float]:
        """By how much the inner charge leads the outer, rad, and its standard deviation by noise and tolerances."""
        both = self.covariance + self.tolerance
        return float(_lag(_parts(self.charges))[0]), float(np.sqrt(carried(_lag, _parts(self.charges), both)[0, 0]))


def measure(
    samples: Samples,
    amplifier: ChargeAmplifier,
    frequency: float | None = None,
    sensitivity: float | None = None,
    calibrated_at: float | None = None,
) -> Measurement:
    """Fit a sinusoidal load and divide the amplifier out.

    Args:
        samples: with channels "inner" and "outer", and perhaps "force".
        amplifier: of each film's channel.
        frequency: of the load, Hz; None: looked for.
        sensitivity: of the force channel, V/N; None: the channel is not used.
        calibrated_at: frequency at which gains were calibrated, Hz.

    Raises:
        HardwareError: a channel is missing, no sinusoid can be fitted, or the load is too slow for the amplifier.
    """
    missing = [name for name in FILMS if name not in samples.channels]
    if missing:
        raise Flawed(f"no channel {missing[0]!r} among {', '.join(samples.channels)}: both films are needed")
    fit = sine_fit(samples, frequency)
    films = [samples.channels.index(name) for name in FILMS]
    response = amplifier.response(fit.frequency)
    charges = fit.amplitudes[films] / response
    turn = _real(1 / response, 2)
    rows = [2 * channel + part for channel in films for part in (0, 1)]
    tolerance = np.zeros((4, 4))
    for k, charge in enumerate(charges):
        scale = _real(charge, 1)
        tolerance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = scale @ amplifier.tolerance(fit.frequency, calibrated_at) @ scale.T
    covariance = turn @ fit.covariance[np.ix_(rows, rows)] @ turn.T
    if _strength(charges, covariance) < LEAST_SEEN:
        raise Flawed(f"no load of about {fit.frequency:.4g} Hz stands out from the noise: is it on, is its frequency right?")
    force, force_sd = _force(samples, fit, sensitivity)
    return Measurement(
        fit=fit,
        charges=charges,
        covariance=covariance,
        tolerance=tolerance,
        force=force,
        force_sd=force_sd,
        saturated=int(samples.saturated.any(axis=1).sum()),
        lost=len(samples.gaps),
        overruns=samples.overruns,
    )


def checked(measurement: Measurement, least_cycles: float) -> Measurement:
    """Return a reading that a calibration may use: of at least so many periods of the load.

    Raises:
        Flawed: gaps, overruns, saturation, too few cycles, or no load.
    """
    strength = _strength(measurement.charges, measurement.covariance)
    flaws = {
        f"{measurement.lost} gaps: samples were lost; read again": measurement.lost > 0,
        f"{measurement.overruns} overruns of the device: ask for a lower rate": measurement.overruns > 0,
        f"{measurement.saturated} samples are saturated: press less, or take a larger feedback capacitance": measurement.saturated
        > 0,
        f"{measurement.fit.cycles:.3g} cycles of the load: at least {least_cycles:g} are needed; read longer": (
            measurement.fit.cycles < least_cycles
        ),
        f"the load's amplitude is {strength:.2g} of its standard deviation: is the load on?": strength < LEAST_STRENGTH,
    }
    for text, flawed in flaws.items():
        if flawed:
            raise Flawed(text)
    return measurement


def _strength(charges: Complexes, covariance: Floats) -> float:
    """The larger amplitude over its standard deviation."""
    return float((np.abs(charges) / np.sqrt(np.diag(covariance)[::2])).max())


def carried(function: Callable[[Floats], Floats], at: Floats, covariance: Floats) -> Floats:
    """Return the covariance of a function of uncertain numbers: delta method, slopes by central differences."""
    step = STEP * float(np.abs(at).max())
    moved = step * np.eye(len(at))
    slopes = np.stack([(function(at + one) - function(at - one)) / (2 * step) for one in moved], axis=1)
    return np.asarray(slopes @ covariance @ slopes.T)


def _force(samples: Samples, fit: SineFit, sensitivity: float | None) -> tuple[float | None, float | None]:
    if sensitivity is None or FORCE not in samples.channels:
        return None, None
    channel = samples.channels.index(FORCE)
    part = slice(2 * channel, 2 * channel + 2)
    amplitude = abs(fit.amplitudes[channel])
    spread = carried(_size, _parts(fit.amplitudes[channel : channel + 1]), fit.covariance[part, part])
    return float(amplitude / abs(sensitivity)), float(np.sqrt(spread[0, 0]) / abs(sensitivity))


def _parts(values: Complexes) -> Floats:
    return np.stack([values.real, values.imag], axis=1).ravel()


def _real(factor: complex, times: int) -> Floats:
    """The matrix by which multiplication with a complex number turns (re, im), repeated along the diagonal."""
    return np.kron(np.eye(times), np.array([[factor.real, -factor.imag], [factor.imag, factor.real]]))


def _complex(parts: Floats) -> Complexes:
    return np.asarray(parts[0::2] + 1j * parts[1::2])


def _quotient(parts: Floats) -> Floats:
    inner, outer = _complex(parts)
    return np.array([(inner / outer).real, (inner / outer).imag])


def _in_phase(parts: Floats) -> Floats:
    charges = _complex(parts)
    total = charges.sum()
    return np.asarray((charges * np.conj(total) / abs(total)).real)


def _lag(parts: Floats) -> Floats:
    inner, outer = _complex(parts)
    return np.array([np.angle(inner * np.conj(outer))])


def _size(parts: Floats) -> Floats:
    return np.abs(_complex(parts))
