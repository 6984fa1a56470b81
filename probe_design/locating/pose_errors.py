"""Infer how far the probe stood from the stated place of each press.

With the error d ~ N(0, P) of the place of reading k, its residuals are r = G d + x u + n to first order, with the
derivatives G of its signals by place, the common errors x u of LO.5, and all else n ~ N(0, N). Given the tumours,

    E d = P G^T V^-1 (r - x E u),   cov d = P - P G^T (V^-1 - V^-1 x C x^T V^-1) G P,   V = N + G P G^T       (LO.7)

with mean E u and covariance C of the common errors. Over the sets of tumours of the posterior means and variances mix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from probe_design.locating.likelihood import Likelihood

UNREAD_VARIANCE = 1e6  # of a channel that is not read: it says nothing, and V can be inverted


@dataclass(frozen=True)
class PoseError:
    """Error of the place of a reading, m: where the probe stood less the stated place.

    Attributes
    ----------
    x, y
        Posterior means.
    x_sd, y_sd
        Posterior standard deviations.
    """

    x: float
    y: float
    x_sd: float
    y_sd: float


def estimate_pose_errors(likelihood: Likelihood, groups: Sequence[Floats], probability: Floats) -> list[PoseError | None]:
    """Return the posterior of the place of each reading, None where the place is exact or of a baseline reading.

    Parameters
    ----------
    likelihood
        Of the readings.
    groups
        Equally probable sets of tumours of each number, none included, shape (n, m, 5) each.
    probability
        Of each number.
    """
    has_error = np.any(likelihood.data.pose_sd > 0, axis=1) & ~likelihood.data.is_baseline
    if not np.any(has_error):
        return [None] * len(has_error)
    parts = [_estimate(likelihood, tumours) for tumours in groups]
    weights = np.concatenate([np.full(len(part), share / len(part)) for part, share in zip(groups, probability, strict=True)])
    means, variances = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    mean = np.einsum("n,nkj->kj", weights, means)
    sd = np.sqrt(np.einsum("n,nkj->kj", weights, variances + (means - mean) ** 2))
    rows = np.hstack([mean, sd]).tolist()
    return [PoseError(*row) if known else None for row, known in zip(rows, has_error.tolist(), strict=True)]


def _estimate(likelihood: Likelihood, tumours: Floats) -> tuple[Floats, Floats]:
    """Return eq. LO.7: mean and variance of each reading's error along x and y for sets (n, m, 5), shape (n, k, 2) each."""
    rows, prior = likelihood.rows, likelihood.data.pose_sd**2
    residuals, variance = likelihood.weigh_readings(tumours)
    common, covariance = likelihood.solve_common(tumours)
    slopes = likelihood.compute_slopes(tumours) if tumours.shape[1] else np.zeros((1, len(prior), 2, 2))
    x = rows.constant + rows.scale * (likelihood.data.values - residuals)[:, None]  # (n, q, k, 2)
    total = np.einsum("nkcj,kj,nkdj->nkcd", slopes, prior, slopes)
    total[..., range(2), range(2)] = np.where(np.isfinite(variance), variance, UNREAD_VARIANCE)  # with the pose error, LO.1
    inverse = np.linalg.inv(total)
    pulls = np.einsum("kj,nkcj,nkcd->nkjd", prior, slopes, inverse)
    offsets = residuals - np.einsum("nq,nqkc->nkc", common, x)
    spread = inverse - np.einsum("nkcd,nqkd,nqp,npke,nkef->nkcf", inverse, x, covariance, x, inverse, optimize=True)
    moved = np.einsum("nkcj,kj->nkcj", slopes, prior)
    variances = prior - np.einsum("nkcj,nkcd,nkdj->nkj", moved, spread, moved)
    return np.einsum("nkjd,nkd->nkj", pulls, offsets), np.maximum(variances, 0.0)
