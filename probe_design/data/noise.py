"""Definition, default and limits of the noise, which are the same for all commands.

Noise is the relative standard deviation of one reading of the ratio. Both channels contribute equally.
"""

from __future__ import annotations

import math

NOISE = 0.05  # the paper's "about 5 %", section 3
RESOLVED = 0.5  # sd of ln E_object up to which a stiffness counts as resolved: a factor of 1.65 either way
LEAST = 1e-6  # better than any electronics; the model's error is larger
LARGEST = 10.0
ALLOWED = f"from {LEAST:g} to {LARGEST:g}: relative, one standard deviation of the ratio, such as {NOISE:g} or {100 * NOISE:g} %"


def checked_noise(noise: float, key: str = "noise") -> float:
    """Return a noise if it is allowed.

    Raises:
        InputError: it is not within ``MIN_NOISE`` and ``MAX_NOISE``.
    """
    if LEAST <= noise <= LARGEST:
        return noise
    from geometry.common.errors import InputError  # imported late: --help needs only the default

    raise InputError(key, noise, ALLOWED)


def of_channel(noise: float) -> float:
    """Return the relative gain error of each channel, one standard deviation, that gives the ratio this noise."""
    return noise / math.sqrt(2)
