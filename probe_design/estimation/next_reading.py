"""Choose the next reading: the candidate after which the interval is expected to be shortest.

The quantities that are not known are drawn from their distribution after the present readings: the coordinate x of the unknown,
eq. ES.2, with a uniform prior, and the nuisances eta of eq. ES.8, normal about their best fit,

    p(x) ~ exp(-chi2(x) / 2),   eta ~ N(M A^T r, M),   M = (I + A^T A)^-1,   r = (y - m(x)) / s.            (ES.11)

Here y are the present data, m(x) their predictions, s their noise, and A = J / s with J of eq. ES.7. Each draw with new noise
simulates a candidate's reading, and eq. ES.4 gives the interval that ``estimate`` would compute. A candidate's score is the mean
logarithmic length of the interval, whose ends count only up to the factor within which the unknown is identifiable
(``estimate_result.MAX_END_RATIOS``). A size by ultrasound is a reading of eta, with the standard deviation of ln size
``ULTRASOUND_RELATIVE_SD``.

All candidates share the same draws (points of one scrambled Sobol sequence), so that chance does not decide their order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, qmc

from geometry.common.arrays import Floats, Ints
from probe_design.estimation.answer import identifiable, widest
from probe_design.estimation.candidates import ULTRASOUND, NextCandidate, candidates, joined
from probe_design.estimation.intervals import Likelihood, hulls
from probe_design.estimation.model import TargetModel
from probe_design.estimation.nuisances import Spread
from probe_design.estimation.predicted import Predicted
from probe_design.estimation.profile import FINER, Track
from probe_design.estimation.readings import Measurements
from probe_design.estimation.shared_errors import SharedErrors
from probe_design.estimation.strength import Interval

DRAWS = 64
COARSE = 10  # points from node to node that bracket the ends of intervals
LIKELY = 0.5  # probability of being identifiable from which a reading is recommended


@dataclass(frozen=True)
class ExpectedInterval:
    """The interval that is expected after one further reading.

    Attributes:
        kind: see ``candidates.NextCandidate``.
        told: the reading in words.
        x, y: of the probe's axis, m; None for a size.
        interval: medians of the interval's ends, SI; None where an end is open in most cases.
        width: median of the ratio of the ends; None where an end is open in most cases.
        identifiable: probability that the unknown is identifiable after this reading.
        score: mean logarithmic length, see above.
    """

    kind: str
    told: str
    x: float | None
    y: float | None
    interval: Interval
    width: float | None
    identifiable: float
    score: float


@dataclass(frozen=True)
class NextReading:
    """Advice what to measure next.

    Attributes:
        reading: the best candidate, or None where none narrows the interval.
        together: all candidates together.
        verdict: the advice in one sentence.
        others: the other candidates, the best first.
        draws: number of draws of eq. ES.11.
    """

    reading: ExpectedInterval | None
    together: ExpectedInterval | None
    verdict: str
    others: tuple[ExpectedInterval, ...]
    draws: int


def next_reading(model: TargetModel, unknown: str, nuisances: Mapping[str, float], told: bool, seed: int = 0) -> NextReading:
    """Rank the candidates for the next reading.

    Args:
        model: with the present readings, under a load within linear elasticity.
        unknown: as in ``probe_design.estimation.estimate``.
        nuisances: likewise, relative standard deviations.
        already_identifiable: whether the unknown is identifiable from the present readings.
        seed: of the draws.
    """
    allowed = candidates(model, unknown, nuisances)
    track, columns = _track(model, unknown, nuisances, allowed)
    present = np.arange(len(model.data.value))
    if not track.runs:
        return NextReading(None, None, "no reading of this probe can: the model cannot predict the readings", (), 0)
    draws = _Draws.of(track, present, columns, seed)
    found = [draws.expected(one, np.append(present, own)) for one, own in zip(allowed, columns, strict=True)]
    ranked = sorted(found, key=lambda one: one.score)
    together = min((draws.expected(*one, together=True) for one in _all(allowed, columns, present)), key=lambda one: one.score)
    now = draws.expected(NextCandidate("nothing more"), present, together=True).score
    best = ranked[0] if ranked and ranked[0].score < now else None
    return NextReading(best, together, _verdict(best, together, told), tuple(ranked[best is not None :]), DRAWS)


def _all(allowed: Sequence[NextCandidate], columns: Sequence[Ints], present: Ints) -> list[tuple[NextCandidate, Ints]]:
    """Return all ratios together, and all ratios with stiffness, which the model's error may make worse; both with sizes."""
    found = []
    for width in sorted({len(own) for one, own in zip(allowed, columns, strict=True) if one.reading}):
        every = [own for one, own in zip(allowed, columns, strict=True) if one.reading is None or len(own) == width]
        kind = "ratios with stiffness" if width > 1 else "ratios"
        found.append((NextCandidate(f"all {len(every)} together, {kind}"), np.concatenate([present, *every])))
    return found


