"""Refine a design for the equivalent-inclusion evaluator, with the closed form corrected to its value and gradient at the design.

With f the closed form's objective, g the evaluator's, u the logarithms of the free variables and u_0 those of the design,

    f(u) + g(u_0) - f(u_0) + (g'(u_0) - f'(u_0)) . (u - u_0)                                          (DS.3)

has the value and the gradient of g at u_0, which is computed by differences of ``LOG_DIFFERENCE_STEP`` (first-order model
management). It is maximised within ``MAX_LOG_CHANGE`` of the design. The new design counts only if g itself is larger there.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError
from probe_design.design_search.choices import Choice, Progress
from probe_design.design_search.closed_search import refine_by_ipopt
from probe_design.design_search.design_objective import DesignObjective
from probe_design.design_search.inclusion_model import compute_inclusion_objective
from probe_design.design_search.search_space import SearchSpace
from probe_design.populations.design_file import Design

LOG_DIFFERENCE_STEP, MAX_LOG_CHANGE = 0.03, 0.25  # of the logarithms
MAX_IPOPT_STEPS = 20  # of IPOPT


@dataclass(frozen=True)
class CorrectedDesigns:
    """The closed-form objective corrected to the finer model at one design (eq. DS.3), for IPOPT."""

    design_objective: DesignObjective
    start: Floats
    slopes: Floats

    def gradient(self, x: Floats, poisson: tuple[float, float], which: list[int]) -> tuple[Floats, Floats]:
        """Return both values and their derivatives, see ``ExactGradients.gradient``."""
        closed_values, slopes = self.design_objective.gradient(x, poisson, which)
        moved = np.log(x[which] / self.start[which])
        return closed_values + np.array([float(self.slopes @ moved), 0.0]), slopes + np.stack([self.slopes, 0 * self.slopes])


def refine_design(
    design_objective: DesignObjective, design: Design, search_space: SearchSpace, start: Choice, progress: Progress
) -> Choice | None:
    """Return a nearby design with a better objective by the equivalent-inclusion evaluator, or None."""
    space = search_space.pin_combination(start.combination)
    free = space.free
    start_value = _evaluate_inclusion(design_objective, design, search_space, start, start.design)
    if not free or not np.isfinite(start_value):
        return None
    slopes = np.zeros(len(free))
    closed_gradient = design_objective.gradient(start.design, start.combination.poisson, free)[1][0]
    for position, k in enumerate(free):
        progress(position, len(free) + 1)
        moved, step = _move_variable(start.design, k, space.low, space.high)
        moved_value = _evaluate_inclusion(design_objective, design, search_space, start, moved)
        slopes[position] = (moved_value - start_value) / step - closed_gradient[position] if np.isfinite(moved_value) else 0.0
    low = np.maximum(space.low, start.design * np.exp(-MAX_LOG_CHANGE))
    high = np.minimum(space.high, start.design * np.exp(MAX_LOG_CHANGE))
    corrected = CorrectedDesigns(design_objective, start.design, slopes)
    nearby_space = replace(space, low=low, high=high)
    refined = refine_by_ipopt(corrected, nearby_space, start.design, poisson=start.combination.poisson, steps=MAX_IPOPT_STEPS)
    progress(len(free) + 1, len(free) + 1)
    if not _evaluate_inclusion(design_objective, design, search_space, start, refined) > start_value:
        return None
    value = float(design_objective.evaluate_designs(refined[:, None], start.combination.poisson)[0])
    return Choice(start.combination, refined, value)


def _move_variable(design: Floats, k: int, low: Floats, high: Floats) -> tuple[Floats, float]:
    """Return a design with one variable moved away from its nearer bound, and the change of that variable's logarithm."""
    upwards = np.log(high[k] / design[k]) >= np.log(design[k] / low[k])
    moved = design.copy()
    moved[k] = np.clip(design[k] * np.exp(LOG_DIFFERENCE_STEP if upwards else -LOG_DIFFERENCE_STEP), low[k], high[k])
    return moved, float(np.log(moved[k] / design[k]))


def _evaluate_inclusion(
    design_objective: DesignObjective, design: Design, search_space: SearchSpace, start: Choice, vector: Floats
) -> float:
    scene = search_space.build_exact_scene(vector, start.combination)
    if scene is None:
        return -np.inf
    with suppress(ProbeError):
        return compute_inclusion_objective(design_objective, design, scene)
    return -np.inf
