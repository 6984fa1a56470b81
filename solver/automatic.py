"""Choose the evaluator for ``auto``: the one that the plan names, or the next one where that misses the accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from geometry.common.errors import Refusal
from geometry.common.limits import format_minimum
from geometry.common.percent import format_minimum_percent, format_percent
from geometry.common.resources import LimitReached
from geometry.scenes.scene import Scene
from geometry.scenes.surface_names import check_surface_names
from solver.evaluators import AUTO, CONTACT, DEFAULT_ACCURACY, evaluator
from solver.results.evaluator import Evaluator, OutOfReach, ProgressCallback
from solver.results.refusals import find_refusal
from solver.results.result import Result

if TYPE_CHECKING:
    from solver.planning.coarse_model import CoarseModel
    from solver.planning.plan import Plan

MAX_ACCURACY_ATTEMPTS = 4  # accuracies that are tried before one is reported as within reach
MIN_LOAD_SHARE_OF_ERROR = 0.2  # share of the error due to the load above which the refusal suggests a smaller load
MIN_ACCURACY_GROWTH = 1.25  # least factor from one tried accuracy to the next


@dataclass(frozen=True)
class AutoChoice:
    """The plan that ``auto`` chose for a scene, with its result.

    Attributes
    ----------
    plan
        Names the evaluator that reaches the accuracy.
    result
        The evaluator's result; None where the evaluator was not run.
    """

    plan: Plan
    result: Result | None


@dataclass(frozen=True)
class FailedAttempt:
    """An evaluator that refused or missed the accuracy.

    Attributes
    ----------
    plan
        The plan that named it.
    fault
        What it raised.
    """

    plan: Plan
    fault: Refusal

    def compute_error(self, accuracy: float) -> float:
        """Return the error bound of the whole result, load and left-out inclusions included; infinite without a result."""
        return (
            self.plan.compute_reached_error(self.fault.reached, accuracy) if isinstance(self.fault, OutOfReach) else float("inf")
        )


def choose_evaluator(
    scene: Scene,
    accuracy: float,
    linear: bool,
    progress: ProgressCallback | None,
    coarse: CoarseModel | None = None,
    *,
    skip_sure: bool = False,
) -> AutoChoice:
    """Choose the evaluator that ``auto`` uses for a scene, by running evaluators in turn; nothing else makes this choice.

    Parameters
    ----------
    scene
        A scene of any kind.
    accuracy
        As in ``solver.evaluation.evaluate``.
    linear
        Likewise.
    progress
        Likewise.
    coarse
        The scene's coarse model, where it is known.
    skip_sure
        Whether a plan that surely reaches the accuracy is accepted without running its evaluator.

    Raises
    ------
    Refusal
        No evaluator takes the scene, or none reaches the accuracy, or its load is out of reach.
    LimitReached
        See ``evaluate``.
    """
    outcome = _try_evaluators(scene, accuracy, linear, progress, coarse=coarse, skip_sure=skip_sure)
    if isinstance(outcome, AutoChoice):
        return outcome
    load_fault = next((attempt.fault for attempt in reversed(outcome) if attempt.fault.key.startswith("load.")), None)
    if load_fault is not None:
        raise _add_remedy(load_fault, outcome[-1].plan, scene) from None
    best = min(outcome, key=lambda attempt: attempt.compute_error(accuracy))
    if not isinstance(best.fault, OutOfReach):
        raise best.fault
    raise _build_refusal(best, best.fault, scene, accuracy, linear=linear, progress=progress) from None


def state_accuracy(scene: Scene) -> Scene:
    """Return a scene with the accuracy that ``auto`` reaches as its ``reading.accuracy``, where the default is out of reach."""
    try:
        choose_evaluator(scene, DEFAULT_ACCURACY, False, None)
    except OutOfReach as fault:
        return scene.model_copy(update={"reading": scene.reading.model_copy(update={"accuracy": fault.reachable})})
    except (Refusal, LimitReached):
        pass  # whatever the accuracy
    return scene


def build_allowed_plan(scene: Scene, accuracy: float, linear: bool, coarse: CoarseModel | None = None) -> Plan:
    """Return the plan with which ``auto`` begins, after a check of the load.

    Parameters
    ----------
    scene
        A scene of any kind.
    accuracy
        As in ``solver.evaluation.evaluate``.
    linear
        Likewise; the load is not checked then.
    coarse
        The scene's coarse model, where it is known.

    Raises
    ------
    Refusal
        No evaluator takes the scene, or its load is known to be too large before anything is solved.
    """
    from solver.planning.plan import build_plan

    check_surface_names(scene)
    planned = build_plan(scene, accuracy, linear=linear, coarse=coarse)
    if planned.evaluator is None:
        raise Refusal("evaluator", AUTO, str(find_refusal(scene, ("contact",))))
    if not linear:
        planned.check_load(scene, accuracy)
    return planned


def get_evaluator(name: str | None, progress: ProgressCallback | None) -> Evaluator:
    """Return the evaluator of the name that a plan gives; None does not occur, as such plans are refused before."""
    assert name is not None  # build_allowed_plan has refused it
    return evaluator(name, progress)


def _try_evaluators(
    scene: Scene, accuracy: float, linear: bool, progress: ProgressCallback | None, *, coarse: CoarseModel | None, skip_sure: bool
) -> AutoChoice | list[FailedAttempt]:
    """Run evaluators in turn; return the choice of the first that reaches the accuracy, or the failed attempts of all.

    Parameters: see ``choose_evaluator``.
    """
    from solver.planning.plan import build_plan, find_next_evaluator

    planned, failures = build_allowed_plan(scene, accuracy, linear, coarse), list[FailedAttempt]()
    while not (skip_sure and planned.is_sure()):
        try:
            result = get_evaluator(planned.evaluator, progress).evaluate_within(planned.scene, planned.accuracy, planned.allowed)
            return AutoChoice(planned, planned.complete_result(result, scene, accuracy, linear))
        except LimitReached:
            raise
        except Refusal as fault:
            failures.append(FailedAttempt(planned, fault))
        tried = [attempt.plan.evaluator or "" for attempt in failures]
        next_name = find_next_evaluator(planned, tried, failures[-1].fault, scene, accuracy=accuracy, linear=linear)
        if next_name is None:
            return failures
        planned = build_plan(scene, accuracy, next_name, linear=linear, coarse=coarse)
    return AutoChoice(planned, None)


def _add_remedy(fault: Refusal, planned: Plan, scene: Scene) -> Refusal:
    """Return the refusal of a load; one by ``contact`` is completed with advice how to evaluate the scene linearly.

    There is no such advice where only ``contact`` takes the scene, or where the refusal already contains it.
    """
    from solver.planning.load_check import LINEAR_REMEDY

    if planned.evaluator != CONTACT or find_refusal(scene, ("contact",)) is not None or LINEAR_REMEDY in fault.allowed:
        return fault
    return Refusal(fault.key, fault.value, f"{fault.allowed}, {LINEAR_REMEDY}")


def _build_refusal(
    best: FailedAttempt, fault: OutOfReach, scene: Scene, accuracy: float, *, linear: bool, progress: ProgressCallback | None
) -> OutOfReach:
    """Return a refusal that names the accuracy within reach, the evaluator that reaches it, and what to do."""
    reached = best.compute_error(accuracy)
    reachable, name = _find_reachable_accuracy(scene, reached, linear, progress), fault.name
    advice = f"--evaluator {name} returns its result with its own error"
    # the load's part of the error, at least: the accuracy that the evaluator's allowed error leaves
    load = 0.0 if linear else (1 + accuracy) / (1 + best.plan.allowed) - 1
    smaller_load, load_text = (
        (", or a smaller load", f", {format_percent(load)} by the load") if load > MIN_LOAD_SHARE_OF_ERROR * reached else ("", "")
    )
    text = f"none for this scene: errors are no smaller than the values (--evaluator {name} prints their bounds)"
    if reachable is not None:
        text = f"{format_percent(reachable)} or more for this scene{smaller_load}"
        text += f" ({name} reaches {format_minimum_percent(reached, 3)}{load_text}; {advice})"
    return OutOfReach(name, scene, accuracy, reached, stopped=fault.stopped, allowed=text, reachable=reachable)


def _find_reachable_accuracy(scene: Scene, reached: float, linear: bool, progress: ProgressCallback | None) -> float | None:
    """Return an accuracy, of two digits, that some evaluator reaches; None if none below 1 is.

    It is found by trying larger and larger ones, from ``reached`` on, as an evaluator's effort depends on the accuracy requested.
    """
    for _ in range(MAX_ACCURACY_ATTEMPTS):
        if not reached < 1:  # NaN too
            return None
        tried = float(format_minimum(reached, 2))
        try:
            outcome = _try_evaluators(scene, tried, linear, progress, coarse=None, skip_sure=False)
        except LimitReached:
            return tried  # out of time: the first suggestion has to do
        if isinstance(outcome, AutoChoice):
            return tried
        reached = max(min(attempt.compute_error(tried) for attempt in outcome), MIN_ACCURACY_GROWTH * tried)
    return float(format_minimum(reached, 2)) if reached < 1 else None
