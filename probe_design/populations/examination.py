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

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from probe_design.inference.linear_gaussian import LinearGaussian
from probe_design.populations.design_file import Design
from probe_design.populations.detection import SCANS_PER_TUMOUR, Detector
from probe_design.populations.inclusion_scan import Progress, compute_inclusion_readings
from probe_design.populations.loaded_scan import PressedScan
from probe_design.populations.noise import build_difference_noise, build_full_noise
from probe_design.populations.objective import LOCATED_KINDS, Kind
from probe_design.populations.performance import ControlSample, MeanError, Performance, estimate_statistic
from probe_design.populations.population import ScenePopulation, TumourDraw
from probe_design.populations.resolved import (
    Unknowns,
    compute_contrast_sd,
    compute_fraction_error,
    compute_informations,
    compute_place_errors,
    is_resolved,
    is_undecided,
)
from probe_design.populations.scan_readings import ScanReadings, compute_closed_form_readings
from probe_design.populations.several_loads import join_noise, join_signals, list_loaded_scenes
from probe_design.populations.tables import CHANNEL_INDICES, ChannelSet, Protocol
from probe_design.populations.tissue_scan import InclusionScan
from solver.contact.pressed_tissue import PressedTissue
from solver.equivalent_inclusion.readings import compute_readings

DETECTOR_TUMOURS = 256  # reference tumours of the detector


