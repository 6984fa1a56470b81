"""Explain an estimate in words: the reason why an unknown is not identifiable, and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.percent import format_percent
from geometry.scenes.units import MM_PER_M, format_modulus
from probe_design.estimation.estimate_result import DepthAndStrength, get_max_end_ratio, is_identifiable
from probe_design.estimation.intervals import TOLERATED_SHIFT, Interval, Piece
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel
from probe_design.estimation.nuisances import SharedErrors
from probe_design.estimation.predictions import MAX_LOG_RATIO_ERROR
from probe_design.estimation.profile import Track
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.planning.load_check import build_load_notes
from solver.results.film_charges import warn_of_read_bonds

MIN_FIT_PROBABILITY = 0.01  # a smaller p-value of the fit contradicts the scene or its noise
UNKNOWN_NAMES = {"youngs_modulus": "E_object", "diameter": "diameter", "depth": "depth"}
END_ADJECTIVES = {
    "youngs_modulus": ("soft", "stiff"), "diameter": ("small", "large"), "depth": ("shallow", "deep"),
    "thickness": ("thin", "thick"),
}  # fmt: skip


@dataclass(frozen=True)
class Findings:
    """The values of an unknown that agree with the readings.

    Attributes
    ----------
    track
        Predictions over the search range.
    pieces
        The accepted values, eq. ES.4, as separate intervals.
    noise_pieces
        The same for a model without error and without nuisances.
    pieces_if_known
        The same with the model's error, without nuisances; None if there are no nuisances.
    best
        Coordinate of the best fit, eq. ES.2; None where no value can be predicted.
    p_value
        Probability of a worse fit than the best one.
    shift
        t of eq. ES.5 at the best fit.
    """

    track: Track
    pieces: tuple[Piece, ...]
    noise_pieces: tuple[Piece, ...]
    best: float | None
    p_value: float
    shift: float
    pieces_if_known: tuple[Piece, ...] | None = None

    @property
    def name(self) -> str:
        """Name of the unknown in a sentence."""
        return UNKNOWN_NAMES.get(self.unknown, self.unknown)

    @property
    def no_model_text(self) -> str:
        """The reason why there are no predictions beyond the range searched."""
        text = f"the model's error is above {MAX_LOG_RATIO_ERROR:.0%}"
        if self.track.plan:
            text = f"{self.track.evaluator} does not reach the load, or its error is above {MAX_LOG_RATIO_ERROR:.0%},"
        return text if self.unknown in TARGET_UNKNOWNS else f"{text.rstrip(',')}, or a face of a layer would cut an inclusion,"

    @property
    def model(self) -> TargetModel:
        """The model that predicts the data."""
        return self.track.model

    @property
    def unknown(self) -> str:
        """youngs_modulus, diameter or depth of the target, or the key of a number of the tissue."""
        return self.track.unknown

    @property
    def best_value(self) -> float | None:
        """The best fit, SI."""
        return None if self.best is None else float(self.track.compute_values(np.array([self.best]))[0])

    @property
    def shared_errors(self) -> SharedErrors | None:
        """The errors that all data share at the best fit, coefficients of shape (k, terms); None without nuisances."""
        if self.track.spread is None or self.best is None:
            return None
        return self.track.spread.interpolate(np.array([self.best])).transform(lambda part: part[0])

    @property
    def log_ratios(self) -> Floats:
        """Predicted ln |ratio| at the usable nodes, for the first reading over the target."""
        return np.asarray(self.track.predicted.value[self.track.predicted.usable, self.model.data.first_ratio])

    def is_searched_to_end(self, end: int) -> bool:
        """Return whether the search reached the first (0) or last (-1) value of the range."""
        return bool(self.track.runs and self.track.runs[end][end] == self.track.x[end])


def explain_unidentifiable(findings: Findings, interval: Interval, noise_interval: Interval) -> str:
    """Return the reason why the unknown is not identifiable.

    Parameters
    ----------
    findings
        Values of the unknown that agree with the readings.
    interval
        95 % interval.
    noise_interval
        The same for a model without error and without nuisances.
    """
    text = _explain_interval(findings, interval)
    if is_identifiable(noise_interval, findings.unknown) and findings.pieces and findings.shift > TOLERATED_SHIFT:
        low, high = (format_value(findings.unknown, end or 0.0) for end in noise_interval)
        text += f"; by the noise alone it would be {low} to {high}, but the model's own error hides that"
    return text


def _explain_interval(findings: Findings, interval: Interval) -> str:
    """Return the reason that the interval shows: no value fits, an end is open, or its ends are too far apart."""
    name, data = findings.name, findings.model.data
    if findings.best is None and findings.track.predicted.resolved.any():
        return f"no {name} gives every ratio the sign that was measured: something in the scene is not as stated"
    if findings.best is None:
        return f"{findings.no_model_text} for every {name} that fits"
    low, high = interval
    if not findings.pieces:
        return _explain_no_fit(findings)
    if low is None and high is None:
        change, noise = np.expm1(np.ptp(findings.log_ratios)), data.noise[data.first_ratio]
        change_text = (
            f"over all of them the ratio changes by {format_percent(change)} of its value, its noise is {format_percent(noise)}"
        )
        return f"any {name} explains the readings: {change_text}"
    if low is None or high is None:
        return _explain_open_end(findings, 0 if low is None else -1)
    return f"the interval's ends are a factor of {high / low:.3g} apart, more than {get_max_end_ratio(findings.unknown):g}"


def _explain_open_end(findings: Findings, end: int) -> str:
    """Return the reason for an open end of the interval, the lower (0) or the upper (-1) one."""
    adjective = END_ADJECTIVES[findings.unknown.rpartition(".")[2]][end]
    if not findings.is_searched_to_end(end):
        limit = format_value(findings.unknown, float(findings.track.compute_values(findings.track.runs[end][end])))
        return f"the interval reaches {limit}, beyond which {findings.no_model_text.rstrip(',')}"
    if findings.unknown == "youngs_modulus":
        first = findings.model.data.first_ratio
        ratio = np.exp(findings.track.predicted.value[end, first]) * findings.model.data.sign[first]
        saturation = f"the ratio saturates at {ratio:.4g}, too near the reading for its noise"
        return f"even an extremely {adjective} body explains the readings: {saturation}"
    subject = "a body" if findings.unknown in TARGET_UNKNOWNS else findings.name
    return f"{subject} as {adjective} as the scene allows explains the readings"


def _explain_no_fit(findings: Findings) -> str:
    """Return the reason why no value of the unknown explains the readings."""
    data, name, first = findings.model.data, findings.name, findings.model.data.first_ratio
    if len(data.value) > 1:
        return f"no {name} explains the readings: something in the scene, or the noise, is not as stated"
    values = findings.log_ratios
    ends = np.exp([values.min(), values.max()])
    side, end = ("below", ends[0]) if data.value[first] < values.min() else ("above", ends[1])
    reading, limit = np.exp(data.value[first]) * data.sign[first], end * data.sign[first]
    limit_text = f"the last ratio that any {name} gives, by more than the noise explains"
    return f"the reading {reading:.4g} lies {side} {limit:.4g}, {limit_text}: something in the scene is not as stated"


def iterate_warnings(findings: Findings, fitted: DepthAndStrength | None) -> Iterator[str]:
    """Yield the warnings of an estimate, one line each; the caller removes duplicates."""
    yield from warn_of_read_bonds(findings.model.scene)
    yield from findings.model.base.notes  # these are for the place farthest from the tissue's middle
    if findings.best is None:
        if not findings.model.pressing:
            heaviest = findings.model.heaviest_scene
            yield from build_load_notes(heaviest, findings.model.rule, findings.model.tolerance, promise=False)
        return
    yield from _describe_load(findings)
    if findings.model.scene.load.preload:
        yield f"readings are taken as {findings.model.scene.load.response}"
    if findings.p_value < MIN_FIT_PROBABILITY:
        yield f"the readings contradict the scene or their noise: so bad a fit has a probability of {findings.p_value:.1g}"
    if findings.shift > TOLERATED_SHIFT:
        yield (
            f"the model's own error, up to {findings.shift:.2g} standard deviations of the noise, is above a third of it: "
            "the interval is widened by it and covers more than 95 %; a smaller --accuracy (accuracy=) may help"
        )
    if len(findings.pieces) > 1:
        parts = [[format_value(findings.unknown, end) for end in (piece.low, piece.high)] for piece in findings.pieces]
        yield f"the interval is the hull of separate parts: {' or '.join(' to '.join(ends) for ends in parts)}"
    yield from _describe_unsearched(findings)
    if fitted is not None and findings.unknown != "depth":
        depth, (low, high) = findings.model.target.depth, fitted.depth_interval
        if not (low or 0.0) <= depth <= (np.inf if high is None else high):
            stated = format_value("depth", depth)
            yield f"the readings fit another depth than the scene's {stated}, with which {findings.name} was estimated"


def _describe_unsearched(findings: Findings) -> Iterator[str]:
    """Yield a warning about parts of the range that were not searched."""
    is_resolved = findings.track.predicted.resolved
    if is_resolved.all() or not is_resolved.any():
        return
    values = findings.track.compute_values(findings.track.x)
    first, last = np.flatnonzero(is_resolved)[[0, -1]]
    parts = [f"below {format_value(findings.unknown, values[first])}"] if first else []
    parts += [f"above {format_value(findings.unknown, values[last])}"] if last < len(values) - 1 else []
    parts += ["at some values between"] if not is_resolved[first:last].all() else []
    yield f"not searched {' and '.join(parts)}: {findings.no_model_text} there"


def _describe_load(findings: Findings) -> Iterator[str]:
    """Yield a warning where the readings' largest load is beyond linear elasticity at the best fit, and linear all the same."""
    model, scene, value = findings.model, findings.model.heaviest_scene, findings.best_value
    assert value is not None  # the caller has checked it
    if model.pressing:
        return
    if findings.unknown in TARGET_UNKNOWNS:
        body = model.target.model_copy(update={findings.unknown: value})
        bodies = tuple(body if index == scene.target else other for index, other in enumerate(scene.inclusion))
        scene = scene.model_copy(update={"inclusion": bodies})
    else:
        scene = scene.replace({findings.unknown: value})
        model = replace(model, scene=scene)
    best_readings = compute_readings(model.base, Tumours.from_scene(scene), scene.target or 0)
    rule = replace(model.rule, stiffness=float(best_readings.stiffness[0]))
    yield from build_load_notes(scene, rule, model.tolerance, promise=False)


def format_value(unknown: str, value: float) -> str:
    """Return a value as text with its unit: lengths in mm, moduli in Pa, kPa, MPa or GPa."""
    return format_modulus(value, 3) if unknown.endswith("youngs_modulus") else f"{value * MM_PER_M:.4g} mm"