def _verdict(best: ExpectedInterval | None, together: ExpectedInterval, told: bool) -> str:
    """Return the advice in one sentence."""
    if best is not None and (told or best.identifiable >= LIKELY):
        return f"measure this: {best.told}"
    if best is not None and together.identifiable >= LIKELY:
        return f"measure this: {best.told}; then the others: no single reading is expected to suffice, all together are"
    chance = f"all that may be read together would with a probability of {together.identifiable:.2g}"
    return f"no reading of this probe can, at this noise: {chance}"


def _track(
    model: TargetModel, unknown: str, nuisances: Mapping[str, float], allowed: Sequence[NextCandidate]
) -> tuple[Track, list[Ints]]:
    """Return predictions of the present data and of all candidates, and the columns of each candidate."""
    data, columns = model.data, []
    for one in allowed:
        more = Measurements.of((one.reading,)) if one.reading is not None else None
        begin = len(data.value)
        data = data if more is None else joined(data, more)
        columns.append(np.arange(begin, len(data.value)))
    track = Track.of(replace(model, data=data), unknown).with_spread(nuisances)
    for k, one in enumerate(allowed):
        if one.learned and track.spread is not None:
            begin = track.predicted.value.shape[1]
            track = _with_sizes(
                track, [list(nuisances).index(name) for name in one.learned], [nuisances[name] for name in one.learned]
            )
            columns[k] = np.arange(begin, track.predicted.value.shape[1])
    return track, columns


def _with_sizes(track: Track, which: Sequence[int], sds: Sequence[float]) -> Track:
    """Add a column for each nuisance that ultrasound measures: its prediction is sd times eta at all values of the unknown."""
    assert track.spread is not None
    more, errors, data = len(which), track.spread.errors, track.model.data
    wider = errors.mapped(lambda part: np.concatenate([part, np.zeros((len(part), more, part.shape[2]))], axis=1))
    wider.line[:, np.arange(-more, 0), which] = sds
    spread = Spread(track.spread.x, wider)
    none = np.zeros((len(track.x), more))
    parts = {key: np.hstack([getattr(track.predicted, key), none]) for key in ("value", "by_modulus", "by_diameter", "bound")}
    none_of = np.zeros(more, dtype=bool)
    own = {key: np.append(getattr(data, key), none_of) for key in ("is_stiffness", "is_blank")}
    own |= {key: np.append(getattr(data, key), np.zeros(more)) for key in ("value", "sign")}
    own |= {"place": np.append(data.place, np.zeros(more, dtype=int)), "is_phase": np.append(data.is_phase, ~none_of)}
    own |= {"noise": np.append(data.noise, np.full(more, ULTRASOUND))}
    model = replace(track.model, data=replace(data, **own))
    return replace(
        track, model=model, predicted=replace(track.predicted, **parts), slope=np.hstack([track.slope, none]), spread=spread
    )


def _some(track: Track, which: Ints, finer: int = FINER) -> Likelihood:
    """Return the likelihood of some columns of the data, with ``finer`` points from node to node."""
    told: Predicted = track.predicted
    parts = {key: getattr(told, key)[:, which] for key in ("value", "by_modulus", "by_diameter", "bound")}
    spread = track.spread
    if spread is not None:
        spread = Spread(spread.x, spread.errors.mapped(lambda part: part[:, which]))
    narrowed = replace(track, predicted=replace(told, **parts), slope=track.slope[:, which], spread=spread, finer=finer)
    return Likelihood(narrowed, track.model.data.noise[which])