@dataclass(frozen=True)
class Examination:
    """The computed readings, which do not depend on noise; both channels at all positions.

    Attributes
    ----------
    population
        The ranges.
    draw
        The tumours.
    by_load
        Readings over the tumours, with reflections where they are computed, under each load of the protocol, or under one.
    first
        The same to first order; none if all tumours have reflections, or none has.
    reflected
        Numbers of the tumours with reflections, or of all, shape (r,).
    reference
        Signals of the detector's reference tumours by the closed form, shape (K, m).
    control
        Signals by the closed form, of the draw's tumours and of more; None if the closed form is the evaluator.
    evaluator
        Evaluator of the readings.
    """

    population: ScenePopulation
    draw: TumourDraw
    by_load: tuple[ScanReadings, ...]
    reference: Floats
    evaluator: str
    reflected: Ints
    first: tuple[ScanReadings, ...] = ()
    control: ControlSample | None = None

    @property
    def readings(self) -> ScanReadings:
        """Readings under the last load."""
        return self.by_load[-1]

    def select(self, positions: Ints, channel_set: ChannelSet) -> Examination:
        """Return the examination restricted to some positions, by number, and to the channels of a set of channels."""
        channels = CHANNEL_INDICES[channel_set]
        first_columns, count = self.readings.list_columns(positions, channels), self.readings.signal.shape[1]
        columns = np.concatenate([number * count + first_columns for number in range(len(self.by_load))])
        return replace(
            self,
            by_load=tuple(readings.select(positions, channels) for readings in self.by_load),
            first=tuple(readings.select(positions, channels) for readings in self.first),
            reference=self.reference[:, columns],
            control=None if self.control is None else self.control.select_readings(columns),
        )

    def evaluate(self, design: Design, channel_set: ChannelSet | None = None) -> Performance:
        """Compute probabilities of detection and resolution under a design file's noise, false alarms and statistic.

        Parameters
        ----------
        design
            The design; its positions are those of the readings.
        channel_set
            The channels that are read; default: those of the protocol.

        Raises
        ------
        InputError
            The noise of a reading is below ``MIN_NOISE``.
        """
        channels = channel_set or design.protocol.channel_set
        return self.select(np.arange(design.protocol.count), channels)._evaluate_channels(design, channels)

    def evaluate_all_channels(self, design: Design) -> Performance:
        """Evaluate the protocol's channels and, in ``by_channels``, the ratio alone, the stiffness alone and both."""
        by_channels: dict[ChannelSet, Performance | None] = {}
        for channel_set in CHANNEL_INDICES:
            try:
                by_channels[channel_set] = self.evaluate(design, channel_set)
            except InputError:  # the noise of a channel that the protocol does not read may be missing
                if channel_set == design.protocol.channel_set:
                    raise
                by_channels[channel_set] = None
        performance = by_channels[design.protocol.channel_set]
        assert performance is not None
        return replace(performance, by_channels=by_channels)

    def _evaluate_channels(self, design: Design, channel_set: ChannelSet) -> Performance:
        """Evaluate the readings, which ``select`` has restricted to one set of channels."""
        draw, objective, protocol, readings = self.draw, design.objective, design.protocol, self.by_load
        unknowns = Unknowns.from_draw(self.population, draw)
        noise, full_noise = self._build_noise(unknowns, design, channel_set)
        detector = Detector.train(self.reference, noise.covariance, protocol.false_alarm)
        values, contrast_sd = _evaluate_tumours(detector, unknowns, readings, noise=full_noise, blank=protocol.blank)
        threshold_error, model_error, causes = self._compute_model_error(detector, values["detection"], protocol.blank)
        control = None if self.control is None else self.control.compute_probabilities(detector)
        correction_errors = dict.fromkeys(values, 0.0)
        if self.first:
            first_order = _evaluate_tumours(detector, unknowns, self.first, noise=full_noise, blank=protocol.blank)[0]
            values, correction_errors = self._correct_first_order(values, first_order)
        reflected = self.reflected
        fraction = np.max([_compute_error_fractions(part, protocol.blank) for part in readings], axis=0)
        resolved = values["resolved"]
        model_errors: dict[Kind, float] = {
            "detection": model_error,
            "resolved": float(is_undecided(contrast_sd[reflected], fraction[reflected]).mean() / 2),
            "information": float(unknowns.bound_information_errors(values["information"], fraction)[reflected].mean()),
            "place_error": float(unknowns.bound_place_errors(values["place_error"], fraction)[reflected].mean()),
        }
        detection, detection_error = estimate_statistic(values["detection"], draw.tissue, objective, control)
        least_error = 1 / (len(draw) + (0 if control is None else len(control.other_tumours)) + 2)  # Laplace's rule of succession
        if len(draw) > 1 and min(detection, 1 - detection) < least_error:  # all or none detected says no more than that
            detection_error = max(detection_error, least_error)
        sampling_errors: dict[Kind, float] = {
            "detection": math.hypot(detection_error, threshold_error),
            "resolved": max(objective.compute_error(resolved, draw.tissue), compute_fraction_error(resolved)),
            **{kind: objective.compute_error(values[kind], draw.tissue) for kind in LOCATED_KINDS},
        }
        means: dict[Kind, float] = {
            "detection": min(max(detection, 0.0), 1.0),  # the control variate may lead beyond, as may eq. PO.13
            "resolved": min(max(float(resolved.mean()), 0.0), 1.0),
            **{kind: objective.compute_statistic(values[kind]) for kind in LOCATED_KINDS},
        }
        errors = {
            kind: MeanError(math.hypot(sampling_errors[kind], corrected), model_errors[kind], corrected)
            for kind, corrected in correction_errors.items()
        }
        return Performance(
            channel_set, means, errors, values, contrast_sd, draw, causes, protocol.false_alarm, self.evaluator, control
        )

    def _build_noise(self, unknowns: Unknowns, design: Design, channel_set: ChannelSet) -> tuple[LinearGaussian, LinearGaussian]:
        """Return the noise of differences, for a detector, and of all readings, under all loads of the protocol."""
        protocol, scenes = design.protocol, list_loaded_scenes(self.draw.scene, design.protocol)
        differences, full = list[LinearGaussian](), list[LinearGaussian]()
        for scene, readings in zip(scenes, self.by_load, strict=True):
            known = design.noise, protocol, scene, np.exp(np.log(readings.blank).mean(axis=0))
            tissue = _average_tissue_derivatives(unknowns, readings)
            forces = readings.mean_forces
            differences.append(build_difference_noise(*known, tissue=tissue, tumour_forces=forces, channel_set=channel_set))
            full.append(build_full_noise(*known, forces, channel_set=channel_set))
        return join_noise(differences, common=not protocol.blank), join_noise(full, common=True)

    def _correct_first_order(
        self, values: dict[Kind, Floats], first_order: dict[Kind, Floats]
    ) -> tuple[dict[Kind, Floats], dict[Kind, float]]:
        """Correct the values of tumours without reflections by the mean change that reflections cause, eq. PO.13.

        Parameters
        ----------
        values
            Values of all n tumours by kind, with reflections where they are computed, shape (n,).
        first_order
            The same, all to first order.

        Returns
        -------
        tuple[dict[Kind, Floats], dict[Kind, float]]
            The corrected values and the standard error of the mean correction, by kind.
        """
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
        self, detector: Detector, probabilities: Floats, blank: bool
    ) -> tuple[float, float, dict[str, float]]:
        """Return the errors of the mean probability of detection.

        Parameters
        ----------
        detector
            The detector.
        probabilities
            Probability of detection of each tumour, shape (n,).
        blank
            Whether there is a baseline reading.

        Returns
        -------
        tuple[float, float, dict[str, float]]
            The standard error by the detector's threshold and by the draws of noise; the error bound by the evaluator; and the
            fraction of the latter that each of its causes has.
        """
        signal, reflected = join_signals(self.by_load), self.reflected
        errors = np.concatenate([_bound_signal_errors(readings, blank) for readings in self.by_load], axis=1)
        derivatives = detector.compute_derivatives(signal)
        signal_errors = errors * np.sign(derivatives)  # eq. PO.11
        lower, upper = (
            detector.compute_probabilities(signal + item) if signal_errors.any() else probabilities
            for item in (-signal_errors, signal_errors)
        )
        shifted = detector.compute_probabilities(signal, threshold=detector.lower_threshold)
        threshold = float(np.mean(shifted - probabilities))
        # the scatter of several tumours contains that of the draws, and a single template needs no draws
        known = len(probabilities) > 1 or len(detector.templates) == 1
        draws = 0.0 if known else math.sqrt(float(probabilities[0] * (1 - probabilities[0])) / SCANS_PER_TUMOUR)
        by_cause = {cause: [part.errors[cause] for part in self.by_load] for cause in self.readings.errors}
        parts = {
            cause: float(np.sum(np.abs(derivatives * np.concatenate(items, axis=1))[reflected]))
            for cause, items in by_cause.items()
        }
        total = sum(parts.values())
        causes = {cause: part / total for cause, part in parts.items()} if total > 0 else {}
        return math.hypot(threshold, draws), float(np.abs(upper - lower)[reflected].mean() / 2), causes


