"""Effect of workshop tolerances on a design: the closed-form objective over random draws of the built probe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm, qmc

from geometry.common.arrays import Floats
from geometry.scenes.catalogue import find_material
from geometry.scenes.scene import Scene
from probe_design.design_search.heights import has_different_heights, read_design_vector
from probe_design.design_search.steered_population import DesignObjective
from probe_design.populations.design_file import Design

TOLERANCE_DRAWS, SOBOL_SEED = 64, 22
LENGTH_SD_M = {"inner_radius": 0.05e-3, "outer_radius": 0.05e-3, "gap": 0.02e-3, "height": 0.05e-3}  # m, one standard deviation
LOG_MODULUS = 0.1  # of a modulus that was measured, where no material says its own
MIN_LENGTH_RELATIVE = 0.2  # of a length that tolerances leave, at least


@dataclass(frozen=True)
class Robustness:
    """One design under tolerances; all by the closed form.

    Attributes:
        nominal: the objective of the drawing.
        expected: its statistic over what is built: the mean, or the quantile that ``[objective]`` names.
        low, high: 5 and 95 % of what is built lie below.
    """

    nominal: float
    expected: float
    low: float
    high: float

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON has them."""
        return vars(self) | {"evaluator": "closed-form", "draws": TOLERANCE_DRAWS}


def compute_robustness(steered: DesignObjective, design: Design, scene: Scene, materials: tuple[str, ...]) -> Robustness:
    """Return the objective of a scene's probe as drawn and its distribution under workshop tolerances."""
    probe = scene.probe
    poisson = probe.inner.poisson_ratio, probe.outer.poisson_ratio
    built = np.concatenate([read_design_vector(scene)[:, None], draw_built_designs(scene, materials)], axis=1)
    values = steered.evaluate_designs(built, poisson)
    finite_values = values[1:][np.isfinite(values[1:])]
    if not len(finite_values):
        return Robustness(float(values[0]), float(values[0]), float(values[0]), float(values[0]))
    low, high = np.quantile(finite_values, [0.05, 0.95])
    return Robustness(float(values[0]), design.objective.compute_statistic(finite_values), float(low), float(high))


def draw_built_designs(scene: Scene, materials: tuple[str, ...]) -> Floats:
    """Draw probes as built, shape (6 or 7, ``TOLERANCE_DRAWS``): lengths and logarithms of moduli are normally distributed."""
    probe, z = scene.probe, norm.ppf(qmc.Sobol(6 + has_different_heights(scene), seed=SOBOL_SEED).random(TOLERANCE_DRAWS)).T
    sizes = {"inner_radius": probe.inner_radius, "outer_radius": probe.tube_radius, "gap": probe.gap, "height": probe.core_height}
    inner, outer, gap, height = (
        np.maximum(size + LENGTH_SD_M[key] * normal, MIN_LENGTH_RELATIVE * size)
        for (key, size), normal in zip(sizes.items(), z, strict=False)
    )
    outer = np.maximum(outer, inner + gap + MIN_LENGTH_RELATIVE * (probe.tube_radius - probe.hole_radius))
    deviations = [find_material(name).log_sd for name in materials] or [LOG_MODULUS, LOG_MODULUS]
    moduli = [
        block.youngs_modulus * np.exp(deviation * normal)
        for block, deviation, normal in zip((probe.inner, probe.outer), deviations, z[4:6], strict=True)
    ]
    heights = [
        np.maximum(probe.tube_height + LENGTH_SD_M["height"] * normal, MIN_LENGTH_RELATIVE * probe.tube_height)
        for normal in z[6:]
    ]
    return np.array([inner, inner**2 / (outer**2 - (inner + gap) ** 2), gap, height, *moduli, *heights])
