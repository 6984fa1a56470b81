"""Why an estimate came out as it did, in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from probe_design.estimation.intervals import TOLERATED, Piece
from probe_design.estimation.model import WORST, TargetModel
from probe_design.estimation.profile import Track
from probe_design.estimation.strength import DepthAndStrength, Interval
from solver.equivalent_inclusion.readings import readings
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import Bound, FilmForces, outputs

IMPROBABLE = 0.01  # a fit this bad says that scene or noise are not what they are said to be
NAMES = {"youngs_modulus": "E_object", "diameter": "diameter", "depth": "depth"}
ENDS = {"youngs_modulus": ("soft", "stiff"), "diameter": ("small", "large"), "depth": ("shallow", "deep")}


@dataclass(frozen=True)
class Findings:
    """Which values of an unknown the readings leave.

    Attributes:
        track: what was searched.
        pieces: eq. (L2).
        of_noise: the same for a model without error.
        best: eq. (T1) of the best fit, None where the model can tell nothing.
        p_value: of its misfit.
        shift: eq. (L3) there.
    """

    track: Track
    pieces: tuple[Piece, ...]
    of_noise: tuple[Piece, ...]
    best: float | None
    p_value: float
    shift: float

    @property
    def model(self) -> TargetModel:
        """What predicts."""
        return self.track.model

    @property
    def unknown(self) -> str:
        """youngs_modulus, diameter or depth."""
        return self.track.unknown

    @property
    def best_value(self) -> float | None:
        """The best fit, SI."""
        return None if self.best is None else float(self.track.values(np.array([self.best]))[0])

    @property
    def values(self) -> Floats:
        """What the first ratio may be, as ln |ratio| at the nodes."""
        return np.asarray(self.track.predicted.value[self.track.predicted.usable, 0])

    def searched_all(self, end: int) -> bool:
        """Whether the first (0) or last (-1) value of the range was searched."""
        return bool(self.track.runs and self.track.runs[end][end] == self.track.x[end])


def reason(found: Findings, interval: Interval, widest: float, resolved_by_noise: bool) -> str:
    """Say why the unknown is not identifiable."""
    text = _reason(found, interval, widest)
    if resolved_by_noise and found.pieces and found.shift > TOLERATED:
        low, high = (shown(found.unknown, end) for end in (found.of_noise[0].low, found.of_noise[-1].high))
        text += f"; by the noise alone it would be {low} to {high}, but the model's own error hides that"
    return text


def _reason(found: Findings, interval: Interval, widest: float) -> str:
    name, data = NAMES[found.unknown], found.model.data
    if found.best is None and found.track.predicted.resolved.any():
        return f"no {name} gives every ratio the sign that was measured: something in the scene is not as stated"
    if found.best is None:
        return f"the model's error is above {WORST:.0%} for every {name} that fits"
    low, high = interval
    if not found.pieces:
        return _unexplained(found)
    if low is None and high is None:
        change = np.expm1(np.ptp(found.values))
        change = f"over all of them the ratio changes by {change:.2g} of itself, its noise is {data.noise[0]:.2g}"
        return f"any {name} explains what was read: {change}"
    for end, value, ends in ((0, low, 0), (1, high, -1)):
        if value is None:
            return _open(found, ENDS[found.unknown][end], ends)
    assert low is not None
    assert high is not None
    return f"the interval's ends are a factor of {high / low:.3g} apart, more than {widest:g}"


def _open(found: Findings, how: str, end: int) -> str:
    if not found.searched_all(end):
        limit = shown(found.unknown, float(found.track.values(found.track.runs[end][end])))
        return f"the interval reaches {limit}, beyond which the model's error is above {WORST:.0%}"
    if found.unknown == "youngs_modulus":
        ratio = np.exp(found.track.predicted.value[end, 0]) * found.model.data.sign[0]
        why = f"the ratio saturates at {ratio:.4g}, too near the reading for its noise"
        return f"a body however {how} explains what was read: {why}"
    return f"a body as {how} as fits explains what was read"


def _unexplained(found: Findings) -> str:
    """Say how a reading lies beyond what any value gives."""
    data, name = found.model.data, NAMES[found.unknown]
    if len(data.value) > 1:
        return f"no {name} explains the readings: something in the scene, or the noise, is not as stated"
    values = found.values
    ends = np.exp([values.min(), values.max()])
    side, end = ("below", ends[0]) if data.value[0] < values.min() else ("above", ends[1])
    read, limit = np.exp(data.value[0]) * data.sign[0], end * data.sign[0]
    last = f"the last ratio that any {name} gives, by more than the noise explains"
    return f"the reading {read:.4g} lies {side} {limit:.4g}, {last}: something in the scene is not as stated"


def warnings(found: Findings, fitted: DepthAndStrength | None) -> tuple[str, ...]:
    """Return what a user has to know, one line each."""
    return tuple(dict.fromkeys(_warnings(found, fitted)))


def _warnings(found: Findings, fitted: DepthAndStrength | None) -> Iterator[str]:
    yield from found.model.base.notes  # of the places farthest from the tissue's middle
    if found.best is None:
        return
    yield from _of_load(found)
    if found.p_value < IMPROBABLE:
        yield f"the readings contradict the scene or their noise: so bad a fit has a probability of {found.p_value:.1g}"
    if found.shift > TOLERATED:
        yield (
            f"the model's own error, up to {found.shift:.2g} standard deviations of the noise, is above a third of it: "
            "the interval is widened by it and covers more than 95 %; a smaller --accuracy may help"
        )
    if len(found.pieces) > 1:
        parts = " or ".join(f"{shown(found.unknown, one.low)} to {shown(found.unknown, one.high)}" for one in found.pieces)
        yield f"the interval is the hull of separate parts: {parts}"
    yield from _not_searched(found)
    if fitted is not None and found.unknown != "depth" and not _contains(fitted.depth_interval, found.model.target.depth):
        given = shown("depth", found.model.target.depth)
        yield f"the scan says another depth than the scene's {given}, with which {NAMES[found.unknown]} was estimated"


def _not_searched(found: Findings) -> Iterator[str]:
    good = found.track.predicted.resolved
    if good.all() or not good.any():
        return
    u = found.track.values(found.track.x)
    first, last = np.flatnonzero(good)[[0, -1]]
    parts = [f"below {shown(found.unknown, u[first])}"] if first else []
    parts += [f"above {shown(found.unknown, u[last])}"] if last < len(u) - 1 else []
    parts += ["at some places between"] if not good[first:last].all() else []
    yield f"not searched {' and '.join(parts)}: the model's error is above {WORST:.0%} there"


def _of_load(found: Findings) -> Iterator[str]:
    """Yield what the evaluator says of the scene's load at the best fit."""
    model, assumed = found.model, found.model.scene
    body = model.target.model_copy(update={found.unknown: found.best_value})
    bodies = tuple(body if index == assumed.target else one for index, one in enumerate(assumed.inclusion))
    told = readings(model.base, Tumours.of(assumed.model_copy(update={"inclusion": bodies})), assumed.target or 0)
    films = FilmForces(told.forces[0], Bound(told.bound[0], float(told.log_ratio_bound[0])), told.by["youngs_modulus"][0])
    yield from outputs(assumed, films)["warnings"]


def _contains(interval: Interval, value: float) -> bool:
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


def shown(unknown: str, value: float) -> str:
    """Write a value for people: lengths in mm, moduli in Pa, kPa, MPa or GPa."""
    if unknown != "youngs_modulus":
        return f"{value * 1e3:.4g} mm"
    scale = min(max(int(np.floor(np.log10(value) / 3)), 0), 3)
    return f"{value / 1000.0**scale:.3g} {('Pa', 'kPa', 'MPa', 'GPa')[scale]}"
