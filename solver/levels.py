"""The evaluators by name, and the choice of one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Scene
from solver.results.film_forces import checked_moduli
from solver.results.result import Curve, Evaluator, Result, unsupported

if TYPE_CHECKING:
    from solver.axisymmetric.level import Axisymmetric
    from solver.equivalent_inclusion.level import EquivalentInclusion
    from solver.planning.plan import Plan
    from solver.solid.level import SolidLevel

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
        from solver.published.level import Published

        return Published()
    if name == "closed-form":
        from solver.closed_form.level import ClosedForm

        return ClosedForm()
    if name == "equivalent-inclusion":
        from solver.equivalent_inclusion.level import EquivalentInclusion

        return EquivalentInclusion()
    if name == "axisymmetric":
        from solver.axisymmetric.level import Axisymmetric

        return Axisymmetric()
    if name == "solid":
        return _solid(tell)
    allowed = ", ".join((AUTO, *BUILT))
    raise InputError("evaluator", name, f"{allowed} (not built yet: {', '.join(PLANNED)})")


def evaluate(scene: Scene, name: str = AUTO, accuracy: float = 0.01, tell: Tell | None = None) -> Result:
    """Evaluate a scene.

    Args:
        scene: what is pressed on what.
        name: an evaluator's, or ``auto``: what ``plan`` says, the cheapest level that takes the scene and reaches the accuracy,
            of ``axisymmetric``, ``equivalent-inclusion`` and ``solid``; it refuses to answer worse than asked.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        tell: called with a line before each long piece of work.

    Raises:
        InputError: no such evaluator or accuracy.
        Refusal: the scene is of a kind that the evaluator cannot take, or ``auto`` cannot reach the accuracy.
    """
    check_accuracy(accuracy)
    if name != AUTO:
        return evaluator(name, tell).evaluate(scene, accuracy)
    import solver.planning.plan  # noqa: F401  what it takes to import is not the answer's cost

    start = perf_counter()
    planned, level = _planned(scene, accuracy, tell)
    try:
        found = level.evaluate_within(planned.scene, planned.accuracy)
    except Refusal:
        solid = _solid(tell)
        if planned.evaluator == solid.name or not solid.may_help(scene, accuracy):
            raise
        planned = plan(scene, accuracy, solid=True)
        found = solid.evaluate_within(planned.scene, planned.accuracy)
    return replace(planned.completed(found, scene), seconds=perf_counter() - start)


def plan(scene: Scene, accuracy: float = 0.01, solid: bool = False) -> Plan:
    """Say how ``auto`` would answer a scene, what it would leave out, and what that may change; see ``solver.planning.plan``.

    Args:
        scene: any.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        solid: whether to plan for the level ``solid``, whatever the scene asks for.

    Raises:
        InputError: no such accuracy, or a surface file that cannot be used.
        Refusal: so extreme that not even the coarsest mesh can be solved in double precision.
    """
    from solver.planning.plan import plan as run

    check_accuracy(accuracy)
    return run(scene, accuracy, solid)


def _planned(scene: Scene, accuracy: float, tell: Tell | None) -> tuple[Plan, Axisymmetric | EquivalentInclusion | SolidLevel]:
    """The plan and its level.

    Raises:
        Refusal: no level built yet takes the scene.
    """
    from solver.axisymmetric.level import Axisymmetric
    from solver.equivalent_inclusion.level import EquivalentInclusion

    planned = plan(scene, accuracy)
    if planned.evaluator is None:
        raise Refusal("evaluator", AUTO, str(unsupported(scene)))
    level = {one.name: one for one in (Axisymmetric(), EquivalentInclusion(), _solid(tell))}[planned.evaluator]
    return planned, level


def _solid(tell: Tell | None = None) -> SolidLevel:
    from solver.solid.level import SolidLevel

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
    check_accuracy(accuracy)
    checked_moduli(scene, moduli)
    start = perf_counter()
    planned, level = _planned(scene, accuracy, tell)
    if any(body.diameter is None for body in planned.scene.inclusion):  # only of spheres the others know curves
        level = _solid(tell)
    found = level.curve(planned.scene, moduli, planned.accuracy)
    return replace(planned.completed_curve(found), seconds=perf_counter() - start)


def check_accuracy(accuracy: float) -> None:
    """Raise ``InputError`` for an accuracy that is none."""
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
