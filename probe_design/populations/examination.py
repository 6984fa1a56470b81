"""What a scan with one probe reads over a population, and what of it is detected and resolved under noise.

Of n tumours r have reflections, the others the first order alone. With v_i the values of the best that is known of each tumour
and w_i those of the first order, a mean over all is

    1/n sum_i (w_i) + 1/r sum_reflected (v_i - w_i)                                                 (PO.13)

so that tumours without reflections count with what reflections change of the others in the mean: that has the standard error
sd(v - w) (1/r - 1/n)^(1/2) on top of the sample's, and the model's error is that of tumours with reflections, whatever n is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError
from probe_design.populations.control import ControlSignals, sample_mean
from probe_design.populations.design_file import Design
from probe_design.populations.detection import SCANS, Detector, deflections
from probe_design.populations.judgement import Judgement, Kind, MeanError
from probe_design.populations.noise import covariance, covariance_of_all
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.readings import ScanReadings
from probe_design.populations.resolved import Unknowns, contrast_deviations, informations, resolved, share_error, undecided
from probe_design.populations.tables import CHANNELS, Observable


@dataclass(frozen=True)
class Examination:
    """What it takes time to find, and no noise changes; both channels at all positions.

    Attributes:
        population: the ranges.
        draw: the tumours.
        readings: over them, the best that is computed of each.
        first: the same to first order; None where all have reflections, or none.
        reflected: numbers of those that have, or of all, shape (r,).
        reference: signals of the tumours that the detector knows, by the formulas, shape (K, m).
        control: signals by the formulas beside another evaluator's, of the draw's tumours and of more.
        evaluator: of the readings.
        seconds: what it took.
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

    def part(self, positions: Ints, observable: Observable) -> Examination:
        """Return what of it is read at some positions, by number, of some channels."""
        channels = CHANNELS[observable]
        kept = self.readings.columns(positions, channels)
        return replace(
            self,
            readings=self.readings.part(positions, channels),
            first=None if self.first is None else self.first.part(positions, channels),
            reference=self.reference[:, kept],
            control=None if self.control is None else self.control.part(kept),
        )

    def judgement(self, design: Design, seed: int = 0, observable: Observable | None = None) -> Judgement:
        """Judge it under a design file's noise, false alarms and statistic.

        Args:
            design: whose positions are those of the readings.
            seed: of the noise's draws.
            observable: what is read; left out: what the protocol says.

        Raises:
            InputError: a reading has less noise than any reader.
        """
        start, read = perf_counter(), observable or design.protocol.observable
        scan = self.part(np.arange(len(design.protocol.positions)), read)
        return scan._judged(design, seed, read, start)

    def judgements(self, design: Design, seed: int = 0) -> Judgement:
        """Judge it likewise, with what the ratio alone, the stiffness alone and both tell beside it."""
        start, own = perf_counter(), design.protocol.observable
        lines: dict[Observable, Judgement | None] = {}
        for observable in CHANNELS:
            try:
                lines[observable] = self.judgement(design, seed, observable)
            except InputError:  # noise of a channel that the protocol does not read need not be said
                if observable == own:
                    raise
                lines[observable] = None
        judged = lines[own]
        assert judged is not None
        return replace(judged, by_observable=lines, seconds=self.seconds + perf_counter() - start)

    def _judged(self, design: Design, seed: int, observable: Observable, start: float) -> Judgement:
        """Judge readings of the observable alone."""
        draw, objective, protocol, readings = self.draw, design.objective, design.protocol, self.readings
        unknowns, blank = Unknowns.of(self.population, draw), np.exp(np.log(readings.blank).mean(axis=0))
        known = design.noise, protocol, draw.scene, blank
        whole = covariance(*known, tissue=_tissue(unknowns, readings), over=readings.over, observable=observable)
        own = covariance_of_all(*known, readings.over, observable=observable)
        detector = Detector.trained(self.reference, whole, protocol.false_alarm, seed=seed)
        values, contrast, modulus = _values(detector, unknowns, readings, own=own, blank=protocol.blank, seed=seed)
        threshold, model, causes = self._model_error(detector, values["detection"], protocol.blank, seed)
        control = None if self.control is None else self.control.found(detector, seed)
        off = dict.fromkeys(values, 0.0)
        if self.first is not None:
            before = _values(detector, unknowns, self.first, own=own, blank=protocol.blank, seed=seed)[0]
            values, off = self._corrected(values, before)
        fraction, some = _share(readings, protocol.blank), self.reflected
        models: dict[Kind, float] = {
            "detection": model,
            "resolved": float(undecided(contrast[some], fraction[some]).mean() / 2),
            "information": float(np.minimum(fraction, values["information"])[some].mean()),
        }
        mean, sampled = sample_mean(values["detection"], draw.tissue, objective, control)
        told, gain = values["resolved"], values["information"]
        sampling: dict[Kind, float] = {
            "detection": math.hypot(sampled, threshold),
            "resolved": max(objective.error(told, draw.tissue), share_error(told)),
            "information": objective.error(gain, draw.tissue),
        }
        return Judgement(
            observable=observable,
            means={"detection": mean, "resolved": float(told.mean()), "information": objective.over(gain)},
            errors={kind: MeanError(math.hypot(sampling[kind], off[kind]), models[kind], off[kind]) for kind in models},
            values=values, contrast_sd=contrast, modulus_sd=modulus, deflection=deflections(readings.signal, whole),
            depth=draw.depth, diameter=draw.diameter, x=draw.x, youngs_modulus=draw.youngs_modulus, tissue=draw.tissue,
            causes=causes, statistic=objective.statistic, false_alarm=protocol.false_alarm, evaluator=self.evaluator,
            seconds=self.seconds + perf_counter() - start, control=control, warnings=(draw.note,) if draw.note else (),
        )  # fmt: skip

    def _corrected(self, values: dict[Kind, Floats], before: dict[Kind, Floats]) -> tuple[dict[Kind, Floats], dict[Kind, float]]:
        """Eq. PO.13: values with the others' mean correction, and the standard error of that."""
        n, r = len(self.draw), len(self.reflected)
        others, off = np.setdiff1d(np.arange(n), self.reflected), {}
        for kind, each in values.items():
            change = each[self.reflected] - before[kind][self.reflected]
            values[kind] = each.copy()
            values[kind][others] = before[kind][others] + change.mean()
            off[kind] = float(np.std(change, ddof=1)) * math.sqrt(1 / r - 1 / n) if r > 1 else float(np.abs(change).max())
        return values, off

    def _model_error(self, detector: Detector, found: Floats, blank: bool, seed: int) -> tuple[float, float, dict[str, float]]:
        """What the threshold and, of one tumour alone, the draws leave open of the mean P; what the evaluator does; by what."""
        readings, some = self.readings, self.reflected
        slopes, errors = detector.slopes(readings.signal), _errors(readings, blank)
        off = errors * np.sign(slopes)  # eq. PO.11
        less, more = (detector.probabilities(readings.signal + one, seed=seed) if off.any() else found for one in (-off, off))
        threshold = float(np.mean(detector.probabilities(readings.signal, seed=seed, shift=-1) - found))
        known = len(found) > 1 or len(detector.templates) == 1  # whose draws scatter with the tumours, or which need none
        draws = 0.0 if known else math.sqrt(float(found[0] * (1 - found[0])) / SCANS)
        parts = {cause: float(np.sum(np.abs(slopes * one)[some])) for cause, one in readings.errors.items()}
        whole = sum(parts.values())
        causes = {cause: part / whole for cause, part in parts.items()} if whole > 0 else {}
        return math.hypot(threshold, draws), float(np.abs(more - less)[some].mean() / 2), causes


