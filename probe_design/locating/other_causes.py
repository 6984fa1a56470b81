"""Compare tumours with other causes of the readings: one reading that is wild, or a gain that drifts from press to press.

Both change few readings, or all of them in their order, so that tumours of the population may explain them as well.

With a drift the readings have one more common error in each channel, eq. LO.5: a_k = sd (k / (n - 1) - 1/2) for reading k of n.
The evidence of a number of tumours then changes by the mean of the likelihood's ratio over their posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp, softmax

from geometry.common.arrays import Floats
from probe_design.locating.common_errors import Rows, Sums
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.posterior import compute_quantiles, find_region
from probe_design.locating.samples import Sample
from probe_design.locating.sampling import draw_posterior

DRIFT_SD = 0.1  # of ln reading from the first to the last, before the readings
MIN_CERTAINTY, MAX_CERTAINTY = 0.95, 0.5  # probability of a tumour that rests on a reading: with it, and at most without it
MAX_LOG_FACTOR = 3.0  # ln Bayes factor of more tumours against one, above which the place of one alone says nothing
MAX_OTHER_SUPPORT = 3.0  # ln likelihood that all readings but one lose without a tumour: about what its place and size cost
MIN_DEVIATION = 3.0  # of a reading from the best tumour, in standard deviations, that makes it worth leaving out


@dataclass(frozen=True)
class SingleReading:
    """A reading without which the result would be another.

    Attributes
    ----------
    index
        Of the reading.
    is_place
        Whether the place of the tumour would be another; else there would probably be none.
    none
        Probability of no tumour without this reading, of none and one.
    place
        Median x and y of one tumour without this reading, m.
    """

    index: int
    is_place: bool
    none: float
    place: tuple[float, float]


@dataclass(frozen=True)
class Drift:
    """A gain that drifts in the order of the readings.

    Attributes
    ----------
    log_factor
        Ln of the Bayes factor of a drift against none, over all numbers of tumours.
    none
        Probability of no tumour with a drift.
    change
        Of ln ratio and ln stiffness from the first reading to the last, posterior means, shape (2,).
    """

    log_factor: float
    none: float
    change: Floats


def compare_drift(likelihood: Likelihood, groups: Sequence[Floats], probability: Floats) -> Drift:
    """Return what a drift of the gain explains.

    Parameters
    ----------
    likelihood
        Of the readings.
    groups
        Equally probable sets of tumours of each number, none included, shape (n, m, 5) each.
    probability
        Of each number without a drift.
    """
    rows = likelihood.rows
    order = DRIFT_SD * np.linspace(-0.5, 0.5, len(likelihood.data))
    extra = order[None, :, None] * np.eye(2)[:, None, :]
    drifting = Rows(np.concatenate([rows.constant, extra]), np.concatenate([rows.scale, 0 * extra]))
    log_factors, changes = [], []
    for tumours in groups:
        residuals, variance = likelihood.weigh_readings(tumours)
        plain, moved = (
            Sums.from_readings(part, residuals, variance, likelihood.data.values - residuals) for part in (rows, drifting)
        )
        ratio = moved.compute_log_likelihood() - plain.compute_log_likelihood()
        log_factors.append(float(logsumexp(ratio)) - np.log(len(ratio)))
        changes.append(DRIFT_SD * softmax(ratio) @ moved.solve()[0][:, -2:])
    with np.errstate(divide="ignore"):
        joint = np.log(probability) + log_factors
    after = softmax(joint)
    return Drift(float(logsumexp(joint)), float(after[0]), after @ np.array(changes))


def find_single_readings(likelihood: Likelihood, samples: Sequence[Sample], none: float) -> list[SingleReading]:
    """Return the readings on which a tumour, or its place, rests alone.

    Left out are the reading that speaks for a tumour the most, and the one that is the farthest from the best tumour.

    Parameters
    ----------
    likelihood
        Of the readings.
    samples
        Of the posteriors of one tumour, two and so on.
    none
        Probability of no tumour.
    """
    prior, data = likelihood.prior, likelihood.data
    if none > 1 - MIN_CERTAINTY or not samples or not prior.free:
        return []
    best = prior.transform(samples[0].points[[int(np.argmax(samples[0].log_weights))]])
    support, deviations = _compare_readings(likelihood, best)
    chosen = {int(np.argmax(support))} | ({int(np.argmax(deviations))} if deviations.max() > MIN_DEVIATION else set())
    log_more = max((part.log_evidence for part in samples[1:]), default=-np.inf) - samples[0].log_evidence
    place = _find_median(likelihood, samples[0])
    result = []
    for index in sorted(chosen):
        reduced = replace(likelihood, data=data.select(np.arange(len(data)) != index))
        sample = draw_posterior(reduced, 1, 0)
        log_odds = float(reduced.evaluate_tumours(np.zeros((1, 0, 5)))[0]) - sample.log_evidence
        with np.errstate(divide="ignore"):  # numbers that are excluded before the readings
            part = softmax([log_odds + np.log(prior.numbers[0]), np.log(prior.numbers[1:].sum())])[0]
        is_single = part > 1 - MAX_CERTAINTY
        is_place = not is_single and log_more < MAX_LOG_FACTOR
        if is_single or (is_place and not find_region(prior, sample.points[:, 0], sample.weights).contains(*place)):
            result.append(SingleReading(index, is_place, float(part), _find_median(reduced, sample)))
    return [reading for reading in result if not reading.is_place] or result  # no place of a tumour that one reading makes


def find_lone_tumours(likelihood: Likelihood, tumours: Floats) -> list[tuple[int, int]]:
    """Return those of several tumours, (1, m, 5), for which one reading speaks alone, each with this reading, by their indices.

    Without such a tumour all other readings together lose less likelihood than its place and size cost.
    """
    misfit, result = _compute_misfits(likelihood, tumours), []
    for tumour in range(tumours.shape[1]):
        support = (_compute_misfits(likelihood, np.delete(tumours, tumour, axis=1)) - misfit).sum(axis=1) / 2
        reading = int(np.argmax(support))
        if support.sum() - support[reading] < MAX_OTHER_SUPPORT:
            result.append((tumour, reading))
    return result


def _compare_readings(likelihood: Likelihood, best: Floats) -> tuple[Floats, Floats]:
    """Return how far each reading speaks for a tumour (1, 1, 5), ln, and its largest deviation from it, shape (k,) each."""
    without, misfit = (_compute_misfits(likelihood, tumours) for tumours in (np.zeros((1, 0, 5)), best))
    return (without - misfit).sum(axis=1) / 2, np.sqrt(misfit.max(axis=1))


def _compute_misfits(likelihood: Likelihood, tumours: Floats) -> Floats:
    """Return the squared deviation of each reading from a set of tumours, (1, m, 5), in standard deviations; shape (k, 2)."""
    residuals, variance = likelihood.compute_residuals(tumours)
    offsets, _ = likelihood.estimate_offsets(residuals, variance)
    return np.asarray((residuals - offsets)[0] ** 2 / variance[0])


def _find_median(likelihood: Likelihood, sample: Sample) -> tuple[float, float]:
    """Return the median x and y of one tumour, m."""
    tumours = likelihood.prior.transform(sample.points[:, 0])
    x, y = (float(compute_quantiles(tumours[:, axis], sample.weights, (0.5,))[0]) for axis in (0, 1))
    return x, y