@dataclass(frozen=True)
class _Draws:
    """Possible truths after the present readings, and simulated data for each.

    Attributes:
        track: of the k present and possible data.
        truth: coordinates of the unknown, shape (s,).
        common_noise_data: simulated data, shape (s, k), with the same noise for all candidates, to compare them one by one.
        separate_noise_data: simulated data, shape (s, k), each with its own noise, for all candidates together.

    The present readings keep their measured values in both.
    """

    track: Track
    truth: Floats
    alike: Floats
    apart: Floats

    @classmethod
    def of(cls, track: Track, present: Ints, columns: Sequence[Ints], seed: int) -> _Draws:
        """Draw truths and nuisances from eq. ES.11, and simulate the data."""
        data, k, nuisances = track.model.data, len(track.model.data.noise), track.shared(track.x[:1]).line.shape[-1]
        fit, here = _some(track, present), data.value[present]
        widths = max((len(own) for own in columns), default=0)
        chance = qmc.Sobol(1 + nuisances + widths, rng=seed).random(DRAWS)
        normal = norm.ppf(np.clip(chance[:, 1:], 1e-9, 1 - 1e-9))
        truth = _truths(fit, here, chance[:, 0])
        shared, value = track.shared(truth), track.at(truth)[0]
        shared = shared.mapped(lambda part: np.broadcast_to(part, (DRAWS, k, part.shape[-1])))
        own = shared.mapped(lambda part: part[:, present]).over(data.noise[present])
        eta = _nuisances(own, (here - value[:, present]) / data.noise[present], normal[:, :nuisances])
        middle = value + shared.at(eta)
        alike, apart = middle.copy(), middle + data.noise * np.random.default_rng(seed).normal(size=middle.shape)
        for columns_of_one in columns:
            noise = normal[:, nuisances : nuisances + len(columns_of_one)]
            alike[:, columns_of_one] += data.noise[columns_of_one] * noise
        alike[:, present] = apart[:, present] = here
        return cls(track, truth, alike, apart)

    def expected(self, one: NextCandidate, which: Ints, together: bool = False) -> ExpectedInterval:
        """Return the expected interval from some columns of the data, over all draws."""
        fit, unknown = _some(self.track, which, COARSE), self.track.unknown
        intervals = hulls(fit, (self.apart if together else self.alike)[:, which])
        truth, most = self.track.values(self.truth), widest(unknown)
        low, high = (np.array([interval[end] or none for interval in intervals]) for end, none in ((0, 0.0), (1, np.inf)))
        length = np.log(np.minimum(high, truth * most)) - np.log(np.maximum(low, truth / most))
        with np.errstate(divide="ignore"):
            ends, width = (float(np.median(low)), float(np.median(high))), float(np.median(high / low))
        spot = one.reading
        return ExpectedInterval(
            one.kind, one.kind if together else one.told, None if spot is None else spot.x, None if spot is None else spot.y,
            interval=(ends[0] or None, ends[1] if np.isfinite(ends[1]) else None), width=width if np.isfinite(width) else None,
            identifiable=float(np.mean([identifiable(interval, unknown) for interval in intervals])),
            score=float(np.mean(np.maximum(length, 0.0))),
        )  # fmt: skip


def _truths(fit: Likelihood, y: Floats, level: Floats) -> Floats:
    """Return coordinates of the unknown at cumulative probabilities of p of eq. ES.11, shape (s,)."""
    points = np.concatenate(fit.track.runs)
    room = np.concatenate([np.gradient(run) for run in fit.track.runs])
    chi2 = fit.chi_square(points, y)
    weight = room * np.exp(-(chi2 - chi2.min()) / 2)
    return np.asarray(points[np.minimum(np.searchsorted(np.cumsum(weight) / weight.sum(), level), len(points) - 1)])


def _nuisances(errors: SharedErrors, off: Floats, normal: Floats) -> Floats:
    """Return eta of eq. ES.11, shape (s, q), for A of shape (s, k, q), r of shape (s, k) and standard normal numbers, (s, q)."""
    A = errors.line
    M = np.linalg.inv(np.eye(A.shape[-1]) + A.swapaxes(1, 2) @ A)
    middle = (M @ (A.swapaxes(1, 2) @ off[..., None]))[..., 0]
    return np.asarray(middle + (np.linalg.cholesky(M) @ normal[..., None])[..., 0])
