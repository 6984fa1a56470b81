"""What noise means and how large it is unless one says: the same for every verb that is told a noise.

Noise is the relative standard deviation of one reading of the ratio. Both channels have the same part in it.
"""

from __future__ import annotations

import math

NOISE = 0.05  # the paper's "about 5 %", section 3
RESOLVED = 0.5  # standard deviation of ln E_object up to which a stiffness counts as told: a factor of 1.65 either way
LEAST = 1e-6  # no reader is as good; far below it the model's own error is all there is
LARGEST = 10.0
ALLOWED = f"from {LEAST:g} to {LARGEST:g}: relative, one standard deviation of the ratio, such as {NOISE:g} or {100 * NOISE:g} %"


def checked_noise(noise: float, key: str = "noise") -> float:
    """Return a noise that is one.

    Raises:
        InputError: it is not from ``LEAST`` to ``LARGEST``.
    """
    if LEAST <= noise <= LARGEST:
        return noise
    from geometry.common.errors import InputError  # --help shows the default and needs no more

    raise InputError(key, noise, ALLOWED)


def of_channel(noise: float) -> float:
    """Relative gain error of each channel, one standard deviation, that gives the ratio this noise."""
    return noise / math.sqrt(2)
