"""Refine a design for the equivalent-inclusion evaluator, with the closed form corrected to its value and gradient at the design.

With f the closed form's objective, g that of the evaluator to first order, u the logarithms of the free variables and u_0 those
of the design,

    f(u) + g(u_0) - f(u_0) + (g'(u_0) - f'(u_0)) . (u - u_0)                                          (DS.3)

has the value and the gradient of g at u_0, which is computed by differences of ``LOG_DIFFERENCE_STEP`` (first-order model
management). It is maximised within ``MAX_LOG_CHANGE`` of the design. The new design counts only if g itself is larger there.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from probe_design.design_search.choices import Choice, Progress
from probe_design.design_search.closed_search import refine_by_ipopt
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.variables import ProbeSizes
from probe_design.populations.film_totals import stack_totals
from solver.closed_form.designs import PROBE_PARAMETERS
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.planning.coarse_model import CoarseModel
from solver.tumour_waves.moments import TumourDraws
from solver.tumour_waves.population_films import Films, ManyTumours

LOG_DIFFERENCE_STEP, MAX_LOG_CHANGE = 0.03, 0.25  # of the logarithms
MAX_IPOPT_STEPS = 20
CHARGE_ACCURACY = 0.05  # of the films' charges without tumours


@dataclass(frozen=True)
class CorrectedObjective:
    """The closed-form objective corrected to the finer model at one design (eq. DS.3), for IPOPT.

    Attributes
    ----------
    objective
        The closed form's objective f.
    start
        The design at which it is corrected, exp(u_0), shape (variables,).
    derivatives
        g'(u_0) - f'(u_0) with respect to the logarithms of the free variables, shape (k,).
    """

    objective: PopulationObjective
    start: Floats
    derivatives: Floats

    def gradient(self, x: Floats, poisson: tuple[float, float], which: list[int]) -> tuple[Floats, Floats]:
        """Return both values and their derivatives, see ``ExactGradients.gradient``.

        The constant g(u_0) - f(u_0) of eq. DS.3 is left out, as it does not move the maximum; the charge's margin is that of
        the closed form.
        """
        closed_values, derivatives = self.objective.gradient(x, poisson, which)
        moved = np.log(x[which] / self.start[which])
        return closed_values + np.array([float(self.derivatives @ moved), 0.0]), derivatives + np.stack(
            [self.derivatives, 0 * self.derivatives]
        )


@dataclass(frozen=True)
class InclusionTumours:
    """Readings over many tumours in place of ``ManyTumours``, for one probe that finite elements solve on each tissue.

    Attributes
    ----------
    bases
        The probe on each tissue.
    draws
        The tumours.
    tissue
        Number of each tumour's tissue, shape (m,).
    places
        Of the probe's axis, m, shape (P, 2).
    """

    bases: tuple[Undisturbed, ...]
    draws: TumourDraws
    tissue: Ints
    places: Floats

    def compute_films(self, probes: Any, stacks: Any = None) -> Films:
        """Return the film forces of the one probe without tumours and their changes by each tumour; arguments are ignored.

        Where its scene reads charges, they follow the forces.

        The arrays of ``Films`` have a first axis of length 1, as there is one probe.
        """
        m, count = len(self.tissue), len(self.places)
        size = 4 if self.bases[0].scene.observable == "charge" else 2
        baseline, change, by_log = np.zeros((1, m, size)), np.zeros((1, m, count, size)), np.zeros((1, m, count, size))
        # baseline, change and by_log: ``Films.without``, its change by the tumour, and the derivative by ln E_object
        for number, base in enumerate(self.bases):
            which = np.flatnonzero(self.tissue == number)
            if not len(which):
                continue
            readings = compute_readings(base, self._list_relative_tumours(which), 0, reflect=False)
            totals = stack_totals(base.scene, base.films)
            baseline[0, which] = totals
            change[0, which] = stack_totals(base.scene, readings).reshape(len(which), count, size) - totals
            parts = [readings] if size == 2 else [readings, readings.get_observable(base.scene)]
            derivatives = [part.derivatives["youngs_modulus"].sum(axis=2) for part in parts]
            by_log[0, which] = np.concatenate(derivatives, axis=-1).reshape(len(which), count, size)
        return Films(baseline, change, by_log)

    def _list_relative_tumours(self, which: Ints) -> Tumours:
        """Return k tumours, given by index, relative to the probe's axis at each of P positions, shape (k P, 1)."""
        draws, count = self.draws, len(self.places)
        columns = [(place[which, None] - self.places[:, axis]).ravel() for axis, place in enumerate((draws.x, draws.y))]
        numbers = draws.depth, 2 * draws.radius, draws.youngs_modulus, draws.poisson_ratio
        columns += [np.repeat(values[which], count) for values in numbers]
        return Tumours(*(column[:, None] for column in columns))


