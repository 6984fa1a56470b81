"""A design with its results by the closed form and by the judging evaluator, and the error of its objective."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from probe_design.optimisation.design_space import alike
from probe_design.optimisation.objective import Noise, objective
from probe_design.optimisation.pressing import RATIO, Pressing, pressing
from solver import Result, evaluator
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_limits import limits_of
from solver.planning.loads import log_sensitivity_change, sensitivity_size
from solver.results.evaluator import Answer, FilmLevel
from solver.results.film_forces import FilmForces

ACCURACY = 0.01  # of the judge
SURE = 2.0  # times the combined error: a gain beyond linear elasticity counts beyond it
FINER = 0.001  # of the judge where its errors at ``JUDGE_ACCURACY`` hide a gain


@dataclass(frozen=True)
class Candidate:
    """A design with its results by the closed form and by the judging evaluator.

    Attributes:
        scene: the scene with this probe.
        judged: the judge's result, at the load of ``pressing``.
        pressing: the load that the objective counts with.
        wall_approach: of the walls per unit indentation, see ``CoarseModel.approach``.
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
    nearing: float
    judged_objective: float
    least: float
    most: float
    searched: Result | None = None
    refused: str | None = None
    searched_objective: float = math.inf
    linear: Candidate | None = None

    @property
    def pressed(self) -> Scene:
        """The scene under the load that it is judged with."""
        return _under(self.scene, self.pressing)

    @property
    def less_pressed(self) -> Candidate | None:
        """The same under the largest load that linear elasticity answers for, where this is under more; None elsewhere."""
        return self.linear if self.linear is not None and self.linear.pressing.force < self.pressing.force else None

    @property
    def error(self) -> float:
        """How far the objective can be off; inf where nothing bounds it."""
        return max(self.most - self.judged_objective, self.judged_objective - self.least) if self.most < math.inf else math.inf

    def gain_over(self, other: Candidate) -> tuple[float, float]:
        """Return by which share the objective is less than the other's, and the combined error of that."""
        if not math.isfinite(other.error) or not math.isfinite(self.error):
            return 0.0 if math.isinf(self.judged_objective) else 1 - self.judged_objective / other.judged_objective, math.inf
        share = self.judged_objective / other.judged_objective
        return 1 - share, share * math.hypot(self.error / self.judged_objective, other.error / other.judged_objective)

    def beats(self, other: Candidate) -> bool:
        """Whether it is better than the other, whatever the errors of both are; beyond linear elasticity by twice those."""
        if self.linear is None and other.linear is None:
            return self.most < other.least
        gain, error = self.gain_over(other)
        return self.most < other.least and gain > SURE * error


def candidate(
    scene: Scene, noise: Noise, judge: str, accuracy: float = ACCURACY, formula: Answer | InputError | None = None
) -> Candidate:
    """Evaluate a scene's probe with the judging evaluator and with the closed form.

    Args:
        scene: with the probe.
        noise: of a reading.
        judge: the level's name.
        accuracy: of the judge.
        formula: what the closed form finds, or its refusal, where that is known, see ``evaluate_closed_form``.

    Raises:
        Refusal: the judge cannot take the scene.
    """
    start, rough = perf_counter(), CoarseModel.of(scene)
    rule = rough.rule(scene)
    answer = answered(scene, judge, accuracy)
    films = answer.films[0]
    pressed = pressing(scene, float(films.totals.sum()), rule)
    least, most = ends_of(films, noise, pressed)
    candidate = Candidate(
        scene=scene,
        judged=replace(
            answer.result(judge, _under(scene, pressed), perf_counter() - start), load_limits=limits_of(rule, RATIO, promise=True)
        ),
        pressing=pressed,
        nearing=rough.approach,
        judged_objective=objective_of(films, noise, pressed.force),
        least=least,
        most=most,
    )
    (found,) = by_formulas([scene], accuracy) if formula is None else (formula,)
    if isinstance(found, InputError):
        return replace(candidate, refused=found.allowed)
    films = found.films[0]
    pressed = pressing(scene, float(films.totals.sum()), rule)
    searched = found.result("closed-form", _under(scene, pressed), 0.0)
    return replace(candidate, searched=searched, searched_objective=objective_of(films, noise, pressed.force))


def answered(scene: Scene, level: str, accuracy: float = ACCURACY) -> Answer:
    """Return the answer of an evaluator, with the error of its log-sensitivity.

    Raises:
        Refusal: the level cannot take the scene.
    """
    made = evaluator(level)
    assert isinstance(made, FilmLevel)
    return made.answer(scene, accuracy)


def by_formulas(scenes: Sequence[Scene], accuracy: float = ACCURACY) -> list[Answer | InputError]:
    """Return what the closed form finds of each scene, or its refusal: of ten in twice the time of one."""
    made = evaluator("closed-form")
    assert isinstance(made, FilmLevel)
    return made.answers(scenes, [accuracy] * len(scenes))


def _under(scene: Scene, pressed: Pressing) -> Scene:
    return scene.model_copy(update={"load": pressed.load})


def objective_of(films: FilmForces, noise: Noise, force: float) -> float:
    """Return the objective under a force, N; inf where the sensitivity is not resolved."""
    if films.unresolved_stress is not None or films.log_sensitivity is None:
        return math.inf
    return objective(noise.information(films.log_sensitivity, _share(films), force))


def merged(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Sort candidates, best first, and drop those within the tolerance of a better one."""
    distinct: list[Candidate] = []
    for one in sorted(candidates, key=lambda one: one.judged_objective):
        if not any(alike(one.scene, other.scene) for other in distinct):
            distinct.append(one)
    return tuple(distinct)


def _share(films: FilmForces) -> float:
    """The inner film's share of the force."""
    return float(films.totals[0] / films.totals.sum())


def ends_of(films: FilmForces, noise: Noise, pressed: Pressing) -> tuple[float, float]:
    """Return lower and upper bounds of the objective, given the errors of film forces and of linear elasticity."""
    sensitivities = films.film_log_sensitivities
    if films.unresolved_stress is not None or films.log_sensitivity is None or sensitivities is None:
        return 0.0, math.inf
    size, share = abs(films.log_sensitivity), _share(films)
    off = films.sensitivity_error + sensitivity_size(sensitivities) * log_sensitivity_change(pressed.x)
    shift = films.bound.log_ratio + pressed.change
    odds = share / (1 - share) * np.exp([-shift, 0.0, shift])  # inner over outer force
    noises = [objective(noise.information(1.0, one / (1 + one), pressed.force)) for one in odds.tolist()]
    return min(noises) / (size + off), max(noises) / (size - off) if size > off else math.inf
