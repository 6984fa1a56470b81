"""Calibrate a probe: from readings on references to the gain matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from hw.signal.measurement import Measurement
from probe_design.built_probe.bench import Bench, Reference
from probe_design.built_probe.block_predictions import BlockPredictions, predict_blocks
from probe_design.built_probe.film_forces import build_observation
from probe_design.built_probe.gain_checks import estimate_consistent_gains
from probe_design.built_probe.gain_fit import compute_mean_gain_sd
from probe_design.built_probe.gains import ForceScale, Gains, Observation
from probe_design.built_probe.load_plausibility import check_reference_loads
from probe_design.built_probe.reference_charges import list_omitted_films
from probe_design.built_probe.timing_errors import count_rate_error_of_gains, list_lag_warnings

T = TypeVar("T")
MAX_BOND_STEPS = 6  # fits of the bonds' modulus, each with predictions at the last
MAX_BOND_SDS = 5.0  # standard deviations of ln of that modulus to which predictions go
NEAR_BONDS = 0.1  # change of it by a fit from which predictions are not repeated: their curvature adds 0.05 % of a charge
FREQUENCY_TOLERANCE = 0.01  # largest relative difference of the loads' frequencies
WARNED_SCALE_SD = 3.0  # standard deviations of the bench's tolerance beyond which the force channel's scale is reported


@dataclass(frozen=True)
class ReferenceReadings:
    """Readings on references and the predictions under their loads.

    Attributes
    ----------
    observations
        One for each reference.
    predictions
        For the references that are blocks of tissue, under the loads that were read.
    lag_warnings
        See ``timing_errors.list_lag_warnings``.
    warnings
        Of loads, waveforms and lags, one line each.
    """

    observations: tuple[Observation, ...]
    predictions: BlockPredictions
    lag_warnings: tuple[str, ...]
    warnings: tuple[str, ...]

    @classmethod
    def from_measurements(
        cls, scene: Scene, bench: Bench, references: Sequence[Reference], measurements: Sequence[Measurement],
        predictions: BlockPredictions, *, linear: bool,
    ) -> ReferenceReadings:  # fmt: skip
        """Compare the loads of readings with the expected ones, and predict the blocks under them.

        Parameters
        ----------
        scene
            The probe as drawn.
        bench
            Of the readings.
        references
            Of the bench, all or the blocks of tissue alone.
        measurements
            By ``film_forces.measure_strict_reading``, one on each reference.
        predictions
            Of the references, without load.
        linear
            See ``BlockPredictions.apply_forces``.

        Raises
        ------
        InputError
            There is not one reading for each reference, or a load differs from the expected one by ``IMPLAUSIBLE_FACTOR``.
        Refusal
            The axisymmetric evaluator cannot compute the probe, or ``contact`` does not reach a load.
        """
        if not references or len(measurements) != len(references):
            kind = "references" if len(references) == len(bench.reference) else "blocks of tissue, at least one"
            raise InputError("readings", len(measurements), f"one for each of the bench's {len(references)} {kind}")
        pairs = zip(measurements, references, strict=True)
        factors = predictions.load_factors or (None,) * len(references)
        observations = [
            replace(build_observation(measurement, reference, scene), load_factor=factor)
            for (measurement, reference), factor in zip(pairs, factors, strict=True)
        ]
        load_warnings = check_reference_loads(observations, predictions, scene)
        try:
            predictions = predictions.apply_forces([item.load for item in observations], references, linear)
        except Refusal as error:  # a wrong unit may explain it
            raise Refusal(error.key, error.value, "; ".join([error.allowed, *load_warnings])) from None
        predictions = replace(predictions, load_sd=_compute_load_sd(observations, predictions, bench))
        factors = predictions.load_factors or (None,) * len(references)
        observations = [replace(item, load_factor=factor) for item, factor in zip(observations, factors, strict=True)]
        lag_warnings = tuple(list_lag_warnings(measurements, references, bench))
        waveform_warnings = _list_waveform_warnings(measurements, references)
        return cls(tuple(observations), predictions, lag_warnings, (*load_warnings, *waveform_warnings, *lag_warnings))


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
    predictions: BlockPredictions | None = None,
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
    predictions
        For the blocks of tissue, if they are known already.
    linear
        See ``BlockPredictions.apply_forces``.

    Raises
    ------
    InputError
        The references do not determine the gains, or the readings contradict each other: see
        ``gain_checks.estimate_consistent_gains``.
    Refusal
        The axisymmetric evaluator cannot compute the probe, or ``contact`` does not reach a load.
    """

    def fit(predictions: BlockPredictions) -> tuple[Gains, tuple[ReferenceReadings, tuple[str, ...]]]:
        """Return the gains that follow from predictions, with the readings and the fit's warnings."""
        readings = ReferenceReadings.from_measurements(scene, bench, bench.reference, measurements, predictions, linear=linear)
        try:
            gains, fit_warnings = estimate_consistent_gains(readings.observations, readings.predictions, bench)
        except InputError as error:  # a film's lag may explain the contradiction
            raise InputError(error.key, error.value, "; ".join([error.allowed, *readings.lag_warnings])) from None
        return gains, (readings, fit_warnings)

    predictions = predict_blocks(scene, bench.reference) if predictions is None else predictions
    gains, (readings, fit_warnings) = fit_bonds(scene, bench.reference, predictions, fit)
    gains = count_rate_error_of_gains(gains, measurements, bench)
    offsets = np.array([measurement.fit.offsets[:2] for measurement in measurements])
    # standard error of the mean; a single reading has no scatter, and its fit's standard deviation stands in
    scatter = offsets.std(axis=0, ddof=1) / np.sqrt(len(offsets)) if len(offsets) > 1 else measurements[0].fit.offsets_sd[:2]
    return Calibration(
        scene=scene,
        bench=bench,
        gains=gains,
        variables=readings.predictions.variables,
        frequency=_compute_mean_frequency(measurements),
        offsets=offsets.mean(axis=0),
        offsets_sd=scatter,
        readings=readings.observations,
        warnings=(*fit_warnings, *_list_gain_warnings(gains, bench), *list_omitted_films(scene), *readings.warnings),
    )


