"""The evaluators by name, and the choice of one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry.errors import InputError
from geometry.grading import Floats
from geometry.scene import Scene
from solver.result import Curve, Evaluator, Result

if TYPE_CHECKING:
    from solver.axisymmetric import Axisymmetric
    from solver.equivalent_inclusion import EquivalentInclusion

AUTO = "auto"
BUILT = ("published", "closed-form", "equivalent-inclusion", "axisymmetric")
PLANNED = ("contact", "solid")


def evaluator(name: str) -> Evaluator:
    """Return the evaluator of that name; importing it only now keeps the start-up short.

    Raises:
        InputError: no evaluator has that name, or it is not built yet.
    """
    if name == "published":
        from solver.published import Published

        return Published()
    if name == "closed-form":
        from solver.closed_form import ClosedForm

        return ClosedForm()
    if name == "equivalent-inclusion":
        from solver.equivalent_inclusion import EquivalentInclusion

        return EquivalentInclusion()
    if name == "axisymmetric":
        from solver.axisymmetric import Axisymmetric

        return Axisymmetric()
    allowed = ", ".join((AUTO, *BUILT))
    raise InputError("evaluator", name, f"{allowed} (not built yet: {', '.join(PLANNED)})")


def evaluate(scene: Scene, name: str = AUTO, accuracy: float = 0.01) -> Result:
    """Evaluate a scene.

    Args:
        scene: what is pressed on what.
        name: an evaluator's, or ``auto``: ``axisymmetric``, or ``equivalent-inclusion`` for tumours off the axis or several;
            it refuses to answer worse than asked.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.

    Raises:
        InputError: no such evaluator or accuracy.
        Refusal: the scene is of a kind that the evaluator cannot take, or ``auto`` cannot reach the accuracy.
    """
    _check_accuracy(accuracy)
    if name == AUTO:
        return _auto(scene).evaluate_within(scene, accuracy)
    return evaluator(name).evaluate(scene, accuracy)


def _auto(scene: Scene) -> Axisymmetric | EquivalentInclusion:
    """The level for a scene: ``axisymmetric`` unless its kind asks for the other."""
    from solver.axisymmetric import Axisymmetric
    from solver.equivalent_inclusion import EquivalentInclusion

    level, other = Axisymmetric(), EquivalentInclusion()
    return other if level.refusal(scene) is not None and other.refusal(scene) is None else level


def curve(scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
    """Return ratio and log-sensitivity of a scene for every Young's modulus (Pa) of its target, by the level of ``auto``.

    Args:
        scene: with one inclusion or a target among several.
        moduli: shape (k,).
        accuracy: relative, on every ratio; above 0, below 1.

    Raises:
        InputError: no such accuracy or moduli; no target.
        Refusal: the scene is of a kind that no level built yet can take.
    """
    _check_accuracy(accuracy)
    return _auto(scene).curve(scene, moduli, accuracy)


def _check_accuracy(accuracy: float) -> None:
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
