"""What was read and what was predicted of the blocks, and how far apart they may be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from geometry.common.arrays import Floats

LEVEL = 0.01  # p-value below which a deviation is one, and the probe fails


@dataclass(frozen=True)
class Deviation:
    """What was read and what was predicted of k blocks.

    Attributes:
        logs: ln(F_inner / F_outer) as read, shape (k,).
        drawn: as predicted for the probe as drawn, shape (k,).
        read: covariance of ``logs``, shape (k, k).
        model: variances of ``drawn`` for the probe as drawn, shape (k,).
        calibration_bias: G S of eq. BP.5 by variable, shape (k,) each; 0 where one is missing.
        workshop: (J - G S) t of eq. BP.5 by variable, t what the workshop's tolerance allows it, shape (k,) each.
    """

    logs: Floats
    drawn: Floats
    read: Floats
    model: Floats
    calibration_bias: Mapping[str, Floats]
    workshop: Mapping[str, Floats] = field(default_factory=dict)

    def covariance(self, *without: str) -> Floats:
        """Return C of a probe within the workshop's tolerances, those of the named variables left out, shape (k, k)."""
        columns = [column for name, column in self.workshop.items() if name not in without]
        allowed = np.array(columns).reshape(len(columns), len(self.logs))
        return np.asarray(self.read + np.diag(self.model) + allowed.T @ allowed)

    def weight(self, *without: str) -> Floats:
        """Return the inverse of ``covariance``, shape (k, k)."""
        return np.asarray(np.linalg.inv(self.covariance(*without)), dtype=float)

    @property
    def chi_square(self) -> float:
        """Of a probe within the workshop's tolerances, eq. BP.4 of ``probe_design.built_probe.check``."""
        off = self.logs - self.drawn
        return float(off @ self.weight() @ off)

    @property
    def p_value(self) -> float:
        """Probability of a chi-square as large or larger."""
        return float(chi2.sf(self.chi_square, len(self.logs)))

    def bias(self, name: str) -> Floats:
        """G S of a variable, shape (k,)."""
        return self.calibration_bias.get(name, np.zeros(len(self.logs)))

    def without(self, k: int) -> Deviation:
        """Return it without block k."""

        def kept(by_name: Mapping[str, Floats]) -> dict[str, Floats]:
            return {name: np.delete(column, k) for name, column in by_name.items()}

        return Deviation(
            np.delete(self.logs, k), np.delete(self.drawn, k), np.delete(np.delete(self.read, k, 0), k, 1),
            np.delete(self.model, k), kept(self.calibration_bias), kept(self.workshop),
        )  # fmt: skip
