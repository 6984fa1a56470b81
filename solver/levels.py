"""The evaluators by name, and the choice of one."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from time import perf_counter
from typing import TYPE_CHECKING, cast

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal
from geometry.common.limits import LimitReached, Limits, limited, timed
from geometry.scenes.scene import Scene
from geometry.scenes.surface_names import check_surface_names
from solver.results.evaluator import Evaluator, Tell
from solver.results.film_forces import checked_moduli
from solver.results.kinds import unsupported
from solver.results.result import Curve, Result

if TYPE_CHECKING:
    from solver.planning.plan import Plan

AUTO = "auto"
BUILT = ("published", "closed-form", "equivalent-inclusion", "axisymmetric", "solid")
"""The levels' names: each lives in the room of that name, one of ``solver/*/level.py``."""
PLANNED = ("contact",)


def evaluator(name: str, tell: Tell | None = None) -> Evaluator:
    """Return the evaluator of that name; importing it only now keeps the start-up short.

    Args:
        name: its name.
        tell: called with a line before each long piece of work, by those that have any.

    Raises:
        InputError: no evaluator has that name, or it is not built yet.
    """
    if name not in BUILT:
        raise InputError("evaluator", name, f"{', '.join((AUTO, *BUILT))} (not built yet: {', '.join(PLANNED)})")
    return cast(Evaluator, import_module(f"solver.{name.replace('-', '_')}.level").level(tell))


def evaluate(
    scene: Scene, name: str = AUTO, accuracy: float = 0.01, tell: Tell | None = None, *, limits: Limits | None = None
) -> Result:
    """Evaluate a scene.

    Args:
        scene: what is pressed on what.
        name: an evaluator's, or ``auto``: what ``plan`` says, the cheapest level that takes the scene and reaches the accuracy,
            of ``axisymmetric``, ``equivalent-inclusion`` and ``solid``; it refuses to answer worse than asked.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        tell: called with a line before each long piece of work.
        limits: of memory and time, 2 GB and 120 s unless ``geometry.common.limits.limited`` says otherwise.

    Raises:
        InputError: no such evaluator or accuracy, or a surface file that is missing.
        Refusal: the scene is of a kind that the evaluator cannot take, or ``auto`` cannot reach the accuracy.
        LimitReached: the answer would take more memory or time than is allowed.
    """
    check_accuracy(accuracy)
    with limited(limits), timed():
        check_surface_names(scene)
        return _automatic(scene, accuracy, tell) if name == AUTO else evaluator(name, tell).evaluate(scene, accuracy)


def _automatic(scene: Scene, accuracy: float, tell: Tell | None) -> Result:
    from solver.planning.plan import second_try  # what it takes to import is not the answer's cost

    start = perf_counter()
    planned = _planned(scene, accuracy)
    try:
        result = _level(planned.evaluator, tell).evaluate_within(planned.scene, planned.accuracy)
    except LimitReached:
        raise
    except Refusal:
        again = second_try(planned, scene, accuracy)
        if again is None:
            raise
        planned = again
        result = _level(planned.evaluator, tell).evaluate_within(planned.scene, planned.accuracy)
    return replace(planned.completed(result, scene), seconds=perf_counter() - start)


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
    with timed():
        check_surface_names(scene)
        return run(scene, accuracy, solid)


def _planned(scene: Scene, accuracy: float) -> Plan:
    """The plan for a scene that some level takes.

    Raises:
        Refusal: no level built yet takes the scene.
    """
    planned = plan(scene, accuracy)
    if planned.evaluator is None:
        raise Refusal("evaluator", AUTO, str(unsupported(scene)))
    return planned


def _level(name: str | None, tell: Tell | None) -> Evaluator:
    assert name is not None  # _planned has refused it
    return evaluator(name, tell)


def curve(
    scene: Scene, moduli: Floats, accuracy: float = 0.01, tell: Tell | None = None, *, limits: Limits | None = None
) -> Curve:
    """Return ratio and log-sensitivity of a scene for every Young's modulus (Pa) of its target, by the level of ``auto``.

    Args:
        scene: with one inclusion or a target among several.
        moduli: shape (k,).
        accuracy: relative, on every ratio; above 0, below 1.
        tell: called with a line before each long piece of work.
        limits: see ``evaluate``.

    Raises:
        InputError: no such accuracy or moduli; no target.
        Refusal: the scene is of a kind that no level built yet can take.
        LimitReached: see ``evaluate``.
    """
    check_accuracy(accuracy)
    checked_moduli(scene, moduli)
    start = perf_counter()
    with limited(limits), timed():
        planned = _planned(scene, accuracy)
        result = _level(planned.curve_evaluator, tell).curve(planned.scene, moduli, planned.accuracy)
    return replace(planned.completed_curve(result), seconds=perf_counter() - start)


def check_accuracy(accuracy: float) -> None:
    """Raise ``InputError`` for an accuracy that is none."""
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
