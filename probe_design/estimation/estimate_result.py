"""Define the result of an estimate: value and interval of one unknown, and other results of the readings."""

from __future__ import annotations

from dataclasses import dataclass

from geometry.common.json_types import JsonObject
from geometry.scenes.scene_tables import Observable
from probe_design.estimation.intervals import Interval
from solver.results.record import Record
from solver.results.result import Decision

MAX_END_RATIOS = {"youngs_modulus": 100.0, "diameter": 4.0, "depth": 4.0, "thickness": 4.0}  # of an identifiable unknown


@dataclass(frozen=True)
class DepthAndStrength:
    """Best fit and 95 % intervals; an end is None where the search range ends before the interval.

    Attributes
    ----------
    depth
        m.
    strength
        m^3.
    modulus, diameter
        Young's modulus, Pa, and diameter, m, of a body with this strength.
    """

    depth: float
    depth_interval: Interval
    strength: float
    strength_interval: Interval
    modulus: float
    diameter: float


@dataclass(frozen=True)
class ExpectedInterval:
    """The interval that is expected after one further reading.

    Attributes
    ----------
    kind
        See ``next_reading.NextCandidate``.
    told
        The reading in words.
    x, y
        Of the probe's axis, m; None for a size.
    interval
        Medians of the interval's ends, SI; None where an end is open in most cases.
    width
        Median of the ratio of the ends; None where an end is open in most cases.
    identifiable
        Probability that the unknown is identifiable after this reading.
    score
        Mean logarithmic length of the interval, see ``probe_design.estimation.next_reading``.
    """

    kind: str
    told: str
    x: float | None
    y: float | None
    interval: Interval
    width: float | None
    identifiable: float
    score: float


@dataclass(frozen=True)
class NextReading:
    """Advice what to measure next.

    Attributes
    ----------
    reading
        The best candidate, or None where none narrows the interval.
    together
        All candidates together.
    verdict
        The advice in one sentence.
    others
        The other candidates, the best first.
    draws
        Number of draws of eq. ES.11.
    """

    reading: ExpectedInterval | None
    together: ExpectedInterval | None
    verdict: str
    others: tuple[ExpectedInterval, ...]
    draws: int


@dataclass(frozen=True, repr=False)
class Estimate(Record):
    """Result of an estimate, SI units; an end of an interval is None where it is open.

    Attributes
    ----------
    unknown
        youngs_modulus, diameter or depth of the target, or the key of a number of the tissue.
    observable
        What the readings are the ratio of: "charge" or "stress", each over its block's end area.
    noise
        Relative standard deviation of each ratio that was read.
    value
        Best fit of the unknown; None where it is not identifiable.
    interval
        95 % interval.
    interval_of_noise
        The same for a model without error and without nuisances.
    nuisances
        Relative standard deviations of uncertain numbers of the scene, by their keys.
    interval_if_known
        The interval without nuisances; None if there are none.
    pieces
        The parts of the interval that agree with the readings, where these are several.
    identifiable
        Whether the interval is bounded, and narrow enough for a value.
    reason
        Why the unknown is not identifiable, or None.
    depth
        The estimate if it is the unknown; else fitted together with the strength if there are several places, else the scene's.
    depth_interval
        95 %; None where the depth is the scene's.
    strength
        eq. ES.1 of ``probe_design.estimation.model``, m^3.
    strength_interval
        95 %; None where size and modulus are the scene's, and thus the strength.
    p_value
        Probability of a worse fit if scene and noise are as stated.
    error_estimate
        Bound on the relative error of the evaluator's ratio at the best fit; None where there is none.
    evaluator, seconds, plan, warnings
        See ``solver.results.result.Result``.
    next
        The advice what to measure next, or None if it was not requested.
    """

    unknown: str
    observable: Observable
    noise: tuple[float, ...]
    value: float | None
    interval: Interval
    interval_of_noise: Interval
    nuisances: dict[str, float]
    interval_if_known: Interval | None
    pieces: tuple[tuple[float, float], ...]
    identifiable: bool
    reason: str | None
    depth: float | None
    depth_interval: Interval | None
    strength: float | None
    strength_interval: Interval | None
    p_value: float | None
    error_estimate: float | None
    evaluator: str
    seconds: float
    plan: tuple[Decision, ...]
    warnings: tuple[str, ...]
    next: NextReading | None = None

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design estimate``, in which the unknown's name replaces ``value``."""
        fields = super().as_dict()
        return {self.unknown: fields.pop("value")} | fields


def is_identifiable(interval: Interval, unknown: str) -> bool:
    """Return whether an interval is bounded and narrow enough to call the unknown identifiable."""
    low, high = interval
    return low is not None and high is not None and high <= get_max_end_ratio(unknown) * low


def get_max_end_ratio(unknown: str) -> float:
    """Return the largest ratio of the ends of an interval for which the unknown counts as identifiable."""
    return MAX_END_RATIOS[unknown.rpartition(".")[2]]  # the last part of a key such as tissue.layer[0].thickness
