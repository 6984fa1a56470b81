"""The evaluators by name, and the choice of one."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words, one_of
from geometry.common.limits import least
from geometry.common.resources import LimitReached, Limits, limited, timed
from geometry.provenance.block import provenance
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from geometry.scenes.surface_names import check_surface_names
from solver.linalg.workspace import Workspace, current, using
from solver.results.evaluator import Evaluator, OutOfReach, Tell
from solver.results.film_forces import checked_moduli
from solver.results.kinds import unsupported
from solver.results.result import Curve, Result
from solver.results.warnings import Note

if TYPE_CHECKING:
    from solver.planning.coarse_model import CoarseModel
    from solver.planning.plan import Plan
    from solver.results.load_curve import LoadCurve

AUTO, CONTACT = "auto", "contact"
BUILT = ("published", "closed-form", "equivalent-inclusion", "axisymmetric", "contact", "solid")
"""The levels' names: each lives in the room of that name, one of ``solver/*/level.py``."""


def evaluator(name: str, tell: Tell | None = None, workspace: Workspace | None = None) -> Evaluator:
    """Return the evaluator of that name; importing it only now keeps the start-up short.

    Args:
        name: its name.
        tell: called with a line before each long piece of work, by those that have any.
        workspace: the evaluator's own; left out: the one that is worked in, usually the process's.

    Raises:
        InputError: no evaluator has that name.
    """
    if name not in BUILT:
        raise InputError("evaluator", name, one_of(name, (AUTO, *BUILT)))
    room = import_module(f"solver.{name.replace('-', '_')}.level")
    with using(current() if workspace is None else workspace):
        return cast(Evaluator, room.level(tell))


def evaluate(
    scene: Scene | Path | str,
    evaluator: str = AUTO,
    accuracy: float = 0.01,
    tell: Tell | None = None,
    *,
    linear: bool = False,
    loads: bool = False,
    frequency: float | None = None,
    limits: Limits | None = None,
) -> Result:
    """Evaluate a scene.

    An evaluator that is named answers linearly, but for ``contact``: its ``error_estimate`` refers to linear elasticity, and
    beyond ``linear_limit_load`` it warns. ``auto`` counts what finite strain may change, has ``contact`` answer larger loads, and
    refuses those that it cannot take.

    Args:
        scene: what is pressed on what, or the name of a scene file.
        evaluator: its name, or ``auto``: what ``plan`` says, the cheapest level that takes the scene and reaches the accuracy,
            of ``axisymmetric``, ``equivalent-inclusion``, ``contact`` and ``solid``; it refuses to answer worse than asked.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        tell: called with a line before each long piece of work.
        linear: whether ``auto`` answers linearly at any load; ``error_estimate`` counts the effect, None where nothing is known.
        loads: whether level ``contact`` tells ``gap_closure_load`` and ``linear_limit_load``, which takes some seconds more.
        frequency: of a sinusoidal load, Hz, at which the loss factors hold: ``ratio_phase`` is told; a second or so.
        limits: of memory and time, 2 GB and 120 s unless ``geometry.common.resources.limited`` says otherwise.

    Raises:
        InputError: no such evaluator, accuracy or frequency, or a surface file that is missing.
        Refusal: the scene is of a kind that the evaluator cannot take, or ``auto`` cannot reach the accuracy, or its load is
            beyond what linear elasticity allows.
        LimitReached: the answer would take more memory or time than is allowed.
    """
    from solver.phase.inertia import check_frequency

    scene = read(scene)
    check_accuracy(accuracy)
    start = perf_counter()
    with limited(limits), timed():
        check_surface_names(scene)
        if frequency is not None:
            check_frequency(scene, frequency)
        try:
            named = evaluator != AUTO
            result = _named(scene, evaluator, accuracy, tell) if named else _automatic(scene, accuracy, linear, tell)
            result = _with_loads(result, scene, accuracy) if loads else result
            result = result if frequency is None else with_phase(result, scene, accuracy, frequency)
            told = provenance(scene, evaluator=evaluator, accuracy=accuracy)
            return replace(result, provenance=told, seconds=result.seconds if named else perf_counter() - start)
        except OutOfReach as fault:
            if fault.stopped or named:
                raise
            raise Refusal("accuracy", accuracy, _reachable(fault, accuracy / fault.accuracy, tell)) from None


