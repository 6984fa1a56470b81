"""Infer number and posterior of the tumours from the readings of a scan."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, softmax
from scipy.stats import chi2

from geometry.common.arrays import Floats
from probe_design.locating.common_errors import CHANNEL_NAMES
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.location import Location, NumberResult, Residual, Tumour
from probe_design.locating.next_position import MAX_PARTICLES, CandidateLoad, NextPosition, build_candidates, choose_position
from probe_design.locating.pose_errors import PoseError, estimate_pose_errors
from probe_design.locating.posterior import CommonSummary, find_region, summarise
from probe_design.locating.result_warnings import TESTED_SETS, WILD_PROBABILITY, add_warnings
from probe_design.locating.samples import Sample
from probe_design.locating.sampling import draw_posteriors
from probe_design.locating.scan_data import ScanConditions

MIN_P_VALUE = 1e-3  # of the residual test: one honest scan in a thousand fails it at the most
STORED_SETS = 2000  # equally probable sets of each number, for maps and pictures
COMMON_SETS = 200  # of each number of tumours, for the posterior of gains, tissue and places


@dataclass(frozen=True)
class Posterior:
    """Samples of all numbers of tumours.

    Attributes
    ----------
    samples
        Of one tumour, two and so on, as far as their evidence is stated.
    log_evidence
        Of no tumour, one and so on, up to a common constant.
    probability
        The same weighted by their prior; sums to 1.
    withheld
        Samples of the larger numbers, from the first whose evidence is not stated; the probabilities leave these numbers out.
    """

    samples: tuple[Sample, ...]
    log_evidence: Floats
    probability: Floats
    withheld: tuple[Sample, ...] = ()

    @classmethod
    def from_likelihood(cls, likelihood: Likelihood, seed: int) -> Posterior:
        """Draw samples of every number of tumours that is probable before the readings."""
        numbers = likelihood.prior.numbers
        samples = draw_posteriors(likelihood, len(numbers) - 1, seed)
        none = float(likelihood.evaluate_tumours(np.zeros((1, 0, 5)))[0])
        stated = next((index for index, sample in enumerate(samples) if index and not sample.is_stated), len(samples))
        log_evidence = np.array([none, *(sample.log_evidence for sample in samples[:stated])])
        with np.errstate(divide="ignore"):  # a number that is excluded before the readings
            probability = softmax(log_evidence + np.log(numbers[: stated + 1]))
        return cls(samples[:stated], log_evidence, probability, samples[stated:])

    def resample(self, likelihood: Likelihood, seed: int) -> tuple[Floats, ...]:
        """Return equally probable sets of tumours of each number above 0, shape (n, number, 5) each."""
        rng = np.random.default_rng((seed, 0))
        return tuple(likelihood.prior.transform(sample.resample(STORED_SETS, rng)) for sample in self.samples)


def infer(
    likelihood: Likelihood,
    conditions: ScanConditions,
    seed: int,
    *,
    advise: bool,
    posterior: Posterior | None = None,
) -> Location:
    """Return the result of `locate`.

    Parameters
    ----------
    likelihood
        Of the readings, with model and prior.
    conditions
        Probe, tissue and loads without tumours.
    seed
        Of the random numbers.
    advise
        Whether to choose the next place.
    posterior
        Where it is known before.
    """
    start = time.perf_counter()
    posterior = Posterior.from_likelihood(likelihood, seed) if posterior is None else posterior
    sets = posterior.resample(likelihood, seed)
    log_factors = (posterior.log_evidence[1:] - posterior.log_evidence[0]).tolist()
    by_number = tuple(_describe_number(likelihood, *parts) for parts in zip(posterior.samples, sets, log_factors, strict=True))
    p_value, best = _test_residuals(likelihood, posterior, sets)
    groups = (np.zeros((1, 0, 5)), *(part[:: max(1, len(part) // COMMON_SETS)] for part in sets))
    pose_errors = estimate_pose_errors(likelihood, groups, posterior.probability)
    result = Location(
        probability=tuple(posterior.probability.tolist()),
        prior=tuple(likelihood.prior.numbers.tolist()),
        by_number=by_number,
        withheld=tuple(sample.points.shape[1] for sample in posterior.withheld),
        nuisances=_describe_common(likelihood, posterior, groups, conditions.middles),
        explained=p_value >= MIN_P_VALUE,
        p_value=p_value,
        residuals=_list_residuals(likelihood, best, pose_errors),
        next=_advise(likelihood, posterior, sets, conditions) if advise else None,
        warnings=(),
        evaluator=conditions.loads.evaluator,
        model_error=max(float(np.hypot(model.error, model.scale_error).max()) for model in likelihood.models),
        seconds=time.perf_counter() - start,
        seed=seed,
        tumour_prior=likelihood.prior,
        data=likelihood.data,
        scene=conditions.loads.main.scene,
    )
    return add_warnings(result, likelihood, posterior.samples, posterior.withheld, groups)


def _describe_number(likelihood: Likelihood, sample: Sample, sets: Floats, log_factor: float) -> NumberResult:
    """Return the posterior of one number of tumours, those first which change the readings most."""
    prior = likelihood.prior
    log_tissues, log_tissue_sd = draw_tissues(likelihood, prior.transform(sample.points), sample.weights)
    strengths = [np.abs(likelihood.predict(sets[::10, [index]])[0]).sum(axis=(1, 2)).mean() for index in range(sets.shape[1])]
    tumours = tuple(
        Tumour(summary, find_region(prior, sample.points[:, index], sample.weights).area)
        for index, summary in enumerate(summarise(prior, sample, log_tissues, log_tissue_sd))
    )
    order = np.argsort(strengths)[::-1]
    return NumberResult(
        number=len(tumours),
        tumours=tuple(tumours[index] for index in order),
        log_bayes_factor=log_factor,
        log_bayes_factor_error=sample.evidence_error,
        effective_sample_size=sample.size,
        converged=sample.is_converged,
        sets=sets[:, order],
        log_tissue=draw_tissues(likelihood, sets, np.ones(len(sets)))[0],
        log_tissue_sd=log_tissue_sd,
    )


def draw_tissues(likelihood: Likelihood, tumours: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return ln of each layer's modulus over the middle of its range, drawn given each set of tumours (n, m, 5), and its spread.

    Shapes (n, l) and (l,), the tissue below the layers last; the spread is the standard deviation before the readings. Both are 0
    where the modulus is known, and draws are 0 for sets without a weight, whose readings may not be predictable.
    """
    errors, is_likely = likelihood.common_errors, weights > 0
    names = [*(f"layer_{number}_modulus" for number in range(len(likelihood.prior.strata.interfaces))), "tissue"]
    draws, deviations = np.zeros((len(tumours), len(names))), np.zeros(len(names))
    for number, name in enumerate(names):
        if name not in errors.names:
            continue
        index = errors.names.index(name)
        deviations[number] = errors.deviations[index]
        mean, covariance = likelihood.solve_common(tumours[is_likely])
        chance = np.random.default_rng(number).standard_normal(len(mean))
        draws[is_likely, number] = deviations[number] * (mean[:, index] + np.sqrt(covariance[:, index, index]) * chance)
    return draws, deviations


