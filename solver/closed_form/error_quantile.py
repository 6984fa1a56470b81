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
from itertools import pairwise
from typing import Literal

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Inclusion, Scene
from solver.closed_form.designs import Shape
from solver.closed_form.lateral_boundary import compute_side_radius
from solver.results.detail_compliance import iterate_details
from solver.results.film_forces import Bound

SceneClass = Literal["bare", "layered", "off axis", "near sides"]
SCENE_CLASSES: tuple[SceneClass, ...] = ("bare", "layered", "off axis", "near sides")
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
        """Of the logarithms of ratio, totals and stiffness."""
        return max(self.log_ratio, float(self.log_totals.max()), self.log_stiffness)

    def compute_bound(self, totals: Floats) -> Bound:
        """Return by how much totals (2,), N/m, may be too large: their logarithms are bounded, so true totals are not zero."""
        sum_error = -math.expm1(-self.log_stiffness) * float(totals.sum())
        return Bound(-np.expm1(-self.log_totals) * totals, self.log_ratio, sum_error)

    def add_details(self, probe: Probe, forces: Floats) -> StatedErrors:
        """Return the errors with bounds on what groove, film and base change of the forces (2, 2), N/m, on top."""
        errors = self
        for detail in iterate_details(probe):
            bound = detail.compute_bound(forces)
            errors = StatedErrors(
                errors.log_ratio + bound.log_ratio,
                errors.log_totals + bound.totals / forces.sum(axis=1),
                errors.log_stiffness + float(bound.totals.sum() / forces.sum()),
                errors.sensitivity,
            )
        return errors


def state_errors(scene: Scene, shape: Shape, forces: Floats, slopes: Floats) -> StatedErrors:
    """State the errors of the formulas for a scene (eq. CF.19).

    Parameters
    ----------
    scene
        The scene.
    shape
        Its structure.
    forces
        N/m, shape (2, 2); positive totals.
    slopes
        Their derivatives by the logarithm of the target's modulus, shape (2, 2).
    """
    table, features = _read_table(), compute_features(scene, shape, forces, slopes)
    exponents = {
        name: table.constants[classify(shape)][name] + sum(weight * features[key] for key, weight in table.weights[name].items())
        for name in QUANTITIES
    }
    ratio, inner, outer, stiffness, sensitivity = (math.exp(exponents[name]) for name in QUANTITIES)
    return StatedErrors(ratio, np.array([inner, outer]), stiffness, sensitivity)


@dataclass(frozen=True)
class _Table:
    """Weights by quantity and feature, and constants by class and quantity, of eq. CF.19."""

    weights: dict[str, dict[str, float]]
    constants: dict[str, dict[str, float]]


@cache
def _read_table() -> _Table:
    """Read ``error_quantiles.json``; it names the scenes and the command that it comes from."""
    document = json.loads(resources.files("solver.closed_form").joinpath("error_quantiles.json").read_text(encoding="utf-8"))
    return _Table(document["weights"], document["constants"])


def compute_features(scene: Scene, shape: Shape, forces: Floats, slopes: Floats) -> dict[str, float]:
    """Return the features of eq. CF.19: each is large, or small, where one of the approximations is rough.

    - soft tube, soft disc: how stiff the tissue's surface is against the blocks, whose ends few functions describe;
    - thin wall, narrow gap, unequal blocks: lengths over the outer radius, under which tractions are steep;
    - thin cover, large tumour: of the worst tumour, whose images are of few moments;
    - compressible: 1 - 2 nu of the tissue's surface;
    - cancelled: the forces beyond their sum, as where a block hangs on the other;
    - interfaces: contrasts of layers, weighted less the deeper they are;
    - far sides: how much sides that are left out matter; near sides: how near modelled ones are;
    - target: how much the target's modulus changes of both totals.

    See ``state_errors`` for the arguments.
    """
    probe, tissue = scene.probe, scene.tissue
    radius, wall = probe.tube_radius, probe.tube_radius - probe.hole_radius
    surface = tissue.layer[0] if tissue.layer else tissue
    modulus = surface.youngs_modulus / (1 - surface.poisson_ratio**2)
    softness = (
        modulus / probe.inner.youngs_modulus * min(probe.core_height / probe.inner_radius, 1.0),
        modulus / probe.outer.youngs_modulus * min(probe.tube_height / wall, 1.0),
    )
    totals = forces.sum(axis=1)
    far_sides, near_sides = _measure_sides(scene, shape)
    return {
        "soft disc": math.log(0.1 + softness[0] / (1 + softness[0])),
        "soft tube": math.log(0.1 + softness[1] / (1 + softness[1])),
        "thin wall": math.log(0.001 + wall / radius),
        "narrow gap": math.log(0.001 + probe.gap / radius),
        "unequal blocks": math.log(probe.inner_radius / radius) ** 2,
        "thin cover": math.log1p(max((_get_cover_ratio(body) for body in scene.inclusion), default=0.0)),
        "large tumour": math.log1p(max(((body.diameter or 0.0) / radius for body in scene.inclusion), default=0.0)),
        "compressible": math.log(0.1 + 1 - 2 * surface.poisson_ratio),
        "cancelled": math.log(float((np.abs(forces).sum(axis=1) / totals).max())),
        "interfaces": math.log(0.1 + _sum_contrasts(scene)),
        "far sides": far_sides,
        "near sides": near_sides,
        "target": math.log(1e-7 + float(np.abs(slopes.sum(axis=1) / totals).sum())),
    }


def _get_cover_ratio(body: Inclusion) -> float:
    """Return the diameter over what covers a sphere."""
    size = body.diameter or 0.0
    return size / (body.depth - size / 2)


def _sum_contrasts(scene: Scene) -> float:
    """Return the sum of the interfaces' contrasts of modulus, each weighted less the deeper it is."""
    tissue = scene.tissue
    moduli = [*(layer.youngs_modulus for layer in tissue.layer), tissue.youngs_modulus]
    return sum(
        abs(upper - lower) / (upper + lower) / (1 + 10 * depth / scene.probe.tube_radius)
        for depth, (upper, lower) in zip(tissue.interfaces, pairwise(moduli), strict=True)
    )


def _measure_sides(scene: Scene, shape: Shape) -> tuple[float, float]:
    """Return how much left-out sides matter, and how near modelled ones are, each 0 where the other holds."""
    tissue, outer = scene.tissue, scene.probe.tube_radius
    if tissue.shape == "half-space":
        return 0.0, 0.0
    side = compute_side_radius(tissue)
    return (0.0, math.log1p(outer / side)) if shape.side_nodes else (math.log1p(10 * tissue.depth * outer / side**2), 0.0)
