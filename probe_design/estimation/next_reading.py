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
from probe_design.estimation.candidates import ULTRASOUND_RELATIVE_SD, NextCandidate, list_candidates
from probe_design.estimation.estimate_result import ExpectedInterval, NextReading, get_max_end_ratio, is_identifiable
from probe_design.estimation.intervals import Likelihood, compute_hulls
from probe_design.estimation.measurements import Measurements
from probe_design.estimation.model import TargetModel
from probe_design.estimation.nuisances import NuisanceErrors
from probe_design.estimation.profile import POINTS_PER_NODE, Track
from probe_design.estimation.shared_errors import SharedErrors
from probe_design.inference.linear_gaussian import LinearGaussian

DRAW_COUNT = 64
COARSE_POINTS = 10  # points from node to node that bracket the ends of intervals
LIKELY_PROBABILITY = 0.5  # probability of being identifiable from which a reading is recommended


def choose_next_reading(
    model: TargetModel, unknown: str, nuisances: Mapping[str, float], already_identifiable: bool, seed: int = 0
) -> NextReading:
    """Rank the candidates for the next reading.

    Parameters
    ----------
    model
        With the present readings, under a load within linear elasticity.
    unknown
        As in ``probe_design.estimation.estimate``.
    nuisances
        Likewise, relative standard deviations.
    already_identifiable
        Whether the unknown is identifiable from the present readings.
    seed
        Of the draws.
    """
    allowed = list_candidates(model, unknown, nuisances)
    track, columns = _build_track(model, unknown, nuisances, allowed)
    present = np.arange(len(model.data.value))
    if not track.runs:
        return NextReading(None, None, "no reading of this probe can: the model cannot predict the readings", (), 0)
    draws = _Draws.from_track(track, present, columns, seed)
    expected = [
        draws.summarise(candidate, np.append(present, own_columns))
        for candidate, own_columns in zip(allowed, columns, strict=True)
    ]
    ranked = sorted(expected, key=lambda candidate: candidate.score)
    together = min(
        (draws.summarise(*candidate, together=True) for candidate in _combine_candidates(allowed, columns, present)),
        key=lambda candidate: candidate.score,
    )
    present_score = draws.summarise(NextCandidate("nothing more"), present, together=True).score
    best = ranked[0] if ranked and ranked[0].score < present_score else None
    return NextReading(
        best, together, _write_verdict(best, together, already_identifiable), tuple(ranked[best is not None :]), DRAW_COUNT
    )


def _combine_candidates(
    allowed: Sequence[NextCandidate], columns: Sequence[Ints], present: Ints
) -> list[tuple[NextCandidate, Ints]]:
    """Return all ratios together, and all ratios with stiffness, which the model's error may make worse; both with sizes."""
    combinations = []
    for width in sorted({len(own_columns) for candidate, own_columns in zip(allowed, columns, strict=True) if candidate.reading}):
        all_columns = [
            own_columns
            for candidate, own_columns in zip(allowed, columns, strict=True)
            if candidate.reading is None or len(own_columns) == width
        ]
        kind = "ratios with stiffness" if width > 1 else "ratios"
        combinations.append((NextCandidate(f"all {len(all_columns)} together, {kind}"), np.concatenate([present, *all_columns])))
    return combinations


def _write_verdict(best: ExpectedInterval | None, together: ExpectedInterval, already_identifiable: bool) -> str:
    """Return the advice in one sentence."""
    if best is not None and (already_identifiable or best.identifiable >= LIKELY_PROBABILITY):
        return f"measure this: {best.told}"
    if best is not None and together.identifiable >= LIKELY_PROBABILITY:
        return f"measure this: {best.told}; then the others: no single reading is expected to suffice, all together are"
    chance = f"all that may be read together would with a probability of {together.identifiable:.2g}"
    return f"no reading of this probe can, at this noise: {chance}"


def _build_track(
    model: TargetModel, unknown: str, nuisances: Mapping[str, float], allowed: Sequence[NextCandidate]
) -> tuple[Track, list[Ints]]:
    """Return predictions of the present data and of all candidates, and the columns of each candidate."""
    data, columns = model.data, []
    for candidate in allowed:
        new_data = Measurements.from_readings((candidate.reading,)) if candidate.reading is not None else None
        start = len(data.value)
        data = data if new_data is None else data.join(new_data)
        columns.append(np.arange(start, len(data.value)))
    track = Track.from_model(replace(model, data=data), unknown).add_nuisances(nuisances)
    for k, candidate in enumerate(allowed):
        if candidate.learned and track.spread is not None:
            start = track.predicted.value.shape[1]
            track = _add_size_columns(
                track,
                [list(nuisances).index(name) for name in candidate.learned],
                [nuisances[name] for name in candidate.learned],
            )
            columns[k] = np.arange(start, track.predicted.value.shape[1])
    return track, columns


def _add_size_columns(track: Track, indices: Sequence[int], sds: Sequence[float]) -> Track:
    """Add a column for each nuisance that ultrasound measures: its prediction is sd times eta at all values of the unknown."""
    assert track.spread is not None
    count, errors, data = len(indices), track.spread.errors, track.model.data
    wider = errors.transform(lambda part: np.concatenate([part, np.zeros((len(part), count, part.shape[2]))], axis=1))
    wider.linear[:, np.arange(-count, 0), indices] = sds
    spread = NuisanceErrors(track.spread.x, wider)
    zeros, no_flags = np.zeros((len(track.x), count)), np.zeros(count, dtype=bool)
    sizes = Measurements(
        data.places,
        place=np.zeros(count, dtype=int),
        is_stiffness=no_flags,
        is_phase=~no_flags,
        is_blank=no_flags,
        value=np.zeros(count),
        sign=np.zeros(count),
        noise=np.full(count, ULTRASOUND_RELATIVE_SD),
    )
    predicted = track.predicted.transform_columns(lambda part: np.hstack([part, zeros]))
    model, slope = replace(track.model, data=data.join(sizes)), np.hstack([track.slope, zeros])
    return replace(track, model=model, predicted=predicted, slope=slope, spread=spread)


