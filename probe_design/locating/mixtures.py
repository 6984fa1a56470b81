"""Fit mixtures of Student densities to weighted particles: proposals of importance sampling.

    q(z) = a p(z) + (1 - a) sum_k c_k t_nu(z; m_k, C_k)                                            (LO.3)

with the prior p as a guard. The components are fitted by expectation maximisation (Cappe and others, Adaptive importance sampling
in general mixture classes, Statistics and Computing 18, 2008). Labels of several tumours are arbitrary: q is averaged over all
their orders.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy.special import gammaln

from geometry.common.arrays import Floats
from probe_design.locating.rounds import Proposal
from probe_design.locating.samples import MAX_LOGIT, choose_systematically, compute_log_prior, log_sum_exp

FREEDOM = 6  # nu: tails heavier than those of a posterior, and near those of the logistic prior in logits
PRIOR_SHARE = 0.05  # a: bounds every weight by twenty times that of the prior
FITTED_PARTICLES = 1024  # to which a mixture of up to 20 components is fitted, chosen among more
FIT_STEPS = 10  # of expectation maximisation: more change the effective sample size by less than its scatter
SPREAD_FACTOR = 1.15  # of the fitted covariances, so that the proposal is wider than the particles
ROWS_AT_ONCE = 1024  # particles whose distances from all components fit the processor's cache
MIN_VARIANCE = 1e-6  # of logits: keeps covariances of a quantity that the readings fix


@dataclass(frozen=True)
class StudentMixture:
    """Eq. LO.3.

    Attributes
    ----------
    shares
        c_k, shape (K,).
    means
        m_k, shape (K, D).
    factors
        Cholesky factors of C_k, shape (K, D, D).
    """

    shares: Floats
    means: Floats
    factors: Floats

    @classmethod
    def fit(
        cls, z: Floats, weights: Floats, count: int, rng: np.random.Generator, *, particles: int = FITTED_PARTICLES
    ) -> StudentMixture:
        """Fit to particles in logits, shape (n, D).

        Parameters
        ----------
        z, weights
            Particles, and their weights, which sum to 1, shape (n,).
        count
            Number of components.
        rng
            Random numbers.
        particles
            To which the mixture is fitted, chosen among more.
        """
        dimensions, size = z.shape[1], 1 / float(weights @ weights)
        if len(z) > particles:
            z = z[choose_systematically(weights, particles, rng)]
            weights = np.full(particles, 1 / particles)
        z = np.clip(z, -MAX_LOGIT, MAX_LOGIT)
        middle = weights @ z
        z = z - middle  # so that differences of products below keep their digits
        products = (z[:, :, None] * z[:, None]).reshape(len(z), -1)
        whole = (weights @ products).reshape(dimensions, dimensions) + MIN_VARIANCE * np.eye(dimensions)
        narrow = whole * count ** (-2 / dimensions)
        pseudo = (dimensions + 2) / size / 2  # of the prior's weight on each covariance
        mixture = cls(
            np.full(count, 1 / count), z[choose_systematically(weights, count, rng)],
            np.repeat(np.linalg.cholesky(narrow)[None], count, axis=0),
        )  # fmt: skip
        for _ in range(FIT_STEPS):
            squares = mixture._compute_squares(z)
            log_parts = mixture._compute_log_components(squares)
            parts = np.exp(log_parts - log_sum_exp(log_parts, axis=0)) * weights
            pulls = parts * (FREEDOM + dimensions) / (FREEDOM + squares)
            shares = np.maximum(parts.sum(axis=1), 1e-12)
            moved = pulls @ z
            means = moved / np.maximum(pulls.sum(axis=1), 1e-300)[:, None]
            crossed = means[:, :, None] * moved[:, None]
            totals = (pulls @ products).reshape(count, dimensions, dimensions) - crossed - crossed.transpose(0, 2, 1)
            totals += pulls.sum(axis=1)[:, None, None] * means[:, :, None] * means[:, None]  # of squared deviations
            # towards the mean of all: thin and curved posteriors are thin everywhere
            narrow = totals.sum(axis=0) / shares.sum() + MIN_VARIANCE * np.eye(dimensions)
            covariances = (totals + pseudo * narrow) / (shares + pseudo)[:, None, None]
            mixture = cls(shares / shares.sum(), means, np.linalg.cholesky(covariances))
        return cls(mixture.shares, mixture.means + middle, mixture.factors * math.sqrt(SPREAD_FACTOR))

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return logits, shape (count, D)."""
        dimensions = self.means.shape[1]
        chosen = choose_systematically(self.shares, count, rng)
        radius = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, size=count))
        steps = np.einsum("nij,nj->ni", self.factors[chosen], rng.standard_normal((count, dimensions)))
        z = self.means[chosen] + radius[:, None] * steps
        is_prior = rng.random(count) < PRIOR_SHARE
        z[is_prior] = rng.logistic(size=(int(is_prior.sum()), dimensions))
        return np.asarray(np.clip(z, -MAX_LOGIT, MAX_LOGIT))

    def compute_log_density(self, z: Floats, log_prior: Floats | None = None) -> Floats:
        """Return ln q at logits (n, D), shape (n,); ``log_prior`` is that of the prior there, where it is known."""
        log_prior = compute_log_prior(z) if log_prior is None else log_prior
        with np.errstate(divide="ignore"):  # ln 0 far from all components, where the prior alone is left
            kernels = np.log(self._sum_components(z)) + self._log_constants.max()
        return np.asarray(np.logaddexp(math.log(PRIOR_SHARE) + log_prior, math.log1p(-PRIOR_SHARE) + kernels))

    def _sum_components(self, z: Floats) -> Floats:
        """Return sum_k c_k t_nu(z) over the largest constant of a component, shape (n,), without logarithms of each."""
        weights = np.exp(self._log_constants - self._log_constants.max())
        whole, half = divmod(FREEDOM + self.means.shape[1], 2)
        total = np.empty(len(z))
        for start in range(0, len(z), ROWS_AT_ONCE):
            inverse = self._compute_squares(z[start : start + ROWS_AT_ONCE])
            inverse /= FREEDOM
            inverse += 1
            np.reciprocal(inverse, out=inverse)
            power = raise_to(inverse, whole)
            if half:
                power *= np.sqrt(inverse, out=inverse)
            total[start : start + ROWS_AT_ONCE] = weights @ power
        return total

    def _compute_squares(self, z: Floats) -> Floats:
        """Return the squared distances from the components in their own units, shape (K, n)."""
        # one product for all components, whose sums run along contiguous rows
        inverses, origins = self._inverses
        scaled = inverses @ z.T
        scaled -= origins
        scaled *= scaled
        return np.asarray(scaled.reshape(*self.means.shape, -1).sum(axis=1))

    @cached_property
    def _inverses(self) -> tuple[Floats, Floats]:
        """Inverses of the Cholesky factors, one below the other, (K D, D), and these times the means, (K D, 1)."""
        inverses: Floats = np.linalg.inv(self.factors).astype(float)
        origins = np.einsum("kij,kj->ki", inverses, self.means).reshape(-1, 1)
        return inverses.reshape(-1, self.means.shape[1]), origins

    @cached_property
    def _log_constants(self) -> Floats:
        """Ln of c_k t_nu at the mean of each component, shape (K,)."""
        dimensions = self.means.shape[1]
        log_volume = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)
        constant = gammaln((FREEDOM + dimensions) / 2) - gammaln(FREEDOM / 2) - dimensions / 2 * math.log(FREEDOM * math.pi)
        return np.asarray(np.log(self.shares) + constant - log_volume)

    def _compute_log_components(self, squares: Floats) -> Floats:
        """Return ln c_k t_nu(z), shape (K, n)."""
        half = (FREEDOM + self.means.shape[1]) / 2
        return np.asarray(self._log_constants[:, None] - half * np.log1p(squares / FREEDOM))


