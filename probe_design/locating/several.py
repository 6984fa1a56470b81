"""Draw sets of several tumours from the posterior, and compute the evidence of their number, in independent repeats.

A pool holds single tumours: of the prior, and about what explains the readings, or what fewer tumours leave of them. With signals
that add, which is nearly so, the likelihood of every pair of the pool is a scalar product; triples follow from pairs. Chosen sets
start tempered sequential Monte Carlo with the likelihood itself. Mixtures fit its particles, eq. LO.3, and from these importance
sampling computes the evidence without bias. Where it has few effective samples, or its repeats differ, long Markov chains move on
from its samples, and a mixture of more components fits them: it is the shape of the posterior that few weighted samples lack.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import expit, logit

from geometry.common.arrays import Floats
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.mixtures import FITTED_PARTICLES, CombinedProposal, ExtendedProposal, SetProposal, StudentMixture
from probe_design.locating.rounds import Proposal, Round, weigh
from probe_design.locating.samples import (
    Evaluate,
    Labels,
    Sample,
    choose_power,
    choose_systematically,
    compute_effective_size,
    compute_log_prior,
    find_largest,
    log_sum_exp,
    order_labels,
    propose_differences,
    raise_likelihood,
    soften_weights,
)

REPEATS = 2  # independent ones, whose evidences are compared
POOL_PART = 384  # tumours of each part of the pool
SOBOL_PART = 4096  # of the prior's sample, that the parts of the pool are fitted to
POOL_COMPONENTS, FIRST_COMPONENTS, LAST_COMPONENTS = 8, 6, 10  # of the mixtures
POOL_SIZE = 250.0  # effective sample size of the tempered likelihood to which a part of the pool is fitted
POWER_STRIDE = 16  # of the sets from which a power is chosen
EXTENDED = 320  # sets to which tumours of the pool are added
PARTICLES, MAX_TEMPERATURES, MOVES = 320, 30, 6  # of tempered sequential Monte Carlo in each repeat
JUMP_SHARE = 0.1  # of its moves that go from mode to mode
TEMPERING_SIZE_RELATIVE = 0.4  # effective sample size that a step of the temperature keeps, of the number of particles
PILOT_SIZE, FIRST_SIZE, LAST_SIZE = 1024, 2048, 4096  # samples of each repeat: to fit a mixture to; the last at least, at most
ENOUGH_SIZE = 400.0  # effective sample size of a repeat's last samples, for which fewer may do: ln evidence is then known to 0.05
GOOD_SIZE, MAX_ROUNDS = 250.0, 5  # effective size of a repeat's last samples, up to which its mixture is fitted anew
MIN_SIZE, MAX_DIFFERENCE = 200.0, 0.12  # of a repeat, and of ln evidence between repeats, beyond which Markov chains run
CHAINS, CHAIN_MOVES, FIRST_KEPT, CHAIN_STRIDE = 1500, 150, 60, 30  # their number, moves, the first move kept, moves between kept
CHAIN_COMPONENTS, CHAIN_FITTED, CHAIN_SIZE, MAX_CHAIN_RUNS = 40, 6000, 8192, 2  # of mixtures fitted to them, and their samples


@dataclass(frozen=True)
class LinearReadings:
    """The likelihood of LO.2 with the noise alone, linear in the signals: ln L = -|y - s|^2 / 2 in coordinates of unit variance.

    Attributes
    ----------
    likelihood
        Of the readings.
    variance
        Of the readings, shape (k, 2); inf where nothing is read.
    """

    likelihood: Likelihood
    variance: Floats

    def whiten(self, values: Floats) -> Floats:
        """Return values (n, k, 2) with unit variance, what the common errors may explain reduced, shape (n, 2 k)."""
        scaled = (values / np.sqrt(self.variance)).reshape(len(values), -1)
        directions, lost = self._common
        return np.asarray(scaled - (scaled @ directions) * lost @ directions.T)

    @cached_property
    def _common(self) -> tuple[Floats, Floats]:
        """Directions of the common errors among the whitened readings, (2 k, q), and what they lose of their size, (q,)."""
        columns = (self.likelihood.rows.constant / np.sqrt(self.variance)).reshape(len(self.likelihood.common_errors), -1)
        directions, sizes, _ = np.linalg.svd(columns.T, full_matrices=False)
        return directions, 1 - 1 / np.sqrt(1 + sizes**2)

    def predict(self, z: Floats) -> Floats:
        """Return whitened signals of single tumours at logits (n, d), shape (n, 2 k); nan where they do not fit."""
        likelihood = self.likelihood
        tumours = likelihood.prior.transform(expit(z)[:, None])
        signals = np.full((len(z), len(likelihood.data), 2), np.nan)
        allowed = likelihood.prior.find_allowed(tumours)
        signals[allowed] = likelihood.predict_possible(tumours[allowed])
        return self.whiten(signals)


@dataclass(frozen=True)
class Pool:
    """Single tumours with the weights that make them a sample of the prior.

    Attributes
    ----------
    readings
        The linear likelihood.
    sobol, sobol_signals
        Sample of the prior, logits (n, d), and whitened signals.
    values
        Whitened readings, shape (2 k,).
    parts
        Mixtures from which tumours of the pool are drawn, besides the prior.
    proposal
        For sets of as many tumours as were drawn from it last, 2 or more.
    """

    readings: LinearReadings
    sobol: Floats
    sobol_signals: Floats
    values: Floats
    parts: tuple[StudentMixture, ...]
    proposal: Proposal | None = None

    @classmethod
    def from_sample(cls, likelihood: Likelihood, sample: Sample, seed: int) -> Pool:
        """Return the pool for pairs, given the sample of one tumour."""
        rng = np.random.default_rng((seed, 7))
        best = likelihood.prior.transform(sample.points[[int(np.argmax(sample.log_weights))]])
        residuals, variance = likelihood.compute_residuals(best)
        if likelihood.outlier_rate:
            wild = np.minimum(likelihood.compute_wild_probability(residuals, variance), 0.999)
            variance = variance / (1 - wild)
        readings = LinearReadings(likelihood, variance[0])
        points = likelihood.prior.draw(SOBOL_PART, 1, seed)
        sobol = logit(points).reshape(len(points), -1)
        posterior = logit(sample.resample(POOL_PART, rng)).reshape(POOL_PART, -1)
        mixture = StudentMixture.fit(posterior, np.full(POOL_PART, 1 / POOL_PART), FIRST_COMPONENTS, rng)
        pool = cls(readings, sobol, readings.predict(sobol), readings.whiten(likelihood.data.values[None])[0], ())
        return pool.add_part(np.zeros((1, len(pool.values))), rng, mixture).add_part(readings.predict(posterior[::8]), rng)

    def add_part(self, signals: Floats, rng: np.random.Generator, *mixtures: StudentMixture) -> Pool:
        """Return the pool with tumours about what explains the readings that sets with ``signals`` (n, 2 k) leave."""
        fits = np.isfinite(signals).all(axis=1)
        cross = np.nan_to_num(self.sobol_signals) @ signals[fits].T
        gains = (self.sobol_signals @ self.values - (self.sobol_signals**2).sum(axis=1) / 2)[:, None] - cross
        gains = np.where(np.isnan(gains), -np.inf, gains)
        log_weights = log_sum_exp(gains) - math.log(gains.shape[1])
        weights = raise_likelihood(log_weights, choose_power(log_weights, 0.0, POOL_SIZE))
        mixture = StudentMixture.fit(self.sobol, weights, POOL_COMPONENTS, rng)
        return replace(self, parts=(*self.parts, *mixtures, mixture))

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
        """Return tumours, logits (n, d), ln weights against the prior (n,), and whitened signals (n, 2 k)."""
        start = int(rng.integers(len(self.sobol) // POOL_PART)) * POOL_PART
        z = np.concatenate([self.sobol[start : start + POOL_PART], *(part.draw(POOL_PART, rng) for part in self.parts)])
        log_prior = compute_log_prior(z)
        densities = np.stack([log_prior, *(part.compute_log_density(z) for part in self.parts)])
        signals = self.readings.predict(z)
        fits = np.isfinite(signals).all(axis=1)
        log_weights = log_prior - log_sum_exp(densities.T)
        return z[fits], log_weights[fits], signals[fits]

    def draw_sets(self, number: int, rng: np.random.Generator) -> tuple[Floats, Floats, float]:
        """Draw sets of ``number`` tumours from the pool, in proportion to the prior times a power of the linear likelihood L.

        Sets grow by one tumour at a time: each set of the size before is paired with each tumour of the pool.

        Returns
        -------
        tuple
            Logits of the sets, (PARTICLES, D), their whitened signals, (PARTICLES, 2 k), and the power of L.
        """
        z, log_priors, signals = self.draw(rng)
        # ln L of each tumour alone, less that of no tumour: y.s - |s|^2 / 2; that of two together lacks only s_1.s_2 of the sum
        log_alone = signals @ self.values - (signals**2).sum(axis=1) / 2
        chosen = rng.integers(len(z), size=EXTENDED)
        sets, set_signals = z[chosen], signals[chosen]
        set_log_likelihoods, set_log_weights = log_alone[chosen], log_priors[chosen]
        power = 0.0
        for size in range(2, number + 1):
            log_likelihoods = set_log_likelihoods[:, None] + log_alone - set_signals @ signals.T  # (sets, tumours of the pool)
            log_weights = set_log_weights[:, None] + log_priors
            count = PARTICLES if size == number else EXTENDED
            power = _choose_joint_power(log_weights, log_likelihoods, 2.0 * count)
            log_weights += power * log_likelihoods
            log_weights -= log_weights.max()  # in place, here and below: the arrays hold a value for each pair
            weights = np.exp(log_weights, out=log_weights)
            old, added = np.divmod(choose_systematically(weights.ravel() / weights.sum(), count, rng), len(z))
            sets, set_signals = np.concatenate([sets[old], z[added]], axis=1), set_signals[old] + signals[added]
            set_log_likelihoods = log_likelihoods[old, added]
            set_log_weights = -power * set_log_likelihoods  # they were drawn by L^power, which does not count again
        return sets, set_signals, power


def _choose_joint_power(log_fixed: Floats, log_likelihood: Floats, size: float) -> float:
    """Return the largest power of the likelihood, up to 1, with which weights keep an effective sample size, from a part."""
    log_fixed, log_likelihood = (part.ravel()[::POWER_STRIDE] for part in (log_fixed, log_likelihood))

    def is_enough(power: float) -> bool:
        return compute_effective_size(log_fixed + power * log_likelihood) >= size / POWER_STRIDE

    return max(find_largest(is_enough, 0.0, 1.0, 11), 1e-3)


def draw_several(likelihood: Likelihood, number: int, seed: int, pool: Pool) -> tuple[Sample, Pool]:
    """Return a sample of the posterior of two or three tumours, and a pool for one more.

    Parameters
    ----------
    likelihood
        Of the readings.
    number
        Tumours in each set.
    seed
        Of the random numbers.
    pool
        Single tumours, that of one tumour less.
    """
    target = _Target(likelihood, number, pool)
    rngs = [np.random.default_rng((seed, number, repeat)) for repeat in range(REPEATS)]
    repeats, signals = [], []
    for rng in rngs:
        z, totals, power = pool.draw_sets(number, rng)
        signals.append(totals)
        repeats.append(target.run_rounds(_temper(target.evaluate, z, number, power, rng), rng))
    for _ in range(MAX_CHAIN_RUNS):
        agree = compute_difference(repeats) <= MAX_DIFFERENCE
        repeats = [
            part if agree and part.size > MIN_SIZE else target.run_chains(part, rng)
            for part, rng in zip(repeats, rngs, strict=True)
        ]
    z, log_weights = np.concatenate([part.z for part in repeats]), np.concatenate([part.log_weights for part in repeats])
    total = float(log_sum_exp(log_weights))
    log_evidence = total - math.log(len(z)) - math.log(likelihood.prior.compute_allowed_fraction(number))
    sample = Sample(
        target.build_points(z), log_weights - total, log_evidence, compute_effective_size(log_weights),
        compute_difference(repeats),
    )  # fmt: skip
    pool = replace(pool, proposal=repeats[-1].proposal)
    return order_labels(sample), pool.add_part(np.concatenate(signals)[::16], np.random.default_rng((seed, number)))


@dataclass(frozen=True)
class _Target:
    """The posterior of several tumours.

    Attributes
    ----------
    likelihood
        Of the readings.
    number
        Of tumours.
    pool
        Single tumours, that of one tumour less.
    """

    likelihood: Likelihood
    number: int
    pool: Pool

    def build_points(self, z: Floats) -> Floats:
        """Return points of the cube at logits (n, m * d), shape (n, m, d)."""
        return np.asarray(expit(z).reshape(-1, self.number, len(self.likelihood.prior.free)))

    def evaluate(self, z: Floats) -> Floats:
        """Return ln likelihood at logits, shape (n, m * d)."""
        return self.likelihood.evaluate(self.build_points(z))

    @property
    def _extended(self) -> tuple[ExtendedProposal, ...]:
        """What tumours of the pool add to sets of one less; not of a single one, which a second moves too much for that."""
        return () if self.pool.proposal is None else (ExtendedProposal(self.pool.proposal, self.pool.parts[-1]),)

    def _fit(
        self, z: Floats, weights: Floats, count: int, rng: np.random.Generator, *, particles: int = FITTED_PARTICLES
    ) -> CombinedProposal:
        """Return a proposal fitted to weighted particles, see ``SetProposal.fit``."""
        z = Labels.from_particles(z, weights, self.number).order(z)
        return CombinedProposal(
            (SetProposal.fit(z, weights, count, rng, particles=particles, number=self.number), *self._extended)
        )

    def run_rounds(self, z: Floats, rng: np.random.Generator) -> Round:
        """Return draws of a proposal that was fitted to particles, then to draws of its own until these are good."""
        pilot, first, last = (size * (1 + len(self._extended)) for size in (PILOT_SIZE, FIRST_SIZE, LAST_SIZE))
        drawn = weigh(self.evaluate, self._fit(z, np.full(len(z), 1 / len(z)), FIRST_COMPONENTS, rng), pilot, rng)
        for _ in range(MAX_ROUNDS):
            proposal = self._fit(drawn.z, soften_weights(drawn.log_weights), LAST_COMPONENTS, rng)
            needed = math.ceil(ENOUGH_SIZE / max(drawn.size / len(drawn.z), 1e-3))
            count = 2 * math.ceil(min(max(needed, first), last) / 2)  # even, as the proposal has two parts at most
            drawn = weigh(self.evaluate, proposal, count, rng)
            if drawn.size > GOOD_SIZE:  # draws chosen for that missed what is rare: ln evidence was up to 0.2 too low
                return weigh(self.evaluate, proposal, count, rng)
        return drawn

    def run_chains(self, start: Round, rng: np.random.Generator) -> Round:
        """Return draws of a proposal that was fitted to Markov chains, which start at the softened weights of a round."""
        z = start.z[choose_systematically(soften_weights(start.log_weights), CHAINS, rng)]
        log_likelihood, kept = self.evaluate(z), []
        for move in range(CHAIN_MOVES):
            if move % CHAIN_STRIDE == 0:
                z = Labels.from_particles(z, np.full(len(z), 1 / len(z)), self.number).order(z)
                if move >= FIRST_KEPT:
                    kept.append(z)
            blocks = self.number if move % 2 else 1
            z, log_likelihood = _move(self.evaluate, z, log_likelihood, power=1.0, blocks=blocks, rng=rng)
        z = np.concatenate([*kept, z])
        proposal = self._fit(z, np.full(len(z), 1 / len(z)), CHAIN_COMPONENTS, rng, particles=CHAIN_FITTED)
        return weigh(self.evaluate, proposal, CHAIN_SIZE * (1 + len(self._extended)), rng)


def compute_difference(repeats: list[Round]) -> float:
    """Return the difference between the largest and the smallest ln evidence of independent rounds."""
    evidences = [float(log_sum_exp(part.log_weights)) - math.log(len(part.z)) for part in repeats]
    return max(evidences) - min(evidences)


def _temper(evaluate: Evaluate, z: Floats, number: int, power: float, rng: np.random.Generator) -> Floats:
    """Return equally weighted particles of the posterior, shape (PARTICLES, D), by tempered sequential Monte Carlo.

    Particles move by differences of two others: of all tumours, or of one alone, for which labels are ordered first.

    Parameters
    ----------
    evaluate
        Ln likelihood at logits.
    z
        Particles that follow the likelihood to ``power``, shape (PARTICLES, D).
    number
        Tumours in a set.
    power
        From which the likelihood is raised to 1.
    rng
        Random numbers.
    """
    log_likelihood = evaluate(z)
    if not np.any(np.isfinite(log_likelihood)):  # all touch: only one place explains readings beyond the population
        return z
    for step in range(MAX_TEMPERATURES):
        end = power if step == 0 else choose_power(log_likelihood, power, TEMPERING_SIZE_RELATIVE * PARTICLES)
        chosen = choose_systematically(raise_likelihood(log_likelihood, end - power), PARTICLES, rng)
        power = end
        z, log_likelihood = z[chosen], log_likelihood[chosen]
        z = Labels.from_particles(z, np.full(len(z), 1 / len(z)), number).order(z)
        for move in range(MOVES):
            z, log_likelihood = _move(evaluate, z, log_likelihood, power=power, blocks=number if move % 2 else 1, rng=rng)
        if power >= 1.0:
            break
    return z


def _move(
    evaluate: Evaluate, z: Floats, log_likelihood: Floats, *, power: float, blocks: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return particles after one step of differential evolution, in one of several blocks of coordinates chosen for each."""
    candidate, log_prior_ratio = propose_differences(z, blocks, rng, jump_share=JUMP_SHARE)
    candidate_likelihood = evaluate(candidate)
    accepted = np.log(rng.random(len(z))) < power * (candidate_likelihood - log_likelihood) + log_prior_ratio
    return np.where(accepted[:, None], candidate, z), np.where(accepted, candidate_likelihood, log_likelihood)
