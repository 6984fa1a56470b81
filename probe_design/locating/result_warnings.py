"""Warn of what a result of `locate` cannot be relied on for: readings, gains, places, numbers of tumours, noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import binom, chi2

from geometry.common.arrays import Floats
from geometry.scenes.probe import format_mm
from probe_design.locating.common_errors import CHANNEL_NAMES, Rows, Sums
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.location import Location, Residual
from probe_design.locating.other_causes import MIN_CERTAINTY, compare_drift, find_lone_tumours, find_single_readings
from probe_design.locating.posterior import NORMAL_90, CommonSummary
from probe_design.locating.samples import CONVERGED_SIZE, Sample
from probe_design.locating.scan_data import ScanData

MIN_GAIN_P_VALUE = 1e-2  # of the gains before the readings, below which a warning names them
MIN_SCATTER_P_VALUE = 1e-3  # of a misfit as small as that of the readings, below which a warning names the noise
MIN_WILD_P_VALUE = 1e-3  # of as many wild readings at the rate that is stated, below which a warning names them
MIN_DRIFT_LOG_FACTOR = math.log(100)  # ln Bayes factor of a drift: at most one honest scan in a hundred exceeds it
EDGE_M, EDGE_PROBABILITY = 1e-3, 0.3  # within which a tumour lies at the edge of the places, and how probably, for a warning
MIN_LEFT_OUT = 0.01  # of the population's tumours, which do not fit, for a warning
TESTED_SETS = 200  # most probable sets of one tumour, among which the best is chosen
MIN_DEFLECTION = 3.0  # of a scan's readings by a tumour, in standard deviations: below it no detector reports it reliably
DETECTABLE_SAMPLES = 1024  # tumours of the prior whose deflections are computed
WILD_PROBABILITY = 0.5  # above it a reading counts as wild and is left out of the residual test
MAX_DEVIATION = 4.0  # standard deviations of one residual above which a warning names it
MAX_LISTED = 4  # of these: a scan of another load had 25, below which the reason was lost


def add_warnings(
    result: Location, likelihood: Likelihood, samples: Sequence[Sample], withheld: Sequence[Sample], groups: Sequence[Floats]
) -> Location:
    """Return the result with its warnings.

    Parameters
    ----------
    result
        Without warnings.
    likelihood
        Of the readings.
    samples, withheld
        Of the posteriors of one tumour, two and so on, as far as their evidence is stated, and of the larger numbers.
    groups
        Equally probable sets of tumours of each number whose evidence is stated, none included, shape (n, m, 5) each.
    """
    notes = []
    if not result.explained:
        notes.append(
            f"no tumour of this population explains these readings (p = {result.p_value:.1g}): another probe, calibration or "
            "tissue, more noise than [noise] states, a wild reading (--outliers, outliers=), or tumours beyond the population"
        )
    notes += filter(
        None,
        (
            _count_copies(likelihood.data, result.residuals),
            _compare_gains(result.nuisances),
            _describe_drift(result, likelihood, groups),
            _find_edge(result),
        ),
    )
    if result.explained:
        notes += [*_list_single_readings(result, likelihood, samples), *_list_lone_tumours(result, likelihood, samples)]
    notes += filter(None, (_count_wild(result, likelihood), _compare_scatter(likelihood, samples)))
    notes += _list_deviations(result)
    for part, probability in zip(result.by_number, result.probability[1:], strict=True):
        if not part.converged:
            tumours = "1 tumour" if part.number == 1 else f"{part.number} tumours"
            notes.append(
                f"not converged: {tumours}, probability {probability:.2g}: the effective sample is "
                f"{part.effective_sample_size:.0f}, below {CONVERGED_SIZE:.0f}; ln evidence ± {part.log_bayes_factor_error:.1f}"
            )
    if withheld:
        sample, (first, *_, last) = withheld[0], (*result.withheld, result.withheld[-1])
        numbers = f"{first} tumours" if first == last else f"{first} to {last} tumours"
        notes.append(
            f"the probability of {numbers} is withheld: repeats of ln evidence differ by {sample.repeat_difference:.1f}, the "
            f"effective sample is {sample.size:.0f}; the other probabilities hold if there are at most {first - 1}"
        )
    scale = np.sqrt((likelihood.data.errors.scale**2).sum(axis=0))[:, likelihood.data.is_read.any(axis=0)]
    if np.any(scale):
        notes.append(
            f"the tissue is not known ([population] tissue, layer): all that tumours change may be off alike by "
            f"{100 * scale.max():.0f} %, to first order, which widens depth, diameter and contrast"
        )
    left_out = 1 - likelihood.prior.compute_allowed_fraction(1)
    if left_out > MIN_LEFT_OUT:
        notes.append(
            f"{100 * left_out:.0f} of 100 tumours of the population are left out: interfaces of layers cross them or are within "
            "a tenth of their diameter, or they reach beyond the tissue"
        )
    share = compute_detectable_share(likelihood)
    if share < 0.1:
        notes.append(
            f"with this noise {100 * share:.0f} of 100 tumours of the population change the readings by more than "
            f"{MIN_DEFLECTION:g} standard deviations: the map is little more than the population"
        )
    return replace(result, warnings=tuple(notes))


def _list_deviations(result: Location) -> list[str]:
    """Return a note for each reading that is far off its prediction; of many the farthest ones, and how many more there are."""
    notes = []
    for index, residual in enumerate(result.residuals):
        for name in CHANNEL_NAMES:
            deviation = getattr(residual, name)
            if deviation is None or abs(deviation) < MAX_DEVIATION or (residual.wild or 0) > WILD_PROBABILITY:
                continue
            cause = ": a tumour may lie below it" if residual.blank else ""
            reading = _name_reading(index, residual)
            text = f"the {name} of {reading} is {deviation:+.1f} standard deviations off its prediction{cause}"
            notes.append((abs(deviation), text))
    notes.sort(key=lambda note: -note[0])
    texts = [text for _, text in notes[:MAX_LISTED]]
    if len(notes) > MAX_LISTED:
        texts.append(f"{len(notes) - MAX_LISTED} more are {MAX_DEVIATION:g} standard deviations off their predictions or more")
    return texts


def _name_reading(index: int, residual: Residual) -> str:
    """Return the words for a reading and its place."""
    place = f"x = {residual.x * 1e3:.4g} mm, y = {residual.y * 1e3:.4g} mm"
    return f"{'baseline reading' if residual.blank else 'reading'} {index} at {place}"


def _count_copies(data: ScanData, residuals: Sequence[Residual]) -> str:
    """Return a note where most readings that repeat a place and a load equal an earlier one there to the last digit."""
    places = np.column_stack([data.positions, data.weights, data.is_baseline])
    first: dict[bytes, int] = {}
    copies, repeats = [], len(data) - len(np.unique(places, axis=0))
    for index, row in enumerate(np.column_stack([places, data.values])):
        if first.setdefault(row.tobytes(), index) != index:
            copies.append((first[row.tobytes()], index))
    if 2 * len(copies) <= repeats:
        return ""
    return (
        f"{len(copies)} of {repeats} repeated readings equal an earlier one at their place to the last digit, as reading "
        f"{copies[0][1]} equals {_name_reading(copies[0][0], residuals[copies[0][0]])}: a press that is listed twice counts as "
        "two, which narrows the map; leave copies out"
    )


def _describe_drift(result: Location, likelihood: Likelihood, groups: Sequence[Floats]) -> str:
    """Return a note where a gain that drifts explains the readings far better than tumours alone, else an empty text."""
    drift = compare_drift(likelihood, groups, np.array(result.probability))
    if drift.log_factor < MIN_DRIFT_LOG_FACTOR:
        return ""
    changes = [
        f"{name} by {100 * drift.change[channel]:+.1f} %"
        for channel, name in enumerate(CHANNEL_NAMES)
        if np.any(likelihood.data.is_read[:, channel])
    ]
    return (
        f"the gain seems to drift from the first reading to the last, {' and '.join(changes)}, which explains them far better "
        f"than tumours alone: no tumour then has a probability of {drift.none:.2g}; take baseline readings between, and divide "
        "by them"
    )


def _list_single_readings(result: Location, likelihood: Likelihood, samples: Sequence[Sample]) -> Iterator[str]:
    """Yield a note for each reading without which the result would be another."""
    for part in find_single_readings(likelihood, samples, result.probability[0]):
        x, y = (1e3 * value for value in part.place)
        what, otherwise = (
            ("where the tumour lies", f"it lies at about x = {x:.1f} mm, y = {y:.1f} mm")
            if part.is_place
            else ("that there is a tumour", f"no tumour has a probability of {part.none:.2g}")
        )
        yield (
            f"{what} rests on {_name_reading(part.index, result.residuals[part.index])} alone: without this reading {otherwise}; "
            "press there again, or allow for wild readings (--outliers, outliers=)"
        )


def _list_lone_tumours(result: Location, likelihood: Likelihood, samples: Sequence[Sample]) -> Iterator[str]:
    """Yield a note for each of several tumours, all of them almost certain, for which one reading speaks alone."""
    number = sum(result.compute_probability_at_least(count) > MIN_CERTAINTY for count in range(1, len(result.probability)))
    if number < 2 or likelihood.outlier_rate:  # with which one reading makes no tumour certain
        return
    tumours = _find_best(likelihood, samples[number - 1])
    for tumour, reading in find_lone_tumours(likelihood, tumours):
        x, y = (1e3 * tumours[0, tumour, :2]).tolist()
        yield (
            f"that one of {number} tumours lies at about x = {x:.1f} mm, y = {y:.1f} mm rests on "
            f"{_name_reading(reading, result.residuals[reading])} alone: press there again, or allow for wild readings "
            "(--outliers, outliers=)"
        )


def _find_best(likelihood: Likelihood, sample: Sample) -> Floats:
    """Return the most likely tumours of a sample, shape (1, m, 5)."""
    likely = sample.points[np.argsort(sample.log_weights)[-TESTED_SETS:]]
    return likelihood.prior.transform(likely[[int(np.argmax(likelihood.evaluate(likely)))]])


def _count_wild(result: Location, likelihood: Likelihood) -> str:
    """Return a note where more readings are wild than the rate lets expect, else an empty text."""
    count = sum((part.wild or 0) > WILD_PROBABILITY for part in result.residuals)
    if binom.sf(count - 1, len(result.residuals), likelihood.outlier_rate) > MIN_WILD_P_VALUE:
        return ""
    return (
        f"{count} of {len(result.residuals)} readings count as wild, where --outliers (outliers=) states "
        f"{likelihood.outlier_rate:g} of them: the others alone carry the result"
    )


def _compare_scatter(likelihood: Likelihood, samples: Sequence[Sample]) -> str:
    """Return a note where readings scatter far less than their noise about no tumour or the best one, else an empty text."""
    count = int(likelihood.data.is_read.sum())
    sets = [(np.zeros((1, 0, 5)), count)]
    for sample in samples[:1]:
        sets.append((_find_best(likelihood, sample), count - len(likelihood.prior.free)))
    for tumours, freedom in sets:
        misfit = float(likelihood.sum_readings(tumours).compute_misfit()[0])
        if freedom > 0 and chi2.cdf(misfit, freedom) < MIN_SCATTER_P_VALUE:
            return (
                f"the readings scatter by {100 * math.sqrt(misfit / freedom):.0f} % of what [noise] states: with noise as it is, "
                "measured by repeats at one place, more can be learnt from them"
            )
    return ""


def _compare_gains(nuisances: dict[str, CommonSummary]) -> str:
    """Return a note where the gains of all channels together are improbable before the readings, else an empty text.

    A probe or a calibration that is not the design file's moves all readings alike, which the gains explain.
    """
    names = [f"ln_gain_{name}" for name in CHANNEL_NAMES]
    gains = {name: nuisances[name] for name in names if name in nuisances and nuisances[name].is_learnt}
    squared, factors = 0.0, []
    for name, summary in gains.items():
        before = summary.before_90[1] / NORMAL_90
        deviation = summary.median / before / math.sqrt(1 - (summary.sd_relative or 0.0) ** 2)
        squared += deviation**2
        factors.append(f"{name.removeprefix('ln_gain_')} by a factor of {math.exp(summary.median):.2f} ({deviation:+.1f} sd)")
    if not gains or chi2.sf(squared, len(gains)) > MIN_GAIN_P_VALUE:
        return ""
    return (
        f"all readings are off alike, {' and '.join(factors)}, which [noise] gain makes improbable: perhaps another probe, "
        "calibration or tissue than the design file's"
    )


def _find_edge(result: Location) -> str:
    """Return a note where the clearest tumour lies at the edge of the population's places, else an empty text."""
    if result.probability[0] > 0.5:
        return ""
    edges = []
    for axis, name in enumerate("xy"):
        places, values = result.tumour_prior.ranges[axis], result.best.sets[:, 0, axis]
        if places.continuous:
            edges += [(float(np.mean(np.abs(values - edge) < EDGE_M)), name, edge) for edge in places.values]
    share, name, edge = max(edges, default=(0.0, "", 0.0))
    if share < EDGE_PROBABILITY:
        return ""
    return (
        f"the clearest tumour lies within {format_mm(EDGE_M)} of {name} = {format_mm(edge)}, where the population's places end, "
        f"with a probability of {share:.2f}: it may lie beyond, which [population] margin allows"
    )


def compute_detectable_share(likelihood: Likelihood) -> float:
    """Return the fraction of single tumours of the prior whose deflection of the readings is above ``MIN_DEFLECTION``."""
    tumours = likelihood.prior.transform(likelihood.prior.draw(DETECTABLE_SAMPLES, 1, 1))
    tumours = tumours[likelihood.prior.find_allowed(tumours)]
    residuals, variance = likelihood.compute_residuals(tumours)
    signal = likelihood.data.values - residuals
    rows = Rows(likelihood.rows.constant, np.zeros_like(likelihood.rows.scale))
    squared = Sums.from_readings(rows, signal, variance, signal).compute_misfit()
    return float(np.mean(squared > MIN_DEFLECTION**2)) if len(squared) else math.nan
