"""Convert one reading to stresses, and compare them with the solver's prediction for the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from hw.signal.measure import FILM_NAMES, Measurement, propagate_covariance
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import CONTRADICTION_SD, SIGNIFICANT_SD, Bench
from probe_design.built_probe.film_forces import compute_film_forces
from probe_design.built_probe.gain_matrix import Gains
from probe_design.built_probe.load_checks import check_film_sum, check_scene_load
from probe_design.built_probe.ratio_phase import SD_PER_BOUND, add_ratio_phase, compare_ratio_phase, compute_ratio_phase
from solver.axisymmetric.evaluator import Axisymmetric
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.evaluation import evaluate
from solver.evaluators import AUTO
from solver.planning.load_check import add_load_effect, check_load
from solver.planning.load_limits import build_load_rule
from solver.results.record import Record
from solver.results.result import Result

EXCHANGE_FACTOR = 5.0  # factor by which exchanged channels must reduce the difference of ln ratio from its prediction


@dataclass(frozen=True)
class StressReading(Record):
    """Stress amplitudes under the sinusoidal load, compression positive; every ``uncertainty`` is a standard deviation.

    Attributes
    ----------
    ratio, stress_inner, stress_outer
        As read, stresses in Pa, over the drawing's end areas. The ratio is None if stress_outer is below its own uncertainty.
    ratio_uncertainty
        Of the ratio, by the delta method, enlarged where stress_outer is uncertain.
    force
        Sum of both film forces, N.
    reference_force
        Amplitude by the force channel, N, or None.
    predicted_ratio, predicted_stress_inner, predicted_stress_outer
        By ``evaluator``, the stresses at the reference force or, without one, at the scene's load.
    z_ratio, z_stress_inner, z_stress_outer
        Differences over their standard deviations, both sides' errors counted.
    frequency
        Of the load, Hz.
    cycles
        Of it in the record.
    ratio_phase, ratio_phase_uncertainty
        By which stress_inner leads stress_outer, rad, counted from the ratio's sign.
    predicted_ratio_phase, z_ratio_phase
        By the scene's loss factors, rad, and the difference over its standard deviation.
    mains
        Frequency of the mains, Hz, or None if not detected.
    calibrated
        Whether gains come from a calibration.
    samples
        Number of samples used.
    saturated
        Number of saturated samples, which are left out.
    gaps, overruns
        Number of gaps, and of overflows of the device's buffer.
    """

    ratio: float | None
    ratio_uncertainty: float | None
    stress_inner: float
    stress_inner_uncertainty: float
    stress_outer: float
    stress_outer_uncertainty: float
    force: float
    force_uncertainty: float
    reference_force: float | None
    evaluator: str
    predicted_ratio: float | None
    predicted_ratio_uncertainty: float | None
    predicted_stress_inner: float | None
    predicted_stress_outer: float | None
    z_ratio: float | None
    z_stress_inner: float | None
    z_stress_outer: float | None
    frequency: float
    cycles: float
    ratio_phase: float
    ratio_phase_uncertainty: float
    predicted_ratio_phase: float | None
    z_ratio_phase: float | None
    mains: float | None
    calibrated: bool
    samples: int
    saturated: int
    gaps: int
    overruns: int
    warnings: tuple[str, ...]


def predict_scene(scene: Scene, accuracy: float, linear: bool = False, frequency: float | None = None) -> Result:
    """Evaluate a scene by the fastest finite-element evaluator that accepts it, whatever error it then states.

    With a frequency (Hz) the ratio's phase is computed, too; it is null, with a warning, where this is not possible.

    Raises
    ------
    Refusal
        No evaluator accepts the scene, or, unless ``linear``, its load is above the limit of linear elasticity.
    """
    evaluator = next(
        (candidate for candidate in (Axisymmetric(), EquivalentInclusion()) if candidate.refusal(scene) is None), None
    )
    if evaluator is None:
        return add_ratio_phase(evaluate(scene, AUTO, accuracy, linear=linear), scene, accuracy, frequency)
    result, rule = evaluator.evaluate(scene, accuracy), build_load_rule(scene)
    if not linear:
        check_load(scene, rule, accuracy, promise=False)
    return add_ratio_phase(add_load_effect(result, scene, rule, accuracy, promise=False), scene, accuracy, frequency)


def compute_reading(
    measurement: Measurement, scene: Scene, bench: Bench, predicted: Result, gains: Gains | None = None
) -> StressReading:
    """Compute the stresses of a reading, and compare them with the prediction.

    Parameters
    ----------
    measurement
        Of both films.
    scene
        For the probe and the tissue that it was pressed on.
    bench
        Of the measurement.
    predicted
        Result of ``predict_scene``.
    gains
        Of a calibration; None: nominal, with the bench's tolerances.

    Raises
    ------
    Flawed
        A film is dead or reversed, or the films contradict the force channel.
    InputError
        The load is 30 times the scene's, or a 30th of it, as with a wrong unit: see ``load_checks``.
    """
    effective = Gains.from_bench(bench) if gains is None else gains
    films, noise = compute_film_forces(measurement, scene, tolerance=True)
    forces, covariance = effective.compute_forces(films), effective.compute_forces_covariance(films, noise)
    _check_films(forces, covariance)
    scale = effective.force_scale
    own_covariance = covariance if measurement.force is None else _compute_own_covariance(films, noise, effective)
    load_warnings = check_film_sum((float(forces.sum()), _compute_sum_sd(own_covariance)), measurement, bench, scale)
    load_warnings += check_scene_load((float(forces.sum()), _compute_sum_sd(covariance)), measurement, scene, predicted, scale)
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])
    stress, spread = forces / areas, np.sqrt(np.diag(covariance)) / areas
    ratio, ratio_sd = _compute_ratio(forces, covariance, float(areas[1] / areas[0]))
    relative = None if predicted.error_estimate is None else SD_PER_BOUND * predicted.error_estimate
    scale_doubt = (
        0.0
        if gains is not None or bench.force is None or bench.force.verified
        else _compute_sum_sd(own_covariance) / abs(forces.sum())
    )
    at_load, at_load_sd = _predict_at_load(
        measurement, scene, bench, predicted, relative, factor=scale.factor, scale_doubt=scale_doubt
    )
    own_sd = np.sqrt(np.maximum(np.diag(own_covariance), 0.0)) / areas
    predicted_ratio_sd = None if predicted.ratio is None or relative is None else abs(predicted.ratio) * relative
    z_ratio = _compute_z(ratio, ratio_sd, predicted.ratio, predicted_ratio_sd)
    comparison_warnings = [*load_warnings, *_warn_of_exchange(films, effective, predicted.ratio, z_ratio, areas)]
    phase, phase_sd = compute_ratio_phase(measurement, bench, effective)
    z_phase, phase_warnings = compare_ratio_phase(phase, phase_sd, predicted)
    return StressReading(
        ratio=ratio,
        ratio_uncertainty=ratio_sd,
        stress_inner=float(stress[0]),
        stress_inner_uncertainty=float(spread[0]),
        stress_outer=float(stress[1]),
        stress_outer_uncertainty=float(spread[1]),
        force=float(forces.sum()),
        force_uncertainty=_compute_sum_sd(covariance),
        reference_force=None if measurement.force is None else measurement.force / scale.factor,
        evaluator=predicted.evaluator,
        predicted_ratio=predicted.ratio,
        predicted_ratio_uncertainty=predicted_ratio_sd,
        predicted_stress_inner=at_load[0],
        predicted_stress_outer=at_load[1],
        z_ratio=z_ratio,
        z_stress_inner=_compute_z(float(stress[0]), float(own_sd[0]), at_load[0], at_load_sd[0]),
        z_stress_outer=_compute_z(float(stress[1]), float(own_sd[1]), at_load[1], at_load_sd[1]),
        frequency=measurement.fit.frequency,
        cycles=measurement.fit.cycles,
        ratio_phase=phase,
        ratio_phase_uncertainty=phase_sd,
        predicted_ratio_phase=predicted.ratio_phase,
        z_ratio_phase=z_phase,
        mains=measurement.fit.mains,
        calibrated=gains is not None,
        samples=measurement.fit.rows,
        saturated=measurement.saturated,
        gaps=measurement.lost,
        overruns=measurement.overruns,
        warnings=(*_list_warnings(measurement, bench, gains, ratio), *comparison_warnings, *phase_warnings),
    )


def _check_films(forces: Floats, covariance: Floats) -> None:
    """Refuse a film in tension, and an inner film without signal. An outer film without signal only makes the ratio null."""
    spread = np.sqrt(np.diag(covariance))
    for name, force, sd in zip(FILM_NAMES, forces.tolist(), spread.tolist(), strict=True):
        if force < -SIGNIFICANT_SD * sd:
            raise Flawed(f"the {name} film shows tension, {force:.3g} N: is its polarity reversed, or its cable another's?")
    if forces[0] < SIGNIFICANT_SD * spread[0]:
        shown = f"the inner film shows {forces[0]:.2g} N, uncertain by {spread[0]:.2g} N"
        raise Flawed(f"{shown}: is it dead, its cable off, or the load too small?")


def _compute_own_covariance(films: Floats, noise: Floats, gains: Gains) -> Floats:
    """Return the covariance of the films' forces without the error that they share with the force channel by a calibration."""
    return replace(gains, covariance=gains.covariance - gains.force_scale.covariance).compute_forces_covariance(films, noise)