def examine(
    scene: Scene,
    design: Design,
    *,
    samples: int | None = None,
    unseen: bool = False,
    pressed: tuple[tuple[PressedTissue, ...], ...] = (),
    progress: Progress | None = None,
) -> Examination:
    """Compute the readings over a population: by the closed form over the design's draw, or by finite elements over another.

    The reference tumours of the detector, computed with the closed form, are others of the population, so that it is never
    tested on tumours that it knows. Both ratio and stiffness are computed, whichever of them the protocol reads.

    Parameters
    ----------
    scene
        The design's scene, perhaps with another probe and load.
    design
        Design with population and protocol.
    samples
        Number of tumours; default: that of the design.
    unseen
        Whether to use equivalent-inclusion with reflections, and tumours that were not used in a search.
    pressed
        The draw's tissues under each load of the protocol, or under the scene's force, where it is beyond linear elasticity:
        readings are then those of ``contact``.
    progress
        Called by finite elements with the number of tissues done and the number of all.

    Raises
    ------
    InputError
        The population does not fit the tissue, or the probe would leave it.
    Refusal
        The evaluators cannot model the scene.
    """
    population, protocol = ScenePopulation.from_scene(scene, design.population), design.protocol.with_both_channels
    draw = population.draw_tumours(samples, unseen=unseen)
    names = ("object", *(name for name, values in population.ranges.items() if not values.is_single and name != "object"))
    control, reflected, loads = None, np.arange(len(draw)), len(protocol.loads) or 1
    best, first = list[ScanReadings](), list[ScanReadings]()
    if unseen:
        for tissues in pressed or ((),):
            readings = compute_inclusion_readings(draw, protocol, names, noise=design.noise, pressed=tissues, progress=progress)
            best.append(readings.best)
            first += [readings.first] if len(readings.reflected) < len(draw) else []
            reflected = readings.reflected
        control = ControlSample.from_draw(protocol, population, draw).repeat_readings(loads) if len(draw) > 1 else None
    else:
        best = [compute_closed_form_readings(draw, protocol, names)]
    # linear signals are the same under all loads
    by_load, first_by_load = (items if pressed else loads * items for items in (best, first))
    # seed + 1: reference tumours that are not among those of the draw
    known_tumours = replace(population, seed=population.seed + 1).draw_tumours(DETECTOR_TUMOURS)
    reference = np.tile(compute_closed_form_readings(known_tumours, protocol).signal, (1, loads))
    if pressed and all(values.is_single for name, values in population.ranges.items() if name.endswith("thickness")):
        changes = [_compute_reference_changes(known_tumours, protocol, tissues) for tissues in pressed]
        reference = reference + np.concatenate(changes, axis=1)
    evaluator = "contact" if pressed else "equivalent-inclusion" if unseen else "closed-form"
    return Examination(population, draw, tuple(by_load), reference, evaluator, reflected, tuple(first_by_load), control)


