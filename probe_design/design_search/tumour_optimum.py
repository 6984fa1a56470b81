"""Define the result of an optimisation for one tumour read once: verdict and warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from probe_design.design_search.optimum import NO_GAIN, Optimum
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.tumour_verification import TumourVerification, replace_non_finite


@dataclass(frozen=True)
class TumourOptimum(Optimum[TumourVerification]):
    """The result of an optimisation for one tumour.

    Attributes
    ----------
    noise
        Noise of a reading.
    linear_evaluator
        Evaluator for verification within linear elasticity; beyond it ``contact`` is used.
    """

    noise: Noise
    linear_evaluator: str

    @property
    def evaluators(self) -> tuple[str, ...]:
        """The evaluators of the best design tried and of the start."""
        return tuple(dict.fromkeys(verified.evaluator for verified in (self.best_tried, self.start)))

    @property
    def verdict(self) -> str:
        """See ``Optimum``."""
        best_value, start = _format_objective(self.best_tried), f"the start's {_format_objective(self.start)}"
        evaluators = f"by {' and '.join(self.evaluators)}"
        if self.winner is not None:
            return (
                f"improved: standard deviation of ln E_object {best_value} of the recommended design in place of "
                f"{start}, {evaluators}"
            )
        reduction = 1 - self.best_tried.value / self.start.value
        if not reduction > 0:
            best = f": the best tried has {best_value}" if self.finalists else ""
            comparison = f"none of {len(self.finalists)} designs has a standard deviation of ln E_object"
            return f"{NO_GAIN}; {comparison} below {start}, {evaluators}{best}"
        return (
            f"{NO_GAIN}; the standard deviation of ln E_object of the best design tried is {best_value}, "
            f"{100 * reduction:.2g} % less than "
            f"{start}, {evaluators}, which is within its errors"
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """See ``Optimum``."""
        return tuple(self._iterate_warnings())

    def _iterate_warnings(self) -> Iterator[str]:
        recommended = () if self.winner is None else (("the recommended design", self.winner),)
        for name, verified in (*recommended, ("the start", self.start)):
            if verified.linear_design is not None:
                yield f"{name} {_describe_load_gain(verified, verified.linear_design)}"
        refused = self.start.refused or self.best.refused
        if refused is not None:
            yield (
                f"closed-form refuses this scene, which is one for {refused}; the search used its formulas all the same: "
                f"only the results of {self.linear_evaluator} are valid"
            )
        if self.winner is None:
            yield from self.warn_wide_start()

    def build_summary(self, files: list[str]) -> dict[str, Any]:
        """See ``Optimum``."""
        best, start = self.best, self.start
        return super().build_summary(files) | {
            "linear_evaluator": self.linear_evaluator,
            "noise": self.noise.ratio,
            "charge_noise": self.noise.charge,
            "searched_objective": replace_non_finite(best.formula_value),
            "baseline_searched_objective": replace_non_finite(start.formula_value),
            "result": best.result.as_dict(),
            "baseline_result": start.result.as_dict(),
            "under_load": best.summarize_load_gain(),
            "baseline": start.as_dict(),
            "candidates": [finalist.as_dict() for finalist in self.finalists],
        }


def _format_objective(verified: TumourVerification) -> str:
    """Format an objective with its bounds by errors."""
    ends = f"above {verified.lower:.3g}" if math.isinf(verified.upper) else f"{verified.lower:.3g} to {verified.upper:.3g}"
    return f"{verified.value:.3g} ({ends} within its errors)"


def _describe_load_gain(verified: TumourVerification, linear: TumourVerification) -> str:
    """Describe the gain of a load beyond linear elasticity."""
    gain, error = verified.compute_gain(linear)
    return (
        f"under {verified.pressing.force:.3g} N (limited by {verified.pressing.limited_by}): "
        f"{_format_objective(verified)} in place of {_format_objective(linear)} under "
        f"{linear.pressing.force:.3g} N, where linear elasticity ends ({linear.pressing.limited_by}): a gain of "
        f"{100 * gain:.2g} %, "
        f"error {100 * error:.2g} %"
    )
