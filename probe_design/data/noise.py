"""Definition, defaults and limits of the noise, which are the same for all commands.

Noise is the relative standard deviation of one reading of the ratio. Both channels contribute equally.
"""

from __future__ import annotations

from geometry.common.errors import InputError
from geometry.common.percent import format_percent
from geometry.scenes.film import Film
from geometry.scenes.probe import Probe
from geometry.scenes.units import read_fraction

DEFAULT_NOISE = 0.05  # the paper's "about 5 %", section 3
DEFAULT_CHARGE_NOISE_C = 0.01e-12  # C: of a good charge amplifier over a second
MAX_RESOLVED_LOG_SD = 0.5  # sd of ln E_object up to which a stiffness counts as resolved: a factor of 1.65 either way
MIN_NOISE = 1e-6  # better than any electronics; the model's error is larger
MAX_NOISE = 10.0
MIN_ACCURACY, MAX_ACCURACY = 5e-4, 0.01  # default accuracies of an evaluator, between which the noise chooses
ALLOWED_NOISE = (
    f"from {MIN_NOISE:g} to {MAX_NOISE:g}: relative, one standard deviation of the ratio, such as "
    f"{DEFAULT_NOISE:g} or {format_percent(DEFAULT_NOISE, 6)}"
)


def check_noise(noise: float, key: str = "noise") -> float:
    """Return a noise if it is allowed; ``key`` is its name in the message of a refusal.

    Raises
    ------
    InputError
        The noise is not within ``MIN_NOISE`` and ``MAX_NOISE``.
    """
    if MIN_NOISE <= noise <= MAX_NOISE:
        return noise

    raise InputError(key, noise, ALLOWED_NOISE)


def read_noise(key: str, value: object) -> float:
    """Return a relative standard deviation from a number or a text such as "5 %", checked as by ``check_noise``."""
    return check_noise(read_fraction(key, value, ALLOWED_NOISE), key)


def choose_accuracy(noise: float) -> float:
    """Return the relative accuracy that a noise asks of an evaluator: the noise itself, within limits."""
    return min(max(noise, MIN_ACCURACY), MAX_ACCURACY)


def find_charge_per_force(probe: Probe) -> float:
    """Return |d33| of a probe's films, C/N; the default film's if the probe states no film, or a d33 of 0."""
    return abs(probe.film.d33 if probe.film else 0.0) or abs(Film().d33)
