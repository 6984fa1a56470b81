"""How good a probe is for a population: tumours detected, contrasts resolved, information gained; with errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from geometry.common.arrays import Floats, Ints
from probe_design.populations.control import ControlVariate, sample_mean
from probe_design.populations.scan_errors import CAUSES
from probe_design.populations.tables import Objective, Observable

Kind = Literal["detection", "resolved", "information"]
KINDS: tuple[Kind, ...] = ("detection", "resolved", "information")


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
    def whole(self) -> float:
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
        return self.errors["detection"].whole

    @property
    def resolved(self) -> float:
        """The fraction of tumours whose ln contrast is resolved."""
        return self.means["resolved"]

    @property
    def resolved_error(self) -> float:
        """What that may be off, sampling and model together."""
        return self.errors["resolved"].whole

    @property
    def information(self) -> float:
        """The statistic of the information gained about ln contrast, nats."""
        return self.means["information"]

    @property
    def information_error(self) -> float:
        """What that may be off, sampling and model together."""
        return self.errors["information"].whole

    @property
    def probability(self) -> Floats:
        """Of each tumour to be detected, shape (n,)."""
        return self.values["detection"]

    @property
    def gain(self) -> Floats:
        """Information gained about each tumour's ln contrast, nats, shape (n,)."""
        return self.values["information"]

    def gain_over(self, other: Judgement, objective: Objective) -> tuple[float, float]:
        """Return by how much this is better than another probe for the same tumours, and the error of that.

        The tumours are the same, and so are the draws: of a mean what counts is how much the differences scatter.
        """
        kind: Kind = objective.maximise
        mine, others = self.values[kind], other.values[kind]
        errors = self.errors[kind], other.errors[kind]
        model, corrected = (math.hypot(*parts) for parts in ([one.model for one in errors], [one.corrected for one in errors]))
        if objective.statistic == "mean":
            both = self.control.less(other.control) if kind == "detection" and self.control and other.control else None
            gain, error = sample_mean(mine - others, self.tissue, objective, both)
            return gain, math.hypot(error, corrected) + model
        error = math.hypot(*(objective.error(one, self.tissue) for one in (mine, others)), corrected)
        return objective.over(mine) - objective.over(others), error + model

    @property
    def error_note(self) -> str:
        """What of the detection's error dominates and what would reduce it, in one sentence."""
        error = self.errors["detection"]
        sampling, model = (f"± {100 * one:.2g}" for one in (error.sampling, error.model))
        parts = f"sampling leaves {sampling} of 100 tumours open and the evaluator's model {model}"
        if error.sampling >= error.model or not self.causes:
            return f"{parts}: sampling dominates, which more population.samples than {len(self.depth)} would reduce"
        cause = max(self.causes, key=lambda one: self.causes[one])
        what, remedy = CAUSES[cause]
        return f"{parts}: the model dominates, {100 * self.causes[cause]:.0f} % of it {what}, which {remedy} would reduce"

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers of the population, as JSON has them."""
        own = self._numbers() | {"false_alarm": self.false_alarm, "tumours": len(self.depth), "observable": self.observable}
        lines = {name: None if one is None else one._numbers() for name, one in self.by_observable.items()}
        return own | {"model_error_causes": self.causes, "error_note": self.error_note, "by_observable": lines}

    def _numbers(self) -> dict[str, float]:
        numbers: dict[str, float] = {}
        for kind in KINDS:
            error = self.errors[kind]
            numbers |= {kind: self.means[kind], f"{kind}_error": error.whole}
            numbers |= {f"{kind}_sampling_error": error.sampling, f"{kind}_model_error": error.model}
        return numbers
