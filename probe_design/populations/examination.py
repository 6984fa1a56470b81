"""Compute the readings of one probe over a population, and which tumours are detected and resolved under noise.

Of n tumours, r are computed with reflections, the others only to first order. With v_i the value of tumour i with reflections and
w_i its value to first order, the mean over all tumours is

    1/n sum_i (w_i) + 1/r sum_reflected (v_i - w_i)                                                 (PO.13)

Tumours without reflections are thus corrected by the mean change that reflections cause in the others. This adds the standard
error sd(v - w) (1/r - 1/n)^(1/2) to that of the sample. The model's error is that of tumours with reflections, whatever n is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.control_variate import ControlSignals, estimate_statistic
from probe_design.populations.design_file import Design
from probe_design.populations.detection import SCANS_PER_TUMOUR, Detector
from probe_design.populations.judgement import Judgement, Kind, MeanError
from probe_design.populations.noise import build_difference_noise, build_full_noise
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.resolved import (
    Unknowns,
    compute_fraction_error,
    compute_informations,
    compute_log_sds,
    is_resolved,
    is_undecided,
)
from probe_design.populations.scan_readings import ScanReadings
from probe_design.populations.tables import CHANNEL_INDICES, Observable


@dataclass(frozen=True)
class Examination:
    """The computed readings, which do not depend on noise; both channels at all positions.

    Attributes
    ----------
    population
        The ranges.
    draw
        The tumours.
    readings
        Readings over the tumours, with reflections where they are computed.
    first
        The same to first order; None if all tumours have reflections, or none.
    reflected
        Numbers of the tumours with reflections, or of all, shape (r,).
    reference
        Signals of the detector's reference tumours by the closed form, shape (K, m).
    control
        Signals by the closed form, of the draw's tumours and of more; None if the closed form is the evaluator.
    evaluator
        Evaluator of the readings.
    seconds
        Computing time, s.
    """

    population: ScenePopulation
    draw: TumourDraw
    readings: ScanReadings
    reference: Floats
    evaluator: str
    seconds: float
    reflected: Ints
    first: ScanReadings | None = None
    control: ControlSignals | None = None

    def select(self, positions: Ints, observable: Observable) -> Examination:
        """Return the examination restricted to some positions, by number, and to the channels of an observable."""
        channels = CHANNEL_INDICES[observable]
        columns = self.readings.list_columns(positions, channels)
        return replace(
            self,
            readings=self.readings.select(positions, channels),
            first=None if self.first is None else self.first.select(positions, channels),
            reference=self.reference[:, columns],
            control=None if self.control is None else self.control.select_readings(columns),
        )

    def evaluate(self, design: Design, seed: int = 0, observable: Observable | None = None) -> Judgement:
        """Compute probabilities of detection and resolution under a design file's noise, false alarms and statistic.

        Parameters
        ----------
        design
            The design; its positions are those of the readings.
        seed
            Seed of the draws of noise.
        observable
            The channels that are read; default: those of the protocol.

        Raises
        ------
        InputError
            The noise of a reading is below ``MIN_NOISE``.
        """
        start, read = perf_counter(), observable or design.protocol.observable
        scan = self.select(np.arange(len(design.protocol.positions)), read)
        return scan._evaluate_observable(design, seed, read, start)

    def evaluate_all_channels(self, design: Design, seed: int = 0) -> Judgement:
        """Evaluate as ``evaluate`` does, and also for the ratio alone, the stiffness alone and both."""
        start, protocol_observable = perf_counter(), design.protocol.observable
        lines: dict[Observable, Judgement | None] = {}
        for observable in CHANNEL_INDICES:
            try:
                lines[observable] = self.evaluate(design, seed, observable)
            except InputError:  # the noise of a channel that the protocol does not read may be missing
                if observable == protocol_observable:
                    raise
                lines[observable] = None
        judged = lines[protocol_observable]
        assert judged is not None
        return replace(judged, by_observable=lines, seconds=self.seconds + perf_counter() - start)

    def _evaluate_observable(self, design: Design, seed: int, observable: Observable, start: float) -> Judgement:
        """Evaluate the readings of one observable."""
        draw, objective, protocol, readings = self.draw, design.objective, design.protocol, self.readings
        unknowns, blank = Unknowns.from_draw(self.population, draw), np.exp(np.log(readings.blank).mean(axis=0))
        known = design.noise, protocol, draw.scene, blank
        noise = build_difference_noise(
            *known,
            tissue=_average_tissue_derivatives(unknowns, readings),
            tumour_forces=readings.mean_forces,
            observable=observable,
        )
        full_noise = build_full_noise(*known, readings.mean_forces, observable=observable)
        detector = Detector.train(self.reference, noise.covariance, protocol.false_alarm, seed=seed)
        values, contrast, modulus = _evaluate_tumours(
            detector, unknowns, readings, noise=full_noise, blank=protocol.blank, seed=seed
        )
        threshold, model, causes = self._compute_model_error(detector, values["detection"], protocol.blank, seed)
        control = None if self.control is None else self.control.compute_probabilities(detector, seed)
        correction_errors = dict.fromkeys(values, 0.0)
        if self.first is not None:
            first_order = _evaluate_tumours(detector, unknowns, self.first, noise=full_noise, blank=protocol.blank, seed=seed)[0]
            values, correction_errors = self._correct_first_order(values, first_order)
        fraction, reflected = _compute_error_fractions(readings, protocol.blank), self.reflected
        models: dict[Kind, float] = {
            "detection": model,
            "resolved": float(is_undecided(contrast[reflected], fraction[reflected]).mean() / 2),
            "information": float(np.minimum(fraction, values["information"])[reflected].mean()),
        }
        mean, sampled = estimate_statistic(values["detection"], draw.tissue, objective, control)
        resolved_values, gain = values["resolved"], values["information"]
        sampling: dict[Kind, float] = {
            "detection": math.hypot(sampled, threshold),
            "resolved": max(objective.compute_error(resolved_values, draw.tissue), compute_fraction_error(resolved_values)),
            "information": objective.compute_error(gain, draw.tissue),
        }
        return Judgement(
            observable=observable,
            means={"detection": mean, "resolved": float(resolved_values.mean()),
                    "information": objective.compute_statistic(gain)},
            errors={kind: MeanError(math.hypot(sampling[kind], correction_errors[kind]), models[kind], correction_errors[kind])
                    for kind in models},
            values=values, contrast_sd=contrast, modulus_sd=modulus,
            deflection=np.sqrt(noise.compute_chi_square(readings.signal)), depth=draw.depth,
            diameter=draw.diameter, x=draw.x, youngs_modulus=draw.youngs_modulus, tissue=draw.tissue,
            causes=causes, statistic=objective.statistic, false_alarm=protocol.false_alarm, evaluator=self.evaluator,
            seconds=self.seconds + perf_counter() - start, control=control, warnings=(draw.note,) if draw.note else (),
        )  # fmt: skip

    def _correct_first_order(
        self, values: dict[Kind, Floats], first_order: dict[Kind, Floats]
    ) -> tuple[dict[Kind, Floats], dict[Kind, float]]:
        """Return the values with the mean correction of eq. PO.13, and the standard error of the correction."""
        n, r = len(self.draw), len(self.reflected)
        unreflected, standard_errors = np.setdiff1d(np.arange(n), self.reflected), {}
        for kind, best_values in values.items():
            change = best_values[self.reflected] - first_order[kind][self.reflected]
            values[kind] = best_values.copy()
            values[kind][unreflected] = first_order[kind][unreflected] + change.mean()
            standard_errors[kind] = (
                float(np.std(change, ddof=1)) * math.sqrt(1 / r - 1 / n) if r > 1 else float(np.abs(change).max())
            )
        return values, standard_errors

    def _compute_model_error(
        self, detector: Detector, probabilities: Floats, blank: bool, seed: int
    ) -> tuple[float, float, dict[str, float]]:
        """Return the errors of the mean P by threshold and draws, and by the evaluator, and the latter's fractions by cause."""
        readings, reflected = self.readings, self.reflected
        slopes, errors = detector.compute_derivatives(readings.signal), _bound_signal_errors(readings, blank)
        signal_errors = errors * np.sign(slopes)  # eq. PO.11
        lower, upper = (
            detector.compute_probabilities(readings.signal + item, seed=seed) if signal_errors.any() else probabilities
            for item in (-signal_errors, signal_errors)
        )
        threshold = float(np.mean(detector.compute_probabilities(readings.signal, seed=seed, shift=-1) - probabilities))
        # the scatter of several tumours contains that of the draws, and a single template needs no draws
        known = len(probabilities) > 1 or len(detector.templates) == 1
        draws = 0.0 if known else math.sqrt(float(probabilities[0] * (1 - probabilities[0])) / SCANS_PER_TUMOUR)
        parts = {cause: float(np.sum(np.abs(slopes * item)[reflected])) for cause, item in readings.errors.items()}
        whole = sum(parts.values())
        causes = {cause: part / whole for cause, part in parts.items()} if whole > 0 else {}
        return math.hypot(threshold, draws), float(np.abs(upper - lower)[reflected].mean() / 2), causes


