"""Estimate one unknown of the target inclusion or of the tissue from readings.

The unknown is the target's Young's modulus, diameter or depth, or a number of the tissue such as a layer's thickness. All other
numbers of the scene are known, or have a standard deviation (``nuisances.py``). ``intervals.py`` holds the statistics;
``model.py`` defines the strength, which is estimated where stiffness and size are not identifiable by themselves. The value is
the best fit; the interval covers the truth in 95 % of cases.

An unknown counts as *identifiable* where the interval is bounded at both ends inside the search range and the ratio of its ends
is at most ``MAX_END_RATIOS``; otherwise the value is None and ``reason`` explains it.

Search range: moduli from 1e-3 to 1e6 times the tissue's, diameters from 1/100 of the largest that fits, depths at which the
target fits, numbers of the tissue from 1/8 to 8 times the scene's; of these only values at which the error of the model's ratio
is at most 30 %.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from types import MappingProxyType

import numpy as np

from geometry.common.errors import InputError, Refusal, Words, describe_choices
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values
from probe_design.data.noise import MAX_ACCURACY, choose_accuracy
from probe_design.estimation.depth_and_strength import Plane
from probe_design.estimation.estimate_result import DepthAndStrength, Estimate, is_identifiable
from probe_design.estimation.intervals import OPEN_INTERVAL, Interval, Likelihood, compute_hull
from probe_design.estimation.loaded_track import LoadedModel, add_load, can_mesh_target
from probe_design.estimation.measurements import Measurements, Reading
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel, check_kind
from probe_design.estimation.next_reading import choose_next_reading
from probe_design.estimation.nuisances import check_nuisances
from probe_design.estimation.predictions import select_usable
from probe_design.estimation.profile import Track
from probe_design.estimation.reasons import Findings, explain_unidentifiable, iterate_warnings
from solver.contact.evaluator import ContactEvaluator
from solver.evaluators import check_accuracy
from solver.planning.load_check import is_load_linear, refuse_load

TISSUE_KEY = re.compile(r"tissue\.(layer\[\d\]\.(thickness|youngs_modulus)|youngs_modulus)")


def estimate(
    scene: Scene, readings: tuple[Reading, ...], unknown: str = "youngs_modulus", accuracy: float | None = None, *,
    linear: bool = False, nuisances: Mapping[str, object] = MappingProxyType({}), advise: bool = False,
) -> Estimate:  # fmt: skip
    """Estimate one unknown of the scene's target, or of its tissue.

    Parameters
    ----------
    scene
        All other numbers, taken as known; its own value of the unknown is not used.
    readings
        One or more.
    unknown
        youngs_modulus, diameter or depth of the target; tissue.youngs_modulus; thickness or youngs_modulus of a layer,
        ``tissue.layer[0].thickness``.
    accuracy
        Of the evaluator, relative; default: a quarter of the smallest noise of the ratios, within 5e-4 and 0.01.
    linear
        Whether to use linear elasticity at any load. The intervals then count the possible effect of finite strain. By default
        that effect is below the smallest noise of the ratios, and ``contact`` predicts the readings at larger loads: see
        ``loaded_track.py``.
    nuisances
        Relative standard deviations, 0.2 or "20 %", of uncertain numbers, by their keys in the scene file; see
        ``probe_design.estimation.nuisances``.
    advise
        Whether ``next`` states what to measure next.

    Raises
    ------
    InputError
        An unknown, nuisance or accuracy is not allowed, or all readings are baseline readings.
    Refusal
        Nothing can be estimated for this kind of scene, or its load is beyond the range of linear elasticity and of ``contact``.
    """
    start = perf_counter()
    check_kind(scene, _is_of_target(scene, unknown))
    nuisance_sds = check_nuisances(scene, nuisances, unknown)
    data, notes = select_usable(scene, Measurements.from_readings(readings))
    if unknown in TARGET_UNKNOWNS and data.is_blank.all():
        raise InputError("reading.blank", Words("true in every reading"), f"one over the inclusion of unknown {unknown}")
    model_accuracy = choose_accuracy(float(data.noise[data.is_ratio].min()) / 4) if accuracy is None else accuracy
    check_accuracy(model_accuracy)
    model, stiffness_notes = _drop_useless_stiffnesses(TargetModel(scene, data, model_accuracy))
    notes += stiffness_notes
    loaded_model, pressing = None, model
    if not linear and not _is_linear(model, nuisance_sds):
        phases = model.data.is_phase.sum()
        notes += (f"{phases} phases left out: nothing is known of them at this load",) if phases else ()
        model = replace(model, data=model.data.select(~model.data.is_phase))
        pressing = replace(model, pressing=True)
        if can_mesh_target(model, bool(nuisance_sds)):
            loaded_model = LoadedModel(model, unknown, min(model.tolerance, MAX_ACCURACY) if accuracy is None else accuracy)
            model = loaded_model.unloaded_model
        else:
            model = pressing
    findings = search_unknown(model, unknown, nuisance_sds, loaded_model)
    result = _build_estimate(findings, _fit_depth_and_strength(findings), nuisance_sds, notes, start)
    if not advise:
        return result
    if loaded_model is not None:
        # other places take tumours off the axis, whose effects under the load contact knows about tissue without them
        reason = ContactEvaluator().refusal_off_axis(scene)
        if reason is not None:
            return replace(result, warnings=(*result.warnings, f"next is null: at this load, advice takes {reason}"))
    try:
        advice = choose_next_reading(pressing, unknown, nuisance_sds, result.identifiable)
    except Refusal as fault:  # at a place that a candidate needs, nearer the tissue's sides
        if not pressing.pressing:
            raise
        return replace(result, warnings=(*result.warnings, f"next is null: {fault}"))
    return replace(result, next=advice, seconds=perf_counter() - start)


def _drop_useless_stiffnesses(model: TargetModel) -> tuple[TargetModel, tuple[str, ...]]:
    """Return the model without stiffnesses that it predicts less accurately than they were measured, and a note on them."""
    is_useless = model.data.is_stiffness & (model.stiffness_error > model.data.noise)
    if not is_useless.any():
        return model, ()
    limit = f"the model predicts stiffness within {format_percent(model.stiffness_error)} only"
    note = f"{is_useless.sum()} stiffnesses left out: {limit}, which is more than their noise"
    return replace(model, data=model.data.select(~is_useless)), (note,)


def _is_linear(model: TargetModel, nuisances: Mapping[str, float]) -> bool:
    """Return whether the effect of finite strain at the readings' largest load is below the noise of the ratios.

    Raises
    ------
    Refusal
        It is not, and ``contact`` cannot model the scene.
    """
    scene = model.heaviest_scene
    if is_load_linear(scene, model.rule, model.tolerance, promise=False):
        return True
    reason = None if can_mesh_target(model, bool(nuisances)) else ContactEvaluator().refusal_off_axis(scene)
    if reason is not None:
        refuse_load(scene, model.rule, model.tolerance, False, reason)
    return False


def _is_of_target(scene: Scene, unknown: str) -> bool:
    """Return whether an unknown is the target's; otherwise it is the tissue's.

    Raises
    ------
    InputError
        It is neither.
    """
    if unknown in TARGET_UNKNOWNS:
        return True
    numbers = [name for name in list_values(scene) if TISSUE_KEY.fullmatch(name)]
    if unknown not in numbers:
        raise InputError("unknown", unknown, describe_choices(unknown, [*TARGET_UNKNOWNS, *numbers]))
    return False


def search_unknown(
    model: TargetModel,
    unknown: str,
    nuisances: Mapping[str, float] = MappingProxyType({}),
    loaded_model: LoadedModel | None = None,
) -> Findings:
    """Return the values of the unknown that agree with the readings, best fit and intervals included.

    Parameters
    ----------
    model
        Without load, or under a load within linear elasticity.
    unknown
        As in ``estimate``.
    nuisances
        Relative standard deviations by key.
    loaded_model
        The model under the load, where that is beyond linear elasticity.
    """
    # track_if_known: predictions as if all numbers but the unknown were known, without nuisances
    track_if_known, noise, y = Track.from_model(model, unknown), model.data.noise, model.data.value
    if loaded_model is not None:
        track_if_known = add_load(track_if_known, loaded_model)
    track = track_if_known.add_nuisances(nuisances)
    if not track.runs:
        return Findings(track, pieces=(), noise_pieces=(), best=None, p_value=1.0, shift=np.inf)
    likelihood = Likelihood(track, noise)
    best, min_chi2 = (float(part[0]) for part in likelihood.find_best(y[None]))
    return Findings(
        track,
        pieces=tuple(likelihood.find_pieces(y)),
        noise_pieces=tuple(Likelihood(track_if_known.remove_model_error(), noise).find_pieces(y)),
        pieces_if_known=tuple(Likelihood(track_if_known, noise).find_pieces(y)) if nuisances else None,
        best=best,
        p_value=likelihood.compute_p_value(best, min_chi2),
        shift=float(likelihood.compute_shift(np.array([best]))[0]),
    )


def _fit_depth_and_strength(findings: Findings) -> DepthAndStrength | None:
    """Fit depth and strength of the target together if there are readings over it from several places, else return None."""
    model, unknown = findings.model, findings.unknown
    if unknown not in TARGET_UNKNOWNS or len(set(model.data.place[~model.data.is_blank])) < 2:
        return None
    try:
        plane = Plane.from_model(model, "diameter" if unknown == "diameter" else "youngs_modulus", findings.shared_errors)
    except Refusal:  # the target fits at one depth only
        return None
    return plane.add_reflections(model.data.value).fit(model.data.value)


def _build_estimate(
    findings: Findings, fitted: DepthAndStrength | None, nuisances: dict[str, float], notes: tuple[str, ...], start: float
) -> Estimate:
    """Return the result of an estimate.

    Parameters
    ----------
    findings
        Values of the unknown that agree with the readings.
    fitted
        The fit of depth and strength, or None if the readings do not allow it.
    nuisances
        Relative standard deviations by key.
    notes
        Warnings about data that were left out.
    start
        Time of ``perf_counter`` at the start.
    """
    unknown, best, data = findings.unknown, findings.best_value, findings.model.data
    interval, noise_interval = compute_hull(findings.pieces), compute_hull(findings.noise_pieces)
    is_good = is_identifiable(interval, unknown)
    value, reason = (best, None) if is_good else (None, explain_unidentifiable(findings, interval, noise_interval))
    depth = findings.model.target.depth if unknown in TARGET_UNKNOWNS else None
    depth_interval: Interval | None = None
    if fitted is None:
        strength, strength_interval = _find_strength(findings, best, interval)
    else:
        strength, strength_interval = fitted.strength, fitted.strength_interval
        depth, depth_interval = fitted.depth, fitted.depth_interval
    if unknown == "depth":
        depth, depth_interval = value, interval
    return Estimate(
        unknown=unknown,
        observable=findings.model.scene.observable,
        noise=tuple(data.noise[data.is_ratio].tolist()),
        value=value,
        interval=interval,
        interval_of_noise=noise_interval,
        nuisances=nuisances,
        interval_if_known=None if findings.pieces_if_known is None else compute_hull(findings.pieces_if_known),
        pieces=tuple((piece.low, piece.high) for piece in findings.pieces) if len(findings.pieces) > 1 else (),
        identifiable=is_good,
        reason=reason,
        depth=depth,
        depth_interval=depth_interval,
        strength=strength,
        strength_interval=strength_interval,
        p_value=None if best is None else findings.p_value,
        error_estimate=_find_error(findings),
        evaluator=findings.track.evaluator,
        seconds=perf_counter() - start,
        plan=(*findings.model.base.plan, *findings.track.plan),
        warnings=tuple(dict.fromkeys((*notes, *iterate_warnings(findings, fitted)))),
    )


def _find_strength(findings: Findings, best: float | None, interval: Interval) -> tuple[float | None, Interval | None]:
    """Return the strength, eq. ES.1, at the best fit, m^3, and its interval, where the depth is known.

    The strength grows with the modulus and, for stiff bodies, with the diameter. Where the modulus is open, the strength still
    ends at that of a rigid body or of a hole; where the diameter is open below, it ends at zero.
    """
    if findings.unknown not in TARGET_UNKNOWNS:
        return None, None
    model = findings.model
    if findings.unknown == "depth":
        return float(model.compute_strength()), None
    if best is None:
        return None, OPEN_INTERVAL
    is_modulus = findings.unknown == "youngs_modulus"

    def compute(value: float) -> float:
        """Return the strength at a value of the unknown."""
        return float(model.compute_strength(modulus=value) if is_modulus else model.compute_strength(diameter=value))

    strength = compute(best)
    if not findings.pieces:
        return strength, OPEN_INTERVAL
    low, high = interval
    if low is None and findings.is_searched_to_end(0):
        low = 0.0
    if high is None and findings.is_searched_to_end(-1) and is_modulus:
        high = np.inf
    ends = (None if low is None else compute(low), None if high is None else compute(high))
    return strength, ends if strength >= 0 or is_modulus else ends[::-1]  # a larger soft body has a lower strength


def _find_error(findings: Findings) -> float | None:
    """Return a bound on the relative error of the ratios at the best fit; None without a fit."""
    if findings.best is None:
        return None
    track = findings.track
    bound = track.predicted.bound[:, findings.model.data.is_ratio].max(axis=1)
    return float(np.expm1(np.interp(findings.best, track.x, bound)))  # the bound is on the logarithm
