"""Choose the next place of the probe: the one whose reading is expected to say the most about the tumours.

The expected information of a reading is its mutual information with the tumours: the entropy of its predictive density, a mixture
over particles of the posterior, less the entropy of a reading when the tumours are known. Channels count by themselves and add.
The gain is taken as known, as earlier readings determine it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from probe_design.locating.prior import ForwardModel

ENTROPY_NODES = 80  # at which the predictive density is integrated
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
    """

    x: float
    y: float
    information: float


def build_candidates(region: tuple[tuple[float, float], tuple[float, float]]) -> Floats:
    """Return the grid of candidates in a region ((low x, high x), (low y, high y)), m, shape (k, 2)."""
    axes = [np.unique(np.linspace(low, high, CANDIDATES_PER_AXIS)) for low, high in region]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def compute_information(
    model: ForwardModel, tumours: Floats, probability_none: float, candidates: Floats, variance: Floats
) -> Floats:
    """Return the expected information of one reading at each candidate, nats, shape (k,).

    Parameters
    ----------
    model
        Predicts readings.
    tumours
        Equally probable sets given that there is a tumour, shape (n, m, 5).
    probability_none
        Probability of no tumour.
    candidates
        Places of the probe, m, shape (k, 2).
    variance
        Of a reading of each channel, shape (2,); inf where it is not read.
    """
    signal = model.predict(tumours[:MAX_PARTICLES], candidates)
    weights = np.append(np.full(len(signal), (1 - probability_none) / len(signal)), probability_none)
    total = np.zeros(len(candidates))
    for channel in np.flatnonzero(np.isfinite(variance)):
        means = np.vstack([signal[:, :, channel], np.zeros(len(candidates))])
        sd = float(np.sqrt(variance[channel]))
        low, high = means.min(axis=0) - 5 * sd, means.max(axis=0) + 5 * sd
        # a wide range with a narrow noise needs more nodes: at least two per standard deviation
        count = int(np.clip(2 * (high - low).max() / sd, ENTROPY_NODES, 8 * ENTROPY_NODES))
        y = low + (high - low) * np.linspace(0, 1, count)[:, None]
        density = np.zeros_like(y)
        for weight, mean in zip(weights, means, strict=True):
            density += weight * np.exp(-(((y - mean) / sd) ** 2) / 2)
        density /= sd * np.sqrt(2 * np.pi)
        entropy = -np.trapezoid(density * np.log(np.maximum(density, 1e-300)), y, axis=0)
        total += np.maximum(entropy - (LOG_2PI_E / 2 + np.log(sd)), 0.0)
    return total


def choose_position(
    model: ForwardModel, tumours: Floats, probability_none: float, candidates: Floats, variance: Floats
) -> NextPosition:
    """Return the candidate with the most expected information, see ``compute_information``."""
    information = compute_information(model, tumours, probability_none, candidates, variance)
    best = int(np.argmax(information))
    return NextPosition(float(candidates[best, 0]), float(candidates[best, 1]), float(information[best]))
