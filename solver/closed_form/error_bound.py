"""Bounds on the errors of the closed form.

    error <= sum of weight x feature,                                                             (CF.19)

of ln(ratio), of the logarithms of both totals and, absolute, of the log-sensitivity, with the features of ``error_features``.
The weights are an envelope of random scenes and of tests/reference, times a margin: ``python -m benchmarks.closed_form.error``
writes them to ``error_weights.json``, audits them on other scenes, and stores the result of the audit there.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.closed_form.error_features import compute_features
from solver.results.detail_compliance import iterate_details
from solver.results.film_forces import Bound

MIN_SENSITIVITY_ERROR = 5e-6  # absolute; half of the smallest log-sensitivity error that matters
BOUNDED_QUANTITIES = ("ratio", "inner", "outer", "sensitivity")  # ln(ratio), the logarithms of both totals, the log-sensitivity


@cache
def read_weights() -> dict[str, dict[str, float]]:
    """Read the weights of eq. CF.19 by quantity and feature; the file names the scenes, margin and command they come from."""
    text = resources.files("solver.closed_form").joinpath("error_weights.json").read_text(encoding="utf-8")
    weights: dict[str, dict[str, float]] = json.loads(text)["weights"]
    return weights


@dataclass(frozen=True)
class StatedErrors:
    """Bounds on the errors of ln(ratio), of the logarithms of both totals, shape (2,), and of the log-sensitivity."""

    log_ratio: float
    log_totals: Floats
    sensitivity: float

    def compute_bound(self, totals: Floats) -> Bound:
        """Return by how much totals (2,), N/m, may be too large: their logarithms are bounded, so true totals are not zero."""
        return Bound(-np.expm1(-self.log_totals) * totals, self.log_ratio)

    @property
    def largest(self) -> float:
        """Relative error bound of ratio, stresses and stiffness."""
        return float(np.expm1(min(max(self.log_ratio, *self.log_totals), 700.0)))


def bound_errors(scene: Scene, forces: Floats, slopes: Floats) -> StatedErrors:
    """Bound the errors for a scene (eq. CF.19) and add those of groove, film and base; see ``compute_features`` for arguments."""
    feature_values = compute_features(scene, forces, slopes)
    ratio, inner, outer, sensitivity = (
        sum(read_weights()[kind].get(name, 0.0) * float(values[place]) for name, values in feature_values.items())
        for place, kind in enumerate(BOUNDED_QUANTITIES)
    )
    detail_bounds = [detail.compute_bound(forces[0]) for detail in iterate_details(scene.probe)]
    films = np.array([inner, outer]) + sum(bound.totals for bound in detail_bounds) / forces[0].sum(axis=1)
    sensitivity += MIN_SENSITIVITY_ERROR
    return StatedErrors(min(ratio, inner + outer) + sum(bound.log_ratio for bound in detail_bounds), films, sensitivity)
