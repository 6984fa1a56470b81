"""Choose the next place of the probe, and its load: those whose reading is expected to say the most about the tumours.

The expected information of a reading is its mutual information with the tumours: the entropy of its predictive density, a mixture
over particles of the posterior, less the entropy of a reading when the tumours are known. Channels count by themselves and add.
Each particle predicts a normal reading: its signal plus the common errors as far as earlier readings determine them, with the
variances of noise, common errors, pose and model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from probe_design.locating.likelihood import Likelihood

ENTROPY_NODES, MAX_ENTROPY_NODES = 80, 400  # at which the predictive density is integrated
MIN_SHARE = 1e-4  # probability of a number of tumours below which it is left out
MAX_PARTICLES = 300  # of the predictive mixture: more change the best place by less than the grid
CANDIDATES_PER_AXIS = 9  # candidates along x, and along y, within a region
LOG_2PI_E = 1 + float(np.log(2 * np.pi))  # twice the entropy of a normal number with variance 1


@dataclass(frozen=True)
class NextPosition:
    """The best place of the next reading.

    Attributes
    ----------
    x, y
        Of the probe's axis, m.
    information
        Expected information of a reading there, nats.
    force
        Under which it is read, N; None for the scene's load.
    """

    x: float
    y: float
    information: float
    force: float | None = None


@dataclass(frozen=True)
class CandidateLoad:
    """A load of the next reading.

    Attributes
    ----------
    force
        On the probe, N; None for the scene's load.
    weights, spreads
        Weights of the l loads of the models in its signal, and in the error of that, eq. LO.6, shape (l,) each.
    variance
        Of a reading of each channel by noise, shape (2,); inf where it is not read.
    """

    force: float | None
    weights: Floats
    spreads: Floats
    variance: Floats


def build_candidates(region: tuple[tuple[float, float], tuple[float, float]]) -> Floats:
    """Return the grid of candidates in a region ((low x, high x), (low y, high y)), m, shape (k, 2)."""
    axes = [np.unique(np.linspace(low, high, CANDIDATES_PER_AXIS)) for low, high in region]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def compute_information(means: Floats, variances: Floats, weights: Floats) -> Floats:
    """Return the expected information of one reading at each candidate, nats, shape (k,).

    Parameters
    ----------
    means, variances
        Of the reading by each particle, shape (n, k).
    weights
        Of the particles, which sum to 1, shape (n,).
    """
    sd = np.sqrt(variances)
    low, high = (means - 5 * sd).min(axis=0), (means + 5 * sd).max(axis=0)
    # a wide range with a narrow noise needs more nodes: at least one for each standard deviation
    count = int(np.clip(((high - low) / sd.min(axis=0)).max(), ENTROPY_NODES, MAX_ENTROPY_NODES))
    y = low + (high - low) * np.linspace(0, 1, count)[:, None]
    density = np.zeros_like(y)
    for weight, mean, spread in zip(weights.tolist(), means, sd, strict=True):
        density += weight / spread * np.exp(-(((y - mean) / spread) ** 2) / 2)
    density /= np.sqrt(2 * np.pi)
    entropy = -np.trapezoid(density * np.log(np.maximum(density, 1e-300)), y, axis=0)
    return np.asarray(np.maximum(entropy - LOG_2PI_E / 2 - weights @ np.log(sd), 0.0))


def choose_position(
    likelihood: Likelihood, groups: Sequence[Floats], probability: Floats, options: Sequence[tuple[CandidateLoad, Floats]]
) -> NextPosition:
    """Return the candidate with the most expected information, the first of those that are equal.

    Parameters
    ----------
    likelihood
        Of the readings so far.
    groups
        Equally probable sets of tumours of each number above 0, shape (n, m, 5) each.
    probability
        Of no tumour, one and so on.
    options
        Loads, and places of the probe under each, m, shape (k, 2).
    """
    return max(
        (_choose_place(likelihood, groups, probability, load, places) for load, places in options),
        key=lambda position: position.information,
    )


def _choose_place(
    likelihood: Likelihood, groups: Sequence[Floats], probability: Floats, load: CandidateLoad, candidates: Floats
) -> NextPosition:
    """Return the place, of candidates (k, 2), with the most expected information under one load."""
    parts: list[tuple[Floats, Floats, Floats]] = []
    for tumours, share in zip([np.zeros((1, 0, 5)), *groups], probability.tolist(), strict=True):
        count = max(1, min(len(tumours), round(MAX_PARTICLES * share)))
        if share > MIN_SHARE:
            chosen = tumours[:: len(tumours) // count][:count]
            mean, spread = _predict_reading(likelihood, chosen, candidates, load)
            parts.append((mean, spread, np.full(count, share / count)))
    mean, spread, weight = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    information = np.zeros(len(candidates))
    for channel in np.flatnonzero(np.isfinite(load.variance)):
        information += compute_information(mean[:, :, channel], spread[:, :, channel], weight / weight.sum())
    best = int(np.argmax(information))
    return NextPosition(float(candidates[best, 0]), float(candidates[best, 1]), float(information[best]), load.force)


def _predict_reading(likelihood: Likelihood, tumours: Floats, candidates: Floats, load: CandidateLoad) -> tuple[Floats, Floats]:
    """Return mean and variance of a reading at each candidate for sets of tumours (n, m, 5), shape (n, k, 2) each."""
    data, k = likelihood.data, len(candidates)
    means, covariances = likelihood.solve_common(tumours)
    pose_sd = data.pose_sd.mean(axis=0) if len(data) else np.zeros(2)
    next_data = replace(
        data, positions=candidates, values=np.zeros((k, 2)), variance=np.tile(load.variance, (k, 1)),
        pose_sd=np.tile(pose_sd, (k, 1)), is_baseline=np.zeros(k, dtype=bool), weights=np.tile(load.weights, (k, 1)),
        spreads=np.tile(load.spreads, (k, 1)),
    )  # fmt: skip
    following = replace(likelihood, data=next_data)
    residuals, spread = following.compute_residuals(tumours, with_scale=False)
    x = following.rows.constant[None] - following.rows.scale * residuals[:, None]  # a + b s of LO.5, (n, q, k, 2)
    spread += np.einsum("nqkc,nqp,npkc->nkc", x, covariances, x, optimize=True)
    return np.einsum("nq,nqkc->nkc", means, x) - residuals, spread
