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

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, qmc

from geometry.common.arrays import Floats, Ints
from geometry.common.percent import format_percent
from probe_design.estimation.estimate_result import ExpectedInterval, NextReading, get_max_end_ratio, is_identifiable
from probe_design.estimation.intervals import Likelihood, compute_hulls
from probe_design.estimation.measurements import Measurements, Reading, is_on_tissue
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel
from probe_design.estimation.nuisances import NuisanceErrors, SharedErrors
from probe_design.estimation.profile import POINTS_PER_NODE, Track
from probe_design.inference.linear_gaussian import LinearGaussian

DRAW_COUNT = 64
DRAW_SEED = 0
COARSE_POINTS = 10  # points from node to node that bracket the ends of intervals
LIKELY_PROBABILITY = 0.5  # probability of being identifiable from which a reading is recommended
RELATIVE_OFFSETS = (0.0, 0.4, 0.8, 1.2, 1.8)  # of the probe's axis from the target's, over the sum of depth and outer radius
MIN_RELATIVE_DISTANCE = 1e-3  # over the same sum: nearer places count as one
ULTRASOUND_RELATIVE_SD = 0.05  # of a diameter or depth by ultrasound, 1 sd: assumed
ULTRASOUND_NUMBERS = ("inclusion.diameter", "inclusion.depth")


@dataclass(frozen=True)
class NextCandidate:
    """A reading or measurement that may be made next.

    Attributes
    ----------
    kind
        "ratio", "ratio and stiffness", "blank", "blank with stiffness", or "size from ultrasound".
    reading
        Its place and noise; its values are placeholders. None for a size by ultrasound.
    learned
        Names of the scene's numbers that ultrasound measures.
    """

    kind: str
    reading: Reading | None = None
    learned: tuple[str, ...] = ()

    @property
    def description(self) -> str:
        """The candidate in words."""
        if self.reading is None:
            keys = " and ".join(name.removeprefix("inclusion.") for name in self.learned)
            return f"{keys} from ultrasound, to {format_percent(ULTRASOUND_RELATIVE_SD, 6)}"
        quantity = "ratio and stiffness" if self.reading.stiffness else "ratio"
        if self.reading.blank:
            return f"{quantity} over tumour-free tissue (blank = true)"
        return f"{quantity} at x = {1e3 * self.reading.x:.4g} mm, y = {1e3 * self.reading.y:.4g} mm"


def choose_next_reading(
    model: TargetModel, unknown: str, nuisances: Mapping[str, float], already_identifiable: bool
) -> NextReading:
    """Rank the candidates for the next reading.

    Parameters
    ----------
    model
        With the present readings.
    unknown
        As in ``probe_design.estimation.estimate``.
    nuisances
        Relative standard deviations by key.
    already_identifiable
        Whether the unknown is identifiable from the present readings.
    """
    track, columns = _build_track(model, unknown, nuisances)
    present = np.arange(len(model.data.value))  # columns of the present readings; those of the candidates follow
    if not track.runs:
        return NextReading(None, None, "no reading of this probe can: the model cannot predict the readings", (), 0)
    draws = _Draws.from_track(track, present, list(columns.values()), DRAW_SEED)
    expected = [draws.summarise(candidate, np.append(present, new)) for candidate, new in columns.items()]
    ranked = sorted(expected, key=lambda candidate: candidate.score)
    combined = [draws.summarise(*combination, together=True) for combination in _combine_candidates(columns, present)]
    together = min(combined, key=lambda candidate: candidate.score)
    present_score = draws.summarise(NextCandidate("nothing more"), present, together=True).score
    best = ranked[0] if ranked and ranked[0].score < present_score else None
    advice = _write_verdict(best, together, already_identifiable)
    return NextReading(best, together, advice, tuple(ranked[best is not None :]), DRAW_COUNT)