def raise_to(values: Floats, power: int) -> Floats:
    """Return a whole power of an array by products."""
    result, square = np.ones_like(values), values
    while power:
        if power & 1:
            result = result * square
        power >>= 1
        if power:
            square = square * square
    return result


@dataclass(frozen=True)
class SetProposal:
    """Proposal for sets of several tumours: half of the sets from a mixture over all their coordinates, half with each by itself.

    Attributes
    ----------
    joint
        Mixture over sets.
    single
        Mixtures over each tumour by itself: what one of them does is then not tied to the others.
    """

    joint: StudentMixture
    single: tuple[StudentMixture, ...]

    @classmethod
    def fit(
        cls, z: Floats, weights: Floats, count: int, rng: np.random.Generator, *, number: int, particles: int = FITTED_PARTICLES
    ) -> SetProposal:
        """Fit to particles in logits, shape (n, D), whose tumours are in order, see ``StudentMixture.fit``."""
        joint, *single = (
            StudentMixture.fit(part, weights, count, rng, particles=particles) for part in (z, *np.split(z, number, axis=1))
        )
        return cls(joint, tuple(single))

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return logits, shape (count, D)."""
        half = count // 2
        single = [part.draw(count - half, rng) for part in self.single]
        return np.concatenate([self.joint.draw(half, rng), np.concatenate([rng.permutation(part) for part in single], axis=1)])

    def compute_log_density(self, z: Floats) -> Floats:
        """Return ln q at logits (n, D), averaged over the orders of the tumours, shape (n,)."""
        number = len(self.single)
        sets, orders = z.reshape(len(z), number, -1), list(permutations(range(number)))
        log_priors = [compute_log_prior(sets[:, tumour]) for tumour in range(number)]
        log_prior = np.sum(log_priors, axis=0)
        joint = [self.joint.compute_log_density(sets[:, order].reshape(z.shape), log_prior) for order in orders]
        parts = [
            [part.compute_log_density(sets[:, tumour], log_priors[tumour]) for tumour in range(number)] for part in self.single
        ]
        single = [sum(parts[label][tumour] for label, tumour in enumerate(order)) for order in orders]
        return log_sum_exp(np.stack([*joint, *single]), axis=0) - math.log(2 * len(orders))


@dataclass(frozen=True)
class ExtendedProposal:
    """Proposal for sets of several tumours: sets of one tumour less, and one more that is not tied to them.

    A tumour that the readings hardly show may lie anywhere beside those that they show.

    Attributes
    ----------
    fewer
        For sets of one tumour less; its density does not depend on their order.
    single
        For the tumour that is added.
    """

    fewer: Proposal
    single: StudentMixture

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return logits, shape (count, D)."""
        return np.concatenate([rng.permutation(self.fewer.draw(count, rng)), self.single.draw(count, rng)], axis=1)

    def compute_log_density(self, z: Floats) -> Floats:
        """Return ln q at logits (n, D), averaged over which tumour is the added one, shape (n,)."""
        sets = z.reshape(len(z), -1, self.single.means.shape[1])
        number = sets.shape[1]
        parts = [
            self.fewer.compute_log_density(np.delete(sets, tumour, axis=1).reshape(len(z), -1))
            + self.single.compute_log_density(sets[:, tumour])
            for tumour in range(number)
        ]
        return log_sum_exp(np.stack(parts), axis=0) - math.log(number)


@dataclass(frozen=True)
class CombinedProposal:
    """Equal parts of several proposals.

    Attributes
    ----------
    parts
        The proposals.
    """

    parts: tuple[Proposal, ...]

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return logits, shape (count, D); count is a multiple of the number of parts."""
        return np.concatenate([part.draw(count // len(self.parts), rng) for part in self.parts])

    def compute_log_density(self, z: Floats) -> Floats:
        """Return ln q at logits (n, D), shape (n,)."""
        densities = [part.compute_log_density(z) for part in self.parts]
        return log_sum_exp(np.stack(densities), axis=0) - math.log(len(self.parts))
