"""Calibrate a probe: from readings on references to the gain matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from hw.common.errors import HardwareError
from hw.common.samples import Samples
from hw.signal.measure import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe.amplifier_responses import add_rate_doubt_to_gains
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import BlockPredictions, predict_blocks
from probe_design.built_probe.film_forces import build_observation, measure_strict_reading
from probe_design.built_probe.force_scale import list_scale_warnings
from probe_design.built_probe.gain_matrix import Gains, Observation
from probe_design.built_probe.load_checks import apply_loads, check_reference_loads
from probe_design.built_probe.phase_lags import list_lag_warnings
from probe_design.built_probe.trusted_gains import estimate_trusted_gains

FREQUENCY_TOLERANCE = 0.01  # largest relative difference of the loads' frequencies


@dataclass(frozen=True)
class Calibration:
    """The gains of a probe, with the readings and assumptions behind them.

    Attributes:
        scene, bench: the probe as drawn and the bench, taken as known.
        gains: the gain matrix M of eq. BP.1 with its covariance.
        variables: names of the variables of ``gains.slopes``.
        frequency: mean frequency of the loads, Hz.
        offsets: of both films' channels, V, mean of all readings, shape (2,).
        offsets_sd: standard deviations of ``offsets``, from the readings' scatter, V.
        readings: one observation for each reference.
        warnings: one line each.
    """

    scene: Scene
    bench: Bench
    gains: Gains
    variables: tuple[str, ...]
    frequency: float
    offsets: Floats
    offsets_sd: Floats
    readings: tuple[Observation, ...]
    warnings: tuple[str, ...]


def calibrate(
    scene: Scene, bench: Bench, samples: Sequence[Samples], shares: BlockPredictions | None = None, *, linear: bool = False
) -> Calibration:
    """Calibrate a probe.

    Args:
        scene: the probe as drawn; the blocks have its tissue's shape and Poisson's ratio.
        bench: references and tolerances.
        samples: one reading for each of the bench's references, in their order.
        shares: the predictions, if they are known already.
        linear: whether to accept loads whose finite strain may change a prediction by more than 0.8 %; it is counted anyway.

    Raises:
        HardwareError: a reading has gaps, is saturated, too short or drifts.
        InputError: the references do not determine the gains, or the readings contradict each other: see
            ``trusted_gains.estimate_trusted_gains``.
        Refusal: the axisymmetric evaluator cannot compute the probe, or a load is above the limit of linear elasticity.
    """
    _check_count(samples, bench)
    measurements = [
        _read_reference(reference, reading, bench, scene) for reference, reading in zip(bench.reference, samples, strict=True)
    ]
    return calibrate_measurements(scene, bench, measurements, shares, linear=linear)


def calibrate_measurements(
    scene: Scene,
    bench: Bench,
    measurements: Sequence[Measurement],
    shares: BlockPredictions | None = None,
    *,
    linear: bool = False,
) -> Calibration:
    """Calibrate from measurements by ``film_forces.measure_strict_reading``; otherwise as ``calibrate``."""
    _check_count(measurements, bench)
    observations = tuple(
        build_observation(measurement, reference, scene)
        for measurement, reference in zip(measurements, bench.reference, strict=True)
    )
    predictions = predict_blocks(scene, bench.reference) if shares is None else shares
    load_warnings = check_reference_loads(observations, predictions, scene)
    predictions = apply_loads(predictions, observations, load_warnings, linear)
    lags = list_lag_warnings(measurements, bench.reference, bench)
    try:
        gains, notes = estimate_trusted_gains(observations, predictions, bench)
    except InputError as fault:  # a film's lag may explain the contradiction
        raise InputError(fault.key, fault.value, "; ".join([fault.allowed, *lags])) from None
    gains = add_rate_doubt_to_gains(gains, measurements, bench)
    offsets = np.array([measurement.fit.offsets[:2] for measurement in measurements])
    spread = offsets.std(axis=0, ddof=1) / np.sqrt(len(offsets)) if len(offsets) > 1 else measurements[0].fit.offsets_sd[:2]
    return Calibration(
        scene=scene,
        bench=bench,
        gains=gains,
        variables=predictions.variables,
        frequency=_compute_frequency(measurements),
        offsets=offsets.mean(axis=0),
        offsets_sd=spread,
        readings=observations,
        warnings=(
            *notes,
            *_list_warnings(gains, bench),
            *load_warnings,
            *list_waveform_warnings(measurements, bench.reference),
            *lags,
        ),
    )


def list_waveform_warnings(measurements: Sequence[Measurement], references: Sequence[Reference]) -> tuple[str, ...]:
    """List the warnings of all readings, each with the names of the references on which it occurs."""
    names_by_text: dict[str, list[str]] = {}
    for measurement, reference in zip(measurements, references, strict=True):
        for text in measurement.warnings:
            names_by_text.setdefault(text, []).append(reference.name)
    return tuple(f"{', '.join(names)}: {text}" for text, names in names_by_text.items())


def _check_count(readings: Sequence[Samples] | Sequence[Measurement], bench: Bench) -> None:
    if len(readings) != len(bench.reference):
        raise InputError("readings", len(readings), f"one for each of the bench's {len(bench.reference)} references")


def _read_reference(reference: Reference, samples: Samples, bench: Bench, scene: Scene) -> Measurement:
    """Measure a reading on a reference; an error names the reference."""
    try:
        return measure_strict_reading(samples, bench, scene)
    except HardwareError as fault:
        dead = "" if reference.on == "tissue" else f"; if the load is on, is the {reference.on} film dead, its cable off?"
        raise Flawed(f"{reference.name}: {fault}{dead}") from fault


def _compute_frequency(measurements: Sequence[Measurement]) -> float:
    frequencies = [measurement.fit.frequency for measurement in measurements]
    mean = float(np.mean(frequencies))
    if np.ptp(frequencies) > FREQUENCY_TOLERANCE * mean:
        spread = Words(f"{min(frequencies):.4g} to {max(frequencies):.4g} Hz")
        raise InputError("load.frequency", spread, "the same at all readings of a calibration")
    return mean


def _list_warnings(gains: Gains, bench: Bench) -> list[str]:
    warnings = list_scale_warnings(gains.force_scale, bench)
    if not gains.absolute:
        warnings.append("no force channel: the ratio is calibrated, the stresses' common factor is not")
    for measured, entry in zip(gains.cross_talk_resolved, ("inner from outer", "outer from inner"), strict=True):
        if not measured:
            warnings.append(f"cross-talk {entry}: the readings do not determine it; the bench's assumption stands")
    return warnings
