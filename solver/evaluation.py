"""The public functions: evaluate a scene, plan it, vary the target's modulus, increase the load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.calls import check_call
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.percent import format_percent
from geometry.common.resources import LimitReached, Limits, start_clock, use_limits
from geometry.provenance.block import build_provenance
from geometry.scenes.fit_check import list_doubts
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from geometry.scenes.scene_tables import LOAD_QUANTITIES
from geometry.scenes.surface_names import check_surface_names
from geometry.scenes.units import FREQUENCY_QUANTITY
from solver import evaluators
from solver.automatic import build_allowed_plan, choose_evaluator, get_evaluator
from solver.evaluators import AUTO, CONTACT, DEFAULT_ACCURACY, choose_accuracy
from solver.phase.inertia import add_inertia_error, check_frequency
from solver.planning.load_limits import combine_computed_limits, compute_load_limits
from solver.results.detail_compliance import CHARGE_CHANGE_FACTOR
from solver.results.evaluator import ProgressCallback, ignore_progress
from solver.results.film_forces import check_moduli
from solver.results.result import Curve, Result
from solver.results.warnings import Note

OMITTED_DETAILS = "groove", "elastic base", "sides that are not round"  # details of a scene that a result may leave out
MIN_NAMED_SHARE = 0.05  # of the error: smaller parts are not named

if TYPE_CHECKING:
    from solver.planning.plan import Plan
    from solver.results.result import LoadCurve


@check_call
def evaluate(
    scene: Scene | Path | str,
    evaluator: str = AUTO,
    accuracy: float | None = None,
    progress: ProgressCallback | None = None,
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

    Parameters
    ----------
    scene
        Probe, tissue, tumours and load, or the name of a scene file.
    evaluator
        Name of an evaluator, or ``auto``: the cheapest that takes the scene and reaches the accuracy, one of ``axisymmetric``,
        ``equivalent-inclusion``, ``contact`` and ``solid``. ``auto`` refuses if none reaches it.
    accuracy
        Relative, on ratio, stresses and stiffness; above 0, below 1. Left out, it is the scene's ``reading.accuracy``, or 0.01.
    progress
        Called with a line of text before each long piece of work.
    linear
        Whether ``auto`` uses linear elasticity at any load; ``error_estimate`` then includes the effect of finite strain and is
        None where that effect is unknown.
    loads
        Whether ``contact`` computes the ``load_limits``, which takes about ten seconds more.
    frequency
        Of a sinusoidal load, Hz, at which the loss factors hold. With it ``ratio_phase`` is computed, in about 1 s.
    limits
        Limits of memory and time, by default those that ``geometry.common.resources.use_limits`` sets, or else 2 GB and 120 s.

    Raises
    ------
    InputError
        No such evaluator, accuracy or frequency, or a surface file that is missing.
    Refusal
        The evaluator cannot take this kind of scene, or ``auto`` cannot reach the accuracy, or the load is above the limit of
        linear elasticity.
    LimitReached
        The evaluation would take more memory or time than is allowed.
    """
    scene = load_scene(scene)
    is_of_scene, accuracy = accuracy is None, choose_accuracy(scene, accuracy)
    start = perf_counter()
    frequency = None if frequency is None else FREQUENCY_QUANTITY.read("frequency", frequency, units_required=False)
    with use_limits(limits), start_clock():
        check_surface_names(scene)
        if frequency is not None:
            check_frequency(scene, frequency)
        named = evaluator != AUTO
        result = (
            _evaluate_by_name(scene, evaluator, accuracy, progress)
            if named
            else choose_evaluator(scene, accuracy, linear, progress).result
        )
        assert result is not None  # no plan is accepted without a result
        result = _add_load_limits(result, scene, accuracy) if loads else result
        result = result if frequency is None else add_phase(result, scene, accuracy, frequency)
        record = build_provenance(scene, evaluator=evaluator, accuracy=accuracy)
        notes = explain_error(scene, result) if is_of_scene else ()
        result = replace(result, warnings=(*find_doubts(scene), *result.warnings, *notes))
        return replace(result, provenance=record, seconds=result.seconds if named else perf_counter() - start)


def find_doubts(scene: Scene) -> tuple[Note, ...]:
    """Return a warning for each number of a scene that is probably a mistake, such as a wrong unit."""
    return tuple(Note("doubt", text) for text in list_doubts(scene))