def read(scene: Scene | Path | str) -> Scene:
    """Return a scene, or that of a file. Raises ``InputError``."""
    if isinstance(scene, Scene):
        return scene
    if not isinstance(scene, Path | str):
        raise InputError("scene", scene, "a Scene, or the name of a scene file")
    from geometry.scenes.scene_file import read_scene

    return read_scene(scene)


def _named(scene: Scene, name: str, accuracy: float, tell: Tell | None) -> Result:
    """The answer of one level; of a linear one with a warning where the load is beyond linear elasticity."""
    from solver.planning.load_check import with_warning

    result = evaluator(name, tell).evaluate(scene, accuracy)
    return result if name == CONTACT else with_warning(result, scene, accuracy)


P = TypeVar("P", "Result", "Plan")


def _with_loads(result: P, scene: Scene, accuracy: float) -> P:
    """An answer or a plan with the loads that level ``contact`` tells, or with why it does not."""
    from solver.contact.level import ContactLevel
    from solver.contact.load_curve import Ends, ends_of

    why = ContactLevel().refusal(scene)
    if why is not None:
        text = f"gap_closure_load is null, linear_limit_load told by the cautious rule: contact cannot take the scene ({why})"
        return replace(result, warnings=(*result.warnings, Note("linear", text)))
    ends: Ends = ends_of(scene, accuracy)
    limit, warnings = ends.linear_limit_load or result.linear_limit_load, (*result.warnings, *ends.notes)
    return replace(result, gap_closure_load=ends.gap_closure_load, linear_limit_load=limit, warnings=warnings)


def with_phase(result: Result, scene: Scene, accuracy: float, frequency: float) -> Result:
    """Return an answer with the phase of its ratio at a frequency (Hz), or with why that is null; see ``solver.phase.phase``."""
    from solver.phase.inertia import with_inertia
    from solver.phase.phase import NotTold, ratio_phase

    still = result
    result = replace(result, frequency=frequency, error_estimate=with_inertia(result.error_estimate, scene, frequency))
    try:
        phase = ratio_phase(scene, still, accuracy, frequency)
    except NotTold as why:
        return replace(result, warnings=(*result.warnings, Note("null", f"ratio_phase is null: {why}")))
    told: dict[str, Any] = {f"ratio_phase{key}": value for key, value in phase.parts.items()}
    return replace(result, **told, warnings=(*result.warnings, *phase.notes))


def _automatic(scene: Scene, accuracy: float, linear: bool, tell: Tell | None) -> Result:
    """The answer of the level that the plan names, or of ``solid`` where that one refuses."""
    from solver.planning.load_check import REMEDY
    from solver.planning.plan import second_try  # what it takes to import is not the answer's cost

    planned = allowed_plan(scene, accuracy, linear)
    try:
        result = _level(planned.evaluator, tell).evaluate_within(planned.scene, planned.accuracy)
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
        result = _level(planned.evaluator, tell).evaluate_within(planned.scene, planned.accuracy)
    return planned.completed(result, scene, accuracy, linear)


def _reachable(fault: OutOfReach, share: float, tell: Tell | None) -> str:
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


def plan(scene: Scene | Path | str, accuracy: float = 0.01, solid: bool = False, *, loads: bool = False) -> Plan:
    """Say how ``auto`` would answer a scene, what it would leave out, and what that may change; see ``solver.planning.plan``.

    Args:
        scene: any, or the name of a scene file.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        solid: whether to plan for the level ``solid``, whatever the scene asks for.
        loads: see ``evaluate``.

    Raises:
        InputError: no such accuracy, or a surface file that cannot be used.
        Refusal: so extreme that not even the coarsest mesh can be solved in double precision.
    """
    from solver.planning.plan import plan as run

    scene = read(scene)
    check_accuracy(accuracy)
    with timed():
        check_surface_names(scene)
        planned = run(scene, accuracy, solid, skin=True)
        return _with_loads(planned, scene, accuracy) if loads else planned


