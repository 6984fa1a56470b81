"""The sample's error made smaller: the formulas, asked of many more tumours, tell how far the judged ones are from all.

The verifying evaluator takes seconds for some tens of tumours, the formulas one for hundreds. Their probabilities c_i of the same
tumours under the same draws differ little from the judge's P_i, so that with C_k those of N others of the population

    P = 1/n sum_i (P_i - c_i) + 1/N sum_k C_k                                                      (PO.10)

has the same mean, whatever the formulas are worth, and as its standard errors those of both parts, which are independent: the
first is small where the formulas are good, the second where N is large. The coefficient of the control is 1 and not fitted to
the n tumours, which would bias it.

Few tumours that happen to be alike (two of two detected) have a plain standard error of nearly 0, which says nothing of the
population. The plain mean's error is therefore at least what n tumours leave by the scatter of the many C_k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.scenes.scene import Scene
from probe_design.populations.closed_form_scan import ClosedFormScan
from probe_design.populations.detection import Detector
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.tables import Objective, Protocol

MIN_CONTROL_TUMOURS, MAX_CONTROL_TUMOURS = (
    256,
    4096,
)  # tumours of which the formulas are asked beside a judge, at least and at most
CONTROL_TUMOURS_PER_TUMOUR = 6  # as many as the judged ones, so that more of these make both parts' errors smaller
CONTROL_TISSUES, SCANS_PER_CONTROL_TUMOUR = 32, 64  # their tissues, scans over each


@dataclass(frozen=True)
class ControlVariate:
    """What the formulas say.

    Attributes:
        same_tumours: of the n judged tumours, c_i, shape (n,).
        other_tumours: of N others, C_k, shape (N,).
        tissue: numbers of the tissues of these, shape (N,).
    """

    same_tumours: Floats
    other_tumours: Floats
    tissue: Ints

    def subtract(self, reference: ControlVariate) -> ControlVariate:
        """Return what the formulas say of the difference of two probes for the same tumours."""
        return ControlVariate(
            self.same_tumours - reference.same_tumours, self.other_tumours - reference.other_tumours, self.tissue
        )


@dataclass(frozen=True)
class ControlSignals:
    """Signals by the formulas.

    Attributes:
        same_tumours: of the n judged tumours, shape (n, m).
        other_tumours: of ``MIN_CONTROL_TUMOURS`` others or more, not the judge's, the detector's or a search's,
            shape (N, m).
        tissue: numbers of the tissues of these, shape (N,).
    """

    same_tumours: Floats
    other_tumours: Floats
    tissue: Ints

    @classmethod
    def from_draw(cls, scene: Scene, protocol: Protocol, population: ScenePopulation, draw: TumourDraw) -> ControlSignals:
        """Ask the formulas; raises ``Refusal`` where they break down for the scene's probe."""
        count = min(max(MIN_CONTROL_TUMOURS, CONTROL_TUMOURS_PER_TUMOUR * len(draw)), MAX_CONTROL_TUMOURS)
        control_draw = replace(population, seed=population.seed + 2).draw_tumours(count, unseen=True, tissues=CONTROL_TISSUES)
        same_tumours, other_tumours = (
            ClosedFormScan.from_draw(tumour_draw, protocol).compute_readings(scene).signal for tumour_draw in (draw, control_draw)
        )
        return cls(same_tumours, other_tumours, control_draw.tissue)

    def select_readings(self, columns: Ints) -> ControlSignals:
        """Return some of the readings, by number."""
        return ControlSignals(self.same_tumours[:, columns], self.other_tumours[:, columns], self.tissue)

    def compute_probabilities(self, detector: Detector, seed: int) -> ControlVariate:
        """Return how often a detector finds them, under the draws that the judged tumours are found under."""
        same_tumours = detector.compute_probabilities(self.same_tumours, seed=seed)
        return ControlVariate(
            same_tumours,
            detector.compute_probabilities(self.other_tumours, seed=seed, scans=SCANS_PER_CONTROL_TUMOUR),
            self.tissue,
        )


def estimate_statistic(values: Floats, tissue: Ints, objective: Objective, control: ControlVariate | None) -> tuple[float, float]:
    """Return the statistic of n tumours and its standard error by the sample: eq. PO.10 of means, where that knows more.

    Args:
        values: of the tumours, shape (n,).
        tissue: number of each one's tissue, shape (n,).
        objective: its statistic.
        control: by the formulas; None where there is none.
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
