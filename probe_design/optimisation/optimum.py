"""What an optimisation found, and whether it counts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from probe_design.optimisation.candidate import Candidate
from probe_design.optimisation.design_space import Limit, Space
from probe_design.optimisation.objective import Noise

NO_GAIN = "no gain: no design better than the start was verified: the start is exported"


@dataclass(frozen=True)
class Optimum:
    """What an optimisation found.

    Attributes:
        judge: the evaluator that ranked the designs within linear elasticity; beyond it ``contact`` judged.
        design_space: the limits they were to keep.
        noise: of a reading.
        baseline: the start.
        candidates: the re-ranked designs, best first.
    """

    judge: str
    design_space: Space
    noise: Noise
    baseline: Candidate
    candidates: tuple[Candidate, ...]

    @property
    def winner(self) -> Candidate | None:
        """The first design that beats the start by more than the errors of both."""
        return next((candidate for candidate in self.candidates if candidate.is_better_than(self.baseline)), None)

    @property
    def status(self) -> Literal["improved", "no-gain"]:
        """``improved``, or ``no-gain`` where no design is better than the start beyond the errors of both."""
        return "no-gain" if self.winner is None else "improved"

    @property
    def best(self) -> Candidate:
        """The recommended design, of which everything speaks that is written: the start itself where nothing beats it."""
        return self.winner or self.baseline

    @property
    def best_tried(self) -> Candidate:
        """The best design tried, whether it is verified to beat the start or not; the start itself where there is none."""
        return self.winner or next(iter(self.candidates), self.baseline)

    @property
    def evaluators(self) -> tuple[str, ...]:
        """Who judged the design that was found and the start."""
        return tuple(dict.fromkeys(candidate.judged.evaluator for candidate in (self.best_tried, self.baseline)))

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All limits of the designs, and which of them the recommended one lies on."""
        return self.design_space.list_limits(self.best.scene)

    @property
    def verdict(self) -> str:
        """What was found, and why it counts or does not, in one sentence."""
        best_value, start, evaluators = (
            _format_objective(self.best_tried),
            f"the start's {_format_objective(self.baseline)}",
            f"by {' and '.join(self.evaluators)}",
        )
        if self.winner is not None:
            return (
                f"improved: standard deviation of ln E_object {best_value} of the recommended design in place of "
                f"{start}, {evaluators}"
            )
        reduction = 1 - self.best_tried.judged_objective / self.baseline.judged_objective
        if not reduction > 0:
            best = f": the best tried has {best_value}" if self.candidates else ""
            comparison = f"none of {len(self.candidates)} designs has a standard deviation of ln E_object"
            return f"{NO_GAIN}; {comparison} below {start}, {evaluators}{best}"
        return (
            f"{NO_GAIN}; the standard deviation of ln E_object of the best design tried is {best_value}, "
            f"{100 * reduction:.2g} % less than "
            f"{start}, {evaluators}, which is within its errors"
        )

    @property
    def remarks(self) -> Iterator[str]:
        """What else one has to know of the search."""
        recommended = () if self.winner is None else (("the recommended design", self.winner),)
        for name, candidate in (*recommended, ("the start", self.baseline)):
            if candidate.linear_candidate is not None:
                yield f"{name} {_describe_load_gain(candidate, candidate.linear_candidate)}"
        refused = self.baseline.refused or self.best.refused
        if refused is not None:
            yield (
                f"closed-form refuses this scene, which is one for {refused}; the search used its formulas all the same: "
                f"only the results of {self.judge} are valid"
            )
        start, limit = self.baseline.scene.probe.tube_radius, self.design_space.outer_radius
        if start > limit and self.winner is None:
            yield f"the start's outer radius of {start * 1e3:.4g} mm is above the limit of {limit * 1e3:.4g} mm"


def _format_objective(candidate: Candidate) -> str:
    """An objective with the ends that errors leave it."""
    ends = (
        f"above {candidate.objective_min:.3g}"
        if math.isinf(candidate.objective_max)
        else f"{candidate.objective_min:.3g} to {candidate.objective_max:.3g}"
    )
    return f"{candidate.judged_objective:.3g} ({ends} within its errors)"


def _describe_load_gain(candidate: Candidate, linear: Candidate) -> str:
    """What more load than linear elasticity answers for brings."""
    gain, error = candidate.compute_gain(linear)
    return (
        f"under {candidate.pressing.force:.3g} N (limited by {candidate.pressing.limited_by}): "
        f"{_format_objective(candidate)} in place of {_format_objective(linear)} under "
        f"{linear.pressing.force:.3g} N, where linear elasticity ends ({linear.pressing.limited_by}): a gain of "
        f"{100 * gain:.2g} %, "
        f"error {100 * error:.2g} %"
    )
