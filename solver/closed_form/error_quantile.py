"""Errors of the closed form: quantiles, which the true errors are below in 95 % of the scenes of each class.

    error = exp(c + sum of w_k x_k)                                                              (CF.19)

of ln(ratio), of the logarithms of both totals and of the stiffness and, absolute, of the log-sensitivity. The features x_k are
logarithms of ratios of lengths and moduli (``compute_features``). Layered scenes have weights w_k of their own, the other classes
the same; the constant c is that of the scene's class. ``python -m benchmarks.closed_form.error`` fits the weights to drawn
scenes, calibrates the constants and writes both to ``TABLES``.
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
from solver.closed_form.contact import Tissue
from solver.closed_form.designs import PROBE_PARAMETERS, TISSUE_PARAMETERS, Shape, split_parameters
from solver.layers.scene_layers import compute_squeezes
from solver.layers.stack import TissueLayer
from solver.results.detail_compliance import FILM_DETAIL, iterate_details
from solver.results.film_forces import Bound

SceneClass = Literal["bare", "layered", "off axis", "near sides"]
SCENE_CLASSES: tuple[SceneClass, ...] = ("bare", "layered", "off axis", "near sides")
TABLES = dict.fromkeys(SCENE_CLASSES, "error_quantiles.json") | {"layered": "layered_error_quantiles.json"}
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

    @classmethod
    def from_row(cls, row: Floats) -> StatedErrors:
        """Return the errors of one scene, a row of ``state_errors``."""
        ratio, inner, outer, stiffness, sensitivity = row.tolist()
        return cls(ratio, np.array([inner, outer]), stiffness, sensitivity)

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


def state_errors(shape: Shape, values: Floats, forces: Floats, derivatives: Floats) -> Floats:
    """Return the 95 % quantiles of the formulas' errors for n scenes of one structure (eq. CF.19), shape (n, 5): ``QUANTITIES``.

    Each operation is on one scene's numbers, so that a scene's errors do not depend on the scenes beside it.

    Parameters
    ----------
    shape
        Their structure.
    values
        Their parameters, see ``designs.build_parameters``, shape (parameters, n).
    forces
        N/m, shape (n, 2, 2); positive totals.
    derivatives
        Their derivatives by the logarithm of the target's modulus, shape (n, 2, 2).
    """
    kind, features = classify(shape), compute_features(shape, values, forces, derivatives)
    table = read_quantiles(TABLES[kind])
    constants, weights = table["constants"][kind], table["weights"]
    exponents = [constants[name] + sum(weight * features[key] for key, weight in weights[name].items()) for name in QUANTITIES]
    return np.stack([np.exp(exponent) for exponent in exponents], axis=1)


@cache
def read_quantiles(file_name: str) -> dict[str, dict[str, dict[str, float]]]:
    """Read a file of this package: weights by quantity and feature, constants by class and quantity of eq. CF.19."""
    document = json.loads(resources.files("solver.closed_form").joinpath(file_name).read_text(encoding="utf-8"))
    return {key: document[key] for key in ("weights", "constants")}


def compute_features(shape: Shape, values: Floats, forces: Floats, derivatives: Floats) -> dict[str, Floats]:
    """Return the features of eq. CF.19, each of shape (n,): large, or small, where one of the approximations is rough.

    - soft tube: how stiff the tissue's surface is compared with the tube, whose end few functions describe;
    - thin wall, unequal radii, unequal heights: shapes of the blocks under which tractions are steep;
    - thin cover, large tumour: of the worst tumour, whose images are of few moments;
    - opposed forces: the forces beyond their sum, as where a block hangs on the other;
    - softer layers: the modulus of the first layer over that of the softest, at most ``MAX_SOFTNESS``;
    - squeezed layer: how much blocks squeeze a thin, soft first layer (``solver.layers.scene_layers.compute_squeezes``);
    - far sides: how much sides that are left out matter; near sides: how near modelled ones are;
    - target: how much the target's modulus changes of both totals; of the log-sensitivity alone.

    See ``state_errors`` for the arguments.
    """
    inner_radius, gap, radius, inner_height, outer_height, _, _, tube_modulus, _ = values[: len(PROBE_PARAMETERS)]
    depth, side, last_modulus, last_poisson = values[len(PROBE_PARAMETERS) : len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)]
    bodies, layers, _ = split_parameters(shape, values)
    wall, none = radius - (inner_radius + gap), np.zeros(values.shape[1])
    first_modulus, first_poisson = layers[0][1:] if len(layers) else (last_modulus, last_poisson)
    softness = first_modulus / (1 - first_poisson**2) / tube_modulus * np.minimum(outer_height / wall, 1.0)
    softest = np.minimum.reduce([last_modulus, *(layer[1] for layer in layers)])
    totals = forces.sum(axis=2)
    features = {
        "soft tube": np.log(0.1 + softness / (1 + softness)),
        "thin wall": np.log(0.001 + wall / radius),
        "unequal radii": np.log(inner_radius / radius) ** 2,
        "unequal heights": np.abs(np.log(inner_height / outer_height)),
        "thin cover": np.log1p(np.maximum.reduce([none, *(2 * body[0] / (body[1] - body[0]) for body in bodies)])),
        "large tumour": np.log1p(np.maximum.reduce([none, *(2 * body[0] / radius for body in bodies)])),
        "opposed forces": np.log((np.abs(forces).sum(axis=2) / totals).max(axis=1)),
        "softer layers": np.log(np.minimum(first_modulus / softest, MAX_SOFTNESS)),
        "squeezed layer": none,
        "far sides": none,
        "near sides": none,
        "target": np.log(1e-7 + np.abs(derivatives.sum(axis=2) / totals).sum(axis=1)),
    }
    if shape.layers:
        bottom, upper_layers = depth if shape.bounded else None, tuple(TissueLayer(*layer) for layer in layers)
        tissue = Tissue(bottom, last_modulus, last_poisson, layers=upper_layers)
        features["squeezed layer"] = np.log1p(compute_squeezes(radius, tissue.stack))
    if shape.bounded:
        if shape.side_nodes:
            features["near sides"] = np.log1p(radius / side)
        else:
            features["far sides"] = np.log1p(10 * depth * radius / side**2)
    return features