def compute_inclusion_objective(objective: PopulationObjective, scene: Scene) -> float:
    """Return the objective of a scene's probe by equivalent-inclusion to first order; ``-inf`` where it is not finite.

    Raises
    ------
    Refusal
        The evaluator does not support the scene.
    """
    draw, sizes = objective.draw, ProbeSizes.from_scene(scene)
    bases = tuple(map(_solve_tissue, draw.replace_probe(scene).tissues))

    def replace_tumours(tumours: ManyTumours) -> Any:
        """Return the same draws of tumours, whose readings follow from ``bases``, the base states on each tissue."""
        return InclusionTumours(bases, tumours.draws, draw.tissue, objective.design.protocol.list_places(scene.placement.y))

    moved = {name: (replace_tumours(smaller), replace_tumours(larger)) for name, (smaller, larger) in objective.moved.items()}
    inclusion_objective = replace(objective, tumours=replace_tumours(objective.tumours), moved=moved)
    # the film forces are those of ``bases``, whatever probes are passed
    no_probes = np.zeros((len(PROBE_PARAMETERS), 1))
    with np.errstate(all="ignore"):
        values = inclusion_objective.compute_statistic(
            no_probes, lambda totals: objective.rule.compute_forces(sizes, totals, draw.tissue)
        )
    return float(values[0]) if np.isfinite(values[0]) else -np.inf


def _solve_tissue(scene: Scene) -> Undisturbed:
    """Return a probe on tissue without tumours, on the coarsest mesh, or on a finer one where charges are read."""
    if scene.observable == "stress":
        return CoarseModel.from_scene(scene, details=False).base_states
    return EquivalentInclusion().prepare(scene.model_copy(update={"inclusion": ()}), CHARGE_ACCURACY)


def refine_design(objective: PopulationObjective, search_space: SearchSpace, start: Choice, progress: Progress) -> Choice | None:
    """Return a nearby design with a better objective by the equivalent-inclusion evaluator; None if there is none.

    Parameters
    ----------
    objective
        The closed form's objective.
    search_space
        The allowed designs.
    start
        The design to refine; its discrete values and materials stay.
    progress
        Called with the number of evaluations done and their total.
    """
    objective = objective.set_choices(start.combination)

    def evaluate(vector: Floats) -> float:
        """Return g of a design; -inf where it cannot be built or evaluated."""
        with suppress(ProbeError):
            scene = search_space.build_exact_scene(vector, start.combination)
            return -np.inf if scene is None else compute_inclusion_objective(objective, scene)
        return -np.inf

    space, poisson = search_space.pin(start.combination.pinned), start.combination.poisson
    free, start_value = space.free, evaluate(start.design)
    if not free or not np.isfinite(start_value):
        return None
    derivatives = np.zeros(len(free))
    closed_gradient = objective.gradient(start.design, poisson, free)[1][0]
    for position, k in enumerate(free):
        progress(position, len(free) + 1)
        # without a value of g there, the closed form's derivative stays uncorrected
        moved, step = _move_variable(start.design, k, space.low, space.high)
        moved_value = evaluate(moved)
        derivatives[position] = (
            (moved_value - start_value) / step - closed_gradient[position] if np.isfinite(moved_value) else 0.0
        )
    low = np.maximum(space.low, start.design * np.exp(-MAX_LOG_CHANGE))
    high = np.minimum(space.high, start.design * np.exp(MAX_LOG_CHANGE))
    corrected, nearby_space = CorrectedObjective(objective, start.design, derivatives), replace(space, low=low, high=high)
    refined = refine_by_ipopt(corrected, nearby_space, start.design, poisson=poisson, steps=MAX_IPOPT_STEPS)
    progress(len(free) + 1, len(free) + 1)
    if not evaluate(refined) > start_value:
        return None
    return Choice(start.combination, refined, float(objective.evaluate_designs(refined[:, None], poisson)[0]))


def _move_variable(design: Floats, k: int, low: Floats, high: Floats) -> tuple[Floats, float]:
    """Return a design with one variable moved away from its nearer bound, and the change of that variable's logarithm."""
    upwards = np.log(high[k] / design[k]) >= np.log(design[k] / low[k])
    moved = design.copy()
    moved[k] = np.clip(design[k] * np.exp(LOG_DIFFERENCE_STEP if upwards else -LOG_DIFFERENCE_STEP), low[k], high[k])
    return moved, float(np.log(moved[k] / design[k]))
