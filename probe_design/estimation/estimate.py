"""What readings say about the target inclusion: one unknown of it, everything else in the scene being known.

The unknown is its Young's modulus, diameter or depth; ``intervals.py`` holds the statistics, ``strength.py`` what is left where
stiffness and size cannot be told. The value is the best fit, the interval covers the truth in 95 % of cases.

An unknown counts as *identifiable* where the interval is bounded at both ends inside what was searched and its ends are at most a
factor ``WIDEST`` apart; otherwise the value is None and ``reason`` says why.

What was searched: moduli from 1e-3 to 1e6 times the tissue's, diameters from 1/100 of the largest that fits, depths at which
the target fits; of these only bodies over which the model's ratio is good to 30 %.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Scene
from probe_design.estimation.depth_and_strength import Plane
from probe_design.estimation.intervals import Likelihood, Piece, p_value
from probe_design.estimation.model import TargetModel, check_kind
from probe_design.estimation.profile import Track
from probe_design.estimation.readings import Measurements, Reading
from probe_design.estimation.reasons import Findings, reason, warnings
from probe_design.estimation.strength import DepthAndStrength, Interval, strength
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.planning.load_check import check_load
from solver.results.result import Decision

WIDEST = {"youngs_modulus": 100.0, "diameter": 4.0, "depth": 4.0}
FINEST = 5e-4  # accuracy asked for without being told to
OPEN: Interval = (None, None)


@dataclass(frozen=True)
class Estimate:
    """What readings say, SI units; an end of an interval is None where it is open.

    Attributes:
        unknown: youngs_modulus, diameter or depth.
        noise: relative standard deviation of each ratio that was read.
        value: of the unknown; None where it is not identifiable.
        interval: 95 %.
        interval_of_noise: the same for a model without error.
        pieces: the values that the readings leave, where they are not all of the interval.
        identifiable: see above.
        reason: why not, or None.
        depth: fitted together with the strength if there are several places, else the scene's, or the estimate.
        depth_interval: 95 %; None where the depth is the scene's.
        strength: eq. ES.1 of ``probe_design.estimation.strength``, m^3.
        strength_interval: 95 %; None where size, modulus and so the strength are the scene's.
        p_value: how probable a worse fit is if scene and noise are right.
        error_estimate: bound on the relative error of the evaluator's ratio at the best fit; None where there is none.
        evaluator, seconds, plan, warnings: see ``solver.results.result.Result``.
    """

    unknown: str
    noise: tuple[float, ...]
    value: float | None
    interval: Interval
    interval_of_noise: Interval
    pieces: tuple[tuple[float, float], ...]
    identifiable: bool
    reason: str | None
    depth: float | None
    depth_interval: Interval | None
    strength: float | None
    strength_interval: Interval | None
    p_value: float | None
    error_estimate: float | None
    evaluator: str
    seconds: float
    plan: tuple[Decision, ...]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design estimate``."""
        fields = asdict(self)
        return {self.unknown: fields.pop("value")} | fields


def estimate(
    scene: Scene, readings: tuple[Reading, ...], unknown: str = "youngs_modulus", accuracy: float | None = None, *,
    linear: bool = False,
) -> Estimate:  # fmt: skip
    """Estimate one unknown of the scene's target.

    Args:
        scene: everything else, taken as known; its own value of the unknown does not matter.
        readings: one or more.
        unknown: youngs_modulus, diameter or depth.
        accuracy: of the evaluator; left out: a quarter of the ratios' least noise, from 5e-4 to 0.01.
        linear: whether to take any load. The intervals count what finite strain may change; left out, that is less than the
            ratios' least noise.

    Raises:
        InputError: no such unknown or accuracy; an inclusion that cannot be seen from one of the places.
        Refusal: the scene is of a kind that cannot be estimated, or its load is beyond what linear elasticity allows.
    """
    start = perf_counter()
    if unknown not in WIDEST:
        raise InputError("unknown", unknown, ", ".join(WIDEST))
    check_kind(scene)
    data = Measurements.of(readings)
    if accuracy is None:
        accuracy = float(np.clip(data.noise[~data.is_stiffness].min() / 4, FINEST, 0.01))
    if not 0 < accuracy < 1:
        raise InputError("accuracy", accuracy, "a number above 0 and below 1, such as 0.01")
    model = TargetModel(scene, data, accuracy)
    if not linear:
        check_load(scene, model.rule, model.tolerance, promise=False)
    notes: tuple[str, ...] = ()
    useless = data.is_stiffness & (model.stiffness_error > data.noise)
    if useless.any():
        limit = f"the model's stiffness is good to {model.stiffness_error:.2g} only"
        notes = (f"{useless.sum()} stiffnesses left out: {limit}, which is more than their noise",)
        model = replace(model, data=data.some(~useless))
    findings = searched(model, unknown)
    return _estimate(findings, _together(findings), notes, start)


