"""Define what is best: the table [objective] of a design file, and the statistic of a population with its sampling error."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError
from geometry.scenes.quantities import Frozen
from geometry.scenes.units import MM_PER_M

Kind = Literal["detection", "resolved", "information", "place_error"]
OBJECTIVE_LABELS: dict[Kind, str] = {
    "detection": "detection, %", "resolved": "resolved, %", "information": "information, nats", "place_error": "place error, mm",
}  # fmt: skip
OBJECTIVE_SCALES: dict[Kind, float] = {"detection": 100.0, "resolved": 100.0, "information": 1.0, "place_error": MM_PER_M}
OBJECTIVE_KINDS: tuple[Kind, ...] = tuple(OBJECTIVE_LABELS)
LOCATED_KINDS: tuple[Kind, ...] = ("information", "place_error")  # that simulated scans verify
Statistic = Literal["mean"] | Annotated[float, Field(gt=0.0, lt=1.0)]


class Objective(Frozen):
    """What is best."""

    maximise: Kind = Field(
        default="detection",
        description=(
            "'detection': probability that a tumour is detected; 'resolved': fraction whose ln contrast is resolved to 0.5 (one "
            "standard deviation); 'information': nats that a scan says of place, depth, diameter and ln contrast; 'place_error': "
            "the posterior standard deviation of the tumour's place, which is made small"
        ),
    )
    statistic: Statistic = Field(
        default="mean", description="over the population: 'mean', or a number between 0 and 1, that quantile", examples=[0.1]
    )

    @model_validator(mode="after")
    def _refuse_quantile_of_fraction(self) -> Self:
        """Refuse a quantile of "resolved", which is 0 or 1 for each tumour."""
        if self.maximise == "resolved" and self.statistic != "mean":
            raise InputError("statistic", self.statistic, "'mean' with maximise = 'resolved', which is a fraction of the tumours")
        return self

    @property
    def is_located(self) -> bool:
        """Whether designs are verified by simulated scans that `locate` explains."""
        return self.maximise in LOCATED_KINDS

    @property
    def sign(self) -> float:
        """1 where a larger value is better, -1 where a smaller is."""
        return -1.0 if self.maximise == "place_error" else 1.0

    @property
    def scale(self) -> float:
        """Factor from fractions and SI units to those of ``label``."""
        return OBJECTIVE_SCALES[self.maximise]

    @property
    def label(self) -> str:
        """Name of the quantity with its unit."""
        return OBJECTIVE_LABELS[self.maximise]

    @property
    def unit(self) -> str:
        """Unit of ``label``."""
        return self.label.rpartition(" ")[2]

    def convert_searched(self, value: float) -> float:
        """Return the quantity for the value that a search makes large: minus ln of a place error, else the quantity itself."""
        return math.exp(-value) if self.maximise == "place_error" else value

    def format_value(self, value: float, error: float) -> str:
        """Return a value with its error and unit."""
        decimals = 1 if self.unit == "%" else 3
        return f"{self.scale * value:.{decimals}f} ± {self.scale * error:.2g} {self.unit}"

    def compute_statistic(self, values: Floats) -> float:
        """Return the statistic of the tumours' values, shape (n,): their mean, or their quantile."""
        return float(np.mean(values) if self.statistic == "mean" else np.quantile(values, self.statistic))

    def compute_error(self, values: Floats, group: Ints | None = None) -> float:
        """Return the standard error of ``compute_statistic``; that of a quantile follows from neighbouring quantiles.

        Parameters
        ----------
        values
            Values of n tumours drawn at random, shape (n,).
        group
            Number of each tumour's tissue, shape (n,); if the few tissues differ by more than random tumours would, their scatter
            counts.
        """
        alone = self._compute_sampling_error(values)
        parts = [] if group is None else [values[group == number] for number in np.unique(group)]
        if len(parts) < 2:
            return alone
        return max(alone, float(np.std([self.compute_statistic(part) for part in parts], ddof=1) / math.sqrt(len(parts))))

    def _compute_sampling_error(self, values: Floats) -> float:
        """Return the standard error of the statistic of values drawn at random."""
        n = len(values)
        if n < 2:
            return 0.0
        if self.statistic == "mean":
            return float(np.std(values, ddof=1) / math.sqrt(n))
        # of the fraction of values below a quantile: half the difference of the quantiles at both ends is the error
        spread = math.sqrt(self.statistic * (1 - self.statistic) / n)
        ends = np.quantile(values, np.clip([self.statistic - spread, self.statistic + spread], 0, 1))
        return float(np.ptp(ends) / 2)