def list_candidates(model: TargetModel, unknown: str, nuisances: Mapping[str, float]) -> tuple[NextCandidate, ...]:
    """Return the candidates for the next reading.

    They are ratios on and off the target's axis and over tumour-free tissue, each without and with stiffness, and sizes by
    ultrasound.
    Their noise is the smallest of the present readings, their load the scene's. In linear elasticity a reading does not depend
    on the load, so that other loads are no candidates; a repetition is one. See ``choose_next_reading`` for the arguments.
    """
    data = model.data
    noise = float(data.noise[data.is_ratio].min())
    stiffness_noise = float(data.noise[data.is_stiffness].min()) if data.is_stiffness.any() else noise
    x, y = data.places[0].tolist()
    templates = {"": Reading(x, y, 1.0, noise)}
    if model.stiffness_error <= stiffness_noise:
        templates["stiffness"] = replace(templates[""], stiffness=1.0, stiffness_noise=stiffness_noise)
    candidates = []
    for stiffness, template in templates.items():
        if unknown in TARGET_UNKNOWNS:
            kind = f"ratio and {stiffness}" if stiffness else "ratio"
            candidates += [NextCandidate(kind, replace(template, x=x, y=y)) for x, y in _list_places(model)]
        if nuisances or unknown not in TARGET_UNKNOWNS:
            candidates.append(NextCandidate(f"blank with {stiffness}" if stiffness else "blank", replace(template, blank=True)))
    learned = tuple(name for name in ULTRASOUND_NUMBERS if nuisances.get(name, 0.0) > ULTRASOUND_RELATIVE_SD)
    return (*candidates, NextCandidate("size from ultrasound", None, learned)) if learned else tuple(candidates)


def _list_places(model: TargetModel) -> list[tuple[float, float]]:
    """Return places of the probe on the tissue along x, with several inclusions also along y; present places come first."""
    target, scene = model.target, model.scene
    reach = target.depth + scene.probe.tube_radius  # unit of the offsets
    is_alone = len(scene.inclusion) == 1  # then readings depend on the distance from the target alone
    # offsets are complex numbers x + iy
    directions = (1.0, -1.0) if is_alone else (1.0, -1.0, 1j, -1j)
    present = model.data.places - [target.x, target.y]
    offsets = [*(present @ [1.0, 1j]), *(offset * reach * direction for offset in RELATIVE_OFFSETS for direction in directions)]
    distinct: list[complex] = []  # x + iy
    for offset in offsets:
        is_new = all(
            abs(abs(offset) - abs(other) if is_alone else offset - other) > MIN_RELATIVE_DISTANCE * reach for other in distinct
        )
        if is_new and is_on_tissue(scene, target.x + offset.real, target.y + offset.imag):
            distinct.append(offset)
    return [(float(target.x + offset.real), float(target.y + offset.imag)) for offset in distinct]


def _combine_candidates(columns: Mapping[NextCandidate, Ints], present: Ints) -> list[tuple[NextCandidate, Ints]]:
    """Return combined candidates with their columns: all ratios, and all with stiffness if any has one; both include sizes.

    Those with stiffness are not always better, as the model's error of the stiffness may widen the interval.
    """
    combinations = []
    # width: data of one reading, 1 for a ratio, 2 with stiffness
    for width in sorted({len(new) for candidate, new in columns.items() if candidate.reading}):
        chosen = [new for candidate, new in columns.items() if candidate.reading is None or len(new) == width]
        kind = "ratios with stiffness" if width > 1 else "ratios"
        combinations.append((NextCandidate(f"all {len(chosen)} together, {kind}"), np.concatenate([present, *chosen])))
    return combinations


def _write_verdict(best: ExpectedInterval | None, together: ExpectedInterval, already_identifiable: bool) -> str:
    """Return the advice in one sentence."""
    if best is not None and (already_identifiable or best.identifiable >= LIKELY_PROBABILITY):
        return f"measure this: {best.told}"
    if best is not None and together.identifiable >= LIKELY_PROBABILITY:
        return f"measure this: {best.told}; then the others: no single reading is expected to suffice, all together are"
    chance = f"all that may be read together would with a probability of {together.identifiable:.2g}"
    return f"no reading of this probe can, at this noise: {chance}"


