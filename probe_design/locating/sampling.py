"""Draw sets of tumours from the posterior, and compute the evidence of their number.

All sampling is in z = logit u of the cube's coordinates u. Importance sampling has weights L(z) p(z) / q(z), whose mean is the
evidence without bias for any proposal q that is nowhere 0, eq. LO.3. One tumour starts from a Sobol sample of the prior, whose
tempered weights a mixture fits, then round after round those of all the last rounds; several tumours see ``several``.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import expit, logit

from geometry.common.arrays import Floats
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.mixtures import StudentMixture
from probe_design.locating.rounds import Rounds, weigh
from probe_design.locating.samples import Sample, compute_effective_size, log_sum_exp, soften_weights
from probe_design.locating.several import Pool, draw_several

START_SIZE = 2**13  # of the Sobol sample of the prior for one tumour
ROUND_SIZE, LAST_SIZE = 2048, 4096  # samples of a round, and of the last one
COMPONENTS, LATE_COMPONENTS, LATE_ROUND = 10, 20, 4  # of the mixture, from a round on: many rounds tell of a curved posterior
MAX_ROUNDS = 20  # of adaptation: one tumour needs 1 to 4 with 25 readings of 1 %, 10 with 400 of 0.3 %
GOOD_SIZE_RELATIVE = 0.2  # effective sample size of a round, of its samples, after which the last one follows
GOOD_SIZE = 1000.0  # effective sample size at which a round is good enough


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
        Ln likelihood of the first Sobol sample of one tumour, shape (n,), where it is computed before.
    """
    return draw_posteriors(likelihood, number, seed, start)[-1]


def draw_posteriors(likelihood: Likelihood, largest: int, seed: int, start: Floats | None = None) -> tuple[Sample, ...]:
    """Return samples of one tumour, two and so on up to ``largest``, see ``draw_posterior``."""
    samples = [_draw_single(likelihood, seed, start)] if largest else []
    if largest > 1 and not likelihood.prior.free:
        return (*samples, *(_weigh_only_set(likelihood, number) for number in range(2, largest + 1)))
    if largest > 1:
        pool = Pool.from_sample(likelihood, samples[0], seed)
    for number in range(2, largest + 1):
        sample, pool = draw_several(likelihood, number, seed, pool)
        samples.append(sample)
    return tuple(samples)


def _weigh_only_set(likelihood: Likelihood, number: int) -> Sample:
    """Return the sample of a population without freedom: one set."""
    points = np.zeros((1, number, 0))
    return Sample(points, np.zeros(1), float(likelihood.evaluate(points)[0]), math.inf)


def _draw_single(likelihood: Likelihood, seed: int, start: Floats | None) -> Sample:
    """Return the sample of one tumour."""
    rng = np.random.default_rng((seed, 1))
    points = likelihood.prior.draw(START_SIZE, 1, seed)
    log_weights = likelihood.evaluate(points) if start is None else start
    dimensions = points.shape[-1]
    log_fraction = math.log(likelihood.prior.compute_allowed_fraction(1))

    def evaluate(z: Floats) -> Floats:
        """Return ln likelihood at logits, shape (n, d)."""
        return likelihood.evaluate(expit(z)[:, None])

    size = compute_effective_size(log_weights)
    if np.any(np.isfinite(log_weights)) and dimensions and size < GOOD_SIZE:
        mixture = StudentMixture.fit(logit(points[:, 0]), soften_weights(log_weights), COMPONENTS, rng)
        rounds = Rounds()
        for round_number in range(MAX_ROUNDS):
            is_last = round_number == MAX_ROUNDS - 1 or (round_number > 0 and size >= GOOD_SIZE_RELATIVE * ROUND_SIZE)
            drawn = weigh(evaluate, mixture, LAST_SIZE if is_last else ROUND_SIZE, rng)
            points, log_weights, size = expit(drawn.z)[:, None], drawn.log_weights, drawn.size
            if is_last and size >= GOOD_SIZE / 2:  # otherwise a region that the mixture missed has large weights: fit it, too
                break
            rounds = rounds.add(drawn)
            z, joined = rounds.join()
            count = COMPONENTS if round_number < LATE_ROUND else LATE_COMPONENTS
            mixture = StudentMixture.fit(z, soften_weights(joined), count, rng)
    total = float(log_sum_exp(log_weights))
    return Sample(points, log_weights - total, total - math.log(len(log_weights)) - log_fraction, size)
