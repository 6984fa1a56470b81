"""Determine what a check can test: the detection limit of each variable with a tolerance, and what hides it.

A variable counts as tested if a deviation of five tolerances is detected with a probability of at least 0.5 (eq. PC.4). To learn
what hides a variable, one source of uncertainty after the other is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.percent import format_percent
from probe_design.probe_check.deviation import DETECTED_TOLERANCES, MIN_POWER, Deviation, compute_power

MAX_TOLERANCES = 1e6  # tolerances: what is not detected there is never detected
BISECTION_STEPS = 40
MAX_POISSON_RATIO = 0.5  # upper limit of a Poisson's ratio, and so of its deviation


@dataclass(frozen=True)
class VariableCoverage:
    """How well a check tests one variable.

    Attributes
    ----------
    variable
        Key of the scene file.
    tolerance
        Of the workshop, a standard deviation, SI.
    found_from
        Detection limit: the deviation that is detected with the probability ``MIN_POWER``, SI; None if there is none.
    effect
        Largest relative change of a block's ratio by a deviation of ``DETECTED_TOLERANCES``.
    power
        Probability that the check detects this deviation.
    reason
        Why the power is below ``MIN_POWER``; empty if the variable is tested.
    """

    variable: str
    tolerance: float
    found_from: float | None
    effect: float
    power: float
    reason: str

    @property
    def tested(self) -> bool:
        """Whether the check detects a deviation of ``DETECTED_TOLERANCES`` with a probability of at least ``MIN_POWER``."""
        return not self.reason


def compute_coverage(deviation: Deviation, tolerances: Mapping[str, float]) -> tuple[VariableCoverage, ...]:
    """Compute how well a check tests each variable, the best tested first.

    Parameters
    ----------
    deviation
        For its covariances.
    tolerances
        Standard deviations, SI, by variable; variables with 0 are left out.
    """
    entries = [_test_variable(deviation, name, sd) for name, sd in tolerances.items() if sd > 0]
    return tuple(sorted(entries, key=lambda entry: -entry.power))


def _test_variable(deviation: Deviation, name: str, tolerance: float) -> VariableCoverage:
    """Compute how well a check tests one variable; ``tolerance`` is its standard deviation, SI."""
    column = deviation.workshop[name]
    probability = compute_power(deviation, {name: DETECTED_TOLERANCES}) if np.any(column != 0) else 0.0
    reason = "" if probability >= MIN_POWER else _explain_hidden(deviation, name, tolerance)
    effect = float(np.abs(np.expm1(DETECTED_TOLERANCES * column)).max())
    return VariableCoverage(name, tolerance, _find_threshold(deviation, name, tolerance), effect, probability, reason)


def _find_threshold(deviation: Deviation, name: str, tolerance: float) -> float | None:
    """Return the deviation of a variable, SI, that is detected with the probability ``MIN_POWER``, or None if there is none.

    As the probability rises with the deviation, the logarithm of the deviation is bisected.
    """
    if not np.any(deviation.workshop[name] != 0) or compute_power(deviation, {name: MAX_TOLERANCES}) < MIN_POWER:
        return None
    low, high = 0.0, np.log(MAX_TOLERANCES)  # of the deviation in tolerances: from 1 tolerance on
    for _ in range(BISECTION_STEPS):
        middle = (low + high) / 2
        low, high = (low, middle) if compute_power(deviation, {name: float(np.exp(middle))}) >= MIN_POWER else (middle, high)
    threshold = float(np.exp(high)) * tolerance
    return None if name.endswith("poisson_ratio") and threshold > MAX_POISSON_RATIO else threshold


def _explain_hidden(deviation: Deviation, name: str, tolerance: float) -> str:
    """Explain why a variable's deviation is not detected: the one source of uncertainty that hides it, or several together."""
    drawn = deviation.workshop[name] + deviation.get_bias(name) * tolerance  # as if the calibration had not depended on it
    if np.any(deviation.get_bias(name) != 0) and _is_detected(
        replace(deviation, workshop={**deviation.workshop, name: drawn}), name
    ):
        return "the calibration took it as drawn and has absorbed what it does"
    for reason, reduced in _iterate_reduced(deviation, name):
        if _is_detected(reduced, name):
            return reason
    if _is_detected(_isolate_variable(deviation, name).shrink_errors("noise", "gains", "model"), name):
        return f"the {_format_reading_sd(deviation)} of noise and gains, the blocks' moduli and other tolerances hide it together"
    return "it hardly changes these ratios"


def _iterate_reduced(deviation: Deviation, name: str) -> Iterator[tuple[str, Deviation]]:
    """Yield for each source of uncertainty a text that names it as the reason, and the deviation without this source."""
    noise = f"not observable at this noise: noise and gains make {_format_reading_sd(deviation)} of a ratio"
    yield noise, deviation.shrink_errors("noise", "gains")
    yield "the tolerances of other variables hide it, which do the same to the ratios", _isolate_variable(deviation, name)
    yield "the blocks' moduli are not known well enough", deviation.shrink_errors("model")


def _isolate_variable(deviation: Deviation, name: str) -> Deviation:
    """Return the deviation without the tolerances of all other variables."""
    return replace(deviation, workshop={name: deviation.workshop[name]})


def _is_detected(deviation: Deviation, name: str) -> bool:
    """Whether a variable's deviation of ``DETECTED_TOLERANCES`` is detected with a probability of at least ``MIN_POWER``."""
    return bool(np.any(deviation.workshop[name] != 0)) and compute_power(deviation, {name: DETECTED_TOLERANCES}) >= MIN_POWER


def _format_reading_sd(deviation: Deviation) -> str:
    """Format the largest relative standard deviation of a reading as percent."""
    return format_percent(float(deviation.reading_sd.max()))
