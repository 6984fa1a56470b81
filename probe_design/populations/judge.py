"""How good a probe is for a population: tumours found, contrasts told, what is learnt; with errors.

``scored`` asks the formulas, for a search, of the tumours that it has drawn; ``judged`` asks the equivalent-inclusion level with
reflections, of tumours that no search has seen. Both judge the same detector: it knows other tumours of the population by the
formulas, so that the tumours it is tried on are none of those it knows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.scenes.scene import Scene
from probe_design.populations.closed_form_scan import ClosedFormScan
from probe_design.populations.control import ControlSignals, ControlVariate, sample_mean
from probe_design.populations.design_file import Design
from probe_design.populations.detection import SCANS, Detector, deflections
from probe_design.populations.inclusion_scan import inclusion_readings
from probe_design.populations.noise import covariance, covariance_of_all
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.readings import ScanReadings
from probe_design.populations.resolved import Unknowns, contrast_deviations, informations, resolved, share_error, undecided
from probe_design.populations.tables import Objective

Progress = Callable[[int, int], None]
REFERENCE = 256  # tumours that the detector knows
LEVELS = ("closed-form", "equivalent-inclusion")
KINDS = ("detection", "resolved", "information")


@dataclass(frozen=True)
class Judgement:
    """What a probe does for n tumours.

    Attributes:
        detection, resolved, information: the statistic of ``[objective]`` over all: probability that a tumour is found; share
            whose ln contrast is told to 0.5; ln(prior / posterior standard deviation) of ln contrast.
        detection_error, resolved_error, information_error: one standard error, of the sample and of the draws, and on it what the
            level may be off.
        probability, contrast_sd, modulus_sd, gain, deflection: of each tumour: P_i, standard deviations of ln contrast and of
            ln E_object, information, d' if it were known; shape (n,).
        depth, diameter, x, youngs_modulus: of the tumours, m and Pa, shape (n,).
        tissue: number of each one's tissue, shape (n,).
        level_errors: what the level may be off in each of ``KINDS``.
        control: probabilities by the formulas, of these tumours and of more, see ``control``; None by the formulas themselves.
        statistic: as in the design file.
        false_alarm: share of tumour-free scans in which a tumour is found.
        evaluator: the level.
        seconds: what it took.
        warnings: what else is to be said.
    """

    detection: float
    detection_error: float
    resolved: float
    resolved_error: float
    information: float
    information_error: float
    probability: Floats
    contrast_sd: Floats
    modulus_sd: Floats
    gain: Floats
    deflection: Floats
    depth: Floats
    diameter: Floats
    x: Floats
    youngs_modulus: Floats
    tissue: Ints
    level_errors: tuple[float, float, float]
    statistic: str | float
    false_alarm: float
    evaluator: str
    seconds: float
    control: ControlVariate | None = None
    warnings: tuple[str, ...] = ()

    def values(self, kind: str) -> Floats:
        """Return each tumour's value of one of ``KINDS``, shape (n,)."""
        return {"detection": self.probability, "resolved": resolved(self.contrast_sd), "information": self.gain}[kind]

    def gain_over(self, other: Judgement, objective: Objective) -> tuple[float, float]:
        """Return by how much this is better than another probe for the same tumours, and the standard error of that.

        The tumours are the same, and so are the draws: of a mean what counts is how much the differences scatter.
        """
        kind = objective.maximise
        mine, others = self.values(kind), other.values(kind)
        level = math.hypot(self.level_errors[KINDS.index(kind)], other.level_errors[KINDS.index(kind)])
        if objective.statistic == "mean":
            both = self.control.less(other.control) if kind == "detection" and self.control and other.control else None
            gain, error = sample_mean(mine - others, self.tissue, objective, both)
            return gain, error + level
        return objective.over(mine) - objective.over(others), math.hypot(
            *(objective.error(one, self.tissue) for one in (mine, others))
        ) + level

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers of the population, as JSON has them."""
        names = [name for kind in KINDS for name in (kind, f"{kind}_error")]
        return {name: getattr(self, name) for name in names} | {"false_alarm": self.false_alarm, "tumours": len(self.depth)}


@dataclass(frozen=True)
class Examination:
    """What a scan with one probe reads over a population: what it takes time to find, and no noise changes.

    Attributes:
        population: the ranges.
        draw: the tumours.
        readings: over them.
        reference: signals of the tumours that the detector knows, by the formulas, shape (K, m).
        control: signals by the formulas beside another level's, of the draw's tumours and of more.
        evaluator: the level of the readings.
        seconds: what it took.
    """

    population: ScenePopulation
    draw: TumourDraw
    readings: ScanReadings
    reference: Floats
    evaluator: str
    seconds: float
    control: ControlSignals | None = None

    def judgement(self, design: Design, seed: int = 0) -> Judgement:
        """Judge it under a design file's noise, false alarms and statistic; ``seed``: of the noise's draws."""
        start, readings, draw, objective = perf_counter(), self.readings, self.draw, design.objective
        unknowns, protocol = Unknowns.of(self.population, draw), design.protocol
        blank = np.exp(np.log(readings.blank).mean(axis=0))
        known = design.noise, protocol, draw.scene, blank
        whole = covariance(*known, tissue=_tissue(unknowns, readings), over=readings.over)
        own = covariance_of_all(*known, readings.over)
        detector = Detector.trained(self.reference, whole, protocol.false_alarm, seed=seed)
        found, unsure = _found(detector, readings, design, seed)
        control = None if self.control is None else self.control.found(detector, seed)
        detection, sampled = sample_mean(found, draw.tissue, objective, control)
        J, share = unknowns.derivatives(readings, protocol.blank), _share(readings, protocol.blank)
        contrast, modulus = (contrast_deviations(unknowns, J, own, of_object) for of_object in (False, True))
        gain, told = informations(unknowns, J, own), resolved(contrast)
        levels = (unsure[1], float(undecided(contrast, share).mean() / 2), float(np.minimum(share, gain).mean()))
        return Judgement(
            detection=detection, detection_error=math.hypot(sampled, unsure[0]) + levels[0],
            resolved=float(told.mean()), resolved_error=max(objective.error(told, draw.tissue), share_error(told)) + levels[1],
            information=objective.over(gain), information_error=objective.error(gain, draw.tissue) + levels[2],
            probability=found, contrast_sd=contrast, modulus_sd=modulus, gain=gain,
            deflection=deflections(readings.signal, whole),
            depth=draw.depth, diameter=draw.diameter, x=draw.x, youngs_modulus=draw.youngs_modulus, tissue=draw.tissue,
            level_errors=levels, statistic=objective.statistic, false_alarm=protocol.false_alarm, evaluator=self.evaluator,
            seconds=self.seconds + perf_counter() - start, control=control, warnings=(draw.note,) if draw.note else (),
        )  # fmt: skip


def examined(
    scene: Scene, design: Design, *, samples: int | None = None, unseen: bool = False, progress: Progress | None = None
) -> Examination:
    """Read a scan over a population: by the formulas over the design's own draw, or by the judge's level over an unseen one.

    Args:
        scene: the design's scene, perhaps with another probe and load.
        design: population and protocol.
        samples: tumours; left out: as many as the design says.
        unseen: whether to take the judge's level and tumours.
        progress: called with tissues done and all, by the judge's level.

    Raises:
        InputError: the population does not fit the tissue, or the probe would leave it.
        Refusal: the levels cannot take the scene.
    """
    start, population = perf_counter(), ScenePopulation.of(scene, design.population)
    draw = population.drawn(samples, unseen=unseen)
    names = ("object", *(name for name, one in population.ranges.items() if not one.single and name != "object"))
    if unseen:
        readings = inclusion_readings(draw, design.protocol, names, noise=design.noise, progress=progress)
    else:
        readings = ClosedFormScan.of(draw, design.protocol).readings(scene, names)
    known = replace(population, seed=population.seed + 1).drawn(REFERENCE)
    reference = ClosedFormScan.of(known, design.protocol).readings(scene).signal
    control = ControlSignals.of(scene, design.protocol, population, draw) if unseen and len(draw) > 1 else None
    return Examination(population, draw, readings, reference, LEVELS[unseen], perf_counter() - start, control)


def judged(
    scene: Scene, design: Design, *, samples: int | None = None, seed: int = 0, progress: Progress | None = None
) -> Judgement:
    """Judge a scene's probe under its load on tumours that no search has seen, by ``equivalent-inclusion`` with reflections.

    Args:
        scene: the design's scene, perhaps with another probe and load.
        design: population, protocol, noise and statistic.
        samples: tumours; left out: as many as the design says.
        seed: of the noise's draws; the tumours' is the design's.
        progress: called with tissues done and all.

    Raises:
        InputError: the population does not fit the tissue, or the probe would leave it.
        Refusal: the levels cannot take the scene.
    """
    return examined(scene, design, samples=samples, unseen=True, progress=progress).judgement(design, seed)


def scored(scene: Scene, design: Design, *, samples: int | None = None, seed: int = 0) -> Judgement:
    """Judge a scene's probe by the formulas on the design's own draw; arguments and refusals as of ``judged``."""
    return examined(scene, design, samples=samples).judgement(design, seed)


def _found(detector: Detector, readings: ScanReadings, design: Design, seed: int) -> tuple[Floats, tuple[float, float]]:
    """P of each tumour; what the threshold and, of one tumour alone, the draws leave open of their mean; what the level does."""
    off = _errors(readings, design.protocol.blank) * np.sign(detector.slopes(readings.signal))  # eq. PO.11
    found = detector.probabilities(readings.signal, seed=seed)
    less, more = (detector.probabilities(readings.signal + one, seed=seed) if off.any() else found for one in (-off, off))
    threshold = float(np.mean(detector.probabilities(readings.signal, seed=seed, shift=-1) - found))
    known = len(found) > 1 or len(detector.templates) == 1  # whose draws scatter with the tumours, or which need none
    draws = 0.0 if known else math.sqrt(float(found[0] * (1 - found[0])) / SCANS)
    return found, (math.hypot(threshold, draws), float(np.abs(more - less).mean() / 2))


def _tissue(unknowns: Unknowns, readings: ScanReadings) -> Floats | None:
    """s_j t_j of eq. PO.3 in the mean over the tissues, shape (m, q)."""
    columns = [
        deviation * readings.on_scan(readings.blank_by[name].mean(axis=0))
        for name, deviation in zip(unknowns.names, unknowns.deviations, strict=True)
        if name in readings.blank_by
    ]
    return np.stack(columns, axis=1) if columns else None


def _share(readings: ScanReadings, blank: bool) -> Floats:
    """By what share each tumour's signals may be off as the level says, at most 1, shape (n,)."""
    largest = np.maximum(np.abs(readings.signal).max(axis=1), 1e-300)
    return np.asarray(_errors(readings, blank).max(axis=1) / largest)


def _errors(readings: ScanReadings, blank: bool) -> Floats:
    """By how much each signal may be off as the level says, at most the tumour's largest, shape (n, m).

    Without a blank readings are counted from what the level predicts, whose own error counts too.
    """
    error = readings.error if blank else readings.error + readings.on_scan(readings.blank_error)[readings.tissue]
    return np.asarray(np.minimum(error, np.abs(readings.signal).max(axis=1, keepdims=True)))
