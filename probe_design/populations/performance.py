"""Define the performance of a probe for a population: tumours detected, contrasts resolved, information gained, with errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from geometry.common.arrays import Floats
from geometry.common.json_types import JsonObject
from probe_design.populations.control_variate import ControlSample, estimate_statistic
from probe_design.populations.population import TumourDraw
from probe_design.populations.scan_errors import ERROR_CAUSES
from probe_design.populations.tables import Objective, Observable

Kind = Literal["detection", "resolved", "information"]
OBJECTIVE_KINDS: tuple[Kind, ...] = ("detection", "resolved", "information")


@dataclass(frozen=True)
class MeanError:
    """The error of a statistic over a population.

    Attributes
    ----------
    sampling
        Standard error due to the draws of tumours and of noise.
    model
        Bound on the error due to the evaluator.
    corrected
        Standard error of the correction of tumours computed without reflections; ``sampling`` includes it.
    """

    sampling: float
    model: float = 0.0
    corrected: float = 0.0

    @property
    def total(self) -> float:
        """Error by sampling and model together."""
        return self.sampling + self.model


@dataclass(frozen=True)
class Performance:
    """The performance of a probe over n tumours.

    Attributes
    ----------
    observable
        The channels that are read: the ratio, the stiffness or both.
    means, errors
        By ``OBJECTIVE_KINDS``, with their errors: the statistic of ``[objective]`` over the probabilities of detection, the
        fraction of tumours whose ln contrast is resolved to 0.5, and the statistic of the information, ln(prior / posterior
        standard deviation) of ln contrast.
    values
        Values of each tumour by ``OBJECTIVE_KINDS``, shape (n,). Tumours without reflections are corrected by the mean change
        that reflections cause in the others, by which a probability may leave the range 0 to 1.
    contrast_sd
        Standard deviation of ln contrast of each tumour, shape (n,).
    draw
        The tumours.
    causes
        Fraction of the detection's model error by cause, see ``scan_errors.ERROR_CAUSES``; empty without an error.
    false_alarm
        Fraction of tumour-free scans in which a tumour is detected.
    evaluator
        Evaluator of the readings.
    control
        Probabilities by the closed form for these tumours and more, see ``control_variate``; None if the evaluator is the closed
        form.
    by_observable
        The same for the ratio alone, the stiffness alone and both; None where the noise of one is not given.
    """

    observable: Observable
    means: dict[Kind, float]
    errors: dict[Kind, MeanError]
    values: dict[Kind, Floats]
    contrast_sd: Floats
    draw: TumourDraw
    causes: dict[str, float]
    false_alarm: float
    evaluator: str
    control: ControlSample | None = None
    by_observable: dict[Observable, Performance | None] = field(default_factory=dict)

    def compute_gain(self, reference: Performance, objective: Objective) -> tuple[float, float]:
        """Return the gain over another probe for the same tumours, and its error.

        Tumours and draws are the same, so that the error of a mean is given by the scatter of the differences.
        """
        kind: Kind = objective.maximise
        values, reference_values = self.values[kind], reference.values[kind]
        error, reference_error = self.errors[kind], reference.errors[kind]
        model = math.hypot(error.model, reference_error.model)
        corrected = math.hypot(error.corrected, reference_error.corrected)
        if objective.statistic == "mean":
            control = None
            if kind == "detection" and self.control is not None and reference.control is not None:
                control = self.control.subtract(reference.control)
            gain, sampling = estimate_statistic(values - reference_values, self.draw.tissue, objective, control)
            return gain, math.hypot(sampling, corrected) + model
        sampling = math.hypot(*(objective.compute_error(item, self.draw.tissue) for item in (values, reference_values)))
        gain = objective.compute_statistic(values) - objective.compute_statistic(reference_values)
        return gain, math.hypot(sampling, corrected) + model

    @property
    def error_note(self) -> str:
        """The dominant error of the detection and how to reduce it, in one sentence."""
        error = self.errors["detection"]
        sampling, model = (f"± {100 * item:.2g}" for item in (error.sampling, error.model))
        parts = f"sampling leaves {sampling} of 100 tumours open and the evaluator's model {model}"
        if error.sampling >= error.model or not self.causes:
            return f"{parts}: sampling dominates, which more population.samples than {len(self.draw)} would reduce"
        cause = max(self.causes, key=lambda item: self.causes[item])
        what, remedy = ERROR_CAUSES[cause]
        return f"{parts}: the model dominates, {100 * self.causes[cause]:.0f} % of it {what}, which {remedy} would reduce"

    def as_dict(self) -> JsonObject:
        """Return the performance as a JSON object."""
        by_observable = {name: item and item._list_numbers() for name, item in self.by_observable.items()}
        return self._list_numbers() | {
            "false_alarm": self.false_alarm, "tumours": len(self.draw), "observable": self.observable,
            "model_error_causes": self.causes, "error_note": self.error_note, "by_observable": by_observable,
        }  # fmt: skip

    def _list_numbers(self) -> dict[str, float]:
        numbers: dict[str, float] = {}
        for kind in OBJECTIVE_KINDS:
            error = self.errors[kind]
            numbers |= {kind: self.means[kind], f"{kind}_error": error.total}
            numbers |= {f"{kind}_sampling_error": error.sampling, f"{kind}_model_error": error.model}
        return numbers
