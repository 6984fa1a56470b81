"""The answer of the level that a plan names, or of the next where that one refuses."""

from __future__ import annotations

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


def automatic(scene: Scene, accuracy: float, linear: bool, tell: Tell | None) -> Result:
    """The answer of the level that the plan names, or of ``solid`` where that one refuses."""
    from solver.planning.load_check import REMEDY
    from solver.planning.plan import second_try  # what it takes to import is not the answer's cost

    planned = allowed_plan(scene, accuracy, linear)
    try:
        result = level_of(planned.evaluator, tell).evaluate_within(planned.scene, planned.accuracy)
    except LimitReached:
        raise
    except Refusal as fault:
        again = second_try(planned, scene, accuracy)
        by_load = planned.evaluator == CONTACT and fault.key.startswith("load.")
        if again is None and by_load and unsupported(scene) is None:
            raise Refusal(fault.key, fault.value, f"{fault.allowed}, {REMEDY}") from None
        if again is None:
            raise
        planned = again
        result = level_of(planned.evaluator, tell).evaluate_within(planned.scene, planned.accuracy)
    return planned.completed(result, scene, accuracy, linear)


def allowed_plan(scene: Scene, accuracy: float, linear: bool, rough: CoarseModel | None = None) -> Plan:
    """Return the plan by which ``auto`` answers a scene.

    Args:
        scene: any.
        accuracy: as in ``evaluate``.
        linear: likewise.
        rough: the scene's coarse model, where it is known.

    Raises:
        Refusal: no level built yet takes the scene, or its load or the accuracy is out of reach before anything is solved.
    """
    planned = supported_plan(scene, accuracy, linear, rough)
    if not linear:
        planned.check_load(scene, accuracy)
    planned.check_reach(accuracy)
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


def reachable(fault: OutOfReach, share: float, tell: Tell | None) -> str:
    """Say which accuracy the level that refused one does reach, by asking it: the effort that it makes depends on what is asked.

    Args:
        fault: the refusal.
        share: what the whole answer is asked, over what the level is asked.
        tell: as in ``evaluate``.
    """
    reached = share * fault.reached
    while reached < 1:
        text = least(reached, 2)
        try:
            evaluator(fault.name, tell).evaluate_within(fault.scene, float(text) / share)
        except LimitReached:
            break
        except OutOfReach as again:
            reached = max(share * again.reached, 1.25 * float(text))
        else:
            return f"{text} or more for this scene (--evaluator {fault.name} answers with its own error)"
    if reached < 1:
        return f"more than {least(reached, 2)} for this scene (--evaluator {fault.name} answers with its own error)"
    return f"none for this scene: errors are no smaller than the values (--evaluator {fault.name} tells which)"
