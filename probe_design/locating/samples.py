"""Weighted sets of tumours: samples of a posterior, their effective size, their labels.

Sets are points of the prior's cube, or their logits z = logit u, in which all sampling takes place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.special import expit, logit

from geometry.common.arrays import Floats, Ints

MIN_TEMPERED_SIZE = 150.0  # effective sample size that a tempered likelihood keeps in each round
CONVERGED_SIZE = 100.0  # effective sample size below which a result is not converged: quantiles are too narrow
STATED_SIZE = 25.0  # effective sample size below which the evidence is not stated: its error is above 0.2
MAX_REPEAT_DIFFERENCE = 0.5  # of ln evidence between independent repeats, above which it is not stated
POWER_STEPS = 20  # of bisection for a power: resolves those that a likelihood of many readings needs
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
    repeat_difference
        Difference of ``log_evidence`` between independent repeats; 0 without repeats.
    """

    points: Floats
    log_weights: Floats
    log_evidence: float
    size: float
    repeat_difference: float = 0.0

    @property
    def weights(self) -> Floats:
        """Weights, which sum to 1, shape (n,)."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def evidence_error(self) -> float:
        """Standard deviation of ``log_evidence`` by the scatter of the weights, or half the difference between two repeats."""
        scatter = math.sqrt(max(1 / self.size - 1 / len(self.log_weights), 0.0)) if self.size > 0 else math.inf
        return max(scatter, self.repeat_difference / 2)

    @property
    def is_stated(self) -> bool:
        """Whether ``log_evidence`` is good enough for a probability of the number of tumours."""
        return self.size >= STATED_SIZE and self.repeat_difference <= MAX_REPEAT_DIFFERENCE

    @property
    def is_converged(self) -> bool:
        """Whether the effective sample size suffices, and repeats agree."""
        return self.size >= CONVERGED_SIZE and self.repeat_difference <= MAX_REPEAT_DIFFERENCE

    def resample(self, count: int, rng: np.random.Generator) -> Floats:
        """Return equally weighted sets, shape (count, m, d)."""
        return np.asarray(self.points[choose_systematically(self.weights, count, rng)])


def choose_systematically(weights: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Return indices of ``count`` draws with given weights, which sum to 1, with little noise; shape (count,)."""
    steps = (np.arange(count) + rng.random()) / count
    return np.asarray(np.minimum(np.searchsorted(np.cumsum(weights), steps), len(weights) - 1))


def log_sum_exp(values: Floats, axis: int = -1) -> Floats:
    """Return ln sum exp along an axis; -inf where all are. Much faster than scipy's, which handles more cases."""
    largest = values.max(axis=axis, keepdims=True)
    largest = np.where(np.isfinite(largest), largest, 0.0)
    with np.errstate(divide="ignore"):  # ln 0 where all are -inf
        return np.asarray(np.log(np.exp(values - largest).sum(axis=axis)) + largest.squeeze(axis))


def compute_effective_size(log_weights: Floats) -> float:
    """Return the effective sample size (sum w)^2 / sum w^2 of weights given by their logarithms; 0 if all are 0."""
    largest = log_weights.max(initial=-math.inf)
    if not math.isfinite(largest):
        return 0.0
    weights = np.exp(log_weights - largest).ravel()
    return float(weights.sum() ** 2 / (weights @ weights))


def choose_power(log_likelihood: Floats, start: float, size: float) -> float:
    """Return the largest power up to 1 such that raising the likelihood from ``start`` keeps an effective sample size."""
    finite = log_likelihood[np.isfinite(log_likelihood)]
    power = find_largest(lambda power: compute_effective_size((power - start) * finite) >= size, start, 1.0, POWER_STEPS)
    return max(power, start + (1 - start) * 0.5**POWER_STEPS)


def find_largest(holds: Callable[[float], bool], low: float, high: float, steps: int) -> float:
    """Return the largest number from ``low`` to ``high`` for which a condition holds, as it does at ``low``, by bisection."""
    if holds(high):
        return high
    for _ in range(steps):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def raise_likelihood(log_likelihood: Floats, power: float) -> Floats:
    """Return weights, which sum to 1, of a power of a likelihood given by its logarithm, which may be -inf."""
    scaled = np.where(np.isfinite(log_likelihood), power * np.where(np.isfinite(log_likelihood), log_likelihood, 0.0), -np.inf)
    return np.asarray(np.exp(scaled - log_sum_exp(scaled)))


def soften_weights(log_weights: Floats) -> Floats:
    """Return weights, which sum to 1, tempered so far that their effective sample size is ``MIN_TEMPERED_SIZE``."""
    return raise_likelihood(log_weights, choose_power(log_weights, 0.0, MIN_TEMPERED_SIZE))


def compute_log_prior(z: Floats) -> Floats:
    """Return ln of the prior's density at logits (n, D): of independent logistic numbers, shape (n,)."""
    sizes = np.abs(z)
    return np.asarray(-(sizes + 2 * np.log1p(np.exp(-sizes))).sum(axis=1))


def propose_differences(z: Floats, blocks: int, rng: np.random.Generator, *, jump_share: float = 0.0) -> tuple[Floats, Floats]:
    """Propose new particles by differential evolution, in one of several blocks of coordinates chosen for each.

    Each particle moves along the difference of two others (ter Braak, Statistics and Computing 16, 2006).

    Parameters
    ----------
    z
        Logits, shape (n, D).
    blocks
        Number of blocks of equal length, of which each particle moves in one.
    rng
        Random numbers.
    jump_share
        Share of the particles that move by the whole difference, which leads from one mode to another.

    Returns
    -------
    tuple[Floats, Floats]
        Candidates, (n, D), and ln of the ratio of the priors, (n,).
    """
    n, dimensions = z.shape
    block = dimensions // blocks
    first, second = np.asarray(rng.integers(n, size=(2, n)))
    scale = np.asarray(2.38 / math.sqrt(2 * block) * rng.uniform(0.2, 1.1, size=n))  # 2.38: the best of a Gaussian
    if jump_share:
        scale[rng.random(n) < jump_share] = 1.0
    difference = scale[:, None] * (z[first] - z[second]) + 1e-3 * rng.standard_normal(z.shape)
    is_moved = np.repeat(np.asarray(rng.integers(blocks, size=n))[:, None] == np.arange(blocks), block, axis=1)
    candidate = np.clip(np.where(is_moved, z + difference, z), -MAX_LOGIT, MAX_LOGIT)
    return candidate, compute_log_prior(candidate) - compute_log_prior(z)


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

    def _compute_costs(self, sets: Floats, orders: Ints) -> Floats:
        """Return the distance of sets (n, m, d) from the medians in each of several orders, shape (orders, n)."""
        scaled = ((sets[:, :, None] - self.medians) / self.spreads) ** 2
        pairs = scaled.sum(axis=-1)  # of tumour j with label k, (n, m, m)
        return np.stack([sum(pairs[:, tumour, label] for label, tumour in enumerate(order)) for order in orders])


def order_labels(sample: Sample) -> Sample:
    """Return a sample of several tumours with their labels nearest to the medians."""
    z = logit(sample.points).reshape(len(sample.points), -1)
    ordered = Labels.from_particles(z, sample.weights, sample.points.shape[1]).order(z)
    return replace(sample, points=expit(ordered).reshape(sample.points.shape))
