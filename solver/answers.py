"""The public functions: evaluate a scene, plan it, vary the target's modulus, increase the load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.resources import LimitReached, Limits, limited, timed
from geometry.provenance.block import provenance
from geometry.scenes.fit import doubts
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from geometry.scenes.surface_names import check_surface_names
from solver import levels
from solver.automatic import automatic, decide, level_of, supported_plan
from solver.levels import AUTO, CONTACT, check_accuracy, read
from solver.results.evaluator import Tell
from solver.results.film_forces import checked_moduli
from solver.results.result import Curve, Result
from solver.results.warnings import Note

if TYPE_CHECKING:
    from solver.planning.plan import Plan
    from solver.results.load_curve import LoadCurve


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

    An evaluator that is named uses linear elasticity, except ``contact``. Its ``error_estimate`` refers to linear elasticity, and
    it warns above ``linear_limit_load``. ``auto`` includes the effect of finite strain in the error, uses ``contact`` for larger
    loads, and refuses loads that ``contact`` cannot compute.

    Args:
        scene: probe, tissue, tumours and load, or the name of a scene file.
        evaluator: its name, or ``auto``: the cheapest evaluator that takes the scene and reaches the accuracy, one of
            ``axisymmetric``, ``equivalent-inclusion``, ``contact`` and ``solid``. ``auto`` refuses if none reaches it.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        tell: called with a line of text before each long piece of work.
        linear: whether ``auto`` uses linear elasticity at any load; ``error_estimate`` then includes the effect of finite strain
            and is None where that effect is unknown.
        loads: whether ``contact`` computes the ``load_limits``, which takes about ten seconds more.
        frequency: of a sinusoidal load, Hz, at which the loss factors hold. With it ``ratio_phase`` is computed, in about 1 s.
        limits: of memory and time, 2 GB and 120 s unless ``geometry.common.resources.limited`` says otherwise.

    Raises:
        InputError: no such evaluator, accuracy or frequency, or a surface file that is missing.
        Refusal: the evaluator cannot take this kind of scene, or ``auto`` cannot reach the accuracy, or the load is above the
            limit of linear elasticity.
        LimitReached: the evaluation would take more memory or time than is allowed.
    """
    from solver.phase.inertia import check_frequency

    scene = read(scene)
    check_accuracy(accuracy)
    start = perf_counter()
    with limited(limits), timed():
        check_surface_names(scene)
        if frequency is not None:
            check_frequency(scene, frequency)
        named = evaluator != AUTO
        result = _named(scene, evaluator, accuracy, tell) if named else automatic(scene, accuracy, linear, tell)
        result = _with_loads(result, scene, accuracy) if loads else result
        result = result if frequency is None else with_phase(result, scene, accuracy, frequency)
        told = provenance(scene, evaluator=evaluator, accuracy=accuracy)
        result = replace(result, warnings=(*doubtful(scene), *result.warnings))
        return replace(result, provenance=told, seconds=result.seconds if named else perf_counter() - start)


def doubtful(scene: Scene) -> tuple[Note, ...]:
    """Return a warning for each number of a scene that is probably a slip."""
    return tuple(Note("doubt", text) for text in doubts(scene))


def _named(scene: Scene, name: str, accuracy: float, tell: Tell | None) -> Result:
    """Evaluate a scene with the named evaluator; linear ones add a warning where the load is beyond linear elasticity."""
    from solver.planning.load_check import with_warning
    from solver.planning.load_limits import load_limits

    result = levels.evaluator(name, tell).evaluate(scene, accuracy)
    return replace(result, load_limits=load_limits(scene, accuracy)) if name == CONTACT else with_warning(result, scene, accuracy)


P = TypeVar("P", "Result", "Plan", "LoadCurve")


def _with_loads(result: P, scene: Scene, accuracy: float) -> P:
    """Return a result, plan or curve with the load limits computed by ``contact``, or with a warning why they are not."""
    from solver.contact.level import ContactLevel
    from solver.contact.load_curve import Ends, ends_of
    from solver.planning.load_limits import computed_limits, load_limits

    why = ContactLevel().refusal(scene)
    if why is not None:
        text = f"loads are bounded, not computed: contact cannot take the scene ({why})"
        return replace(result, warnings=(*result.warnings, Note("linear", text)))
    ends: Ends = ends_of(scene, accuracy)
    limits = computed_limits(ends, load_limits(scene, accuracy), accuracy)
    return replace(result, load_limits=limits, warnings=(*result.warnings, *ends.notes))


