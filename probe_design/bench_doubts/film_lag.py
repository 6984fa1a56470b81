"""The films' phases on blocks of tissue: what is elastic turns neither, so that a lag is tissue that flows or a fault.

With both charges q, their amplifiers divided out, and the outer channel sampled later than the inner by s, the inner leads by

    phi = arg(q_inner / q_outer) + 2 pi f s                                                                (BP.8)

On a pin or a ring the film that is not pressed shows cross-talk, which may have either sign, and whose phase is no lag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hw.signal.measure import FILMS, Measurement
from probe_design.built_probe.bench import Bench, Reference

MAX_LAG_RAD = 0.02  # beyond three standard deviations a warning reports it: a film loses 2e-4 of its amplitude by that
SIGNIFICANT_SD = 3.0


def lag_warnings(measurements: Sequence[Measurement], references: Sequence[Reference], bench: Bench) -> list[str]:
    """Return a warning for each film that lags on tissue, with the references on which it does.

    Args:
        measurements: one for each reference, each film's own amplifier divided out.
        references: what was pressed on.
        bench: for the channels' sampling, and whether the force channel counts.
    """
    lags: dict[str, list[tuple[str, float]]] = {}
    for measurement, reference in zip(measurements, references, strict=True):
        if reference.on != "tissue":
            continue
        lag, spread = film_lag(measurement, bench)
        if abs(lag) - SIGNIFICANT_SD * spread > MAX_LAG_RAD:
            lags.setdefault(_fault(measurement, bench, lag), []).append((reference.name, abs(lag)))
    return [
        f"{', '.join(name for name, _ in found)}: {fault} by up to {max(lag for _, lag in found):.2g} rad: tissue that flows, "
        "or that film's amplifier, filter or cable; the gains are of the parts in phase with the load"
        for fault, found in lags.items()
    ]


def film_lag(measurement: Measurement, bench: Bench) -> tuple[float, float]:
    """Return by how much the inner film leads the outer one, eq. BP.8, and its standard deviation, both in rad."""
    lag, spread = measurement.lag
    turn = 2 * math.pi * measurement.fit.frequency
    return lag + turn * bench.sampling.skew, math.hypot(spread, turn * bench.sampling.skew_tolerance)


def _fault(measurement: Measurement, bench: Bench, lag: float) -> str:
    """Say which film lags; the force channel, where there is one, decides which of both is out of phase."""
    late, early = reversed(FILMS) if lag > 0 else FILMS
    words = f"the {late} film lags the {early} film"
    if measurement.force is None or bench.force is None:
        return words
    turn = 2 * math.pi * measurement.fit.frequency
    force = measurement.fit.amplitudes[2] * np.exp(1j * turn * bench.force.delay)
    charges = measurement.charges * np.exp([0.0, -1j * turn * bench.sampling.skew])
    off = [abs(math.remainder(float(np.angle(one * np.conj(force))), math.pi)) for one in charges]  # a sensor may be reversed
    return f"{words} (the {FILMS[int(np.argmax(off))]} film is out of phase with the force channel)"
