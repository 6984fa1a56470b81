"""How far the closed form may be off.

    error <= sum of weight x feature,                                                             (CF.19)

of ln(ratio), of the logarithms of both totals and, absolute, of the log-sensitivity, with the features of ``error_features``.
The weights are an envelope of random scenes and of tests/reference, times a margin: ``python -m benchmarks.closed_form.error``
prints them, and audits them on other scenes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.closed_form.error_features import features
from solver.results.detail_compliance import details
from solver.results.film_forces import Bound

LEAST_SENSITIVITY = 5e-6  # half of what no one asks to be told
WEIGHTS: dict[str, dict[str, float]] = {
    "ratio": {
        "inner": 0.281, "inner small": 0.1, "inner soft": 0.05, "outer": 0.02, "outer tall shell": 0.701,
        "outer soft shell": 0.1, "outer soft tall": 0.0849, "spheres near surface": 1.32, "spheres near floor": 0.1,
        "spheres at the floor": 1.83, "spheres near sides": 1, "spheres under rim": 0.02, "spheres several": 0.02,
        "always": 0.01, "thin": 0.005, "very thin": 0.002, "side 2": 0.37, "side 4": 0.3, "cut 4": 0.05, "side 8": 1,
        "cut 8": 4.45, "side slender": 0.2, "cut slender": 0.03, "soft squared": 0.199, "soft wide": 1.76,
        "hairline small": 0.823, "cancelled": 0.00598,
    },
    "inner": {
        "inner": 0.02, "inner small": 0.1, "inner soft": 0.05, "inner in shell": 0.256, "outer": 0.02,
        "outer tall shell": 0.2, "outer soft shell": 0.952, "outer wide": 1.02, "spheres near surface": 3.29,
        "spheres near floor": 0.1, "spheres near sides": 7.15, "spheres under rim": 0.02, "spheres several": 0.02,
        "always": 0.0197, "thin": 0.005, "very thin": 0.002, "side 2": 0.03, "side 4": 0.3, "cut 4": 0.05, "side 8": 1,
        "cut 8": 0.925, "side slender": 0.88, "cut slender": 0.0577, "soft squared": 0.0599, "soft wide": 1.96,
        "hairline": 0.0292, "hairline small": 0.597, "cancelled": 0.00398,
    },
    "outer": {
        "inner": 0.02, "inner small": 0.1, "inner soft": 0.05, "inner in shell": 4.34, "outer": 0.02,
        "outer tall shell": 0.727, "outer soft shell": 0.1, "outer soft tall": 0.0807, "spheres": 0.0224,
        "spheres near surface": 1.46, "spheres near floor": 0.1, "spheres at the floor": 1.56,
        "spheres near sides": 4.68, "spheres under rim": 0.02, "spheres several": 0.02, "always": 0.01, "thin": 0.005,
        "very thin": 0.002, "side 2": 0.03, "side 4": 0.3, "cut 4": 0.05, "side 8": 1, "cut 8": 3.76,
        "side slender": 0.986, "cut slender": 0.0955, "soft squared": 0.0325, "hairline small": 0.1,
        "cancelled": 0.00373,
    },
    "sensitivity": {
        "inner": 0.02, "inner small": 7.08, "inner soft": 1.77, "inner in shell": 0.833, "outer": 0.02,
        "outer tall shell": 0.668, "outer soft shell": 0.1, "outer soft tall": 9.28, "spheres near surface": 3.13,
        "spheres near floor": 0.1, "spheres at the floor": 4.02, "spheres near sides": 1, "spheres under rim": 1.68,
        "spheres several": 2.55, "always": 0.01, "thin": 0.81, "very thin": 0.002, "side 2": 0.03, "side 4": 0.3,
        "cut 4": 0.858, "side 8": 1, "cut 8": 0.3, "side slender": 0.2, "cut slender": 0.0927, "soft squared": 0.02,
        "soft wide": 4.45, "hairline small": 0.106, "cancelled": 0.0103,
    },
}  # fmt: skip


@dataclass(frozen=True)
class StatedErrors:
    """Bounds on the errors of ln(ratio), of the logarithms of both totals, shape (2,), and of the log-sensitivity."""

    log_ratio: float
    log_totals: Floats
    sensitivity: float

    def bound(self, totals: Floats) -> Bound:
        """What totals may be too large by: as their logarithms are bounded, true ones are not zero."""
        return Bound(-np.expm1(-self.log_totals) * totals, self.log_ratio)

    @property
    def largest(self) -> float:
        """Relative error bound of ratio, stresses and stiffness."""
        return float(np.expm1(min(max(self.log_ratio, *self.log_totals), 700.0)))


def errors(scene: Scene, forces: Floats, slopes: Floats, sided: bool) -> StatedErrors:
    """Return eq. CF.19 for a scene, with all of groove, film and base; arguments as of ``error_features.features``."""
    feature_sets = features(scene, forces, slopes, sided)
    ratio, inner, outer, sensitivity = (
        sum(weight * part[name] for name, weight in WEIGHTS[kind].items())
        for kind, part in zip(WEIGHTS, feature_sets, strict=True)
    )
    detail_bounds = [detail.bound(forces[0]) for detail in details(scene.probe)]
    films = np.array([inner, outer]) + sum(bound.totals for bound in detail_bounds) / forces[0].sum(axis=1)
    sensitivity += LEAST_SENSITIVITY
    return StatedErrors(min(ratio, inner + outer) + sum(bound.log_ratio for bound in detail_bounds), films, sensitivity)
