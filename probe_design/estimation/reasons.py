"""Explain an estimate in words: the reason why an unknown is not identifiable, and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.variables import changed
from probe_design.estimation.intervals import TOLERATED, Piece
from probe_design.estimation.model import OF_TARGET, TargetModel
from probe_design.estimation.predicted import WORST
from probe_design.estimation.profile import Track
from probe_design.estimation.shared_errors import SharedErrors
from probe_design.estimation.strength import DepthAndStrength, Interval
from solver.equivalent_inclusion.readings import readings
from solver.inclusions.tumours import Tumours
from solver.planning.load_check import load_notes
from solver.results.film_forces import Bound, FilmForces, outputs

IMPROBABLE = 0.01  # a smaller p-value of the fit contradicts the scene or its noise
NAMES = {"youngs_modulus": "E_object", "diameter": "diameter", "depth": "depth"}
ENDS = {
    "youngs_modulus": ("soft", "stiff"), "diameter": ("small", "large"), "depth": ("shallow", "deep"),
    "thickness": ("thin", "thick"),
}  # fmt: skip


@dataclass(frozen=True)
class Findings:
    """The values of an unknown that agree with the readings.

    Attributes:
        track: predictions over the search range.
        pieces: the set of eq. ES.4.
        noise_pieces: the same for a model without error and without nuisances.
        pieces_if_known: the same with the model's error, without nuisances; None if there are no nuisances.
        best: coordinate of the best fit, eq. ES.2; None where no value can be predicted.
        p_value: of the best fit.
        shift: t of eq. ES.5 at the best fit.
    """

    track: Track
    pieces: tuple[Piece, ...]
    of_noise: tuple[Piece, ...]
    best: float | None
    p_value: float
    shift: float
    if_known: tuple[Piece, ...] | None = None

    @property
    def name(self) -> str:
        """Name of the unknown in a sentence."""
        return NAMES.get(self.unknown, self.unknown)

    @property
    def nothing(self) -> str:
        """The reason why there are no predictions beyond the range searched."""
        told = f"the model's error is above {WORST:.0%}"
        if self.track.plan:
            told = f"{self.track.level} does not reach the load, or its error is above {WORST:.0%},"
        return told if self.unknown in OF_TARGET else f"{told.rstrip(',')}, or a face of a layer would cut an inclusion,"

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
        return None if self.best is None else float(self.track.values(np.array([self.best]))[0])

    @property
    def shared(self) -> SharedErrors | None:
        """The errors that all data share at the best fit, shapes (k, q); None without nuisances."""
        if self.track.spread is None or self.best is None:
            return None
        return self.track.spread.at(np.array([self.best])).mapped(lambda part: part[0])

    @property
    def values(self) -> Floats:
        """Predicted ln |ratio| of the first ratio at the usable nodes."""
        return np.asarray(self.track.predicted.value[self.track.predicted.usable, self.model.data.first])

    def searched_all(self, end: int) -> bool:
        """Return whether the search reached the first (0) or last (-1) value of the range."""
        return bool(self.track.runs and self.track.runs[end][end] == self.track.x[end])


def reason(findings: Findings, interval: Interval, widest: float, resolved_by_noise: bool) -> str:
    """Return the reason why the unknown is not identifiable."""
    text = _reason(findings, interval, widest)
    if resolved_by_noise and findings.pieces and findings.shift > TOLERATED:
        low, high = (shown(findings.unknown, end) for end in (findings.of_noise[0].low, findings.of_noise[-1].high))
        text += f"; by the noise alone it would be {low} to {high}, but the model's own error hides that"
    return text


def _reason(findings: Findings, interval: Interval, widest: float) -> str:
    """Return the reason that the interval shows: no fit, an open end, or too wide."""
    name, data = findings.name, findings.model.data
    if findings.best is None and findings.track.predicted.resolved.any():
        return f"no {name} gives every ratio the sign that was measured: something in the scene is not as stated"
    if findings.best is None:
        return f"{findings.nothing} for every {name} that fits"
    low, high = interval
    if not findings.pieces:
        return _unexplained(findings)
    if low is None and high is None:
        change = np.expm1(np.ptp(findings.values))
        change = f"over all of them the ratio changes by {change:.2g} of itself, its noise is {data.noise[data.first]:.2g}"
        return f"any {name} explains the readings: {change}"
    for end, value, ends in ((0, low, 0), (1, high, -1)):
        if value is None:
            return _open(findings, ENDS[findings.unknown.rpartition(".")[2]][end], ends)
    assert low is not None
    assert high is not None
    return f"the interval's ends are a factor of {high / low:.3g} apart, more than {widest:g}"


def _open(findings: Findings, how: str, end: int) -> str:
    """Return the reason for an open end, the first (0) or last (-1) of the search range."""
    if not findings.searched_all(end):
        limit = shown(findings.unknown, float(findings.track.values(findings.track.runs[end][end])))
        return f"the interval reaches {limit}, beyond which {findings.nothing.rstrip(',')}"
    if findings.unknown == "youngs_modulus":
        first = findings.model.data.first
        ratio = np.exp(findings.track.predicted.value[end, first]) * findings.model.data.sign[first]
        why = f"the ratio saturates at {ratio:.4g}, too near the reading for its noise"
        return f"even an extremely {how} body explains the readings: {why}"
    what = "a body" if findings.unknown in OF_TARGET else findings.name
    return f"{what} as {how} as the scene allows explains the readings"


def _unexplained(findings: Findings) -> str:
    """Return the reason why no value of the unknown explains the readings."""
    data, name, first = findings.model.data, findings.name, findings.model.data.first
    if len(data.value) > 1:
        return f"no {name} explains the readings: something in the scene, or the noise, is not as stated"
    values = findings.values
    ends = np.exp([values.min(), values.max()])
    side, end = ("below", ends[0]) if data.value[first] < values.min() else ("above", ends[1])
    read, limit = np.exp(data.value[first]) * data.sign[first], end * data.sign[first]
    last = f"the last ratio that any {name} gives, by more than the noise explains"
    return f"the reading {read:.4g} lies {side} {limit:.4g}, {last}: something in the scene is not as stated"


def warnings(findings: Findings, fitted: DepthAndStrength | None) -> tuple[str, ...]:
    """Return the warnings of an estimate, one line each."""
    return tuple(dict.fromkeys(_warnings(findings, fitted)))


def _warnings(findings: Findings, fitted: DepthAndStrength | None) -> Iterator[str]:
    yield from findings.model.base.notes  # these are for the place farthest from the tissue's middle
    if findings.best is None:
        yield from load_notes(findings.model.scene, findings.model.rule, findings.model.tolerance, promise=False)
        return
    yield from _of_load(findings)
    if findings.p_value < IMPROBABLE:
        yield f"the readings contradict the scene or their noise: so bad a fit has a probability of {findings.p_value:.1g}"
    if findings.shift > TOLERATED:
        yield (
            f"the model's own error, up to {findings.shift:.2g} standard deviations of the noise, is above a third of it: "
            "the interval is widened by it and covers more than 95 %; a smaller --accuracy may help"
        )
    if len(findings.pieces) > 1:
        ends = [(shown(findings.unknown, one.low), shown(findings.unknown, one.high)) for one in findings.pieces]
        parts = " or ".join(f"{low} to {high}" for low, high in ends)
        yield f"the interval is the hull of separate parts: {parts}"
    yield from _not_searched(findings)
    if fitted is not None and findings.unknown != "depth" and not _contains(fitted.depth_interval, findings.model.target.depth):
        stated = shown("depth", findings.model.target.depth)
        yield f"the readings fit another depth than the scene's {stated}, with which {findings.name} was estimated"


def _not_searched(findings: Findings) -> Iterator[str]:
    """Yield a warning about parts of the range that were not searched."""
    good = findings.track.predicted.resolved
    if good.all() or not good.any():
        return
    u = findings.track.values(findings.track.x)
    first, last = np.flatnonzero(good)[[0, -1]]
    parts = [f"below {shown(findings.unknown, u[first])}"] if first else []
    parts += [f"above {shown(findings.unknown, u[last])}"] if last < len(u) - 1 else []
    parts += ["at some values between"] if not good[first:last].all() else []
    yield f"not searched {' and '.join(parts)}: {findings.nothing} there"


def _of_load(findings: Findings) -> Iterator[str]:
    """Yield the evaluator's warnings about the scene's load at the best fit."""
    model, assumed = findings.model, _at_best(findings)
    if findings.unknown not in OF_TARGET:
        model = replace(model, scene=assumed)
    best = readings(model.base, Tumours.of(assumed), assumed.target or 0)
    slope = best.by["youngs_modulus"][0] if best.by else None
    films = FilmForces(best.forces[0], Bound(best.bound[0], float(best.log_ratio_bound[0])), slope)
    yield from outputs(assumed, films)["warnings"]
    rule = replace(model.rule, stiffness=float(best.stiffness[0]))
    yield from load_notes(assumed, rule, model.tolerance, promise=False)


def _at_best(findings: Findings) -> Scene:
    """Return the scene with the best fit of the unknown."""
    scene, unknown, value = findings.model.scene, findings.unknown, findings.best_value
    assert value is not None  # the caller has checked it
    if unknown not in OF_TARGET:
        return changed(scene, {unknown: value})
    body = findings.model.target.model_copy(update={unknown: value})
    bodies = tuple(body if index == scene.target else one for index, one in enumerate(scene.inclusion))
    return scene.model_copy(update={"inclusion": bodies})


def _contains(interval: Interval, value: float) -> bool:
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


def shown(unknown: str, value: float) -> str:
    """Return a value as text with its unit: lengths in mm, moduli in Pa, kPa, MPa or GPa."""
    if not unknown.endswith("youngs_modulus"):
        return f"{value * 1e3:.4g} mm"
    scale = min(max(int(np.floor(np.log10(value) / 3)), 0), 3)
    return f"{value / 1000.0**scale:.3g} {('Pa', 'kPa', 'MPa', 'GPa')[scale]}"
