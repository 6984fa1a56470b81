"""Draw sets of tumours from the posterior, and compute the evidence of their number.

All sampling is in z = logit u of the cube's coordinates u. Importance sampling has weights L(z) p(z) / q(z), whose mean is the
evidence without bias for any proposal q that is nowhere 0. Here q is a mixture,

    q(z) = a p(z) + (1 - a) / K sum_k t_5(z; z_k, h^2 C)                                            (LO.3)

of the prior p, a guard, and of Student kernels about K particles of the round before, which a tempered likelihood L^b has chosen;
C is the weighted covariance of that round. Several tumours start from tempered sequential Monte Carlo. Their labels are
arbitrary: a set counts only in the order of labels that is nearest to the medians, and the evidence is multiplied by m!.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.special import expit, gammaln, log_expit, logit, logsumexp

from geometry.common.arrays import Bools, Floats, Ints
from probe_design.locating.likelihood import Likelihood

PRIOR_SHARE = 0.1  # a of eq. LO.3: bounds every weight by ten times that of the prior
KERNELS = 150  # K: more make the proposal slower, not better (60 to 768 tried)
SEVERAL_KERNEL_WIDTH = 0.6  # h for two and three tumours: 0.3 and 1.0 give a third of the effective sample size
KERNEL_FREEDOM = 5  # degrees of freedom of the kernels, whose tails are heavier than those of a posterior
START_SIZE = 2**14  # of the Sobol sample of the prior for one tumour
SEVERAL_START_SIZE = 2**13  # for two and three, which start from tempering where it does not suffice
ROUND_SIZE, LAST_SIZE, SEVERAL_SIZE = 4096, 16384, 32768  # samples of a round, of the last one, of several tumours
MAX_ROUNDS = 8  # of adaptation: one tumour needs 1 to 6
MIN_TEMPERED_SIZE = 150.0  # effective sample size that the tempered likelihood keeps in each round
GOOD_SIZE = 1000.0  # effective sample size at which a round is good enough
CONVERGED_SIZE = 100.0  # effective sample size below which a result is not converged: quantiles are too narrow
PARTICLES, MAX_TEMPERATURES, MOVES = 768, 60, 10  # of tempered sequential Monte Carlo
TEMPERING_SIZE_RELATIVE = 0.5  # effective sample size that a step of the temperature keeps, of the number of particles
MAX_LOGIT = 20.0  # of coordinates: beyond it the cube ends within rounding

Evaluate = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Sample:
    """Weighted sets of m tumours from the posterior of this number.

    Attributes
    ----------
    points
        Coordinates in the cube, shape (n, m, d).
    log_weights
        Ln of the weights, normalised to a sum of 1, shape (n,).
    log_evidence
        Ln of the mean likelihood over the prior of this number.
    size
        Effective sample size.
    """

    points: Floats
    log_weights: Floats
    log_evidence: float
    size: float

    @property
    def weights(self) -> Floats:
        """Weights, which sum to 1, shape (n,)."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def evidence_error(self) -> float:
        """Standard deviation of ``log_evidence`` by the scatter of the weights."""
        return math.sqrt(max(1 / self.size - 1 / len(self.log_weights), 0.0))

    @property
    def is_converged(self) -> bool:
        """Whether the effective sample size suffices."""
        return self.size >= CONVERGED_SIZE

    def resample(self, count: int, rng: np.random.Generator) -> Floats:
        """Return equally weighted sets, shape (count, m, d)."""
        return np.asarray(self.points[choose_systematically(self.weights, count, rng)])


