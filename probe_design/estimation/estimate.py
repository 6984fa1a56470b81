"""Estimate one unknown of the target inclusion or of the tissue from readings.

The unknown is the target's Young's modulus, diameter or depth, or a number of the tissue such as a layer's thickness. All other
numbers of the scene are known, or have a standard deviation (``nuisances.py``). ``intervals.py`` holds the statistics;
``strength.py`` defines the strength, which is estimated where stiffness and size are not identifiable by themselves. The value is
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
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words, one_of
from geometry.scenes.scene import Scene
from geometry.scenes.variables import values
from probe_design.estimation.answer import OPEN, Estimate, hull, identifiable, several, widest
from probe_design.estimation.depth_and_strength import Plane
from probe_design.estimation.intervals import Likelihood, p_value
from probe_design.estimation.loaded_model import LoadedModel, refusal
from probe_design.estimation.model import OF_TARGET, TargetModel, check_kind
from probe_design.estimation.nuisances import checked
from probe_design.estimation.phases import usable
from probe_design.estimation.profile import Track
from probe_design.estimation.readings import Measurements, Reading
from probe_design.estimation.reasons import Findings, reason, warnings
from probe_design.estimation.strength import DepthAndStrength, Interval, strength
from probe_design.estimation.under_load import under_load
from solver.planning.load_check import check_load

OF_TISSUE = re.compile(r"tissue\.(layer\[\d\]\.(thickness|youngs_modulus)|youngs_modulus)")
FINEST, COARSEST = 5e-4, 0.01  # default accuracies, between which the noise chooses


def estimate(
    scene: Scene, readings: tuple[Reading, ...], unknown: str = "youngs_modulus", accuracy: float | None = None, *,
    linear: bool = False, nuisances: Mapping[str, Any] = MappingProxyType({}), advise: bool = False,
) -> Estimate:  # fmt: skip
    """Estimate one unknown of the scene's target, or of its tissue.

    Args:
        scene: all other numbers, taken as known; its own value of the unknown is not used.
        readings: one or more.
        unknown: youngs_modulus, diameter or depth of the target; tissue.youngs_modulus; thickness or youngs_modulus of a layer,
            ``tissue.layer[0].thickness``.
        accuracy: of the evaluator, relative; default: a quarter of the smallest noise of the ratios, within 5e-4 and 0.01.
        linear: whether to use linear elasticity at any load. The intervals then count the possible effect of finite strain. By
            default that effect is below the smallest noise of the ratios, and ``contact`` predicts the readings at larger loads:
            see ``under_load.py``.
        nuisances: relative standard deviations, 0.2 or "20 %", of uncertain numbers, by their keys in the scene file; see
            ``probe_design.estimation.nuisances``.
        advise: whether ``next`` states what to measure next.

    Raises:
        InputError: an unknown, nuisance or accuracy is not allowed, or all readings are baseline readings.
        Refusal: nothing can be estimated for this kind of scene, or its load is beyond the range of linear elasticity and of
            ``contact``.
    """
    start = perf_counter()
    check_kind(scene, _of_target(scene, unknown))
    known = checked(scene, nuisances, unknown)
    data, notes = usable(scene, Measurements.of(readings))
    if unknown in OF_TARGET and data.is_blank.all():
        raise InputError("reading.blank", Words("true in every reading"), f"one over the inclusion of unknown {unknown}")
    model = TargetModel(scene, data, accuracy_for(accuracy, data))
    useless = data.is_stiffness & (model.stiffness_error > data.noise)
    if useless.any():
        limit = f"the model's stiffness is good to {model.stiffness_error:.2g} only"
        notes = (
            *notes,
            f"{useless.sum()} stiffnesses left out: {limit}, which is more than their noise",
        )
        model = replace(model, data=data.some(~useless))
    loaded = None if linear else _loaded(model, unknown, accuracy, known)
    if loaded is not None:
        phases, model = model.data.is_phase.sum(), loaded.at_rest
        notes = (*notes, f"{phases} phases left out: nothing is known of them at this load") if phases else notes
    findings = searched(model, unknown, known, loaded)
    found = _estimate(findings, _together(findings), known, notes, start)
    return _advised(found, model, known, at_rest=loaded is None) if advise else found


def _advised(found: Estimate, model: TargetModel, nuisances: Mapping[str, float], at_rest: bool) -> Estimate:
    """Return an estimate with advice what to measure next; at loads beyond linear elasticity with a warning instead."""
    from probe_design.estimation.next_reading import next_reading

    start = perf_counter()
    if not at_rest:
        return replace(found, warnings=(*found.warnings, "next is null: there is no advice at loads beyond linear elasticity"))
    advice = next_reading(model, found.unknown, nuisances, found.identifiable)
    return replace(found, next=advice, seconds=found.seconds + perf_counter() - start)


def accuracy_for(asked: float | None, data: Measurements) -> float:
    """Return the accuracy of the evaluator: the requested one, else a quarter of the smallest noise of ratios, within limits."""
    least = float(data.noise[data.is_ratio].min())
    accuracy = float(np.clip(least / 4, FINEST, COARSEST)) if asked is None else asked
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
    return accuracy


def _loaded(model: TargetModel, unknown: str, accuracy: float | None, nuisances: Mapping[str, float]) -> LoadedModel | None:
    """Return the model under load where the effect of finite strain is above the noise of the ratio, else None.

    Raises:
        Refusal: the load is beyond the range of linear elasticity, and ``contact`` cannot model the readings.
    """
    try:
        check_load(model.scene, model.rule, model.tolerance, promise=False)
    except Refusal as fault:
        why = refusal(model, bool(nuisances))
        if why is None:
            model = replace(model, data=model.data.some(~model.data.is_phase))
            return LoadedModel(model, unknown, min(model.tolerance, COARSEST) if accuracy is None else accuracy)
        raise Refusal(fault.key, fault.value, f"{fault.allowed}; contact, for larger loads, takes {why}") from None
    return None


def _of_target(scene: Scene, unknown: str) -> bool:
    """Return whether an unknown is the target's; otherwise it is the tissue's.

    Raises:
        InputError: it is neither.
    """
    if unknown in OF_TARGET:
        return True
    numbers = [name for name in values(scene) if OF_TISSUE.fullmatch(name)]
    if unknown not in numbers:
        raise InputError("unknown", unknown, one_of(unknown, [*OF_TARGET, *numbers]))
    return False


def searched(
    model: TargetModel, unknown: str, nuisances: Mapping[str, float] = MappingProxyType({}), loaded: LoadedModel | None = None
) -> Findings:
    """Return the values of the unknown that agree with the readings, best fit and intervals included.

    Args:
        model: without load, or under a load within linear elasticity.
        unknown: as in ``estimate``.
        nuisances: likewise, relative standard deviations by key.
        loaded_model: the model under the load, where that is beyond linear elasticity.
    """
    certain, noise, y = Track.of(model, unknown), model.data.noise, model.data.value
    if loaded is not None:
        certain = under_load(certain, loaded)
    track = certain.with_spread(nuisances)
    if not track.runs:
        return Findings(track, pieces=(), of_noise=(), best=None, p_value=1.0, shift=np.inf)
    along = Likelihood(track, noise)
    best, least = (float(part[0]) for part in along.best(y[None]))
    return Findings(
        track,
        pieces=tuple(along.pieces(y)),
        of_noise=tuple(Likelihood(certain.exact(), noise).pieces(y)),
        if_known=tuple(Likelihood(certain, noise).pieces(y)) if nuisances else None,
        best=best,
        p_value=p_value(least, len(y), along.spoiled(best)),
        shift=float(along.shift(np.array([best]))[0]),
    )


def _together(findings: Findings) -> DepthAndStrength | None:
    """Fit depth and strength of the target together if there are readings over it from several places, else return None."""
    model, unknown = findings.model, findings.unknown
    if unknown not in OF_TARGET or len(set(model.data.place[~model.data.is_blank])) < 2:
        return None
    try:
        plane = Plane.of(model, "diameter" if unknown == "diameter" else "youngs_modulus", findings.shared)
    except Refusal:  # the target fits at one depth only
        return None
    return plane.with_reflections(model.data.value).fit(model.data.value)


def _estimate(
    findings: Findings, fitted: DepthAndStrength | None, nuisances: dict[str, float], notes: tuple[str, ...], start: float
) -> Estimate:
    """Return the result from findings, and from the fit of depth and strength if there is one."""
    unknown, best, data = findings.unknown, findings.best_value, findings.model.data
    interval, of_noise = hull(findings.pieces), hull(findings.of_noise)
    good = identifiable(interval, unknown)
    value = best if good else None
    depth = findings.model.target.depth if unknown in OF_TARGET else None
    depth_interval: Interval | None = None
    if fitted is None:
        strong, strong_interval = _strength(findings, best, interval)
    else:
        strong, strong_interval = fitted.strength, fitted.strength_interval
        depth, depth_interval = fitted.depth, fitted.depth_interval
    if unknown == "depth":
        depth, depth_interval = value, interval
    return Estimate(
        unknown=unknown,
        noise=tuple(data.noise[data.is_ratio].tolist()),
        value=value,
        interval=interval,
        interval_of_noise=of_noise,
        nuisances=nuisances,
        interval_if_known=None if findings.if_known is None else hull(findings.if_known),
        pieces=several(findings.pieces),
        identifiable=good,
        reason=None if good else reason(findings, interval, widest(unknown), identifiable(of_noise, unknown)),
        depth=depth,
        depth_interval=depth_interval,
        strength=strong,
        strength_interval=strong_interval,
        p_value=None if best is None else findings.p_value,
        error_estimate=_error(findings),
        evaluator=findings.track.level,
        seconds=perf_counter() - start,
        plan=(*findings.model.base.plan, *findings.track.plan),
        warnings=(*notes, *warnings(findings, fitted)),
    )


def _strength(findings: Findings, best: float | None, interval: Interval) -> tuple[float | None, Interval | None]:
    """Return the strength, eq. ES.1, at the best fit and its interval, the depth being known.

    The strength grows with the modulus and, for stiff bodies, with the diameter. Where the modulus is open, the strength still
    ends at that of a rigid body or of a hole; where the diameter is open below, it ends at zero.
    """
    if findings.unknown not in OF_TARGET:
        return None, None
    around, body = findings.model.host, findings.model.target
    if findings.unknown == "depth":
        return float(strength(around, body)), None
    if best is None:
        return None, OPEN
    key = "modulus" if findings.unknown == "youngs_modulus" else "diameter"

    def at(value: Floats | float) -> float:
        return float(strength(around, body, **{key: np.asarray(value)}))

    if not findings.pieces:
        return at(best), OPEN
    low, high = interval
    beyond = np.inf if key == "modulus" else None
    ends = [
        at(low) if low is not None else at(0.0) if findings.searched_all(0) else None,
        at(high) if high is not None else at(beyond) if beyond and findings.searched_all(-1) else None,
    ]
    return at(best), (ends[0], ends[1]) if at(best) >= 0 or key == "modulus" else (ends[1], ends[0])


def _error(findings: Findings) -> float | None:
    """Return a bound on the relative error of the ratios at the best fit; None without a fit."""
    if findings.best is None:
        return None
    track = findings.track
    bound = track.predicted.bound[:, findings.model.data.is_ratio].max(axis=1)
    return float(np.expm1(np.interp(findings.best, track.x, bound)))