def with_phase(result: Result, scene: Scene, accuracy: float, frequency: float) -> Result:
    """Return a result with the phase of its ratio at a frequency (Hz), or with a warning why the phase is null.

    See ``solver.phase.phase``.
    """
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


def plan(scene: Scene | Path | str, accuracy: float = 0.01, solid: bool = False, *, loads: bool = False) -> Plan:
    """Return how ``auto`` would evaluate a scene, what it would leave out and the effect of that; see ``solver.planning.plan``.

    The evaluators run as they do in ``evaluate``, so that the one that is named does reach the accuracy. ``solid``, which takes
    up to a minute, runs only where it is uncertain whether it reaches the accuracy. Where none does, ``evaluator`` is None and
    ``refusal`` is the error that ``evaluate`` raises.

    Args:
        scene: any, or the name of a scene file.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        solid: whether to plan for ``solid``, also where a cheaper evaluator would do.
        loads: see ``evaluate``.

    Raises:
        InputError: no such accuracy, or a surface file that cannot be used.
        Refusal: so extreme that not even the coarsest mesh can be solved in double precision.
        LimitReached: see ``evaluate``.
    """
    from solver.planning.coarse_model import CoarseModel
    from solver.planning.plan import SOLID, Plan
    from solver.planning.plan import plan as run

    scene = read(scene)
    check_accuracy(accuracy)
    with timed():
        check_surface_names(scene)
        rough = CoarseModel.of(scene)
        planned = run(scene, accuracy, SOLID if solid else None, skin=True, rough=rough)
        if not solid:
            try:
                decided = decide(scene, accuracy, False, None, rough, sure=Plan.sure).plan
                planned = replace(decided, warnings=planned.warnings)
            except LimitReached:
                raise
            except Refusal as fault:
                planned = planned.refused(fault)
        planned = replace(planned, warnings=(*doubtful(scene), *planned.warnings))
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
    """Compute a scene under rising loads, with finite strain and contact; see ``solver.results.load_curve.LoadCurve``.

    Args:
        scene: one that ``contact`` takes, or the name of a scene file; its own load is not used.
        force: the largest load, N; or
        indentation: the largest, m. One of the two.
        points: number of loads, evenly spaced above 0.
        accuracy: relative, on ratio, stresses and stiffness; above 0, below 1.
        tell: called with a line before each load.
        limits: see ``evaluate``; the time is for each of the loads.

    Raises:
        InputError: no such load or accuracy.
        Refusal: ``contact`` cannot take this kind of scene, or not even the first load converges.
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
        (tell or silent)("loads at which the gap closes and linear elasticity ends")
        pressed = _with_loads(pressed, scene, accuracy)
    return replace(pressed, provenance=provenance(scene, evaluator=CONTACT, accuracy=accuracy))


def curve(
    scene: Scene | Path | str,
    moduli: Floats,
    accuracy: float = 0.01,
    tell: Tell | None = None,
    *,
    linear: bool = False,
    limits: Limits | None = None,
) -> Curve:
    """Return ratio and log-sensitivity of a scene for every Young's modulus (Pa) of its target, by the evaluator of ``auto``.

    Args:
        scene: with one inclusion or a target among several, or the name of a scene file.
        moduli: shape (k,).
        accuracy: relative, on every ratio; above 0, below 1.
        tell: called with a line before each long piece of work.
        linear: see ``evaluate``.
        limits: see ``evaluate``.

    Raises:
        InputError: no such accuracy or moduli; no target.
        Refusal: no evaluator takes this kind of scene, or its load is above the limit of linear elasticity.
        LimitReached: see ``evaluate``.
    """
    scene = read(scene)
    check_accuracy(accuracy)
    checked_moduli(scene, moduli)
    start = perf_counter()
    with limited(limits), timed():
        planned = supported_plan(scene, accuracy, linear)
        if not linear:
            planned.check_load(scene, accuracy)
        result = level_of(planned.curve_evaluator, tell).curve(planned.scene, moduli, planned.accuracy)
    told = provenance(scene, evaluator=AUTO, accuracy=accuracy)
    return replace(planned.completed_curve(result, scene, accuracy, linear), seconds=perf_counter() - start, provenance=told)
