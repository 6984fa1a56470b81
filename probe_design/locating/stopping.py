"""Decide when a survey may stop.

It stops where no tumour is improbable; where it is improbable that tumours lie there which the whole scan of the protocol, a grid
of its positions along x and y under each of its loads, would detect with a probability of 0.9 (the detector of eq. PO.4); or
where no further reading is expected to say anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from geometry.common.arrays import Floats
from probe_design.locating.common_errors import Rows
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.next_position import CandidateLoad
from probe_design.locating.prior import ForwardModel
from probe_design.populations.design_file import Design
from probe_design.populations.detection import Detector, whiten

PROBABILITY_NONE = 0.01  # of no tumour, below which a survey stops
DETECTABLE_PROBABILITY = 0.01  # of tumours that the scan detects, below which a survey stops: as many such stops are wrong
DETECTION = 0.9  # probability with which the scan detects these tumours
MIN_INFORMATION_NATS = 0.003  # expected of the best next reading: below it nothing more is learnt within a hundred readings
MAX_LINE_POSITIONS = 9  # of the protocol's positions that the grid uses along each axis
REFERENCE_TUMOURS, FREE_SCANS, SCANS_PER_TUMOUR = 512, 8192, 64  # of the detector: its 0.9 is then known to 0.02
NEIGHBOURS = 41  # tumours of similar deflection over which detection is averaged

Reason = Literal["tumour", "none", "nothing to learn", "presses", "recordings"]


@dataclass(frozen=True)
class Stop:
    """Why a survey stops.

    Attributes
    ----------
    reason
        "tumour": no tumour is improbable; "none": tumours that the scan would detect are improbable; "nothing to learn";
        "presses": as many as requested are made; "recordings": all are read.
    text
        The same in a sentence.
    """

    reason: Reason
    text: str


def find_stop(
    probability_none: float, detectable: float, information: float, limit: float = DETECTABLE_PROBABILITY
) -> Stop | None:
    """Return why a survey may stop, or None.

    Parameters
    ----------
    probability_none
        Probability of no tumour.
    detectable
        Probability that tumours lie there which the scan detects with a probability of 0.9.
    information
        Expected of the best next reading, nats.
    limit
        Probability of these tumours below which a survey stops.
    """
    if probability_none < PROBABILITY_NONE:
        return Stop("tumour", f"a tumour lies there: the probability of none is {probability_none:.1g}, below 0.01")
    if detectable < limit:
        text = f"a tumour that the scan would detect (90 %) lies there with a probability of {detectable:.2g}, below {limit:g}"
        return Stop("none", text)
    if information < MIN_INFORMATION_NATS:
        return Stop("nothing to learn", f"the best next reading is expected to say {information:.1g} nats: nothing more to learn")
    return None


@dataclass(frozen=True)
class PlannedScan:
    """The scan of a protocol: a grid of readings and a baseline reading.

    Attributes
    ----------
    models
        Predict signals, one at each load of the tables, shape (l,).
    weights
        Weights of these in the signals under each load of the protocol, shape (p, l).
    positions
        Of the readings under each load, m, shape (k, 2).
    channels
        Indices of those that are read.
    detector
        That of eq. PO.4.
    deflection
        Deflection of the readings, above which tumours are detected with a probability of 0.9; inf if none are.
    """

    models: tuple[ForwardModel, ...]
    weights: Floats
    positions: Floats
    channels: tuple[int, ...]
    detector: Detector
    deflection: float

    @classmethod
    def from_design(cls, design: Design, likelihood: Likelihood, loads: Sequence[CandidateLoad]) -> PlannedScan:
        """Train the detector on single tumours of the population, under one load.

        Parameters
        ----------
        design
            For its protocol.
        likelihood
            For its models and common errors.
        loads
            Under each of which every place is read.
        """
        lines = design.protocol.places
        chosen = lines[np.unique(np.linspace(0, len(lines) - 1, min(len(lines), MAX_LINE_POSITIONS)).round().astype(int))]
        positions = np.stack(np.meshgrid(chosen, chosen), axis=-1).reshape(-1, 2)
        variance, weights = (np.stack([getattr(load, name) for load in loads]) for name in ("variance", "weights"))
        channels, k = tuple(np.flatnonzero(np.isfinite(variance[0])).tolist()), len(positions) + design.protocol.blank
        # common errors of the readings without tumours: one row for each reading, load by load, channel by channel
        constant = Rows.from_errors(likelihood.common_errors, weights).constant[:, :, list(channels)]
        common = np.repeat(constant.reshape(len(constant), -1), k, axis=1)
        covariance = np.diag(np.repeat(variance[:, list(channels)], k)) + common.T @ common
        prior = likelihood.prior
        tumours = prior.transform(prior.draw(REFERENCE_TUMOURS, 1, 2))
        tumours = tumours[prior.find_allowed(tumours)]
        untrained = Detector(np.eye(1), np.zeros((1, 1)), 0.5, 0.0, 0.5, 0.0)
        draft = cls(likelihood.models, weights, positions, channels, untrained, np.inf)
        signals = draft._predict(tumours, design.protocol.blank)
        detector = Detector.train(signals, covariance, design.protocol.false_alarm, blanks=FREE_SCANS)
        probabilities = detector.compute_probabilities(signals, scans=SCANS_PER_TUMOUR)
        deflections = np.linalg.norm(whiten(detector.factor, signals), axis=1)
        return replace(draft, detector=detector, deflection=_find_crossing(deflections, probabilities))

    def compute_detected_fraction(self, tumours: Floats) -> float:
        """Return the fraction of sets of tumours (n, m, 5) that the scan detects with a probability of 0.9 or more."""
        has_baseline = len(self.detector.factor) > len(self.weights) * len(self.channels) * len(self.positions)
        deflections = np.linalg.norm(whiten(self.detector.factor, self._predict(tumours, has_baseline)), axis=1)
        return float(np.mean(deflections >= self.deflection))

    def _predict(self, tumours: Floats, has_baseline: bool) -> Floats:
        """Return the signals load by load, channel by channel, with those of the baseline readings, 0; shape (n, m)."""
        signals = np.zeros((len(self.weights), len(tumours), len(self.positions), 2))
        for model, weights in zip(self.models, self.weights.T, strict=True):
            if np.any(weights):
                signals += weights[:, None, None, None] * model.predict(tumours, self.positions)
        blank = np.zeros((len(tumours), int(has_baseline)))
        return np.hstack([part for signal in signals for channel in self.channels for part in (signal[:, :, channel], blank)])


def _find_crossing(deflections: Floats, probabilities: Floats) -> float:
    """Return the deflection above which tumours are detected with ``DETECTION`` in the mean of similar ones; inf if none are."""
    order = np.argsort(deflections)
    count = min(NEIGHBOURS, len(order))
    smooth = np.convolve(probabilities[order], np.full(count, 1 / count), mode="valid")
    middles = np.convolve(deflections[order], np.full(count, 1 / count), mode="valid")
    below = np.flatnonzero(smooth < DETECTION)
    first = below[-1] + 1 if len(below) else 0
    return float(middles[first]) if first < len(middles) else float("inf")
