"""Calibrate a probe: from readings on references to the gain matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from hw.signal.measure import Measurement
from probe_design.built_probe.amplifier_responses import add_rate_doubt_to_gains
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import BlockPredictions
from probe_design.built_probe.force_scale import list_scale_warnings
from probe_design.built_probe.gain_matrix import Gains, Observation
from probe_design.built_probe.pressed_references import PressedReferences
from probe_design.built_probe.trusted_gains import estimate_trusted_gains

FREQUENCY_TOLERANCE = 0.01  # largest relative difference of the loads' frequencies


@dataclass(frozen=True)
class Calibration:
    """The gains of a probe, with the readings and assumptions behind them.

    Attributes
    ----------
    scene, bench
        The probe as drawn and the bench, taken as known.
    gains
        The gain matrix M of eq. BP.1 with its covariance.
    variables
        Names of the variables of ``gains.slopes``.
    frequency
        Mean frequency of the loads, Hz.
    offsets
        Of both films' channels, V, mean of all readings, shape (2,).
    offsets_sd
        Standard deviations of ``offsets``, from the readings' scatter, V.
    readings
        One observation for each reference.
    warnings
        One line each.
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
    scene: Scene,
    bench: Bench,
    measurements: Sequence[Measurement],
    shares: BlockPredictions | None = None,
    *,
    linear: bool = False,
) -> Calibration:
    """Calibrate a probe.

    Parameters
    ----------
    scene
        The probe as drawn; the blocks have its tissue's shape and Poisson's ratio.
    bench
        References and tolerances.
    measurements
        By ``film_forces.measure_strict_reading``, one on each of the bench's references, in their order.
    shares
        The predictions, if they are known already.
    linear
        Whether to accept loads whose finite strain may change a prediction by more than 0.8 %; it is counted anyway.

    Raises
    ------
    InputError
        The references do not determine the gains, or the readings contradict each other: see
        ``trusted_gains.estimate_trusted_gains``.
    Refusal
        The axisymmetric evaluator cannot compute the probe, or a load is above the limit of linear elasticity.
    """
    pressed = PressedReferences.from_measurements(scene, bench, bench.reference, measurements, shares, linear=linear)
    try:
        gains, notes = estimate_trusted_gains(pressed.observations, pressed.predictions, bench)
    except InputError as fault:  # a film's lag may explain the contradiction
        raise InputError(fault.key, fault.value, "; ".join([fault.allowed, *pressed.lag_warnings])) from None
    gains = add_rate_doubt_to_gains(gains, measurements, bench)
    offsets = np.array([measurement.fit.offsets[:2] for measurement in measurements])
    spread = offsets.std(axis=0, ddof=1) / np.sqrt(len(offsets)) if len(offsets) > 1 else measurements[0].fit.offsets_sd[:2]
    return Calibration(
        scene=scene,
        bench=bench,
        gains=gains,
        variables=pressed.predictions.variables,
        frequency=_compute_frequency(measurements),
        offsets=offsets.mean(axis=0),
        offsets_sd=spread,
        readings=pressed.observations,
        warnings=(*notes, *_list_warnings(gains, bench), *pressed.warnings),
    )


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