def _test_residuals(likelihood: Likelihood, posterior: Posterior, sets: tuple[Floats, ...]) -> tuple[float, Floats]:
    """Return the p-value of the residuals, and the most likely set of tumours of the most probable number, (1, m, 5).

    The misfit is the smallest over the most likely sets of all numbers; the degrees of freedom are all readings, so that the test
    errs to the side of an explanation. The largest single residual is tested, too; the gain counts as a reading.
    """
    best_sets, p_values = [np.zeros((1, 0, 5))], []
    for sample in posterior.samples:
        likely = np.argsort(sample.log_weights)[-TESTED_SETS:]
        tumours = likelihood.prior.transform(sample.points[likely])
        values = likelihood.evaluate_tumours(tumours)
        best_sets.append(tumours[[int(np.argmax(values))]])
    for tumours in best_sets:
        deviations = _compute_deviations(likelihood, tumours)
        chi_square, largest = (deviations**2).sum(), np.abs(deviations).max(initial=0.0)
        single = 1 - (1 - 2 * ndtr(-largest)) ** max(len(deviations), 1)
        p_values.append(min(1.0, 2 * min(float(chi2.sf(chi_square, len(deviations))), float(single))))
    return max(p_values), best_sets[int(np.argmax(posterior.probability))]


def _compute_deviations(likelihood: Likelihood, tumours: Floats) -> Floats:
    """Return the residuals of one set of tumours and the common errors, in standard deviations, without wild readings, (k,)."""
    residuals, variance = likelihood.compute_residuals(tumours)
    offsets, common = likelihood.estimate_offsets(residuals, variance)
    is_used = likelihood.data.is_read
    if likelihood.outlier_rate:
        is_used = is_used & (likelihood.compute_wild_probability(residuals, variance)[0] < WILD_PROBABILITY)
    deviations = (residuals - offsets)[0] / np.sqrt(variance[0])
    is_moved = np.any(likelihood.rows.constant[:, likelihood.data.is_read], axis=1)
    return np.concatenate([deviations[is_used], common[0, is_moved]])


