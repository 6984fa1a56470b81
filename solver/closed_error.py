"""How far the closed form may be off.

    error <= sum of weight x feature,                                                             (C2)

of ln(ratio), of the logarithms of both totals and, absolute, of the log-sensitivity, with the features of ``closed_features``.
The weights are an envelope of random scenes and of tests/reference, times a margin: ``python benchmarks/closed_form_error.py``
prints them, and audits them on other scenes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.grading import Floats
from geometry.scene import Scene
from solver.closed_features import features
from solver.details import details
from solver.film_forces import Bound

LEAST_SENSITIVITY = 5e-6  # half of what no one asks to be told
WEIGHTS: dict[str, dict[str, float]] = {
    "ratio": {
        "inner": 0.02, "inner small": 0.1, "inner flat": 0.0426, "inner soft": 0.0259, "inner in shell": 0.041,
        "outer": 0.02, "outer tall shell": 0.596, "outer soft shell": 0.257, "spheres near surface": 1.03,
        "spheres near floor": 0.204, "spheres near sides": 1, "spheres under rim": 0.02, "spheres several": 0.02,
        "always": 0.01, "thin": 0.0494, "very thin": 0.001, "side 2": 0.03, "cut 2": 0.164, "side 4": 0.3,
        "cut 4": 0.384, "side 8": 1, "cut 8": 0.3, "side slender": 0.2, "cut slender": 0.01, "soft squared": 0.649,
        "hairline small": 0.287, "cancelled": 0.00306,
    },
    "inner": {
        "inner": 0.02, "inner small": 0.407, "inner soft": 0.02, "outer": 0.02, "outer tall shell": 0.496,
        "outer soft shell": 0.609, "spheres near surface": 1.77, "spheres near floor": 0.1, "spheres near sides": 6.18,
        "spheres under rim": 0.02, "spheres several": 0.02, "always": 0.0128, "very thin": 0.001, "side 2": 0.03,
        "cut 2": 0.0758, "side 4": 10.3, "cut 4": 0.05, "side 8": 1, "cut 8": 0.3, "side slender": 0.705,
        "cut slender": 0.0128, "soft squared": 0.744, "hairline": 0.05, "hairline small": 0.1, "cancelled": 0.00355,
    },
    "outer": {
        "inner": 0.02, "inner small": 0.1, "inner flat": 0.0423, "inner soft": 0.02, "inner in shell": 0.0131,
        "outer": 0.02, "outer tall shell": 0.662, "outer soft shell": 0.1, "spheres": 0.0315,
        "spheres near surface": 0.5, "spheres near floor": 0.1, "spheres near sides": 3.56, "spheres under rim": 0.02,
        "spheres several": 0.02, "always": 0.0112, "very thin": 0.001, "side 2": 0.03, "side 4": 0.3, "cut 4": 0.05,
        "side 8": 1, "cut 8": 0.492, "side slender": 0.829, "cut slender": 0.0895, "soft squared": 0.02,
        "hairline small": 0.1, "cancelled": 0.003,
    },
    "sensitivity": {
        "inner": 0.02, "inner small": 6.31, "inner soft": 0.988, "inner in shell": 5.27, "outer": 0.02,
        "outer tall shell": 1.73, "outer soft shell": 2.15, "outer soft tall": 0.73, "spheres near surface": 2.83,
        "spheres near floor": 0.1, "spheres at the floor": 1.03, "spheres near sides": 1, "spheres under rim": 1.49,
        "spheres several": 0.02, "always": 0.01, "thin": 0.258, "very thin": 0.001, "side 2": 0.03, "side 4": 0.3,
        "cut 4": 0.05, "side 8": 1, "cut 8": 0.895, "side slender": 0.2, "cut slender": 0.01, "soft squared": 0.125,
        "soft wide": 2.94, "hairline small": 0.331, "cancelled": 0.003, "strong": 0.147,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Errors:
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


def errors(scene: Scene, forces: Floats, slopes: Floats, sided: bool) -> Errors:
    """Return eq. (C2) for a scene, with all of groove, film and base; arguments as of ``closed_features.features``."""
    found = features(scene, forces, slopes, sided)
    ratio, inner, outer, sensitivity = (
        sum(weight * part[name] for name, weight in WEIGHTS[kind].items()) for kind, part in zip(WEIGHTS, found, strict=True)
    )
    told = [detail.bound(forces[0]) for detail in details(scene.probe)]
    films = np.array([inner, outer]) + sum(bound.totals for bound in told) / forces[0].sum(axis=1)
    sensitivity += LEAST_SENSITIVITY
    return Errors(min(ratio, inner + outer) + sum(bound.log_ratio for bound in told), films, sensitivity)
