"""The one decision of ``auto``: the evaluator that the plan names, or the next one where that does not reach the accuracy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from geometry.common.errors import Refusal
from geometry.common.limits import least
from geometry.common.resources import LimitReached
from geometry.scenes.scene import Scene
from geometry.scenes.surface_names import check_surface_names
from solver.levels import AUTO, CONTACT, evaluator
from solver.results.evaluator import Evaluator, OutOfReach, Tell
from solver.results.kinds import unsupported
from solver.results.result import Result

if TYPE_CHECKING:
    from solver.planning.coarse_model import CoarseModel
    from solver.planning.plan import Plan

ATTEMPTS = 4  # accuracies that are tried before one is named as within reach
LOADED = 0.2  # of the error that is reached: where the load has more of it, a smaller one is worth naming
MORE = 1.25  # times the last of them is the next, at least


Sure = Callable[["Plan"], bool]


def never(planned: Plan) -> bool:
    """Ask every evaluator that is named."""
    return False


@dataclass(frozen=True)
class Decided:
    """What ``auto`` does with a scene.

    Attributes:
        plan: with the evaluator that answers.
        result: its answer; None where that was not asked for.
    """

    plan: Plan
    result: Result | None


@dataclass(frozen=True)
class Missed:
    """An evaluator that did not answer.

    Attributes:
        plan: that named it.
        fault: why it did not.
    """

    plan: Plan
    fault: Refusal

    def reached(self, accuracy: float) -> float:
        """Return the error of the whole answer, load and left-out inclusions included; infinite where there was none."""
        return self.plan.reached(self.fault.reached, accuracy) if isinstance(self.fault, OutOfReach) else float("inf")


def automatic(scene: Scene, accuracy: float, linear: bool, tell: Tell | None) -> Result:
    """Return the answer of the cheapest evaluator that reaches the accuracy.

    Raises:
        Refusal: none does, or the load is beyond what linear elasticity allows; see ``decide``.
    """
    result = decide(scene, accuracy, linear, tell).result
    assert result is not None  # it was asked for
    return result


def decide(
    scene: Scene, accuracy: float, linear: bool, tell: Tell | None, rough: CoarseModel | None = None, *, sure: Sure = never
) -> Decided:
    """Decide how ``auto`` answers a scene, by asking the evaluators in turn; the one place where that is decided.

    Args:
        scene: any.
        accuracy: as in ``evaluate``.
        linear: likewise.
        tell: likewise.
        rough: the scene's coarse model, where it is known.
        sure: whether an evaluator is named without being asked.

    Raises:
        Refusal: no evaluator takes the scene, or none reaches the accuracy, or its load is out of reach.
        LimitReached: see ``evaluate``.
    """
    found = _first_to_answer(scene, accuracy, linear, tell, rough=rough, sure=sure)
    if isinstance(found, Decided):
        return found
    by_load = next((one.fault for one in reversed(found) if one.fault.key.startswith("load.")), None)
    if by_load is not None:
        raise _with_remedy(by_load, found[-1].plan, scene) from None
    best = min(found, key=lambda one: one.reached(accuracy))
    if not isinstance(best.fault, OutOfReach):
        raise best.fault
    raise _out_of_reach(best, best.fault, scene, accuracy, linear=linear, tell=tell) from None


def allowed_plan(scene: Scene, accuracy: float, linear: bool, rough: CoarseModel | None = None) -> Plan:
    """Return the plan with which ``auto`` begins.

    Args:
        scene: any.
        accuracy: as in ``evaluate``.
        linear: likewise.
        rough: the scene's coarse model, where it is known.

    Raises:
        Refusal: no level built yet takes the scene, or its load is out of reach before anything is solved.
    """
    planned = supported_plan(scene, accuracy, linear, rough)
    if not linear:
        planned.check_load(scene, accuracy)
    return planned


def supported_plan(scene: Scene, accuracy: float, linear: bool, rough: CoarseModel | None = None) -> Plan:
    """The plan for a scene that some level takes.

    Raises:
        Refusal: no level built yet takes the scene.
    """
    from solver.planning.plan import plan as run

    check_surface_names(scene)
    planned = run(scene, accuracy, linear=linear, rough=rough)
    if planned.evaluator is None:
        raise Refusal("evaluator", AUTO, str(unsupported(scene)))
    return planned


def level_of(name: str | None, tell: Tell | None) -> Evaluator:
    """Return the level that a plan names."""
    assert name is not None  # supported_plan has refused it
    return evaluator(name, tell)


def _first_to_answer(
    scene: Scene, accuracy: float, linear: bool, tell: Tell | None, *, rough: CoarseModel | None, sure: Sure
) -> Decided | list[Missed]:
    """The first evaluator that answers within the accuracy, or all that did not."""
    from solver.planning.plan import following
    from solver.planning.plan import plan as run

    planned, missed = allowed_plan(scene, accuracy, linear, rough), list[Missed]()
    while not sure(planned):
        try:
            result = level_of(planned.evaluator, tell).evaluate_within(planned.scene, planned.accuracy, planned.allowed)
            return Decided(planned, planned.completed(result, scene, accuracy, linear))
        except LimitReached:
            raise
        except Refusal as fault:
            missed.append(Missed(planned, fault))
        tried = [one.plan.evaluator or "" for one in missed]
        level = following(planned, tried, missed[-1].fault, scene, accuracy=accuracy, linear=linear)
        if level is None:
            return missed
        planned = run(scene, accuracy, level, linear=linear, rough=rough)
    return Decided(planned, None)


def _with_remedy(fault: Refusal, planned: Plan, scene: Scene) -> Refusal:
    """What ``contact`` says of a load, with the way to answer linearly all the same."""
    from solver.planning.load_check import REMEDY

    if planned.evaluator != CONTACT or unsupported(scene) is not None or REMEDY in fault.allowed:
        return fault
    return Refusal(fault.key, fault.value, f"{fault.allowed}, {REMEDY}")


def _out_of_reach(
    best: Missed, fault: OutOfReach, scene: Scene, accuracy: float, *, linear: bool, tell: Tell | None
) -> OutOfReach:
    """Say in the user's own numbers what is reached, by which evaluator, and what to do."""
    reached = best.reached(accuracy)
    enough, name = _enough(scene, reached, linear, tell), fault.name
    own = f"--evaluator {name} answers with its own error"
    load = 0.0 if linear else (1 + accuracy) / (1 + best.plan.allowed) - 1
    smaller, share = (", or a smaller load", f", {load:.2g} of it by the load") if load > LOADED * reached else ("", "")
    text = f"{enough} or more for this scene{smaller} ({name} reaches {least(reached, 3)}{share}; {own})"
    if enough is None:
        text = f"none for this scene: errors are no smaller than the values (--evaluator {name} tells which)"
    return OutOfReach(name, scene, accuracy, reached, stopped=fault.stopped, allowed=text)


def _enough(scene: Scene, reached: float, linear: bool, tell: Tell | None) -> str | None:
    """The accuracy that is answered, found by asking for it: the effort that evaluators make depends on what is asked."""
    for _ in range(ATTEMPTS):
        if not reached < 1:
            return None
        text = least(reached, 2)
        try:
            found = _first_to_answer(scene, float(text), linear, tell, rough=None, sure=never)
        except LimitReached:
            return text
        if isinstance(found, Decided):
            return text
        reached = max(min(one.reached(float(text)) for one in found), MORE * float(text))
    return least(reached, 2) if reached < 1 else None
