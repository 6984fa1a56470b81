"""The evaluators by name, and the choice of one."""

from __future__ import annotations

from geometry.errors import InputError
from geometry.grading import Floats
from geometry.scene import Scene
from solver.result import Curve, Evaluator, Result

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
    _check_accuracy(accuracy)
    if name == AUTO:
        from solver.axisymmetric import Axisymmetric

        return Axisymmetric().evaluate_within(scene, accuracy)
    return evaluator(name).evaluate(scene, accuracy)


def curve(scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
    """Return ratio and log-sensitivity of a scene for every Young's modulus (Pa) of its inclusion, by ``axisymmetric``.

    Args:
        scene: with one sphere on the probe's axis.
        moduli: shape (k,).
        accuracy: relative, on every ratio; above 0, below 1.

    Raises:
        InputError: no such accuracy or moduli; no inclusion.
        Refusal: the scene is of a kind that ``axisymmetric`` cannot take.
    """
    _check_accuracy(accuracy)
    from solver.axisymmetric import Axisymmetric

    return Axisymmetric().curve(scene, moduli, accuracy)


def _check_accuracy(accuracy: float) -> None:
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