def explain_error(scene: Scene, result: Result) -> tuple[Note, ...]:
    """Return a note on what an error above the default accuracy is due to, where the scene states its own accuracy."""
    is_charge = result.observable == "charge"
    error = result.charge_ratio_error if is_charge else result.error_estimate
    if scene.reading.accuracy is None or error is None or error <= DEFAULT_ACCURACY:
        return ()
    factor = CHARGE_CHANGE_FACTOR if is_charge else 1.0
    left_out = [
        f"at most {format_percent(min(factor * item.effect, error))} to the {item.feature}, which is left out"
        for item in result.plan
        if item.feature in OMITTED_DETAILS and not item.modelled and factor * item.effect >= MIN_NAMED_SHARE * error
    ]
    parts = ", ".join([*left_out, f"{'the rest ' if left_out else ''}to the meshes of {result.evaluator} under this load"])
    stated = f"reading.accuracy = {format_percent(scene.reading.accuracy, 6)} of the scene"
    text = f"{stated}: the error of {format_percent(error)} is due {parts}"
    return (Note("accuracy", text),)


def _evaluate_by_name(scene: Scene, name: str, accuracy: float, progress: ProgressCallback | None) -> Result:
    """Evaluate a scene with the named evaluator; linear ones add a warning where the load is beyond linear elasticity."""
    from solver.planning.load_check import add_load_warning

    result = evaluators.evaluator(name, progress).evaluate(scene, accuracy)
    return (
        replace(result, load_limits=compute_load_limits(scene, accuracy))
        if name == CONTACT
        else add_load_warning(result, scene, accuracy)
    )


P = TypeVar("P", "Result", "Plan", "LoadCurve")  # what has load limits


def _add_load_limits(result: P, scene: Scene, accuracy: float) -> P:
    """Return a result, plan or load curve with load limits computed by ``contact``, or with a warning that says why not."""
    from solver.contact.evaluator import ContactEvaluator
    from solver.contact.load_curve import LoadEnds, find_load_ends

    reason = ContactEvaluator().refusal(scene)
    if reason is not None:
        text = f"loads are bounded, not computed, for this scene; contact computes them for {reason}"
        return replace(result, warnings=(*result.warnings, Note("linear", text)))
    ends: LoadEnds = find_load_ends(scene, accuracy)
    limits = combine_computed_limits(ends, compute_load_limits(scene, accuracy), accuracy)
    return replace(result, load_limits=limits, warnings=(*result.warnings, *ends.notes))


def add_phase(result: Result, scene: Scene, accuracy: float, frequency: float) -> Result:
    """Return a result with the phase of its ratio at a frequency (Hz), or with a warning why the phase is null.

    See ``solver.phase.phase``.
    """
    from solver.phase.phase import PhaseUnknown, compute_ratio_phase

    quasi_static = result
    errors = (add_inertia_error(error, scene, frequency) for error in (result.error_estimate, result.charge_ratio_error))
    error_estimate, charge_error = errors
    result = replace(result, frequency=frequency, error_estimate=error_estimate, charge_ratio_error=charge_error)
    try:
        phase = compute_ratio_phase(scene, quasi_static, accuracy, frequency)
    except PhaseUnknown as reason:
        return replace(result, warnings=(*result.warnings, Note("null", f"ratio_phase is null: {reason}")))
    return replace(
        result,
        ratio_phase=phase.value,
        ratio_phase_error=phase.error,
        ratio_phase_derivatives=phase.derivatives,
        warnings=(*result.warnings, *phase.notes),
    )


@check_call
def plan(scene: Scene | Path | str, accuracy: float | None = None, solid: bool = False, *, loads: bool = False) -> Plan:
    """Return how ``auto`` would evaluate a scene, what it would leave out and the effect of that; see ``solver.planning.plan``.

    The evaluators run as they do in ``evaluate``, so that the one that is named does reach the accuracy. ``solid``, which takes
    up to a minute, runs only where it is uncertain whether it reaches the accuracy. Where none does, ``evaluator`` is None and
    ``refusal`` is the error that ``evaluate`` raises.

    Parameters
    ----------
    scene
        A scene of any kind, or the name of a scene file.
    accuracy
        Relative, on ratio, stresses and stiffness; above 0, below 1. Left out, it is the scene's ``reading.accuracy``, or 0.01.
    solid
        Whether to plan for ``solid``, also where a cheaper evaluator would do.
    loads
        See ``evaluate``.

    Raises
    ------
    InputError
        No such accuracy, or a surface file that cannot be used.
    Refusal
        So extreme that not even the coarsest mesh can be solved in double precision.
    LimitReached
        See ``evaluate``.
    """
    from solver.planning.coarse_model import CoarseModel
    from solver.planning.plan import SOLID, build_plan

    scene = load_scene(scene)
    accuracy = choose_accuracy(scene, accuracy)
    with start_clock():
        check_surface_names(scene)
        coarse = CoarseModel.from_scene(scene)
        planned = build_plan(scene, accuracy, SOLID if solid else None, skin=True, coarse=coarse)
        if not solid:
            try:
                # skip_sure: an evaluator that is sure to reach the accuracy is named without running it
                decided = choose_evaluator(scene, accuracy, False, None, coarse, skip_sure=True).plan
                planned = replace(decided, warnings=planned.warnings)
            except LimitReached:
                raise
            except Refusal as fault:
                planned = planned.with_refusal(fault)
        planned = replace(planned, warnings=(*find_doubts(scene), *planned.warnings))
        return _add_load_limits(planned, scene, accuracy) if loads else planned


