"""Verify designs by an evaluator more accurate than the search's closed form, each design under its own load."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

from geometry.common.errors import InputError, Refusal
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_dict
from probe_design.design_search.loaded_limits import PressedDesign
from probe_design.design_search.loads import MAX_RATIO_CHANGE_RELATIVE, Pressing, compute_pressing
from probe_design.design_search.objective_bounds import bound_objective, compute_objective
from probe_design.design_search.scan_trials import ScanTrials
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.variables import is_same_design
from probe_design.populations.objective import Objective
from probe_design.populations.performance import Performance
from probe_design.populations.tables import Protocol
from solver import Result, evaluator
from solver.closed_form.evaluator import ClosedForm
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_limits import build_limits
from solver.results.evaluator import FilmEvaluator, FilmSolution

GAIN_SIGNIFICANCE = 2.0  # times the combined error: a gain beyond it counts
VERIFICATION_ACCURACY = 0.01  # of the evaluator
FINER_ACCURACY = 0.001  # of the evaluator if its errors at ``VERIFICATION_ACCURACY`` hide a gain


@dataclass(frozen=True)
class PopulationVerification:
    """A design verified on tumours that the search did not use.

    Attributes
    ----------
    scene
        The whole scene, with the force as its load.
    pressed
        The force with its limits.
    performance
        Performance on tumours not used in the search.
    aim
        The quantity that the design file asks for.
    protocol
        The readings of the scan.
    trials
        Simulated scans over the tumours, where the quantity is verified by them; else None.
    materials
        Materials of the inner and the outer block, empty if none were requested.
    """

    scene: Scene
    pressed: PressedDesign
    performance: Performance
    aim: Objective
    protocol: Protocol
    trials: ScanTrials | None = None
    materials: tuple[str, ...] = ()

    @property
    def loaded_scene(self) -> Scene:
        """The scene under the load that it is verified with."""
        return self.scene

    @property
    def evaluator(self) -> str:
        """Name of the evaluator."""
        return self.performance.evaluator

    @property
    def objective(self) -> tuple[float, float]:
        """The quantity that the design file asks for, and its error."""
        if self.trials is not None:
            return self.trials.compute_objective(self.aim)
        kind = self.aim.maximise
        return self.performance.means[kind], self.performance.errors[kind].total

    @property
    def force(self) -> tuple[float, str]:
        """The force, N, and what limits it."""
        return self.pressed.force, self.pressed.limited_by

    def compute_gain(self, reference: PopulationVerification) -> tuple[float, float]:
        """Return the gain in the objective over another design for the same tumours, and its error by model and sample."""
        if self.scene == reference.scene and self.protocol == reference.protocol:
            return 0.0, 0.0
        if self.trials is not None and reference.trials is not None:
            return self.trials.compute_gain(reference.trials, self.aim)
        return self.performance.compute_gain(reference.performance, self.aim)

    def is_better_than(self, reference: PopulationVerification) -> bool:
        """Return whether this is better than another design by more than twice the error of the gain."""
        return is_significant(*self.compute_gain(reference))

    def summarize_pressing(self) -> JsonObject:
        """Return the load as a JSON object."""
        pressed = self.pressed
        return {
            "force": pressed.force, "indentation": pressed.indentation, "tissue_strain": pressed.tissue_strain,
            "charge": list(pressed.charge), "limited_by": pressed.limited_by,
        }  # fmt: skip


@dataclass(frozen=True)
class TumourVerification:
    """A design with its results by the closed form and by the verifying evaluator.

    Attributes
    ----------
    scene
        The scene with this probe.
    result
        The evaluator's result, at the load of ``pressing``.
    pressing
        The load of the objective.
    value
        Standard deviation of ln E_object by the evaluator, smaller is better.
    lower, upper
        Bounds of ``value``, from the evaluator's error bounds and the neglected finite strain.
    formula_result
        The closed form's result, or None if it refuses the scene.
    refused
        The requirement that the closed form states in a refusal, or None.
    formula_value
        ``value`` by the closed form, inf if it refuses the scene.
    linear
        The same design under the largest load within linear elasticity, if ``pressing`` is beyond that.
    """

    scene: Scene
    result: Result
    pressing: Pressing
    value: float
    lower: float
    upper: float
    formula_result: Result | None = None
    refused: str | None = None
    formula_value: float = math.inf
    linear: TumourVerification | None = None

    @property
    def loaded_scene(self) -> Scene:
        """The scene under the load that it is verified with."""
        return _set_load(self.scene, self.pressing)

    @property
    def evaluator(self) -> str:
        """Name of the evaluator."""
        return self.result.evaluator

    @property
    def objective(self) -> tuple[float, float]:
        """Standard deviation of ln E_object and its error bound, which is inf if there is none."""
        return self.value, max(self.upper - self.value, self.value - self.lower) if self.upper < math.inf else math.inf

    @property
    def force(self) -> tuple[float, str]:
        """The force, N, and what limits it."""
        return self.pressing.force, self.pressing.limited_by

    @property
    def linear_design(self) -> TumourVerification | None:
        """The same design under the largest load within linear elasticity, if this one is under more; else None."""
        return self.linear if self.linear is not None and self.linear.pressing.force < self.pressing.force else None

    def compute_gain(self, reference: TumourVerification) -> tuple[float, float]:
        """Return the relative reduction of the standard deviation compared with another design, and the error of the reduction.

        The error combines those of both designs, and is inf where one of them has no bound.
        """
        (value, error), (reference_value, reference_error) = self.objective, reference.objective
        if not math.isfinite(reference_error) or not math.isfinite(error):
            return 0.0 if math.isinf(value) else 1 - value / reference_value, math.inf
        quotient = value / reference_value
        return 1 - quotient, quotient * math.hypot(error / value, reference_error / reference_value)

    def is_better_than(self, reference: TumourVerification) -> bool:
        """Return whether this is better than another design whatever the errors of both are within their bounds.

        If one of them is under a load beyond linear elasticity, the gain has to be above twice its error as well.
        """
        if not self.upper < reference.lower:
            return False
        return (self.linear is None and reference.linear is None) or is_significant(*self.compute_gain(reference))

    def as_dict(self) -> JsonObject:
        """Return the results as a JSON object."""
        return {
            "objective": replace_non_finite(self.value),
            "objective_within": [self.lower, replace_non_finite(self.upper)],
            "searched_objective": replace_non_finite(self.formula_value),
            "force": self.pressing.force,
            "force_limited_by": self.pressing.limited_by,
            "evaluator": self.evaluator,
            "under_load": self.summarize_load_gain(),
            "design": scene_to_dict(self.loaded_scene),
        }

    def summarize_load_gain(self) -> JsonObject | None:
        """Return as a JSON object what a load beyond linear elasticity gains over the largest load within it.

        The design is the same: ``linear_objective`` is its standard deviation of ln E_object under the largest load within
        linear elasticity, with its bounds, and ``gain`` the relative reduction by the larger load. None if there is no larger.
        """
        linear = self.linear_design
        if linear is None:
            return None
        gain, error = self.compute_gain(linear)
        return {
            "linear_force": linear.pressing.force,
            "linear_force_limited_by": linear.pressing.limited_by,
            "linear_objective": replace_non_finite(linear.value),
            "linear_objective_within": [linear.lower, replace_non_finite(linear.upper)],
            "gain": replace_non_finite(gain),
            "gain_error": replace_non_finite(error),
        }


def is_significant(gain: float, error: float) -> bool:
    """Return whether a gain is above 0 and above ``GAIN_SIGNIFICANCE`` times its error."""
    return gain > GAIN_SIGNIFICANCE * error and gain > 0


def replace_non_finite(value: float | None) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return value if value is not None and math.isfinite(value) else None


def verify_tumour_design(
    scene: Scene,
    noise: Noise,
    evaluator_name: str,
    accuracy: float = VERIFICATION_ACCURACY,
    formula: FilmSolution | InputError | None = None,
) -> TumourVerification:
    """Verify a scene's probe by an evaluator, and compute the closed form's result for comparison.

    Parameters
    ----------
    scene
        Scene with the probe.
    noise
        Noise of a reading.
    evaluator_name
        Evaluator of the verification.
    accuracy
        Accuracy of the evaluator.
    formula
        The closed form's result or refusal, if it is known already; see ``evaluate_closed_form``.

    Raises
    ------
    Refusal
        The evaluator cannot model the scene.
    """
    # the rule for loads comes from a coarse model, so that evaluator and closed form are compared by the same rule
    start, rule = perf_counter(), CoarseModel.from_scene(scene).build_rule(scene)
    solution = evaluate_films(scene, evaluator_name, accuracy)
    films = solution.films[0]
    pressing = compute_pressing(scene, float(films.totals.sum()), rule)
    lower, upper = bound_objective(scene, films, noise, pressing)
    result = solution.build_result(evaluator_name, _set_load(scene, pressing), perf_counter() - start)
    verified = TumourVerification(
        scene=scene,
        result=replace(result, load_limits=build_limits(rule, MAX_RATIO_CHANGE_RELATIVE, promise=True)),
        pressing=pressing,
        value=compute_objective(scene, films, noise, pressing.force),
        lower=lower,
        upper=upper,
    )
    (formula_solution,) = evaluate_closed_form([scene], accuracy) if formula is None else (formula,)
    if isinstance(formula_solution, InputError):
        return replace(verified, refused=formula_solution.allowed)
    films = formula_solution.films[0]
    pressing = compute_pressing(scene, float(films.totals.sum()), rule)
    formula_result = formula_solution.build_result("closed-form", _set_load(scene, pressing), 0.0)
    verified = replace(verified, formula_result=formula_result)
    with suppress(Refusal):  # a closed form without charges has no objective
        return replace(verified, formula_value=compute_objective(scene, films, noise, pressing.force))
    return verified


def evaluate_films(scene: Scene, evaluator_name: str, accuracy: float = VERIFICATION_ACCURACY) -> FilmSolution:
    """Return the film forces by an evaluator, with the error of its log-sensitivity.

    Raises
    ------
    Refusal
        The evaluator cannot model the scene.
    """
    film_evaluator = evaluator(evaluator_name)
    assert isinstance(film_evaluator, FilmEvaluator)
    return film_evaluator.solve(scene, accuracy)


def evaluate_closed_form(scenes: Sequence[Scene], accuracy: float = VERIFICATION_ACCURACY) -> list[FilmSolution | InputError]:
    """Return the closed form's result or refusal for each scene; ten scenes take twice the time of one."""
    return ClosedForm().solve_many(scenes, [accuracy] * len(scenes))


def _set_load(scene: Scene, pressed: Pressing) -> Scene:
    """Return the scene under the load of ``pressed``."""
    return scene.model_copy(update={"load": pressed.load})


def merge_designs(verified: Iterable[TumourVerification]) -> tuple[TumourVerification, ...]:
    """Sort designs, best first, and drop those that agree with a better one within ``is_same_design``'s tolerance."""
    distinct: list[TumourVerification] = []
    for item in sorted(verified, key=lambda item: item.value):
        if not any(is_same_design(item.scene, better.scene) for better in distinct):
            distinct.append(item)
    return tuple(distinct)
