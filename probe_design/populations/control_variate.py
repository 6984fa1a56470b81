"""Reduce the sampling error of a verification with the closed form as control variate, evaluated for many more tumours.

The verifying evaluator takes seconds for some tens of tumours, the closed form one second for hundreds. P_i are the probabilities
of detection of n verified tumours, c_i those of the closed form for the same tumours under the same draws, and C_k those of the
closed form for N other tumours of the population. The estimate

    P = 1/n sum_i (P_i - c_i) + 1/N sum_k C_k                                                      (PO.10)

has the mean of P_i, however accurate the closed form is. The standard errors of both parts are independent: the first is small
where the closed form is accurate, the second where N is large. The coefficient of the control is 1: fitting it to the n tumours
would bias it.

Few tumours that happen to be alike (two of two detected) have a plain standard error of nearly 0, which does not describe the
population. The error of the plain mean is therefore at least that of n tumours with the scatter of the many C_k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from probe_design.populations.closed_form_scan import compute_closed_form_readings
from probe_design.populations.detection import Detector
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.tables import Objective, Protocol

MIN_CONTROL_TUMOURS, MAX_CONTROL_TUMOURS = 256, 4096  # other tumours that the closed form evaluates in a verification
CONTROL_TUMOURS_PER_TUMOUR = 6
CONTROL_TISSUES, SCANS_PER_CONTROL_TUMOUR = 32, 64  # their tissues, and scans over each tumour


@dataclass(frozen=True)
class ControlSample:
    """Values by the closed form: signals with one more axis for the m readings, or probabilities of detection.

    Attributes
    ----------
    same_tumours
        Values of the n verified tumours, shape (n,) or (n, m).
    other_tumours
        Values of N others, used neither in the verification nor by the detector or a search, shape (N,) or (N, m).
    tissue
        Number of the tissue of each of these others, shape (N,).
    """

    same_tumours: Floats
    other_tumours: Floats
    tissue: Ints

    @classmethod
    def from_draw(cls, protocol: Protocol, population: ScenePopulation, draw: TumourDraw) -> ControlSample:
        """Compute the signals. Raises ``Refusal`` where the closed form fails for the scene's probe."""
        count = min(max(MIN_CONTROL_TUMOURS, CONTROL_TUMOURS_PER_TUMOUR * len(draw)), MAX_CONTROL_TUMOURS)
        control_draw = replace(population, seed=population.seed + 2).draw_tumours(count, unseen=True, tissues=CONTROL_TISSUES)
        same, others = (compute_closed_form_readings(tumours, protocol).signal for tumours in (draw, control_draw))
        return cls(same, others, control_draw.tissue)

    def select_readings(self, columns: Ints) -> ControlSample:
        """Return the signals of some of the readings, by number."""
        return ControlSample(self.same_tumours[:, columns], self.other_tumours[:, columns], self.tissue)

    def compute_probabilities(self, detector: Detector) -> ControlSample:
        """Return the probabilities of detection from signals, under the same draws as those of the verified tumours."""
        same = detector.compute_probabilities(self.same_tumours)
        others = detector.compute_probabilities(self.other_tumours, scans=SCANS_PER_CONTROL_TUMOUR)
        return ControlSample(same, others, self.tissue)

    def subtract(self, reference: ControlSample) -> ControlSample:
        """Return the difference of the values of two probes for the same tumours."""
        same, others = self.same_tumours - reference.same_tumours, self.other_tumours - reference.other_tumours
        return ControlSample(same, others, self.tissue)


def estimate_statistic(values: Floats, tissue: Ints, objective: Objective, control: ControlSample | None) -> tuple[float, float]:
    """Return the statistic of n tumours and its standard error; for a mean, by eq. PO.10 where its error is smaller.

    Parameters
    ----------
    values
        Values of the tumours, shape (n,).
    tissue
        Number of each tumour's tissue, shape (n,).
    objective
        Objective that defines the statistic.
    control
        Probabilities by the closed form, or None.
    """
    plain = objective.compute_statistic(values), objective.compute_error(values, tissue)
    if control is None or objective.statistic != "mean":
        return plain
    plain = plain[0], max(plain[1], float(np.std(control.other_tumours, ddof=1)) / math.sqrt(len(values)))
    differences = values - control.same_tumours
    error = math.hypot(
        objective.compute_error(differences, tissue), objective.compute_error(control.other_tumours, control.tissue)
    )
    return (float(np.mean(differences) + np.mean(control.other_tumours)), error) if error < plain[1] else plain
