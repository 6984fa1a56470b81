"""A design with its results by the closed form and by the judging evaluator, and the error of its objective."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from probe_design.optimisation.design_space import is_same_design
from probe_design.optimisation.objective import Noise, standard_deviation
from probe_design.optimisation.pressing import MAX_RATIO_CHANGE_RELATIVE, Pressing, compute_pressing
from solver import Result, evaluator
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_limits import build_limits
from solver.planning.loads import bound_log_sensitivity_change, compute_sensitivity_size
from solver.results.evaluator import FilmEvaluator, FilmSolution
from solver.results.film_forces import FilmForces

JUDGE_ACCURACY = 0.01  # of the judge
GAIN_SIGNIFICANCE = 2.0  # times the combined error: a gain beyond linear elasticity counts beyond it
FINER_ACCURACY = 0.001  # of the judge where its errors at ``JUDGE_ACCURACY`` hide a gain


@dataclass(frozen=True)
class Candidate:
    """A design with its results by the closed form and by the judging evaluator.

    Attributes:
        scene: the scene with this probe.
        judged: the judge's result, at the load of ``pressing``.
        pressing: the load that the objective counts with.
        wall_approach: of the walls per unit indentation, see ``CoarseModel.wall_approach``.
        judged_objective: standard deviation of ln E_object by the judge, smaller is better.
        objective_min, objective_max: bounds of that objective, from the judge's error bounds and the neglected finite strain.
        searched: the closed form's result, or None where it refuses the scene.
        refused: what it takes instead, or None.
        searched_objective: by the closed form, inf where it refuses.
        linear: the same design under the largest load that linear elasticity answers for, where this is one beyond that.
    """

    scene: Scene
    judged: Result
    pressing: Pressing
    wall_approach: float
    judged_objective: float
    objective_min: float
    objective_max: float
    searched: Result | None = None
    refused: str | None = None
    searched_objective: float = math.inf
    linear: Candidate | None = None

    @property
    def loaded_scene(self) -> Scene:
        """The scene under the load that it is judged with."""
        return _set_load(self.scene, self.pressing)

    @property
    def linear_candidate(self) -> Candidate | None:
        """The same under the largest load that linear elasticity answers for, where this is under more; None elsewhere."""
        return self.linear if self.linear is not None and self.linear.pressing.force < self.pressing.force else None

    @property
    def error(self) -> float:
        """How far the objective can be off; inf where nothing bounds it."""
        return (
            max(self.objective_max - self.judged_objective, self.judged_objective - self.objective_min)
            if self.objective_max < math.inf
            else math.inf
        )

    def compute_gain(self, reference: Candidate) -> tuple[float, float]:
        """Return by which share the objective is less than the other's, and the combined error of that."""
        if not math.isfinite(reference.error) or not math.isfinite(self.error):
            return 0.0 if math.isinf(self.judged_objective) else 1 - self.judged_objective / reference.judged_objective, math.inf
        share = self.judged_objective / reference.judged_objective
        return 1 - share, share * math.hypot(self.error / self.judged_objective, reference.error / reference.judged_objective)

    def is_better_than(self, reference: Candidate) -> bool:
        """Whether it is better than the other, whatever the errors of both are; beyond linear elasticity by twice those."""
        if self.linear is None and reference.linear is None:
            return self.objective_max < reference.objective_min
        gain, error = self.compute_gain(reference)
        return self.objective_max < reference.objective_min and gain > GAIN_SIGNIFICANCE * error


