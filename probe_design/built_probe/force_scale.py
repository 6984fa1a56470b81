"""Estimate the force channel's scale, its reading over the true force, which readings of the films alone cannot confirm.

A sensor that reads 10 % high makes all gains 10 % too small and contradicts nothing. Its maker's tolerance is used once a known
load has confirmed it. Until then the scale k is unknown, and follows from the films' nominal gains, of standard deviation sigma
each:

    F_read = k F,    (g_inner + g_outer) / 2 = 1 +- sigma / sqrt(2)                                        (BP.9)

F is the true force, F_read the channel's reading, g_inner and g_outer the films' gains. A reference of known load determines k.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geometry.common.arrays import Floats
from probe_design.built_probe.bench import Bench

UNKNOWN_LN = 1.0  # standard deviation of ln k if unknown: the films' nominal gains have 400 times the weight
WORTH_TELLING = 3.0  # standard deviations of the bench's tolerance beyond which the scale is reported


@dataclass(frozen=True)
class ForceScale:
    """The force channel's scale as a calibration estimates it.

    Attributes
    ----------
    factor
        Reading over true force; 1 without force channel.
    sd
        Relative standard deviation of ``factor``.
    entries
        Change of the entries of M, row by row, for an error of ``factor`` by one ``sd``, shape (4,); readings with the same
        channel share it.
    confirmed
        Whether a known load determines the scale; if not, the films' nominal gains do.
    """

    factor: float = 1.0
    sd: float = 0.0
    entries: Floats = field(default_factory=lambda: np.zeros(4))
    confirmed: bool = True

    @property
    def covariance(self) -> Floats:
        """Part of the covariance of the entries of M that is due to the scale, shape (4, 4)."""
        return np.outer(self.entries, self.entries)


def compute_prior_sd(bench: Bench, doubt: float) -> float:
    """Return the standard deviation of ln k before any reading; ``doubt`` is the relative error of a lag, common to all."""
    assert bench.force is not None
    return float(np.hypot(bench.force.tolerance if bench.force.verified else UNKNOWN_LN, doubt))


def compute_mean_gain_sd(bench: Bench) -> float:
    """Return the standard deviation of the mean of both channels' gains, due to films and amplifiers."""
    return float(
        np.sqrt(sum(bench.channels.gain**2 + amplifier.capacitance_tolerance**2 for amplifier in bench.amplifier.build_films()))
        / 2
    )


def list_scale_warnings(scale: ForceScale, bench: Bench) -> list[str]:
    """List the warnings on the force channel's scale: not confirmed by a known load, or different from 1."""
    if bench.force is None or scale.sd == 0:
        return []
    percent_error = 100 * (scale.factor - 1)
    shown = (
        f"shows {abs(percent_error):.2g} % too {'much' if percent_error > 0 else 'little'}, give or take {100 * scale.sd:.2g} %"
    )
    if not scale.confirmed:
        return [
            f"nothing confirms the force channel's scale: by the films' nominal gains it {shown}; gains and stresses count that, "
            "the ratio does not depend on it. For better stresses give a reference a known load (known_force in the bench: a "
            "weight on the pin), or write verified = true under [force] if a known load has confirmed the sensor"
        ]
    if abs(scale.factor - 1) > WORTH_TELLING * float(np.hypot(bench.force.tolerance, scale.sd)):
        return [f"the force channel {shown}, by the references of known load: corrected; look at its sensitivity"]
    return []
