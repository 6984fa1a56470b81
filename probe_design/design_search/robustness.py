"""Compute the effect of workshop tolerances on a design: the closed-form objective over random draws of the built probe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, qmc

from geometry.common.arrays import Floats
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from probe_design.built_probe.block_predictions import express_by_outer_radius
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.search_tumours import split_stacks
from probe_design.design_search.variables import SEPARATE_HEIGHT_NAMES, ProbeSizes
from probe_design.tolerancing.budget import split_heights
from probe_design.tolerancing.sample_statistics import build_draw_function
from probe_design.tolerancing.uncertain_numbers import UncertainNumber, list_uncertain_numbers
from solver.closed_form.contact import Films as FilmStacks
from solver.closed_form.designs import PROBE_PARAMETERS

TOLERANCE_DRAWS, SOBOL_SEED = 64, 22
MIN_WALL_RELATIVE = 0.2  # minimum of the outer block's thickness as built, over the drawn one


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


def compute_robustness(objective: PopulationObjective, scene: Scene) -> Robustness:
    """Return the objective of a scene's probe as drawn and its distribution under workshop tolerances.

    The probes as built differ by the uncertain numbers of the command ``tolerances``, films and bonds included. A built probe for
    which the closed form has no result, such as one with a charge of the other sign, counts as one that detects nothing (of place
    errors: as the largest of the others).
    """
    drawn = split_heights(express_by_outer_radius(scene.model_copy(update={"inclusion": ()})))
    variables = list_uncertain_numbers(drawn)
    eta = norm.ppf(qmc.Sobol(len(variables), seed=SOBOL_SEED).random(TOLERANCE_DRAWS)).T
    # the first column is the probe as drawn
    designs, poisson, stacks = draw_built_probes(drawn, variables, np.insert(eta, 0, 0.0, axis=1))
    rule = replace(objective.rule, omits_cancelling=False)  # a search leaves such designs out, a built probe is as it is
    searched = replace(objective, rule=rule, stacks=stacks, scans={}).evaluate_designs(designs, poisson)
    aim, is_finite = objective.design.objective, np.isfinite(searched)
    worst = 0.0 if aim.sign > 0 else min(searched[is_finite].tolist(), default=0.0)
    nominal, *built = map(aim.convert_searched, np.where(is_finite, searched, worst).tolist())
    low, high = np.quantile(built, [0.05, 0.95]).tolist()
    return Robustness(nominal, aim.compute_statistic(np.array(built)), low, high)


def draw_built_probes(
    scene: Scene, variables: Sequence[UncertainNumber], eta: Floats
) -> tuple[Floats, Floats, FilmStacks | None]:
    """Draw probes as built.

    Parameters
    ----------
    scene
        The scene with the probe as drawn, without tumours, given by its outer radius.
    variables
        The v uncertain numbers.
    eta
        Standard normal numbers, shape (v, n).

    Returns
    -------
    tuple[Floats, Floats, FilmStacks | None]
        Designs as in ``variables``, with two heights, shape (7, n); Poisson's ratios of both blocks, shape (2, n); and films and
        bonds where the scene reads charges that need them.
    """
    shape, draw_parameters = build_draw_function(scene, variables)
    columns, _ = draw_parameters(eta)
    numbers = dict(zip(PROBE_PARAMETERS, columns, strict=False))  # those of the tissue follow
    hole = numbers["inner_radius"] + numbers["gap"]
    outer = np.maximum(numbers["outer_radius"], hole + MIN_WALL_RELATIVE * (scene.probe.tube_radius - scene.probe.hole_radius))
    sizes = ProbeSizes(
        inner_radius=numbers["inner_radius"],
        area_ratio=numbers["inner_radius"] ** 2 / (outer**2 - hole**2),
        gap=numbers["gap"],
        inner_height=numbers["inner_height"],
        outer_height=numbers["outer_height"],
        inner_modulus=numbers["inner_modulus"],
        outer_modulus=numbers["outer_modulus"],
    )
    poisson = np.array([numbers["inner_poisson"], numbers["outer_poisson"]])
    return sizes.build_vector(SEPARATE_HEIGHT_NAMES), poisson, split_stacks(scene, shape, columns)