def searched(model: TargetModel, unknown: str) -> Findings:
    """Return which values of the unknown the readings leave."""
    track, noise, y = Track.of(model, unknown), model.data.noise, model.data.value
    if not track.runs:
        return Findings(track, pieces=(), of_noise=(), best=None, p_value=1.0, shift=np.inf)
    along = Likelihood(track, noise)
    best, least = (float(part[0]) for part in along.best(y[None]))
    return Findings(
        track,
        pieces=tuple(along.pieces(y)),
        of_noise=tuple(Likelihood(track.exact(), noise).pieces(y)),
        best=best,
        p_value=p_value(least, len(y), along.spoiled(best)),
        shift=float(along.shift(np.array([best]))[0]),
    )


def _together(findings: Findings) -> DepthAndStrength | None:
    """Fit depth and strength together where there are readings from several places."""
    model = findings.model
    if len(model.data.places) < 2:
        return None
    try:
        plane = Plane.of(model, "diameter" if findings.unknown == "diameter" else "youngs_modulus")
    except Refusal:  # the target fits at one depth only
        return None
    return plane.with_reflections(model.data.value).fit(model.data.value)


def _estimate(findings: Findings, fitted: DepthAndStrength | None, notes: tuple[str, ...], start: float) -> Estimate:
    unknown, best, data = findings.unknown, findings.best_value, findings.model.data
    interval, of_noise = hull(findings.pieces), hull(findings.of_noise)
    good = identifiable(interval, unknown)
    value = best if good else None
    depth: float | None = findings.model.target.depth
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
        noise=tuple(data.noise[~data.is_stiffness].tolist()),
        value=value,
        interval=interval,
        interval_of_noise=of_noise,
        pieces=_several(findings.pieces),
        identifiable=good,
        reason=None if good else reason(findings, interval, WIDEST[unknown], identifiable(of_noise, unknown)),
        depth=depth,
        depth_interval=depth_interval,
        strength=strong,
        strength_interval=strong_interval,
        p_value=None if best is None else findings.p_value,
        error_estimate=_error(findings),
        evaluator=EquivalentInclusion().name,
        seconds=perf_counter() - start,
        plan=findings.model.base.plan,
        warnings=(*notes, *warnings(findings, fitted)),
    )


def identifiable(interval: Interval, unknown: str) -> bool:
    """Whether an interval is bounded and narrow enough to call the unknown told."""
    low, high = interval
    return low is not None and high is not None and high <= WIDEST[unknown] * low


def hull(pieces: tuple[Piece, ...]) -> Interval:
    """Return the ends of all pieces together, None where they are open or where there are none."""
    if not pieces:
        return OPEN
    return None if pieces[0].low_open else pieces[0].low, None if pieces[-1].high_open else pieces[-1].high


def _several(pieces: tuple[Piece, ...]) -> tuple[tuple[float, float], ...]:
    return tuple((piece.low, piece.high) for piece in pieces) if len(pieces) > 1 else ()


def _strength(findings: Findings, best: float | None, interval: Interval) -> tuple[float | None, Interval | None]:
    """Eq. ES.1 at the best fit and at the ends of the interval, depth being known.

    It grows with the modulus and, for stiff bodies, with the diameter. Where the modulus is open the strength is not: a rigid
    body's, or a hole's, is the end; a diameter that is open below ends at no body at all.
    """
    body = findings.model.target
    if findings.unknown == "depth":
        return float(strength(findings.model.host, body)), None
    if best is None:
        return None, OPEN
    key = "modulus" if findings.unknown == "youngs_modulus" else "diameter"

    def at(value: Floats | float) -> float:
        return float(strength(findings.model.host, body, **{key: np.asarray(value)}))

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
    """Bound on the relative error of the ratios at the best fit."""
    if findings.best is None:
        return None
    track = findings.track
    bound = track.predicted.bound[:, ~findings.model.data.is_stiffness].max(axis=1)
    return float(np.expm1(np.interp(findings.best, track.x, bound)))