def _build_track(model: TargetModel, unknown: str, nuisances: Mapping[str, float]) -> tuple[Track, dict[NextCandidate, Ints]]:
    """Return a track that predicts the present data and all candidates, and the columns of each candidate in its data."""
    data, columns = model.data, dict[NextCandidate, Ints]()
    candidates = list_candidates(model, unknown, nuisances)
    for candidate in candidates:
        if candidate.reading is not None:
            start, data = len(data.value), data.join(Measurements.from_readings((candidate.reading,)))
            columns[candidate] = np.arange(start, len(data.value))
    track = Track.from_model(replace(model, data=data), unknown).add_nuisances(nuisances)
    for candidate in candidates:
        if candidate.learned and track.spread is not None:
            columns[candidate] = np.arange(len(data.value), len(data.value) + len(candidate.learned))
            track = _add_size_columns(track, {list(nuisances).index(name): nuisances[name] for name in candidate.learned})
    return track, columns


def _add_size_columns(track: Track, sds: Mapping[int, float]) -> Track:
    """Add a datum for each nuisance that ultrasound measures: it is predicted as sd times eta at all values of the unknown.

    Parameters
    ----------
    track
        With nuisances.
    sds
        Relative standard deviation of each such nuisance before the measurement, by its index in eta.
    """
    assert track.spread is not None
    count, data, errors = len(sds), track.model.data, track.spread.errors
    coefficients = np.pad(errors.coefficients, ((0, 0), (0, count), (0, 0)))
    coefficients[:, np.arange(-count, 0), list(sds)] = list(sds.values())
    zeros, no_flags = np.zeros((len(track.x), count)), np.zeros(count, dtype=bool)
    sizes = Measurements(
        data.places,
        place=np.zeros(count, dtype=int),
        is_stiffness=no_flags,
        is_phase=~no_flags,  # as a phase, a size is a plain number without sign
        is_blank=no_flags,
        value=np.zeros(count),
        sign=np.zeros(count),
        noise=np.full(count, ULTRASOUND_RELATIVE_SD),
        force=np.full(count, np.nan),
    )
    return replace(
        track,
        model=replace(track.model, data=data.join(sizes)),
        predicted=track.predicted.transform_columns(lambda part: np.hstack([part, zeros])),
        derivative=np.hstack([track.derivative, zeros]),
        spread=NuisanceErrors(track.spread.x, SharedErrors(coefficients, errors.powers)),
    )


