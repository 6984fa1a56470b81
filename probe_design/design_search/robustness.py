"""Compute the effect of workshop tolerances on a design: the closed-form objective over random draws of the built probe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, qmc

from geometry.common.arrays import Floats
from geometry.common.json_types import JsonObject
from geometry.scenes.catalogue import find_material
from geometry.scenes.scene import Scene
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.variables import ProbeSizes, has_separate_heights, name_variables, read_vector

TOLERANCE_DRAWS, SOBOL_SEED = 64, 22
LENGTH_SD_M = {"inner_radius": 0.05e-3, "outer_radius": 0.05e-3, "gap": 0.02e-3, "height": 0.05e-3}  # m, one standard deviation
LOG_MODULUS = 0.1  # of a measured modulus, if the material does not state its own
MIN_LENGTH_RELATIVE = 0.2  # minimum of a length as built, over the drawn one


@dataclass(frozen=True)
class Robustness:
    """One design under tolerances; all by the closed form.

    Attributes
    ----------
    nominal
        The objective of the probe as drawn.
    expected
        Its statistic over the built probes: the mean, or the quantile that ``[objective]`` names.
    low, high
        The 5 % and 95 % quantiles over the built probes.
    """

    nominal: float
    expected: float
    low: float
    high: float

    def as_dict(self) -> JsonObject:
        """Return the numbers as a JSON object."""
        return vars(self) | {"evaluator": "closed-form", "draws": TOLERANCE_DRAWS}


def compute_robustness(objective: PopulationObjective, scene: Scene, materials: tuple[str, ...]) -> Robustness:
    """Return the objective of a scene's probe as drawn and its distribution under workshop tolerances."""
    probe = scene.probe
    poisson = probe.inner.poisson_ratio, probe.outer.poisson_ratio
    built = np.concatenate([read_vector(scene)[:, None], draw_built_designs(scene, materials)], axis=1)
    searched = objective.evaluate_designs(built, poisson)
    convert = objective.design.objective.convert_searched
    finite_values = np.array([convert(value) for value in searched[1:].tolist() if np.isfinite(value)])
    nominal = convert(float(searched[0]))
    if not len(finite_values):
        return Robustness(nominal, nominal, nominal, nominal)
    low, high = np.quantile(finite_values, [0.05, 0.95]).tolist()
    return Robustness(nominal, objective.design.objective.compute_statistic(finite_values), low, high)


def draw_built_designs(scene: Scene, materials: tuple[str, ...]) -> Floats:
    """Draw probes as built: lengths and logarithms of moduli are normally distributed about the drawn ones.

    Parameters
    ----------
    scene
        The scene with the probe as drawn.
    materials
        Names of the blocks' materials, whose own tolerances hold; empty: ``LOG_MODULUS`` for both.

    Returns
    -------
    Floats
        Designs as in ``variables``, with one height or two, shape (6 or 7, ``TOLERANCE_DRAWS``).
    """
    separate, probe = has_separate_heights(scene), scene.probe
    z = norm.ppf(qmc.Sobol(6 + separate, seed=SOBOL_SEED).random(TOLERANCE_DRAWS)).T

    def draw_length(key: str, size: float, normal: Floats) -> Floats:
        """Return lengths as built, m, for standard normal numbers; never near 0."""
        return np.maximum(size + LENGTH_SD_M[key] * normal, MIN_LENGTH_RELATIVE * size)

    inner, gap = draw_length("inner_radius", probe.inner_radius, z[0]), draw_length("gap", probe.gap, z[2])
    # the wall, too, keeps a minimum thickness
    outer = np.maximum(
        draw_length("outer_radius", probe.tube_radius, z[1]),
        inner + gap + MIN_LENGTH_RELATIVE * (probe.tube_radius - probe.hole_radius),
    )
    deviations = [find_material(name).log_sd for name in materials] or [LOG_MODULUS, LOG_MODULUS]
    inner_modulus, outer_modulus = (
        block.youngs_modulus * np.exp(deviation * normal)
        for block, deviation, normal in zip((probe.inner, probe.outer), deviations, z[4:6], strict=True)
    )
    sizes = ProbeSizes(
        inner_radius=inner,
        area_ratio=inner**2 / (outer**2 - (inner + gap) ** 2),
        gap=gap,
        inner_height=draw_length("height", probe.core_height, z[3]),
        outer_height=draw_length("height", probe.tube_height, z[6 if separate else 3]),
        inner_modulus=inner_modulus,
        outer_modulus=outer_modulus,
    )
    return sizes.build_vector(name_variables(len(z)))