def _compute_sum_sd(covariance: Floats) -> float:
    """Return the standard deviation of both films' sum."""
    return math.sqrt(max(float(covariance.sum()), 0.0))


def _warn_of_exchange(films: Floats, gains: Gains, predicted: float | None, z: float | None, areas: Floats) -> list[str]:
    """Return a warning if a ratio is far from its prediction, and much nearer with the films' channels exchanged."""
    if predicted is None or z is None or predicted <= 0 or abs(z) <= CONTRADICTION_SD:
        return []
    forces = [gains.compute_forces(pair) / areas for pair in (films, films[::-1])]
    deviation, exchanged_deviation = (abs(float(np.log(abs(pair[0] / pair[1] / predicted)))) for pair in forces)
    if exchanged_deviation > deviation / EXCHANGE_FACTOR:
        return []
    return [f"the ratio is {abs(z):.2g} standard deviations from its prediction, and near it with the films' channels exchanged"]


def _compute_z(read: float | None, spread: float | None, predicted: float | None, predicted_spread: float | None) -> float | None:
    if read is None or spread is None or predicted is None or predicted_spread is None:
        return None
    return (read - predicted) / math.hypot(spread, predicted_spread)


def _predict_at_load(
    measurement: Measurement,
    scene: Scene,
    bench: Bench,
    predicted: Result,
    relative: float | None,
    *,
    factor: float,
    scale_doubt: float,
) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
    """Return the predicted stresses of both films at the load of the reading, Pa, and their standard deviations.

    ``factor`` is the force channel's reading over the true force, ``scale_doubt`` its relative standard deviation.
    """
    if predicted.stress_inner is None or predicted.stress_outer is None or relative is None:
        return (None, None), (None, None)
    stress = np.array([predicted.stress_inner, predicted.stress_outer])
    if measurement.force is not None and bench.force is not None:
        stress = stress * measurement.force / factor / float(stress @ [scene.probe.inner_area, scene.probe.outer_area])
        relative = math.hypot(relative, bench.force.tolerance, measurement.force_doubt, scale_doubt)
    return tuple(stress.tolist()), tuple((np.abs(stress) * relative).tolist())


