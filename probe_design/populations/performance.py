"""Compute the performance of a probe for a population: tumours detected, contrasts resolved, information gained, with errors.

The closed form as control variate reduces the sampling error of a verification, whose evaluator takes seconds for some tens of
tumours, while the closed form takes one second for hundreds. P_i are the probabilities of detection of n verified tumours, c_i
those of the closed form for the same tumours under the same draws, and C_k those of the closed form for N other tumours of the
population. The estimate

    P = 1/n sum_i (P_i - c_i) + 1/N sum_k C_k                                                      (PO.10)

has the mean of P_i, however accurate the closed form is. The standard errors of both parts are independent: the first is small
where the closed form is accurate, the second where N is large. The coefficient of the control is 1: fitting it to the n tumours
would bias it.

Few tumours that happen to be alike (two of two detected) have a plain standard error of nearly 0, which does not describe the
population. The error of the plain mean is therefore at least that of n tumours with the scatter of the many C_k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.json_types import JsonObject
from probe_design.populations.detection import Detector
from probe_design.populations.objective import OBJECTIVE_KINDS, Kind, Objective
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.scan_errors import ERROR_CAUSES
from probe_design.populations.scan_readings import compute_closed_form_readings
from probe_design.populations.tables import ChannelSet, Protocol

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
        """Compute the signals of the verified tumours of ``draw`` and of other tumours of the population by the closed form.

        Raises ``Refusal`` where the closed form fails for the scene's probe.
        """
        count = min(max(MIN_CONTROL_TUMOURS, CONTROL_TUMOURS_PER_TUMOUR * len(draw)), MAX_CONTROL_TUMOURS)
        # seed + 2: neither the verified tumours (seed) nor the detector's reference tumours (seed + 1)
        control_draw = replace(population, seed=population.seed + 2).draw_tumours(count, unseen=True, tissues=CONTROL_TISSUES)
        same, others = (compute_closed_form_readings(tumours, protocol).signal for tumours in (draw, control_draw))
        return cls(same, others, control_draw.tissue)

    def repeat_readings(self, times: int) -> ControlSample:
        """Return the signals of ``times`` as many readings, all alike."""
        same, others = (np.tile(signals, (1, times)) for signals in (self.same_tumours, self.other_tumours))
        return ControlSample(same, others, self.tissue)

    def select_readings(self, columns: Ints) -> ControlSample:
        """Return the signals of some of the readings, by number."""
        return ControlSample(self.same_tumours[:, columns], self.other_tumours[:, columns], self.tissue)

    def compute_probabilities(self, detector: Detector) -> ControlSample:
        """Return the probabilities of detection from these signals, by the closed form, of verified tumours and others.

        The verified tumours are scanned under the same draws of noise as in their verification, so that these cancel in the
        difference between both evaluators; the many others, which serve as the control variate, under fewer draws each.
        """
        same = detector.compute_probabilities(self.same_tumours)
        others = detector.compute_probabilities(self.other_tumours, scans=SCANS_PER_CONTROL_TUMOUR)
        return ControlSample(same, others, self.tissue)

    def subtract(self, reference: ControlSample) -> ControlSample:
        """Return these values less those of another probe for the same tumours."""
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
    # standard errors of the two means of eq. PO.10, which are independent
    error = math.hypot(
        objective.compute_error(differences, tissue), objective.compute_error(control.other_tumours, control.tissue)
    )
    return (float(np.mean(differences) + np.mean(control.other_tumours)), error) if error < plain[1] else plain


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
    channel_set
        The channels that are read: the ratio, the stiffness or both.
    means, errors
        By ``OBJECTIVE_KINDS``, with their errors: the statistic of ``[objective]`` over the probabilities of detection, the
        fraction of tumours whose ln contrast is resolved to 0.5, the statistic of the information, nats, and of the place's
        posterior standard deviation, m, both as if the readings were linear in the unknowns.
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
        Probabilities by the closed form for these tumours and more, eq. PO.10; None if the evaluator is the closed
        form.
    by_channels
        The same for the ratio alone, the stiffness alone and both; None where the noise of one is not given.
    """

    channel_set: ChannelSet
    means: dict[Kind, float]
    errors: dict[Kind, MeanError]
    values: dict[Kind, Floats]
    contrast_sd: Floats
    draw: TumourDraw
    causes: dict[str, float]
    false_alarm: float
    evaluator: str
    control: ControlSample | None = None
    by_channels: dict[ChannelSet, Performance | None] = field(default_factory=dict)

    def compute_gain(self, reference: Performance, objective: Objective) -> tuple[float, float]:
        """Return the gain in the objective over another probe for the same tumours, above 0 if better, and the gain's error.

        Tumours and draws are the same, so that the sampling error of a mean is given by the scatter of the differences. A
        quantile has no such differences: the sampling errors of both probes are combined.
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
            return objective.sign * gain, math.hypot(sampling, corrected) + model
        sampling = math.hypot(*(objective.compute_error(item, self.draw.tissue) for item in (values, reference_values)))
        gain = objective.compute_statistic(values) - objective.compute_statistic(reference_values)
        return objective.sign * gain, math.hypot(sampling, corrected) + model

    @property
    def error_note(self) -> str:
        """The dominant error of the detection and how to reduce it, in one sentence."""
        error = self.errors["detection"]
        sampling, model = (f"± {100 * item:.2g}" for item in (error.sampling, error.model))
        parts = f"{sampling} of 100 tumours by sampling, {model} by the model"
        if error.sampling >= error.model or not self.causes:
            return f"{parts}; more tumours than {len(self.draw)}, population.samples, would reduce the former"
        cause = max(self.causes, key=lambda item: self.causes[item])
        what, remedy = ERROR_CAUSES[cause]
        return f"{parts}; the largest part of the latter, {100 * self.causes[cause]:.0f} %, is due to {what}: {remedy} reduces it"

    def as_dict(self) -> JsonObject:
        """Return the performance as a JSON object."""
        by_channels = {name: item and item._list_numbers() for name, item in self.by_channels.items()}
        return self._list_numbers() | {
            "false_alarm": self.false_alarm, "tumours": len(self.draw), "channels": self.channel_set,
            "model_error_causes": self.causes, "error_note": self.error_note, "by_channels": by_channels,
        }  # fmt: skip

    def _list_numbers(self) -> dict[str, float]:
        """Return each mean with its errors, by the keys of the JSON object."""
        numbers: dict[str, float] = {}
        for kind in OBJECTIVE_KINDS:
            error = self.errors[kind]
            numbers |= {kind: self.means[kind], f"{kind}_error": error.total}
            numbers |= {f"{kind}_sampling_error": error.sampling, f"{kind}_model_error": error.model}
        return numbers