def _select_data(track: Track, columns: Ints, points_per_node: int = POINTS_PER_NODE) -> Likelihood:
    """Return the likelihood of some columns of the data, on a grid of ``points_per_node`` points from node to node."""
    predicted = track.predicted.transform_columns(lambda part: part[:, columns])
    spread = track.spread
    if spread is not None:
        spread = NuisanceErrors(spread.x, spread.errors.transform(lambda part: part[:, columns]))
    derivative = track.derivative[:, columns]
    narrowed = replace(track, predicted=predicted, derivative=derivative, spread=spread, points_per_node=points_per_node)
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
    def from_track(cls, track: Track, present: Ints, columns: list[Ints], seed: int) -> _Draws:
        """Draw truths and nuisances from eq. ES.11, and simulate the data.

        Parameters
        ----------
        track
            Of the present data and all candidates.
        present
            Columns of the present data.
        columns
            Columns of each candidate.
        seed
            Of the random numbers.
        """
        data, nuisance_count = track.model.data, track.compute_shared_errors(track.x[:1]).powers.shape[1]
        present_values, present_noise = data.value[present], data.noise[present]
        width = max((len(new) for new in columns), default=0)
        # one dimension for the unknown, one for each nuisance, and one for the noise of each datum of a candidate
        chance = qmc.Sobol(1 + nuisance_count + width, rng=seed).random(DRAW_COUNT)
        normal = norm.ppf(np.clip(chance[:, 1:], 1e-9, 1 - 1e-9))  # clipped: 0 and 1 would give infinity
        truth = _draw_truths(_select_data(track, present), present_values, chance[:, 0])
        shared, value = track.compute_shared_errors(truth), track.interpolate(truth)[0]
        present_errors = shared.transform(lambda part: part[..., present, :]).divide_by_noise(present_noise)
        residual = (present_values - value[:, present]) / present_noise
        eta = _draw_nuisances(present_errors, residual, normal[:, :nuisance_count])
        exact_data = value + shared.evaluate(eta)
        separate_noise_data = exact_data + data.noise * np.random.default_rng(seed).normal(size=exact_data.shape)
        common_noise_data = exact_data.copy()
        for new in columns:
            common_noise_data[:, new] += data.noise[new] * normal[:, nuisance_count : nuisance_count + len(new)]
        common_noise_data[:, present] = separate_noise_data[:, present] = present_values
        return cls(track, truth, common_noise_data, separate_noise_data)

    def summarise(self, candidate: NextCandidate, columns: Ints, together: bool = False) -> ExpectedInterval:
        """Return the expected interval from some columns of the data, over all draws.

        ``together`` uses separate noise for each datum, and the candidate's kind as its description.
        """
        fit, unknown = _select_data(self.track, columns, COARSE_POINTS), self.track.unknown
        intervals = compute_hulls(fit, (self.separate_noise_data if together else self.common_noise_data)[:, columns])
        truth, max_ratio = self.track.compute_values(self.truth), get_max_end_ratio(unknown)
        low = np.array([0.0 if end is None else end for end, _ in intervals])
        high = np.array([np.inf if end is None else end for _, end in intervals])
        length = np.log(np.minimum(high, truth * max_ratio)) - np.log(np.maximum(low, truth / max_ratio))
        with np.errstate(divide="ignore"):
            ends, width = (float(np.median(low)), float(np.median(high))), float(np.median(high / low))
        reading = candidate.reading
        return ExpectedInterval(
            kind=candidate.kind,
            told=candidate.kind if together else candidate.description,
            x=None if reading is None else reading.x,
            y=None if reading is None else reading.y,
            interval=(ends[0] or None, ends[1] if np.isfinite(ends[1]) else None),
            width=width if np.isfinite(width) else None,
            identifiable=float(np.mean([is_identifiable(interval, unknown) for interval in intervals])),
            score=float(np.mean(np.maximum(length, 0.0))),
        )


def _draw_truths(fit: Likelihood, y: Floats, probability: Floats) -> Floats:
    """Return the coordinates of the unknown at which the distribution p of eq. ES.11 reaches s cumulative probabilities.

    Parameters
    ----------
    fit
        Likelihood of the present data.
    y
        Their measured values, shape (k,).
    probability
        Cumulative probabilities, shape (s,).
    """
    points = np.concatenate(fit.track.runs)
    spacing = np.concatenate([np.gradient(run) for run in fit.track.runs])
    chi2 = fit.compute_chi_square(points, y)
    weight = spacing * np.exp(-(chi2 - chi2.min()) / 2)
    return np.asarray(points[np.minimum(np.searchsorted(np.cumsum(weight) / weight.sum(), probability), len(points) - 1)])


def _draw_nuisances(errors: SharedErrors, residual: Floats, normal: Floats) -> Floats:
    """Return eta of eq. ES.11, shape (s, q), for s draws.

    Parameters
    ----------
    errors
        Shared errors, whose linear part is A, shape (s, k, q).
    residual
        r, shape (s, k).
    normal
        Independent standard normal numbers, shape (s, q).
    """
    model = LinearGaussian.from_shared_errors(errors.linear, np.ones(residual.shape[-1]))
    root = np.linalg.cholesky(model.compute_posterior_covariance())
    return np.asarray(model.compute_posterior_mean(residual) + (root @ normal[..., None])[..., 0])
