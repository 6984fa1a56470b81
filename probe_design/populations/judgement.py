"""How good a probe is for a population: tumours detected, contrasts resolved, information gained; with errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from geometry.common.arrays import Floats, Ints
from probe_design.populations.control_variate import ControlVariate, estimate_statistic
from probe_design.populations.scan_errors import ERROR_CAUSES
from probe_design.populations.tables import Objective, Observable

Kind = Literal["detection", "resolved", "information"]
OBJECTIVE_KINDS: tuple[Kind, ...] = ("detection", "resolved", "information")


@dataclass(frozen=True)
class MeanError:
    """What a statistic over a population may be off.

    Attributes:
        sampling: one standard error, of the tumours drawn and of the draws of noise.
        model: bound on what the evaluator's errors change.
        corrected: one standard error, which ``sampling`` counts already, of what reflections change of tumours computed without.
    """

    sampling: float
    model: float = 0.0
    corrected: float = 0.0

    @property
    def total(self) -> float:
        """Both together."""
        return self.sampling + self.model


@dataclass(frozen=True)
class Judgement:
    """What a probe does for n tumours.

    Attributes:
        observable: what is read: the ratio, the stiffness or both.
        means, errors: by ``OBJECTIVE_KINDS``: the statistic of ``[objective]`` over the probabilities of detection, the
            fraction of tumours
            whose ln contrast is resolved to 0.5, ln(prior / posterior standard deviation) of ln contrast; and their errors.
        values: of each tumour, by ``OBJECTIVE_KINDS``, shape (n,): those without reflections with what reflections change
            of the others in
            the mean, by which a probability may leave 0 to 1.
        contrast_sd, modulus_sd, deflection: of each tumour: standard deviations of ln contrast and of ln E_object, d' if it were
            known; shape (n,).
        depth, diameter, x, youngs_modulus: of the tumours, m and Pa, shape (n,).
        tissue: number of each one's tissue, shape (n,).
        causes: fraction of the model's error of the detection by cause, see ``scan_errors.ERROR_CAUSES``; empty if there is none.
        statistic: as in the design file.
        false_alarm: fraction of tumour-free scans in which a tumour is detected.
        evaluator: that computed the readings.
        seconds: what it took.
        control: probabilities by the formulas, of these tumours and of more, see ``control``; None by the formulas themselves.
        warnings: what else is to be said.
        by_observable: the same by the ratio alone, the stiffness alone and both; None where noise says nothing of one.
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
        """Of each tumour to be detected, shape (n,)."""
        return self.values["detection"]

    @property
    def gain(self) -> Floats:
        """Information gained about each tumour's ln contrast, nats, shape (n,)."""
        return self.values["information"]

    def compute_gain(self, reference: Judgement, objective: Objective) -> tuple[float, float]:
        """Return by how much this is better than another probe for the same tumours, and the error of that.

        The tumours are the same, and so are the draws: of a mean what counts is how much the differences scatter.
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
        """What of the detection's error dominates and what would reduce it, in one sentence."""
        error = self.errors["detection"]
        sampling, model = (f"± {100 * item:.2g}" for item in (error.sampling, error.model))
        parts = f"sampling leaves {sampling} of 100 tumours open and the evaluator's model {model}"
        if error.sampling >= error.model or not self.causes:
            return f"{parts}: sampling dominates, which more population.samples than {len(self.depth)} would reduce"
        cause = max(self.causes, key=lambda item: self.causes[item])
        what, remedy = ERROR_CAUSES[cause]
        return f"{parts}: the model dominates, {100 * self.causes[cause]:.0f} % of it {what}, which {remedy} would reduce"

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers of the population, as JSON has them."""
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
