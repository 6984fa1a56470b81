"""The evaluators by name, and the choice of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from geometry.errors import InputError, Refusal
from geometry.grading import Floats
from geometry.scene import Scene
from solver.result import Curve, Evaluator, Result

if TYPE_CHECKING:
    from solver.axisymmetric import Axisymmetric
    from solver.equivalent_inclusion import EquivalentInclusion
    from solver.solid import SolidLevel

AUTO = "auto"
BUILT = ("published", "closed-form", "equivalent-inclusion", "axisymmetric", "solid")
PLANNED = ("contact",)
Tell = Callable[[str], None]


def evaluator(name: str, tell: Tell | None = None) -> Evaluator:
    """Return the evaluator of that name; importing it only now keeps the start-up short.

    Args:
        name: its name.
        tell: called with a line before each long piece of work, by those that have any.

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
    if name == "solid":
        return _solid(tell)
    allowed = ", ".join((AUTO, *BUILT))
    raise InputError("evaluator", name, f"{allowed} (not built yet: {', '.join(PLANNED)})")


def evaluate(scene: Scene, name: str = AUTO, accuracy: float = 0.01, tell: Tell | None = None) -> Result:
    """Evaluate a scene.

    Args:
        scene: what is pressed on what.
        name: an evaluator's, or ``auto``: the cheapest level that takes the scene and reaches the accuracy, of ``axisymmetric``,
            ``equivalent-inclusion`` (tumours off the axis or several) and ``solid``; it refuses to answer worse than asked.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        tell: called with a line before each long piece of work.

    Raises:
        InputError: no such evaluator or accuracy.
        Refusal: the scene is of a kind that the evaluator cannot take, or ``auto`` cannot reach the accuracy.
    """
    _check_accuracy(accuracy)
    if name != AUTO:
        return evaluator(name, tell).evaluate(scene, accuracy)
    cheap, solid = _auto(scene), _solid(tell)
    if cheap is None:
        return solid.evaluate_within(scene, accuracy)
    try:
        return cheap.evaluate_within(scene, accuracy)
    except Refusal:
        if not solid.may_help(scene, accuracy):
            raise
    return solid.evaluate_within(scene, accuracy)


def _auto(scene: Scene) -> Axisymmetric | EquivalentInclusion | None:
    """The cheapest level for a scene: ``axisymmetric`` unless its kind asks for the other; None where neither takes it."""
    from solver.axisymmetric import Axisymmetric
    from solver.equivalent_inclusion import EquivalentInclusion

    level, other = Axisymmetric(), EquivalentInclusion()
    if level.refusal(scene) is None:
        return level
    return other if other.refusal(scene) is None else None


def _solid(tell: Tell | None = None) -> SolidLevel:
    from solver.solid import SolidLevel

    return SolidLevel() if tell is None else SolidLevel(tell)


def curve(scene: Scene, moduli: Floats, accuracy: float = 0.01, tell: Tell | None = None) -> Curve:
    """Return ratio and log-sensitivity of a scene for every Young's modulus (Pa) of its target, by the level of ``auto``.

    Args:
        scene: with one inclusion or a target among several.
        moduli: shape (k,).
        accuracy: relative, on every ratio; above 0, below 1.
        tell: called with a line before each long piece of work.

    Raises:
        InputError: no such accuracy or moduli; no target.
        Refusal: the scene is of a kind that no level built yet can take.
    """
    _check_accuracy(accuracy)
    level = _auto(scene)
    if level is None or any(body.diameter is None for body in scene.inclusion):  # only of spheres the others know curves
        return _solid(tell).curve(scene, moduli, accuracy)
    return level.curve(scene, moduli, accuracy)


def _check_accuracy(accuracy: float) -> None:
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