def _list_residuals(likelihood: Likelihood, tumours: Floats, pose_errors: list[PoseError | None]) -> tuple[Residual, ...]:
    """Return each reading against the prediction of one set of tumours, shape (1, m, 5)."""
    data = likelihood.data
    residuals, variance = likelihood.compute_residuals(tumours)
    offsets, wild = likelihood.estimate_offsets(residuals, variance)[0][0], [None] * len(data)
    if likelihood.outlier_rate:
        wild = likelihood.compute_wild_probability(residuals, variance)[0].max(axis=-1).tolist()
    deviations, predicted = (residuals[0] - offsets) / np.sqrt(variance[0]), data.values - residuals[0]
    changes = data.values - offsets

    def pick(values: Floats, index: int, channel: int) -> float | None:
        """Return a reading's value of a channel, None where it is not read."""
        return float(values[index, channel]) if data.is_read[index, channel] else None

    return tuple(
        Residual(
            x=float(data.positions[index, 0]),
            y=float(data.positions[index, 1]),
            blank=bool(data.is_baseline[index]),
            ratio=pick(deviations, index, 0),
            stiffness=pick(deviations, index, 1),
            ratio_change=pick(changes, index, 0),
            stiffness_change=pick(changes, index, 1),
            predicted_ratio_change=pick(predicted, index, 0),
            predicted_stiffness_change=pick(predicted, index, 1),
            wild=wild[index],
            pose_error=pose_errors[index],
        )
        for index in range(len(data))
    )


def _describe_common(
    likelihood: Likelihood, posterior: Posterior, groups: tuple[Floats, ...], middles: dict[str, float]
) -> dict[str, CommonSummary]:
    """Return the posterior of the gains that are read and of the tissue's unknown numbers, over sets of all numbers."""
    parts, weights = [], []
    for tumours, probability in zip(groups, posterior.probability, strict=True):
        parts.append(likelihood.solve_common(tumours))
        weights.append(np.full(len(tumours), probability / len(tumours)))
    mean, covariance = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    spread, weight = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), np.concatenate(weights)
    errors, is_read = likelihood.common_errors, np.any(likelihood.data.is_read, axis=0).tolist()
    channels = {f"ln_gain_{name}" for name, read in zip(CHANNEL_NAMES, is_read, strict=True) if read}
    return {
        name: CommonSummary.from_mixture(
            deviation * mean[:, index], deviation * spread[:, index], weight, deviation=deviation, middle=middles.get(name)
        )
        for index, (name, deviation) in enumerate(zip(errors.names, errors.deviations.tolist(), strict=True))
        if name in channels or name in middles
    }


def _advise(likelihood: Likelihood, posterior: Posterior, sets: tuple[Floats, ...], conditions: ScanConditions) -> NextPosition:
    """Return the best place of the next reading, under the scene's load."""
    data = likelihood.data
    x_region, y_region = ((min(part.values), max(part.values)) for part in likelihood.prior.ranges[:2])
    variance = np.median(np.where(data.is_read, data.variance, np.inf), axis=0)
    groups = [part[np.linspace(0, len(part) - 1, MAX_PARTICLES).astype(int)] for part in sets]
    weights, spreads = conditions.loads.weigh([None])
    options = ((CandidateLoad(None, weights[0], spreads[0], variance), build_candidates((x_region, y_region))),)
    return choose_position(likelihood, groups, posterior.probability, options)