def choose_systematically(weights: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Return indices of ``count`` draws with given weights, which sum to 1, with little noise; shape (count,)."""
    steps = (np.arange(count) + rng.random()) / count
    return np.asarray(np.minimum(np.searchsorted(np.cumsum(weights), steps), len(weights) - 1))


def compute_effective_size(log_weights: Floats) -> float:
    """Return the effective sample size (sum w)^2 / sum w^2 of weights given by their logarithms; 0 if all are 0."""
    if not np.any(np.isfinite(log_weights)):
        return 0.0
    return float(np.exp(2 * logsumexp(log_weights) - logsumexp(2 * log_weights)))


def draw_posterior(likelihood: Likelihood, number: int, seed: int, start: Floats | None = None) -> Sample:
    """Return a sample of the posterior of a number of tumours, and their evidence.

    Parameters
    ----------
    likelihood
        Of the readings.
    number
        Tumours in each set, 1 or more.
    seed
        Of the random numbers; the same seed gives the same sample.
    start
        Ln likelihood of the first Sobol sample, shape (n,), where it is computed before.
    """
    rng = np.random.default_rng((seed, number))
    points = likelihood.prior.draw(START_SIZE if number == 1 else SEVERAL_START_SIZE, number, seed)
    dimensions = points.shape[-1]
    log_weights = likelihood.evaluate(points) if start is None else start
    size = compute_effective_size(log_weights)
    log_fraction = math.log(likelihood.prior.compute_allowed_fraction(number))

    def finish(points: Floats, log_weights: Floats, factor: float = 0.0) -> Sample:
        """Return the sample of unnormalised weights; ``factor`` is the logarithm of a factor of the evidence."""
        total = float(logsumexp(log_weights))
        evidence = total - math.log(len(log_weights)) - log_fraction + factor
        return Sample(points, log_weights - total, evidence, compute_effective_size(log_weights))

    if not np.any(np.isfinite(log_weights)) or dimensions == 0 or size >= GOOD_SIZE:
        sample = finish(points, log_weights)
        return sample if number == 1 or dimensions == 0 else _order_labels(sample)

    def evaluate(z: Floats) -> Floats:
        """Return ln likelihood at logits, shape (n, m * d)."""
        return likelihood.evaluate(expit(z).reshape(-1, number, dimensions))

    z = logit(points).reshape(len(points), -1)
    labels = Labels.from_particles(z, np.exp(log_weights - logsumexp(log_weights)), number)
    if number == 1:
        z, log_weights = _adapt(evaluate, z, log_weights, labels, rng)
    else:
        z = _temper(evaluate, z, log_weights, number, rng)
        equal = np.full(len(z), 1 / len(z))
        labels = Labels.from_particles(z, equal, number)
        proposal = Proposal.from_particles(labels.order(z), equal, rng, SEVERAL_KERNEL_WIDTH)
        z, log_weights = _weigh(evaluate, proposal, SEVERAL_SIZE, labels, rng)
    return finish(expit(z).reshape(-1, number, dimensions), log_weights, math.lgamma(number + 1))


def _adapt(evaluate: Evaluate, z: Floats, log_weights: Floats, labels: Labels, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return a sample of importance sampling with adapted proposals, eq. LO.3, and the logarithms of its weights.

    Parameters
    ----------
    evaluate
        Ln likelihood at logits.
    z, log_weights
        First particles, shape (n, D), and the logarithms of their weights, shape (n,).
    labels
        Which order of the tumours counts.
    rng
        Random numbers.
    """
    best: tuple[float, Floats, Floats] | None = None
    for round_number in range(MAX_ROUNDS):
        is_last = round_number == MAX_ROUNDS - 1 or (best is not None and best[0] >= GOOD_SIZE / 2)
        proposal = Proposal.from_particles(z, soften_weights(log_weights), rng)
        z, log_weights = _weigh(evaluate, proposal, LAST_SIZE if is_last else ROUND_SIZE, labels, rng)
        size = compute_effective_size(log_weights)
        if best is None or size > best[0] or is_last:
            best = size, z, log_weights
        if is_last:
            break
    assert best is not None
    return best[1], best[2]


def _weigh(evaluate: Evaluate, proposal: Proposal, count: int, labels: Labels, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return draws of a proposal, shape (count, D), and the logarithms of their weights; 0 in other orders of the labels."""
    z = proposal.draw(count, rng)
    log_prior = compute_log_prior(z)
    is_ordered, log_weights = labels.is_ordered(z), np.full(count, -np.inf)
    log_density = proposal.compute_log_density(z[is_ordered], log_prior[is_ordered])
    log_weights[is_ordered] = evaluate(z[is_ordered]) + log_prior[is_ordered] - log_density
    return z, log_weights


def soften_weights(log_weights: Floats) -> Floats:
    """Return weights, which sum to 1, tempered so far that their effective sample size is ``MIN_TEMPERED_SIZE``."""
    low, high = 0.0, 1.0
    finite = np.isfinite(log_weights)
    relative = np.where(finite, log_weights, 0.0)
    for _ in range(30):
        power = high if compute_effective_size(log_weights) >= MIN_TEMPERED_SIZE else (low + high) / 2
        scaled = np.where(finite, power * relative, -np.inf)
        if power == 1.0:
            break
        low, high = (power, high) if compute_effective_size(scaled) >= MIN_TEMPERED_SIZE else (low, power)
    return np.asarray(np.exp(scaled - logsumexp(scaled)))


@dataclass(frozen=True)
class Proposal:
    """Eq. LO.3.

    Attributes
    ----------
    centres
        z_k, shape (K, D).
    factor
        Cholesky factor of h^2 C, shape (D, D).
    """

    centres: Floats
    factor: Floats

    @classmethod
    def from_particles(cls, z: Floats, weights: Floats, rng: np.random.Generator, width: float | None = None) -> Proposal:
        """Return kernels about particles with weights that sum to 1; ``width`` is h, by default that of Silverman's rule."""
        dimensions = z.shape[1]
        clipped = np.clip(z, -MAX_LOGIT, MAX_LOGIT)
        centres = clipped[choose_systematically(weights, KERNELS, rng)]
        deviations = clipped - weights @ clipped
        covariance = (weights[:, None] * deviations).T @ deviations + 1e-8 * np.eye(dimensions)
        width = KERNELS ** (-1 / (dimensions + 4)) if width is None else width
        return cls(centres, np.asarray(width * np.linalg.cholesky(covariance)))

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return logits, shape (count, D)."""
        dimensions = self.centres.shape[1]
        centres = self.centres[rng.integers(len(self.centres), size=count)]
        spread = np.sqrt(KERNEL_FREEDOM / rng.chisquare(KERNEL_FREEDOM, size=count))
        z = centres + spread[:, None] * (rng.standard_normal((count, dimensions)) @ self.factor.T)
        is_prior = rng.random(count) < PRIOR_SHARE
        z[is_prior] = rng.logistic(size=(int(is_prior.sum()), dimensions))
        return np.clip(z, -MAX_LOGIT, MAX_LOGIT)

    def compute_log_density(self, z: Floats, log_prior: Floats) -> Floats:
        """Return ln q at logits (n, D), of which ``log_prior`` is ln p; shape (n,)."""
        dimensions = z.shape[1]
        whitened, centres = (np.linalg.solve(self.factor, part.T).T for part in (z, self.centres))
        squares = (whitened**2).sum(axis=1)[:, None] + (centres**2).sum(axis=1) - 2 * whitened @ centres.T
        half = (KERNEL_FREEDOM + dimensions) / 2
        constant = (
            gammaln(half) - gammaln(KERNEL_FREEDOM / 2) - dimensions / 2 * math.log(KERNEL_FREEDOM * math.pi)
            - np.log(np.diag(self.factor)).sum() - math.log(len(self.centres))
        )  # fmt: skip
        kernels = np.log((1 + np.maximum(squares, 0.0) / KERNEL_FREEDOM) ** -half).T
        log_kernels = constant + logsumexp(kernels, axis=0)
        return np.asarray(np.logaddexp(math.log(PRIOR_SHARE) + log_prior, math.log1p(-PRIOR_SHARE) + log_kernels))


def compute_log_prior(z: Floats) -> Floats:
    """Return ln of the prior's density at logits (n, D): of independent logistic numbers, shape (n,)."""
    return np.asarray((log_expit(z) + log_expit(-z)).sum(axis=1))


@dataclass(frozen=True)
class Labels:
    """The order of labels of m tumours that counts: the one nearest to their medians.

    Attributes
    ----------
    medians, spreads
        Of each label's logits, shape (m, d).
    """

    medians: Floats
    spreads: Floats

    @classmethod
    def from_particles(cls, z: Floats, weights: Floats, number: int) -> Labels:
        """Return the labels of particles (n, m * d) with weights that sum to 1, by repeated ordering."""
        chosen = z[choose_systematically(weights, 1000, np.random.default_rng(0))]
        sets = chosen.reshape(len(chosen), number, -1)
        labels = cls(sets[0], np.maximum(sets.std(axis=(0, 1)), 1e-3) * np.ones_like(sets[0]))
        for _ in range(6 if number > 1 else 0):
            ordered = labels.order(chosen).reshape(sets.shape)
            labels = cls(np.median(ordered, axis=0), np.maximum(ordered.std(axis=0), 0.05))
        return labels

    def order(self, z: Floats) -> Floats:
        """Return particles (n, m * d) with their tumours in the order that counts."""
        sets = z.reshape(len(z), *self.medians.shape)
        orders = np.array(list(permutations(range(len(self.medians)))))
        best = orders[np.argmin(self._compute_costs(sets, orders), axis=0)]
        return np.take_along_axis(sets, best[:, :, None], axis=1).reshape(z.shape)

    def is_ordered(self, z: Floats) -> Bools:
        """Return which particles (n, m * d) are in the order that counts, shape (n,)."""
        if len(self.medians) == 1:
            return np.ones(len(z), dtype=bool)
        orders = np.array(list(permutations(range(len(self.medians)))))
        costs = self._compute_costs(z.reshape(len(z), *self.medians.shape), orders)
        return np.asarray(costs[0] <= costs.min(axis=0))

    def _compute_costs(self, sets: Floats, orders: Ints) -> Floats:
        """Return the distance of sets (n, m, d) from the medians in each of several orders, shape (orders, n)."""
        scaled = ((sets[:, :, None] - self.medians) / self.spreads) ** 2
        pairs = scaled.sum(axis=-1)  # of tumour j with label k, (n, m, m)
        return np.stack([sum(pairs[:, tumour, label] for label, tumour in enumerate(order)) for order in orders])


def _order_labels(sample: Sample) -> Sample:
    """Return a sample of several tumours with their labels nearest to the medians."""
    z = logit(sample.points).reshape(len(sample.points), -1)
    ordered = Labels.from_particles(z, sample.weights, sample.points.shape[1]).order(z)
    return Sample(expit(ordered).reshape(sample.points.shape), sample.log_weights, sample.log_evidence, sample.size)


def _temper(evaluate: Evaluate, z: Floats, log_likelihood: Floats, number: int, rng: np.random.Generator) -> Floats:
    """Return equally weighted particles of the posterior, shape (PARTICLES, D), by tempered sequential Monte Carlo.

    Particles move by differences of two others: of all tumours, or of one alone, for which labels are ordered first.

    Parameters
    ----------
    evaluate
        Ln likelihood at logits.
    z, log_likelihood
        Sample of the prior, shape (n, D), and its ln likelihood, shape (n,).
    number
        Tumours in a set.
    rng
        Random numbers.
    """
    power, size = 0.0, TEMPERING_SIZE_RELATIVE * PARTICLES
    for _ in range(MAX_TEMPERATURES):
        step = _choose_step(log_likelihood, 1 - power, size)
        power += step
        weights = step * log_likelihood
        chosen = choose_systematically(np.exp(weights - logsumexp(weights)), PARTICLES, rng)
        z, log_likelihood = z[chosen], log_likelihood[chosen]
        z = Labels.from_particles(z, np.full(len(z), 1 / len(z)), number).order(z)
        for move in range(MOVES):
            z, log_likelihood = _move(evaluate, z, log_likelihood, power=power, blocks=number if move % 2 else 1, rng=rng)
        if power >= 1.0:
            break
    return z


def _choose_step(log_likelihood: Floats, largest: float, size: float) -> float:
    """Return the largest step of the power of the likelihood that keeps an effective sample size."""
    low, high = 0.0, largest
    if compute_effective_size(high * log_likelihood) >= size:
        return high
    finite = np.isfinite(log_likelihood)
    for _ in range(40):
        middle = (low + high) / 2
        scaled = np.where(finite, middle * np.where(finite, log_likelihood, 0.0), -np.inf)
        low, high = (middle, high) if compute_effective_size(scaled) >= size else (low, middle)
    return max(low, 1e-12)


def _move(
    evaluate: Evaluate, z: Floats, log_likelihood: Floats, *, power: float, blocks: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return particles after one step of differential evolution, in one of several blocks of coordinates chosen for each."""
    n, dimensions = z.shape
    block = dimensions // blocks
    first, second = np.asarray(rng.integers(n, size=(2, n)))
    scale = np.asarray(2.38 / math.sqrt(2 * block) * rng.uniform(0.2, 1.1, size=n))
    scale[rng.random(n) < 0.1] = 1.0  # jumps between modes
    difference = scale[:, None] * (z[first] - z[second]) + 1e-3 * rng.standard_normal(z.shape)
    is_moved = np.repeat(np.asarray(rng.integers(blocks, size=n))[:, None] == np.arange(blocks), block, axis=1)
    candidate = np.clip(np.where(is_moved, z + difference, z), -MAX_LOGIT, MAX_LOGIT)
    candidate_likelihood = evaluate(candidate)
    log_ratio = power * (candidate_likelihood - log_likelihood) + compute_log_prior(candidate) - compute_log_prior(z)
    accepted = np.log(rng.random(n)) < log_ratio
    return np.where(accepted[:, None], candidate, z), np.where(accepted, candidate_likelihood, log_likelihood)