def _evaluate_tumours(
    detector: Detector, unknowns: Unknowns, readings: ScanReadings, *, noise: LinearGaussian, blank: bool, seed: int
) -> tuple[dict[Kind, Floats], Floats, Floats]:
    """Return each tumour's probability of detection, resolution, information, and the standard deviations of both logarithms."""
    J = unknowns.build_derivatives(readings, blank)
    contrast, modulus = compute_log_sds(unknowns, J, noise)
    values: dict[Kind, Floats] = {
        "detection": detector.compute_probabilities(readings.signal, seed=seed),
        "resolved": is_resolved(contrast),
        "information": compute_informations(unknowns, J, noise),
    }
    return values, contrast, modulus


def _average_tissue_derivatives(unknowns: Unknowns, readings: ScanReadings) -> Floats | None:
    """Return s_j t_j of eq. PO.3, averaged over the tissues, shape (m, q)."""
    columns = [
        deviation * readings.repeat_over_positions(readings.blank_derivatives[name].mean(axis=0))
        for name, deviation in zip(unknowns.names, unknowns.deviations, strict=True)
        if name in readings.blank_derivatives
    ]
    return np.stack(columns, axis=1) if columns else None


def _compute_error_fractions(readings: ScanReadings, blank: bool) -> Floats:
    """Return the relative error bound of each tumour's signals, at most 1, shape (n,)."""
    largest = np.maximum(np.abs(readings.signal).max(axis=1), 1e-300)
    return np.asarray(_bound_signal_errors(readings, blank).max(axis=1) / largest)


def _bound_signal_errors(readings: ScanReadings, blank: bool) -> Floats:
    """Return the error bound of each signal, at most the tumour's largest signal, shape (n, m).

    Without a baseline reading, readings are compared with the evaluator's prediction, whose error bound is added.
    """
    error = readings.error if blank else readings.error + readings.repeat_over_positions(readings.blank_error)[readings.tissue]
    return np.asarray(np.minimum(error, np.abs(readings.signal).max(axis=1, keepdims=True)))
