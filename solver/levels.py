"""The evaluators by name, and the choice of one."""

from __future__ import annotations

from geometry.errors import InputError
from geometry.scene import Scene
from solver.result import Evaluator, Result

AUTO = "auto"
BUILT = ("published", "closed-form", "axisymmetric")
PLANNED = ("equivalent-inclusion", "contact", "solid")


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
    if name == "axisymmetric":
        from solver.axisymmetric import Axisymmetric

        return Axisymmetric()
    allowed = ", ".join((AUTO, *BUILT))
    raise InputError("evaluator", name, f"{allowed} (not built yet: {', '.join(PLANNED)})")


def evaluate(scene: Scene, name: str = AUTO, accuracy: float = 0.01) -> Result:
    """Evaluate a scene.

    Args:
        scene: what is pressed on what.
        name: an evaluator's, or ``auto``, which is ``axisymmetric`` and refuses to answer worse than asked.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.

    Raises:
        InputError: no such evaluator or accuracy.
        Refusal: the scene is of a kind that the evaluator cannot take, or ``auto`` cannot reach the accuracy.
    """
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
    if name == AUTO:
        from solver.axisymmetric import Axisymmetric

        return Axisymmetric().evaluate_within(scene, accuracy)
    return evaluator(name).evaluate(scene, accuracy)
