"""The sample's error made smaller: the formulas, asked of many more tumours, tell how far the judged ones are from all.

The judge's level takes seconds for some tens of tumours, the formulas one for hundreds. Their probabilities c_i of the same
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

MANY, MOST = 256, 4096  # tumours of which the formulas are asked beside a judge, at least and at most
TIMES = 6  # as many as the judged ones, so that more of these make both parts' errors smaller
TISSUES, FEW_SCANS = 32, 64  # their tissues, scans over each


@dataclass(frozen=True)
class ControlVariate:
    """What the formulas say.

    Attributes:
        same_tumours: of the n judged tumours, c_i, shape (n,).
        other_tumours: of N others, C_k, shape (N,).
        tissue: numbers of the tissues of these, shape (N,).
    """

    own: Floats
    many: Floats
    tissue: Ints

    def less(self, other: ControlVariate) -> ControlVariate:
        """Return what the formulas say of the difference of two probes for the same tumours."""
        return ControlVariate(self.own - other.own, self.many - other.many, self.tissue)


@dataclass(frozen=True)
class ControlSignals:
    """Signals by the formulas.

    Attributes:
        same_tumours: of the n judged tumours, shape (n, m).
        other_tumours: of ``MIN_CONTROL_TUMOURS`` others or more, not the judge's, the detector's or a search's,
            shape (N, m).
        tissue: numbers of the tissues of these, shape (N,).
    """

    own: Floats
    many: Floats
    tissue: Ints

    @classmethod
    def of(cls, scene: Scene, protocol: Protocol, population: ScenePopulation, draw: TumourDraw) -> ControlSignals:
        """Ask the formulas; raises ``Refusal`` where they break down for the scene's probe."""
        count = min(max(MANY, TIMES * len(draw)), MOST)
        others = replace(population, seed=population.seed + 2).drawn(count, unseen=True, tissues=TISSUES)
        own, many = (ClosedFormScan.of(one, protocol).readings(scene).signal for one in (draw, others))
        return cls(own, many, others.tissue)

    def part(self, columns: Ints) -> ControlSignals:
        """Return some of the readings, by number."""
        return ControlSignals(self.own[:, columns], self.many[:, columns], self.tissue)

    def found(self, detector: Detector, seed: int) -> ControlVariate:
        """Return how often a detector finds them, under the draws that the judged tumours are found under."""
        own = detector.probabilities(self.own, seed=seed)
        return ControlVariate(own, detector.probabilities(self.many, seed=seed, scans=FEW_SCANS), self.tissue)


def sample_mean(values: Floats, tissue: Ints, objective: Objective, control: ControlVariate | None) -> tuple[float, float]:
    """Return the statistic of n tumours and its standard error by the sample: eq. PO.10 of means, where that knows more.

    Args:
        values: of the tumours, shape (n,).
        tissue: number of each one's tissue, shape (n,).
        objective: its statistic.
        control: by the formulas; None where there is none.
    """
    plain = objective.over(values), objective.error(values, tissue)
    if control is None or objective.statistic != "mean":
        return plain
    plain = plain[0], max(plain[1], float(np.std(control.many, ddof=1)) / math.sqrt(len(values)))
    rest = values - control.own
    error = math.hypot(objective.error(rest, tissue), objective.error(control.many, control.tissue))
    return (float(np.mean(rest) + np.mean(control.many)), error) if error < plain[1] else plain
