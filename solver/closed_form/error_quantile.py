"""Errors of the closed form: quantiles, which the true errors are below in 95 % of the scenes of each class.

    error = exp(c + sum of w_k x_k)                                                              (CF.19)

of ln(ratio), of the logarithms of both totals and of the stiffness and, absolute, of the log-sensitivity. The features x_k are
logarithms of ratios of lengths and moduli (``compute_features``), their weights w_k the same for all classes; the constant c is
that of the scene's class. ``python -m benchmarks.closed_form.error`` fits the weights to drawn scenes, calibrates the constants
and writes both to ``error_quantiles.json``.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Literal

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from solver.closed_form.designs import Shape
from solver.closed_form.lateral_boundary import compute_side_radius
from solver.results.detail_compliance import FILM_DETAIL, iterate_details
from solver.results.film_forces import Bound

SceneClass = Literal["bare", "layered", "off axis", "near sides"]
SCENE_CLASSES: tuple[SceneClass, ...] = ("bare", "layered", "off axis", "near sides")
CHARGE_CLASSES: tuple[SceneClass, ...] = ("bare", "layered", "near sides")  # of which charges are known
MAX_SOFTNESS = 30.0  # ratio of moduli: plates on softer layers are not further off, and few were drawn
QUANTITIES = ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity")


def classify(shape: Shape) -> SceneClass:
    """Return the class of scenes of a structure: layers, else tumours off the axis or several, else modelled sides, else bare."""
    if shape.layers:
        return "layered"
    if len(shape.on_axis) > 1 or not all(shape.on_axis):
        return "off axis"
    return "near sides" if shape.side_nodes else "bare"


@dataclass(frozen=True)
class StatedErrors:
    """95 % quantiles of the errors of a scene's film forces.

    Attributes
    ----------
    log_ratio
        Of ln(ratio).
    log_totals
        Of the logarithms of both totals, shape (2,).
    log_stiffness
        Of the logarithm of their sum.
    sensitivity
        Of the log-sensitivity, absolute.
    """

    log_ratio: float
    log_totals: Floats
    log_stiffness: float
    sensitivity: float

    @property
    def largest(self) -> float:
        """The largest of the errors of the logarithms of ratio, totals and stiffness."""
        return max(self.log_ratio, float(self.log_totals.max()), self.log_stiffness)

    def compute_bound(self, totals: Floats) -> Bound:
        """Return bounds on the errors of totals, N/m, shape (2,): by how much they may be too large.

        The errors of their logarithms are bounded, so that the true totals are exp(-error) of them at least, and not zero.
        """
        sum_error = -math.expm1(-self.log_stiffness) * float(totals.sum())
        return Bound(-np.expm1(-self.log_totals) * totals, self.log_ratio, sum_error)

    def add_details(self, probe: Probe, forces: Floats, *, films: bool) -> StatedErrors:
        """Return the errors, increased by bounds on how much groove, base and films change the forces, N/m, shape (2, 2).

        ``films`` is whether the forces take the films' compliance into account.
        """
        errors = self
        for detail in iterate_details(probe):
            if films and detail.name == FILM_DETAIL:
                continue
            bound = detail.compute_bound(forces)
            errors = StatedErrors(
                errors.log_ratio + bound.log_ratio,
                errors.log_totals + bound.totals / forces.sum(axis=1),
                errors.log_stiffness + float(bound.totals.sum() / forces.sum()),
                errors.sensitivity,
            )
        return errors


def state_errors(scene: Scene, shape: Shape, forces: Floats, derivatives: Floats) -> StatedErrors:
    """Return the 95 % quantiles of the formulas' errors for a scene (eq. CF.19).

    Parameters
    ----------
    scene
        The scene.
    shape
        Its structure.
    forces
        N/m, shape (2, 2); positive totals.
    derivatives
        Their derivatives by the logarithm of the target's modulus, shape (2, 2).
    """
    table, features = _read_table(), compute_features(scene, shape, forces, derivatives)
    exponents = {
        name: table["constants"][classify(shape)][name]
        + sum(weight * features[key] for key, weight in table["weights"][name].items())
        for name in QUANTITIES
    }
    ratio, inner, outer, stiffness, sensitivity = (math.exp(exponents[name]) for name in QUANTITIES)
    return StatedErrors(ratio, np.array([inner, outer]), stiffness, sensitivity)


@cache
def _read_table() -> dict[str, dict[str, dict[str, float]]]:
    """Read ``error_quantiles.json``: weights by quantity and feature, constants by class and quantity of eq. CF.19."""
    document = json.loads(resources.files("solver.closed_form").joinpath("error_quantiles.json").read_text(encoding="utf-8"))
    return {key: document[key] for key in ("weights", "constants")}


def compute_features(scene: Scene, shape: Shape, forces: Floats, derivatives: Floats) -> dict[str, float]:
    """Return the features of eq. CF.19: each is large, or small, where one of the approximations is rough.

    - soft tube: how stiff the tissue's surface is compared with the tube, whose end few functions describe;
    - thin wall, unequal radii, unequal heights: shapes of the blocks under which tractions are steep;
    - thin cover, large tumour: of the worst tumour, whose images are of few moments;
    - opposed forces: the forces beyond their sum, as where a block hangs on the other;
    - softer layers: the modulus of the first layer over that of the softest, at most ``MAX_SOFTNESS``;
    - far sides: how much sides that are left out matter; near sides: how near modelled ones are;
    - target: how much the target's modulus changes of both totals; of the log-sensitivity alone.

    See ``state_errors`` for the arguments.
    """
    probe, tissue = scene.probe, scene.tissue
    radius, wall = probe.tube_radius, probe.tube_radius - probe.hole_radius
    layers = (*tissue.layer, tissue)
    modulus = layers[0].youngs_modulus / (1 - layers[0].poisson_ratio ** 2)
    softness = modulus / probe.outer.youngs_modulus * min(probe.tube_height / wall, 1.0)
    sizes = [(body.diameter or 0.0, body.depth) for body in scene.inclusion]
    totals = forces.sum(axis=1)
    features = {
        "soft tube": math.log(0.1 + softness / (1 + softness)),
        "thin wall": math.log(0.001 + wall / radius),
        "unequal radii": math.log(probe.inner_radius / radius) ** 2,
        "unequal heights": abs(math.log(probe.core_height / probe.tube_height)),
        "thin cover": math.log1p(max((size / (depth - size / 2) for size, depth in sizes), default=0.0)),
        "large tumour": math.log1p(max((size / radius for size, _ in sizes), default=0.0)),
        "opposed forces": math.log(float((np.abs(forces).sum(axis=1) / totals).max())),
        "softer layers": math.log(min(layers[0].youngs_modulus / min(layer.youngs_modulus for layer in layers), MAX_SOFTNESS)),
        "far sides": 0.0,
        "near sides": 0.0,
        "target": math.log(1e-7 + float(np.abs(derivatives.sum(axis=1) / totals).sum())),
    }
    if tissue.shape != "half-space":
        side = compute_side_radius(tissue)
        if shape.side_nodes:
            features["near sides"] = math.log1p(radius / side)
        else:
            features["far sides"] = math.log1p(10 * tissue.depth * radius / side**2)
    return features
