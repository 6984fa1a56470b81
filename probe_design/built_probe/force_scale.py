"""The force channel's scale: what it shows over what it should, which no reading of the films alone can confirm.

A sensor that reads 10 % high makes all gains 10 % too small and contradicts nothing. Its maker's tolerance counts once a known
load has confirmed it. Until then the scale k is unknown, and follows from the films' nominal gains, of standard deviation sigma
each:

    F_read = k F,    (g_inner + g_outer) / 2 = 1 +- sigma / sqrt(2)                                        (BP.9)

A reference of known load settles k.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geometry.common.arrays import Floats
from probe_design.built_probe.bench import Bench

UNKNOWN_LN = 1.0  # standard deviation of ln k where nothing is known of it: the films' nominal gains outweigh it 400 times
WORTH_TELLING = 3.0  # standard deviations of what the bench says of the sensor, beyond which its scale is reported


@dataclass(frozen=True)
class ForceScale:
    """What a calibration has found of the force channel.

    Attributes:
        factor: what it shows over the true force; 1 where it is not asked for.
        sd: relative standard deviation of ``factor``.
        entries: by how much the entries of M are off with ``factor`` by one ``sd``, row by row, shape (4,); what is read with the
            same channel shares it.
        confirmed: whether a known load stands behind it; if not, the films' nominal gains do.
    """

    factor: float = 1.0
    sd: float = 0.0
    entries: Floats = field(default_factory=lambda: np.zeros(4))
    confirmed: bool = True

    @property
    def covariance(self) -> Floats:
        """Return what the channel adds to the covariance of the entries of M, shape (4, 4)."""
        return np.outer(self.entries, self.entries)


def prior_sd(bench: Bench, doubt: float) -> float:
    """Return the standard deviation of ln k before any reading; ``doubt`` is what a lag may have changed in all alike."""
    assert bench.force is not None
    return float(np.hypot(bench.force.tolerance if bench.force.verified else UNKNOWN_LN, doubt))


def mean_gain_sd(bench: Bench) -> float:
    """Return the standard deviation of the mean of both channels' gains about 1, films and amplifiers together."""
    return float(np.sqrt(sum(bench.channels.gain**2 + one.capacitance_tolerance**2 for one in bench.amplifier.of_films())) / 2)


def scale_warnings(scale: ForceScale, bench: Bench) -> list[str]:
    """Return what is to be said of the force channel's scale: that nothing has confirmed it, or that it is off."""
    if bench.force is None or scale.sd == 0:
        return []
    off = 100 * (scale.factor - 1)
    shown = f"shows {abs(off):.2g} % too {'much' if off > 0 else 'little'}, give or take {100 * scale.sd:.2g} %"
    if not scale.confirmed:
        return [
            f"nothing confirms the force channel's scale: by the films' nominal gains it {shown}; gains and stresses count that, "
            "the ratio does not depend on it. For better stresses give a reference a known load (known_force in the bench: a "
            "weight on the pin), or write verified = true under [force] if a known load has confirmed the sensor"
        ]
    if abs(scale.factor - 1) > WORTH_TELLING * float(np.hypot(bench.force.tolerance, scale.sd)):
        return [f"the force channel {shown}, by the references of known load: corrected; look at its sensitivity"]
    return []