def load(
    scene: Scene | Path | str,
    *,
    force: float | None = None,
    indentation: float | None = None,
    points: int = 20,
    accuracy: float = 0.01,
    tell: Tell | None = None,
    limits: Limits | None = None,
) -> LoadCurve:
    """Press a scene ever harder, at finite strain and with contact; see ``solver.results.load_curve.LoadCurve``.

    Args:
        scene: that level ``contact`` takes, or the name of a scene file; its own load does not matter.
        force: the largest load, N; or
        indentation: the largest, m. One of the two.
        points: number of loads, evenly spaced above 0.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        tell: called with a line before each load.
        limits: see ``evaluate``; the time is for each load that is asked for.

    Raises:
        InputError: no such load or accuracy.
        Refusal: the scene is of a kind that level ``contact`` cannot take, or not even the first load converges.
        LimitReached: see ``evaluate``.
    """
    from solver.contact.load_curve import load_curve
    from solver.results.evaluator import silent

    scene = read(scene)
    check_accuracy(accuracy)
    most = force if indentation is None else indentation
    if (force is None) == (indentation is None) or most is None or not 0 < most < float("inf") or points < 1:
        raise InputError(
            "load", Words(f"force = {force}, indentation = {indentation}"), "one of them, above 0, and points from 1"
        )
    if indentation is not None and scene.tissue.shape != "half-space" and indentation >= scene.tissue.depth:
        raise InputError("indentation", mm(indentation), f"less than the tissue's depth of {mm(scene.tissue.depth)}")
    loads = most * np.arange(1, points + 1) / points
    with limited(limits):
        pressed = load_curve(scene, loads, accuracy, by_force=indentation is None, tell=tell or silent)
    return replace(pressed, provenance=provenance(scene, evaluator=CONTACT, accuracy=accuracy))


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
    planned = _planned(scene, accuracy, linear, rough)
    if not linear:
        planned.check_load(scene, accuracy)
    planned.check_reach(accuracy)
    return planned


def _planned(scene: Scene, accuracy: float, linear: bool, rough: CoarseModel | None = None) -> Plan:
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


def _level(name: str | None, tell: Tell | None) -> Evaluator:
    assert name is not None  # _planned has refused it
    return evaluator(name, tell)


def curve(
    scene: Scene | Path | str,
    moduli: Floats,
    accuracy: float = 0.01,
    tell: Tell | None = None,
    *,
    linear: bool = False,
    limits: Limits | None = None,
) -> Curve:
    """Return ratio and log-sensitivity of a scene for every Young's modulus (Pa) of its target, by the level of ``auto``.

    Args:
        scene: with one inclusion or a target among several, or the name of a scene file.
        moduli: shape (k,).
        accuracy: relative, on every ratio; above 0, below 1.
        tell: called with a line before each long piece of work.
        linear: see ``evaluate``.
        limits: see ``evaluate``.

    Raises:
        InputError: no such accuracy or moduli; no target.
        Refusal: the scene is of a kind that no level built yet can take, or its load is beyond what linear elasticity allows.
        LimitReached: see ``evaluate``.
    """
    scene = read(scene)
    check_accuracy(accuracy)
    checked_moduli(scene, moduli)
    start = perf_counter()
    with limited(limits), timed():
        planned = _planned(scene, accuracy, linear)
        if not linear:
            planned.check_load(scene, accuracy)
        result = _level(planned.curve_evaluator, tell).curve(planned.scene, moduli, planned.accuracy)
    told = provenance(scene, evaluator=AUTO, accuracy=accuracy)
    return replace(planned.completed_curve(result, scene, accuracy, linear), seconds=perf_counter() - start, provenance=told)


def check_accuracy(accuracy: float) -> None:
    """Raise ``InputError`` for an accuracy that is none."""
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