def _select_data(track: Track, columns: Ints, finer: int = POINTS_PER_NODE) -> Likelihood:
    """Return the likelihood of some columns of the data, with ``finer`` points from node to node."""
    predicted = track.predicted.transform_columns(lambda part: part[:, columns])
    spread = track.spread
    if spread is not None:
        spread = NuisanceErrors(spread.x, spread.errors.transform(lambda part: part[:, columns]))
    narrowed = replace(track, predicted=predicted, slope=track.slope[:, columns], spread=spread, finer=finer)
    return Likelihood(narrowed, track.model.data.noise[columns])


@dataclass(frozen=True)
class _Draws:
    """Possible truths after the present readings, and simulated data for each.

    Attributes
    ----------
    track
        Of the k present and possible data.
    truth
        Coordinates of the unknown, shape (s,).
    common_noise_data
        Simulated data, shape (s, k), with the same noise for all candidates, to compare them one by one.
    separate_noise_data
        Simulated data, shape (s, k), each with its own noise, for all candidates together.

    The present readings keep their measured values in both.
    """

    track: Track
    truth: Floats
    common_noise_data: Floats
    separate_noise_data: Floats

    @classmethod
    def from_track(cls, track: Track, present: Ints, columns: Sequence[Ints], seed: int) -> _Draws:
        """Draw truths and nuisances from eq. ES.11, and simulate the data."""
        data, k, nuisances = (
            track.model.data,
            len(track.model.data.noise),
            track.compute_shared_errors(track.x[:1]).linear.shape[-1],
        )
        fit, present_values = _select_data(track, present), data.value[present]
        widths = max((len(selected) for selected in columns), default=0)
        chance = qmc.Sobol(1 + nuisances + widths, rng=seed).random(DRAW_COUNT)
        normal = norm.ppf(np.clip(chance[:, 1:], 1e-9, 1 - 1e-9))
        truth = _draw_truths(fit, present_values, chance[:, 0])
        shared, value = track.compute_shared_errors(truth), track.interpolate(truth)[0]
        shared = shared.transform(lambda part: np.broadcast_to(part, (DRAW_COUNT, k, part.shape[-1])))
        selected = shared.transform(lambda part: part[:, present]).divide_by_noise(data.noise[present])
        eta = _draw_nuisances(selected, (present_values - value[:, present]) / data.noise[present], normal[:, :nuisances])
        middle = value + shared.evaluate(eta)
        common_noise_data, separate_noise_data = (
            middle.copy(),
            middle + data.noise * np.random.default_rng(seed).normal(size=middle.shape),
        )
        for own_columns in columns:
            noise = normal[:, nuisances : nuisances + len(own_columns)]
            common_noise_data[:, own_columns] += data.noise[own_columns] * noise
        common_noise_data[:, present] = separate_noise_data[:, present] = present_values
        return cls(track, truth, common_noise_data, separate_noise_data)

    def summarise(self, candidate: NextCandidate, columns: Ints, together: bool = False) -> ExpectedInterval:
        """Return the expected interval from some columns of the data, over all draws."""
        fit, unknown = _select_data(self.track, columns, COARSE_POINTS), self.track.unknown
        intervals = compute_hulls(fit, (self.separate_noise_data if together else self.common_noise_data)[:, columns])
        truth, max_ratio = self.track.compute_values(self.truth), get_max_end_ratio(unknown)
        low, high = (
            np.array([interval[end] or open_value for interval in intervals]) for end, open_value in ((0, 0.0), (1, np.inf))
        )
        length = np.log(np.minimum(high, truth * max_ratio)) - np.log(np.maximum(low, truth / max_ratio))
        with np.errstate(divide="ignore"):
            ends, width = (float(np.median(low)), float(np.median(high))), float(np.median(high / low))
        reading = candidate.reading
        return ExpectedInterval(
            candidate.kind, candidate.kind if together else candidate.description, None if reading is None else reading.x,
            None if reading is None else reading.y,
            interval=(ends[0] or None, ends[1] if np.isfinite(ends[1]) else None), width=width if np.isfinite(width) else None,
            identifiable=float(np.mean([is_identifiable(interval, unknown) for interval in intervals])),
            score=float(np.mean(np.maximum(length, 0.0))),
        )  # fmt: skip


def _draw_truths(fit: Likelihood, y: Floats, probability: Floats) -> Floats:
    """Return coordinates of the unknown at cumulative probabilities of p of eq. ES.11, shape (s,)."""
    points = np.concatenate(fit.track.runs)
    spacing = np.concatenate([np.gradient(run) for run in fit.track.runs])
    chi2 = fit.compute_chi_square(points, y)
    weight = spacing * np.exp(-(chi2 - chi2.min()) / 2)
    return np.asarray(points[np.minimum(np.searchsorted(np.cumsum(weight) / weight.sum(), probability), len(points) - 1)])


def _draw_nuisances(errors: SharedErrors, residual: Floats, normal: Floats) -> Floats:
    """Return eta of eq. ES.11, shape (s, q), for A of shape (s, k, q), r of shape (s, k) and standard normal numbers, (s, q)."""
    model = LinearGaussian.from_shared_errors(errors.linear, np.ones(residual.shape[-1]))
    root = np.linalg.cholesky(model.compute_posterior_covariance())
    return np.asarray(model.compute_posterior_mean(residual) + (root @ normal[..., None])[..., 0])