@check_call
def press(
    scene: Scene | Path | str,
    *,
    force: float | None = None,
    indentation: float | None = None,
    points: int = 20,
    accuracy: float | None = None,
    progress: ProgressCallback | None = None,
    limits: Limits | None = None,
) -> LoadCurve:
    """Compute a scene under rising loads, with finite strain and contact; see ``solver.results.result.LoadCurve``.

    Parameters
    ----------
    scene
        One that ``contact`` takes, or the name of a scene file; its own load is not used.
    force
        Largest load as a force, N, or a text with its unit; either this or ``indentation``.
    indentation
        Largest load as an indentation, m.
    points
        Number of loads, evenly spaced above 0.
    accuracy
        Relative, on ratio, stresses and stiffness; above 0, below 1. Left out, it is the scene's ``reading.accuracy``, or 0.01.
    progress
        Called with a line before each load.
    limits
        See ``evaluate``; the time is for each of the loads.

    Raises
    ------
    InputError
        No such load or accuracy.
    Refusal
        ``contact`` cannot take this kind of scene, or not even the first load converges.
    LimitReached
        See ``evaluate``.
    """
    from solver.contact.load_curve import compute_load_curve

    scene = load_scene(scene)
    accuracy = choose_accuracy(scene, accuracy)
    force, indentation = (
        None if load is None else LOAD_QUANTITIES[name].read(name, load, units_required=False)
        for name, load in (("force", force), ("indentation", indentation))
    )
    if (force is None) == (indentation is None):
        value = Words("missing" if force is None else "both force and indentation")
        raise InputError("load", value, "the largest load: either force, such as '0.3 N', or indentation, such as '2 mm'")
    max_load = force if indentation is None else indentation
    if not max_load:
        raise InputError("force" if indentation is None else "indentation", max_load, "the largest load, above 0")
    if not isinstance(points, int | np.integer) or points < 1:
        raise InputError("points", points, "a whole number from 1: of loads, evenly spaced above 0")
    if indentation is not None and indentation >= scene.tissue.bottom:
        raise InputError(
            "indentation", format_mm(indentation), f"less than the tissue's depth of {format_mm(scene.tissue.bottom)}"
        )
    loads = max_load * np.arange(1, points + 1) / points
    with use_limits(limits):
        result = compute_load_curve(scene, loads, accuracy, by_force=indentation is None, progress=progress or ignore_progress)
        (progress or ignore_progress)("loads at which the gap closes and linear elasticity ends")
        result = _add_load_limits(result, scene, accuracy)
    return replace(result, provenance=build_provenance(scene, evaluator=CONTACT, accuracy=accuracy))


@check_call
def curve(
    scene: Scene | Path | str,
    moduli: Floats,
    accuracy: float | None = None,
    progress: ProgressCallback | None = None,
    *,
    linear: bool = False,
    limits: Limits | None = None,
) -> Curve:
    """Return ratios and log-sensitivities of a scene for every Young's modulus (Pa) of its target, by the evaluator of ``auto``.

    The ratio of charges stands beside that of stresses; ``Curve.reading`` is the one that the scene reads.

    Parameters
    ----------
    scene
        A scene with one inclusion or a target among several, or the name of a scene file.
    moduli
        Young's moduli of the target, Pa, shape (k,); texts with units, too.
    accuracy
        Relative, on every ratio; above 0, below 1. Left out, it is as in ``evaluate``.
    progress
        Called with a line before each long piece of work.
    linear
        See ``evaluate``.
    limits
        See ``evaluate``.

    Raises
    ------
    InputError
        No such accuracy or moduli; no target.
    Refusal
        No evaluator takes this kind of scene, or its load is above the limit of linear elasticity.
    LimitReached
        See ``evaluate``.
    """
    scene = load_scene(scene)
    moduli = check_moduli(scene, moduli)
    accuracy = choose_accuracy(scene, accuracy)
    start = perf_counter()
    with use_limits(limits), start_clock():
        planned = build_allowed_plan(scene, accuracy, linear)
        result = get_evaluator(planned.evaluator, progress).curve(planned.scene, moduli, planned.accuracy)
    record = build_provenance(scene, evaluator=AUTO, accuracy=accuracy)
    return replace(planned.complete_curve(result, scene, accuracy, linear), seconds=perf_counter() - start, provenance=record)