def evaluate_candidate(
    scene: Scene, noise: Noise, judge: str, accuracy: float = JUDGE_ACCURACY, formula: FilmSolution | InputError | None = None
) -> Candidate:
    """Evaluate a scene's probe with the judging evaluator and with the closed form.

    Args:
        scene: with the probe.
        noise: of a reading.
        judge: the evaluator's name.
        accuracy: of the judge.
        formula: what the closed form finds, or its refusal, where that is known, see ``evaluate_closed_form``.

    Raises:
        Refusal: the judge cannot take the scene.
    """
    start, rough = perf_counter(), CoarseModel.from_scene(scene)
    rule = rough.build_rule(scene)
    answer = evaluate_films(scene, judge, accuracy)
    films = answer.films[0]
    pressed = compute_pressing(scene, float(films.totals.sum()), rule)
    objective_min, objective_max = bound_objective(films, noise, pressed)
    candidate = Candidate(
        scene=scene,
        judged=replace(
            answer.build_result(judge, _set_load(scene, pressed), perf_counter() - start),
            load_limits=build_limits(rule, MAX_RATIO_CHANGE_RELATIVE, promise=True),
        ),
        pressing=pressed,
        wall_approach=rough.wall_approach,
        judged_objective=compute_objective(films, noise, pressed.force),
        objective_min=objective_min,
        objective_max=objective_max,
    )
    (formula_answer,) = evaluate_closed_form([scene], accuracy) if formula is None else (formula,)
    if isinstance(formula_answer, InputError):
        return replace(candidate, refused=formula_answer.allowed)
    films = formula_answer.films[0]
    pressed = compute_pressing(scene, float(films.totals.sum()), rule)
    searched = formula_answer.build_result("closed-form", _set_load(scene, pressed), 0.0)
    return replace(candidate, searched=searched, searched_objective=compute_objective(films, noise, pressed.force))


def evaluate_films(scene: Scene, evaluator_name: str, accuracy: float = JUDGE_ACCURACY) -> FilmSolution:
    """Return the answer of an evaluator, with the error of its log-sensitivity.

    Raises:
        Refusal: the evaluator cannot take the scene.
    """
    made = evaluator(evaluator_name)
    assert isinstance(made, FilmEvaluator)
    return made.solve(scene, accuracy)


def evaluate_closed_form(scenes: Sequence[Scene], accuracy: float = JUDGE_ACCURACY) -> list[FilmSolution | InputError]:
    """Return what the closed form finds of each scene, or its refusal: of ten in twice the time of one."""
    made = evaluator("closed-form")
    assert isinstance(made, FilmEvaluator)
    return made.solve_many(scenes, [accuracy] * len(scenes))


def _set_load(scene: Scene, pressed: Pressing) -> Scene:
    return scene.model_copy(update={"load": pressed.load})


def compute_objective(films: FilmForces, noise: Noise, force: float) -> float:
    """Return the objective under a force, N; inf where the sensitivity is not resolved."""
    if films.stress_below_error is not None or films.log_sensitivity is None:
        return math.inf
    return standard_deviation(noise.compute_information(films.log_sensitivity, _compute_inner_share(films), force))


def merge_candidates(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Sort candidates, best first, and drop those within the tolerance of a better one."""
    distinct: list[Candidate] = []
    for item in sorted(candidates, key=lambda item: item.judged_objective):
        if not any(is_same_design(item.scene, better.scene) for better in distinct):
            distinct.append(item)
    return tuple(distinct)


def _compute_inner_share(films: FilmForces) -> float:
    """The inner film's share of the force."""
    return float(films.totals[0] / films.totals.sum())


def bound_objective(films: FilmForces, noise: Noise, pressed: Pressing) -> tuple[float, float]:
    """Return lower and upper bounds of the objective, given the errors of film forces and of linear elasticity."""
    sensitivities = films.film_log_sensitivities
    if films.stress_below_error is not None or films.log_sensitivity is None or sensitivities is None:
        return 0.0, math.inf
    size, share = abs(films.log_sensitivity), _compute_inner_share(films)
    sensitivity_error = films.sensitivity_error + compute_sensitivity_size(sensitivities) * bound_log_sensitivity_change(
        pressed.x
    )
    shift = films.bound.log_ratio + pressed.change
    odds = share / (1 - share) * np.exp([-shift, 0.0, shift])  # inner over outer force
    noises = [standard_deviation(noise.compute_information(1.0, ratio / (1 + ratio), pressed.force)) for ratio in odds.tolist()]
    return min(noises) / (size + sensitivity_error), max(noises) / (
        size - sensitivity_error
    ) if size > sensitivity_error else math.inf