def fit_bonds(
    scene: Scene,
    references: Sequence[Reference],
    predictions: BlockPredictions,
    fit: Callable[[BlockPredictions], tuple[Gains, T]],
) -> tuple[Gains, T]:
    """Fit gains and, where readings are charges, the modulus of the films' bonds, and return what the last fit returned.

    Predictions are linear in the logarithm of that modulus, so that they are repeated where a fit ends.

    Parameters
    ----------
    scene
        The probe as drawn.
    references
        Of the predictions.
    predictions
        For the bonds as drawn.
    fit
        Returns the gains that follow from predictions, and anything else.
    """
    for _ in range(MAX_BOND_STEPS):
        gains, other = fit(predictions)
        if gains.bonds is None or predictions.bonds is None:
            break
        limit = MAX_BOND_SDS * predictions.bonds.log_sd
        log_bonds = float(np.clip(gains.bonds.log_factor, -limit, limit))
        if abs(log_bonds - predictions.bonds.log_factor) < NEAR_BONDS:
            break
        predictions = predict_blocks(scene, references, log_bonds, predictions)
    return gains, other


def _compute_load_sd(observations: Sequence[Observation], predictions: BlockPredictions, bench: Bench) -> float:
    """Return the relative standard deviation of all loads together: of the force channel's scale, or of both films' gains."""
    if all(item.force is not None for item in observations) and bench.force is not None and bench.force.verified:
        return bench.force.tolerance
    by_bonds = [factor.bond_derivative for factor in predictions.load_factors]
    spread = 0.0 if predictions.bonds is None or bench.force is not None else predictions.bonds.log_sd * max(map(abs, by_bonds))
    return float(np.hypot(compute_mean_gain_sd(bench), spread))


def _compute_mean_frequency(measurements: Sequence[Measurement]) -> float:
    """Return the mean frequency of the loads, Hz. Raises ``InputError`` if they differ by more than FREQUENCY_TOLERANCE."""
    frequencies = [measurement.fit.frequency for measurement in measurements]
    mean = float(np.mean(frequencies))
    if np.ptp(frequencies) > FREQUENCY_TOLERANCE * mean:
        limits = Words(f"{min(frequencies):.4g} to {max(frequencies):.4g} Hz")
        raise InputError("load.frequency", limits, "the same at all readings of a calibration")
    return mean


def _list_waveform_warnings(measurements: Sequence[Measurement], references: Sequence[Reference]) -> list[str]:
    """List the warnings of all readings, each with the names of the references on which it occurs."""
    names_by_text: dict[str, list[str]] = {}
    for measurement, reference in zip(measurements, references, strict=True):
        for text in measurement.warnings:
            names_by_text.setdefault(text, []).append(reference.name)
    return [f"{', '.join(names)}: {text}" for text, names in names_by_text.items()]


def _list_gain_warnings(gains: Gains, bench: Bench) -> list[str]:
    """List what the readings leave undetermined: force scale, common factor, cross-talk."""
    warnings = list_scale_warnings(gains.force_scale, bench)
    if not gains.absolute:
        warnings.append("no force channel: the ratio is calibrated, the stresses' common factor is not")
    for is_resolved, entry in zip(gains.cross_talk_resolved, ("inner from outer", "outer from inner"), strict=True):
        if not is_resolved:
            warnings.append(f"cross-talk {entry}: the readings do not determine it; the bench's assumption stands")
    return warnings


def list_scale_warnings(scale: ForceScale, bench: Bench) -> list[str]:
    """List the warnings on the force channel's scale: not confirmed by a known load, or different from 1."""
    if bench.force is None or scale.sd == 0:
        return []
    percent_error = 100 * (scale.factor - 1)
    side = "much" if percent_error > 0 else "little"
    shown = f"shows {abs(percent_error):.2g} % too {side}, ± {format_percent(scale.sd)}"
    if not scale.confirmed:
        return [
            f"nothing confirms the force channel's scale: by the films' nominal gains it {shown}; gains and stresses count that, "
            "the ratio does not depend on it. For better stresses give a reference a known load (known_force in the bench: a "
            "weight on the pin), or write verified = true under [force] if a known load has confirmed the sensor"
        ]
    if abs(scale.factor - 1) > WARNED_SCALE_SD * float(np.hypot(bench.force.tolerance, scale.sd)):
        return [f"the force channel {shown}, by the references of known load: corrected; look at its sensitivity"]
    return []