def _values(
    detector: Detector, unknowns: Unknowns, readings: ScanReadings, *, own: Floats, blank: bool, seed: int
) -> tuple[dict[Kind, Floats], Floats, Floats]:
    """Each tumour's probability of detection, whether it is resolved, its information; standard deviations of both logarithms."""
    J = unknowns.derivatives(readings, blank)
    contrast, modulus = (contrast_deviations(unknowns, J, own, of_object) for of_object in (False, True))
    values: dict[Kind, Floats] = {
        "detection": detector.probabilities(readings.signal, seed=seed),
        "resolved": resolved(contrast),
        "information": informations(unknowns, J, own),
    }
    return values, contrast, modulus


def _tissue(unknowns: Unknowns, readings: ScanReadings) -> Floats | None:
    """s_j t_j of eq. PO.3 in the mean over the tissues, shape (m, q)."""
    columns = [
        deviation * readings.on_scan(readings.blank_by[name].mean(axis=0))
        for name, deviation in zip(unknowns.names, unknowns.deviations, strict=True)
        if name in readings.blank_by
    ]
    return np.stack(columns, axis=1) if columns else None


def _share(readings: ScanReadings, blank: bool) -> Floats:
    """By what fraction each tumour's signals may be off as the evaluator says, at most 1, shape (n,)."""
    largest = np.maximum(np.abs(readings.signal).max(axis=1), 1e-300)
    return np.asarray(_errors(readings, blank).max(axis=1) / largest)


def _errors(readings: ScanReadings, blank: bool) -> Floats:
    """By how much each signal may be off as the evaluator says, at most the tumour's largest, shape (n, m).

    Without a baseline reading readings are counted from what the evaluator predicts, whose own error counts too.
    """
    error = readings.error if blank else readings.error + readings.on_scan(readings.blank_error)[readings.tissue]
    return np.asarray(np.minimum(error, np.abs(readings.signal).max(axis=1, keepdims=True)))
