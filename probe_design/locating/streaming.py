"""Update a posterior by each new reading, without drawing it anew.

Particles of a number of tumours carry the sums of eq. LO.2, to which a reading adds its terms. Their weights change by the ratio
of the likelihoods, which keeps the evidence of importance sampling without bias. Where the effective sample size falls too low,
one tumour is drawn anew from eq. LO.3 about the particles that there are. Sets of two and three tumours have too many coordinates
for that: they are resampled and moved by steps that leave the posterior as it is (Chopin, A sequential particle filter method for
static models, Biometrika 89, 2002), and the evidence is the product of the mean changes of the weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logit, logsumexp

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal
from probe_design.locating.common_errors import Sums
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.mixtures import StudentMixture
from probe_design.locating.samples import (
    CONVERGED_SIZE,
    Labels,
    Sample,
    choose_systematically,
    compute_effective_size,
    compute_log_prior,
    find_largest,
    propose_differences,
    soften_weights,
)
from probe_design.locating.sampling import COMPONENTS, GOOD_SIZE, draw_posterior

STREAMED_START_SIZE = 2**14  # Sobol sample of the prior for one tumour
RENEWED_SIZE = 4096  # samples of a round of one tumour: 35 ms with 25 readings
MIN_STREAMED_SIZE = 250.0  # effective sample size of one tumour below which it is drawn anew
MAX_RENEWALS = 4  # rounds of one reading, before everything is drawn as by `locate`
SEVERAL_PARTICLES, SEVERAL_START = 800, 2**13  # particles of two and three tumours, and their sample of the prior
SEVERAL_SIZE_RELATIVE = 0.5  # effective sample size below which they are resampled and moved
MOVES_PER_TUMOUR = 4  # steps of each set after resampling, for each of its tumours
MAX_BRIDGES = 20  # powers of the likelihood of a single reading that surprises


@dataclass(frozen=True)
class Stream:
    """The posterior of one number of tumours, as it changes from reading to reading.

    Attributes
    ----------
    sample
        Weighted sets of tumours.
    log_likelihood
        Ln L of each set given the readings so far, shape (n,).
    sums
        Eq. LO.2 of each set; None with wild readings, whose likelihood has no such sums.
    log_fraction
        Ln of the fraction of the prior's cube that fits the tissue.
    variance
        Of ln evidence, accumulated over the resamplings.
    """

    sample: Sample
    log_likelihood: Floats
    sums: Sums | None
    log_fraction: float
    variance: float = 0.0

    @classmethod
    def from_prior(cls, likelihood: Likelihood, number: int, seed: int) -> Stream:
        """Return the sample of the prior, before any reading of ``likelihood``, which has none."""
        size = RENEWED_SIZE if likelihood.outlier_rate else STREAMED_START_SIZE if number == 1 else SEVERAL_START
        points = likelihood.prior.draw(size, number, seed)
        log_likelihood, sums = _measure(likelihood, points)
        total = float(logsumexp(log_likelihood))
        log_weights = log_likelihood - total
        sample = Sample(points, log_weights, 0.0, compute_effective_size(log_weights))
        return cls(sample, log_likelihood, sums, math.log(likelihood.prior.compute_allowed_fraction(number)))

    def update(self, likelihood: Likelihood, rng: np.random.Generator, seed: int) -> Stream:
        """Return the posterior with the last reading of ``likelihood``.

        Parameters
        ----------
        likelihood
            Of all readings.
        rng
            Random numbers.
        seed
            Of a sample drawn as by `locate`, where nothing else suffices.
        """
        sample, number = self.sample, self.sample.points.shape[1]
        log_likelihood, sums = self._add_reading(likelihood)
        log_weights = sample.log_weights + _subtract(log_likelihood, self.log_likelihood)
        total = float(logsumexp(log_weights))
        size = compute_effective_size(log_weights)
        if math.isfinite(total):
            sample = Sample(sample.points, log_weights - total, sample.log_evidence + total, size)
            stream = Stream(sample, log_likelihood, sums, self.log_fraction, self.variance)
            threshold = MIN_STREAMED_SIZE if number == 1 else SEVERAL_SIZE_RELATIVE * SEVERAL_PARTICLES
            if size >= threshold or sample.points.shape[-1] == 0:
                return stream
            stream = stream._renew(likelihood, rng) if number == 1 else self._move(likelihood, log_likelihood, rng)
            if stream.sample.size >= CONVERGED_SIZE:
                return stream
        drawn = draw_posterior(likelihood, number, seed)
        return Stream(drawn, *_measure(likelihood, drawn.points), self.log_fraction)

    @property
    def evidence_error(self) -> float:
        """Standard deviation of ln evidence by the sampling."""
        return math.sqrt(self.variance + self.sample.evidence_error**2)

    def _add_reading(self, likelihood: Likelihood) -> tuple[Floats, Sums | None]:
        """Return ln L and the sums with the last reading."""
        if self.sums is None:
            return likelihood.evaluate(self.sample.points), None
        latest = replace(likelihood, data=likelihood.data.select(slice(len(likelihood.data) - 1, None)))
        is_possible = np.isfinite(self.log_likelihood)
        tumours = likelihood.prior.transform(self.sample.points)
        sums = self.sums + _sum_predictable(latest, tumours, is_possible)
        return sums.compute_log_likelihood(), sums

    def _renew(self, likelihood: Likelihood, rng: np.random.Generator) -> Stream:
        """Return one tumour drawn anew, eq. LO.3, about the particles."""
        points, log_weights, best = self.sample.points, self.sample.log_weights, self
        for _ in range(MAX_RENEWALS):
            z = logit(points).reshape(len(points), -1)
            proposal = StudentMixture.fit(z, soften_weights(log_weights), COMPONENTS, rng)
            z = proposal.draw(RENEWED_SIZE, rng)
            points, log_prior = expit(z).reshape(RENEWED_SIZE, *points.shape[1:]), compute_log_prior(z)
            log_likelihood, sums = _measure(likelihood, points)
            log_weights = log_likelihood + log_prior - proposal.compute_log_density(z)
            total, size = float(logsumexp(log_weights)), compute_effective_size(log_weights)
            if size > best.sample.size:
                evidence = total - math.log(len(points)) - self.log_fraction
                best = Stream(Sample(points, log_weights - total, evidence, size), log_likelihood, sums, self.log_fraction)
            if size >= GOOD_SIZE / 2:
                break
        return best

    def _move(self, likelihood: Likelihood, log_likelihood: Floats, rng: np.random.Generator) -> Stream:
        """Return several tumours resampled and moved; a reading that surprises counts bit by bit.

        Parameters
        ----------
        likelihood
            Of all readings.
        log_likelihood
            Ln L given all readings, shape (n,).
        rng
            Random numbers.
        """
        number, power, sample = self.sample.points.shape[1], 0.0, self.sample
        evidence, variance = sample.log_evidence, self.variance
        # ln L before and after the last reading; the moves leave old + power (new - old) as it is
        z, old, new, log_weights = (
            logit(sample.points).reshape(len(log_likelihood), -1),
            self.log_likelihood,
            log_likelihood,
            sample.log_weights,
        )
        for bridge in range(MAX_BRIDGES):
            change = _subtract(new, old)
            step = 1 - power if bridge == MAX_BRIDGES - 1 else _choose_step(log_weights, change, 1 - power)
            power = power + step
            log_weights = log_weights + np.where(np.isfinite(change), step * change, -np.inf)
            total, size = float(logsumexp(log_weights)), compute_effective_size(log_weights)
            evidence, variance = evidence + total, variance + max(1 / size - 1 / len(log_weights), 0.0)
            chosen = choose_systematically(np.exp(log_weights - total), SEVERAL_PARTICLES, rng)
            z, old, new, log_weights = (
                z[chosen],
                old[chosen],
                new[chosen],
                np.full(SEVERAL_PARTICLES, -math.log(SEVERAL_PARTICLES)),
            )
            z = Labels.from_particles(z, np.exp(log_weights), number).order(z)
            is_last = power > 1 - 1e-9
            for move in range(MOVES_PER_TUMOUR * number):
                candidate, log_prior_ratio = propose_differences(z, number if move % 2 else 1, rng)
                points = expit(candidate).reshape(len(z), number, -1)
                candidate_old, candidate_new = _evaluate_last(likelihood, points, with_earlier=not is_last)
                gain = power * _subtract(candidate_new, new) + (0.0 if is_last else (1 - power) * _subtract(candidate_old, old))
                accepted = np.log(rng.random(len(z))) < gain + log_prior_ratio
                z = np.where(accepted[:, None], candidate, z)
                old, new = np.where(accepted, candidate_old, old), np.where(accepted, candidate_new, new)
            if is_last:
                break
        points = expit(z).reshape(len(z), number, -1)
        moved = Sample(points, log_weights, evidence, float(len(z)))
        return Stream(moved, *_measure(likelihood, points), self.log_fraction, variance)


def _subtract(new: Floats, old: Floats) -> Floats:
    """Return new less old, -inf where new is -inf."""
    return np.where(np.isfinite(new), new, 0.0) - np.where(np.isfinite(old), old, 0.0) + np.where(np.isfinite(new), 0.0, -np.inf)


def _evaluate_last(likelihood: Likelihood, points: Floats, *, with_earlier: bool) -> tuple[Floats, Floats]:
    """Return ln L of sets of tumours without the last reading and with it; the first is the second unless ``with_earlier``."""
    if not with_earlier:
        value = likelihood.evaluate(points)
        return value, value
    count = len(likelihood.data) - 1
    earlier, last = (replace(likelihood, data=likelihood.data.select(rows)) for rows in (slice(0, count), slice(count, None)))
    if likelihood.outlier_rate:
        return earlier.evaluate(points), likelihood.evaluate(points)
    old, sums = _measure(earlier, points)
    assert sums is not None
    sums += _sum_predictable(last, likelihood.prior.transform(points), np.isfinite(old))
    return old, sums.compute_log_likelihood()


def _measure(likelihood: Likelihood, points: Floats) -> tuple[Floats, Sums | None]:
    """Return ln L of sets of tumours, -inf where they do not fit, and the sums of eq. LO.2 unless readings may be wild."""
    if likelihood.outlier_rate:
        return likelihood.evaluate(points), None
    tumours = likelihood.prior.transform(points)
    sums = _sum_predictable(likelihood, tumours, likelihood.prior.find_allowed(tumours))
    return sums.compute_log_likelihood(), sums


def _sum_predictable(likelihood: Likelihood, tumours: Floats, is_possible: Bools) -> Sums:
    """Return the sums of eq. LO.2; of sets that are not possible, and of those that the model refuses, with infinite squares."""
    total = Sums.build_impossible(len(likelihood.common_errors), len(tumours))
    chosen = np.flatnonzero(is_possible)
    parts = list(np.array_split(chosen, max(1, len(chosen) // 4096)))
    while parts:
        part = parts.pop()
        if not len(part):
            continue
        try:
            sums = likelihood.sum_readings(tumours[part])
        except Refusal:
            if len(part) > 1:
                parts += np.array_split(part, 2)
            continue
        total.replace(part, sums)
    return total


def _choose_step(log_weights: Floats, change: Floats, largest: float) -> float:
    """Return the largest power of the change of the likelihood that keeps a fifth of the particles' effective size."""
    size = compute_effective_size(log_weights) / 5
    finite = np.isfinite(change)
    exponents = np.where(finite, change, 0.0)

    def keep(step: float) -> bool:
        return compute_effective_size(np.where(finite, log_weights + step * exponents, -np.inf)) >= size

    return max(find_largest(keep, 0.0, largest, 30), 1e-9)