def _compute_reference_changes(draw: TumourDraw, protocol: Protocol, pressed: tuple[PressedTissue, ...]) -> Floats:
    """Return what the load adds to the signals of reference tumours, shape (K, m).

    Their tissues are others than the pressed ones of the same population, which stand for them: a detector that is trained on
    readings a little off detects a little less, and is what is verified.
    """
    changes = np.zeros((len(draw), protocol.channels * protocol.count))
    for number in range(len(draw.tissues)):
        tissue = pressed[number % len(pressed)]
        scan = InclusionScan(draw, protocol, number, tissue.base)
        which, offset, indices = scan.list_distinct()
        tumours = scan.build_tumours(which, offset)
        readings = compute_readings(tissue.base, tumours, 0, reflect=False)
        signal = PressedScan.from_tumours(tissue, tumours).compute_change(readings).signal
        changes[scan.members] = scan.join_channels(signal[indices])
    return changes


def _evaluate_tumours(
    detector: Detector, unknowns: Unknowns, by_load: tuple[ScanReadings, ...], *, noise: LinearGaussian, blank: bool
) -> tuple[dict[Kind, Floats], Floats]:
    """Return each tumour's probability of detection, resolution and information, and its standard deviation of ln contrast."""
    J = np.concatenate([unknowns.build_derivatives(readings, blank) for readings in by_load], axis=1)
    contrast_sd = compute_contrast_sd(unknowns, J, noise)
    values: dict[Kind, Floats] = {
        "detection": detector.compute_probabilities(join_signals(by_load)),
        "resolved": is_resolved(contrast_sd),
        "information": compute_informations(unknowns, J, noise),
        "place_error": compute_place_errors(unknowns, J, noise),
    }
    return values, contrast_sd


def _average_tissue_derivatives(unknowns: Unknowns, readings: ScanReadings) -> Floats | None:
    """Return s_j t_j of eq. PO.3 of the tissue's q unknowns, averaged over the tissues, shape (m, q); None without any."""
    columns = [
        deviation * readings.repeat_over_positions(readings.blank_derivatives[name].mean(axis=0))
        for name, deviation in zip(unknowns.names, unknowns.deviations, strict=True)
        if name in readings.blank_derivatives
    ]
    return np.stack(columns, axis=1) if columns else None


def _compute_error_fractions(readings: ScanReadings, blank: bool) -> Floats:
    """Return the error bound of each tumour's signals over its largest signal, at most 1, shape (n,)."""
    largest = np.maximum(np.abs(readings.signal).max(axis=1), 1e-300)
    return np.asarray(_bound_signal_errors(readings, blank).max(axis=1) / largest)


def _bound_signal_errors(readings: ScanReadings, blank: bool) -> Floats:
    """Return the error bound of each signal, at most the tumour's largest signal, shape (n, m).

    Without a baseline reading, readings are compared with the evaluator's prediction, whose error bound is added.
    """
    error = readings.error if blank else readings.error + readings.repeat_over_positions(readings.blank_error)[readings.tissue]
    return np.asarray(np.minimum(error, np.abs(readings.signal).max(axis=1, keepdims=True)))
