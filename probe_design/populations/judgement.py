"""Define the performance of a probe for a population: tumours detected, contrasts resolved, information gained, with errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from geometry.common.arrays import Floats, Ints
from geometry.common.json_types import JsonObject
from probe_design.populations.control_variate import ControlVariate, estimate_statistic
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
class Judgement:
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
    contrast_sd, modulus_sd, deflection
        Standard deviations of ln contrast and of ln E_object of each tumour, and d' if the tumour were known; shape (n,).
    depth, diameter, x, youngs_modulus
        Numbers of the tumours, m and Pa, shape (n,).
    tissue
        Number of each one's tissue, shape (n,).
    causes
        Fraction of the detection's model error by cause, see ``scan_errors.ERROR_CAUSES``; empty without an error.
    statistic
        Statistic of the design file.
    false_alarm
        Fraction of tumour-free scans in which a tumour is detected.
    evaluator
        Evaluator of the readings.
    seconds
        Computing time, s.
    control
        Probabilities by the closed form for these tumours and more, see ``control_variate``; None if the evaluator is the closed
        form.
    warnings
        Warnings, one line each.
    by_observable
        The same for the ratio alone, the stiffness alone and both; None where the noise of one is not given.
    """

    observable: Observable
    means: dict[Kind, float]
    errors: dict[Kind, MeanError]
    values: dict[Kind, Floats]
    contrast_sd: Floats
    modulus_sd: Floats
    deflection: Floats
    depth: Floats
    diameter: Floats
    x: Floats
    youngs_modulus: Floats
    tissue: Ints
    causes: dict[str, float]
    statistic: str | float
    false_alarm: float
    evaluator: str
    seconds: float
    control: ControlVariate | None = None
    warnings: tuple[str, ...] = ()
    by_observable: dict[Observable, Judgement | None] = field(default_factory=dict)

    @property
    def detection(self) -> float:
        """The statistic of the probabilities of detection."""
        return self.means["detection"]

    @property
    def detection_error(self) -> float:
        """What that may be off, sampling and model together."""
        return self.errors["detection"].total

    @property
    def resolved(self) -> float:
        """The fraction of tumours whose ln contrast is resolved."""
        return self.means["resolved"]

    @property
    def resolved_error(self) -> float:
        """What that may be off, sampling and model together."""
        return self.errors["resolved"].total

    @property
    def information(self) -> float:
        """The statistic of the information gained about ln contrast, nats."""
        return self.means["information"]

    @property
    def information_error(self) -> float:
        """What that may be off, sampling and model together."""
        return self.errors["information"].total

    @property
    def probability(self) -> Floats:
        """Probability of detection of each tumour, shape (n,)."""
        return self.values["detection"]

    @property
    def gain(self) -> Floats:
        """Information gained about each tumour's ln contrast, nats, shape (n,)."""
        return self.values["information"]

    def compute_gain(self, reference: Judgement, objective: Objective) -> tuple[float, float]:
        """Return the gain over another probe for the same tumours, and its error.

        Tumours and draws are the same, so that the error of a mean is given by the scatter of the differences.
        """
        kind: Kind = objective.maximise
        mine, reference_values = self.values[kind], reference.values[kind]
        errors = self.errors[kind], reference.errors[kind]
        model, corrected = (
            math.hypot(*parts) for parts in ([item.model for item in errors], [item.corrected for item in errors])
        )
        if objective.statistic == "mean":
            control_difference = (
                self.control.subtract(reference.control) if kind == "detection" and self.control and reference.control else None
            )
            gain, error = estimate_statistic(mine - reference_values, self.tissue, objective, control_difference)
            return gain, math.hypot(error, corrected) + model
        error = math.hypot(*(objective.compute_error(item, self.tissue) for item in (mine, reference_values)), corrected)
        return objective.compute_statistic(mine) - objective.compute_statistic(reference_values), error + model

    @property
    def error_note(self) -> str:
        """The dominant error of the detection and how to reduce it, in one sentence."""
        error = self.errors["detection"]
        sampling, model = (f"± {100 * item:.2g}" for item in (error.sampling, error.model))
        parts = f"sampling leaves {sampling} of 100 tumours open and the evaluator's model {model}"
        if error.sampling >= error.model or not self.causes:
            return f"{parts}: sampling dominates, which more population.samples than {len(self.depth)} would reduce"
        cause = max(self.causes, key=lambda item: self.causes[item])
        what, remedy = ERROR_CAUSES[cause]
        return f"{parts}: the model dominates, {100 * self.causes[cause]:.0f} % of it {what}, which {remedy} would reduce"

    def as_dict(self) -> JsonObject:
        """Return the performance as a JSON object."""
        numbers = self._list_numbers() | {
            "false_alarm": self.false_alarm,
            "tumours": len(self.depth),
            "observable": self.observable,
        }
        lines = {name: None if judgement is None else judgement._list_numbers() for name, judgement in self.by_observable.items()}
        return numbers | {"model_error_causes": self.causes, "error_note": self.error_note, "by_observable": lines}

    def _list_numbers(self) -> dict[str, float]:
        numbers: dict[str, float] = {}
        for kind in OBJECTIVE_KINDS:
            error = self.errors[kind]
            numbers |= {kind: self.means[kind], f"{kind}_error": error.total}
            numbers |= {f"{kind}_sampling_error": error.sampling, f"{kind}_model_error": error.model}
        return numbers