def _list_warnings(measurement: Measurement, bench: Bench, gains: Gains | None, ratio: float | None) -> list[str]:
    lost = {"gaps": measurement.lost, "overruns": measurement.overruns, "saturated samples": measurement.saturated}
    warnings = [f"{count} {label}: left out, never filled in" for label, count in lost.items() if count]
    warnings += measurement.warnings
    if gains is None:
        channels = bench.channels
        text = f"gains to {100 * channels.gain:g} %, cross-talk to {100 * channels.cross_talk:g} %"
        warnings.append(f"not calibrated: the uncertainties count {text} of nominal")
    elif not gains.absolute:
        warnings.append("the calibration had no force channel: the stresses' common factor is nominal")
    if ratio is None:
        warnings.append("ratio is null: stress_outer is below its own uncertainty")
    return warnings


def _compute_ratio(forces: Floats, covariance: Floats, areas: float) -> tuple[float | None, float | None]:
    """Return the ratio and its standard deviation, enlarged by 1/(1 - x) with x the outer force's relative one."""
    outer_sd = float(np.sqrt(covariance[1, 1]))
    if outer_sd >= abs(forces[1]):
        return None, None
    loose = outer_sd / float(abs(forces[1]))
    spread = float(np.sqrt(propagate_covariance(_divide_forces, forces, covariance)[0, 0])) / (1 - loose)
    return float(forces[0] / forces[1] * areas), spread * areas


def _divide_forces(forces: Floats) -> Floats:
    return forces[:1] / forces[1:]
