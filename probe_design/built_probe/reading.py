"""Convert one reading to stresses, and compare them with the solver's prediction for the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Observable
from hw.common.samples import FILM_NAMES
from hw.signal.covariance import propagate_covariance
from hw.signal.measurement import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import CONTRADICTION_SD, SIGNIFICANT_SD, Bench
from probe_design.built_probe.film_forces import compute_film_forces
from probe_design.built_probe.gains import ForceScale, Gains
from probe_design.built_probe.load_plausibility import check_film_sum, check_scene_load
from probe_design.built_probe.ratio_phase import SD_PER_BOUND, add_ratio_phase, compare_ratio_phase, compute_ratio_phase
from probe_design.built_probe.reference_charges import compute_charge_units, list_omitted_films
from solver.axisymmetric.evaluator import Axisymmetric
from solver.contact.evaluator import ContactEvaluator
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.evaluation import evaluate
from solver.evaluators import AUTO
from solver.planning.load_check import add_load_effect, check_load, is_load_linear
from solver.planning.load_limits import build_load_rule
from solver.results.film_charges import reads_film_states
from solver.results.record import Record
from solver.results.result import Result

EXCHANGE_FACTOR = 5.0  # factor by which exchanged channels must reduce the difference of ln ratio from its prediction


@dataclass(frozen=True, repr=False)
class StressReading(Record):
    """Stress amplitudes under the sinusoidal load, compression positive; every ``uncertainty`` is a standard deviation.

    Attributes
    ----------
    ratio, stress_inner, stress_outer
        As read, stresses in Pa, over the drawing's end areas. The ratio is None if stress_outer is below its own uncertainty.
        Where readings are charges, the ratio is that of charges per area, and stresses follow by the predicted charges per force.
    ratio_uncertainty
        Of the ratio, by the delta method, enlarged where stress_outer is uncertain; the bonds' calibrated modulus counts.
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
    observable
        What the ratio is of, "charge" or "stress": what the scene reads.
    ratio_phase, ratio_phase_uncertainty
        By which stress_inner leads stress_outer, rad, counted from the ratio's sign.
    predicted_ratio_phase, z_ratio_phase
        By the scene's loss factors, rad, and the difference over its standard deviation.
    mains
        Frequency of the mains, Hz, or None if not detected.
    calibrated
        Whether gains come from a calibration.
    log_bonds
        ln of the factor on the moduli of the films' bonds by the calibration, with which the ratio is to be predicted, or None.
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
    observable: Observable
    ratio_phase: float
    ratio_phase_uncertainty: float
    predicted_ratio_phase: float | None
    z_ratio_phase: float | None
    mains: float | None
    calibrated: bool
    log_bonds: float | None
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
        No evaluator accepts the scene, or, unless ``linear``, its load is above the limits of linear elasticity and of
        ``contact``.
    """
    evaluators = (Axisymmetric(), EquivalentInclusion())
    evaluator = next((candidate for candidate in evaluators if candidate.refusal(scene) is None), None)
    if evaluator is None:
        return add_ratio_phase(evaluate(scene, AUTO, accuracy, linear=linear), scene, accuracy, frequency)
    rule = build_load_rule(scene)
    if not linear and not is_load_linear(scene, rule, accuracy, promise=False):
        if ContactEvaluator().refusal(scene) is not None:
            check_load(scene, rule, accuracy, promise=False)
        return add_ratio_phase(evaluate(scene, ContactEvaluator.name, accuracy), scene, accuracy, frequency)
    result = evaluator.evaluate(scene, accuracy)
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
        The load differs from the scene's by ``IMPLAUSIBLE_FACTOR``, as with a wrong unit: see ``load_plausibility``.
    """
    used_gains = Gains.from_bench(bench) if gains is None else gains
    films, noise = compute_film_forces(measurement, scene, tolerance=True)
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])
    charges, charge_covariance = used_gains.compute_forces(films), used_gains.compute_forces_covariance(films, noise)
    ratio, ratio_sd = _compute_ratio(charges, charge_covariance, float(areas[1] / areas[0]))
    # from charges over their unit to forces, where readings are charges; else both are the same
    factors, predicted_ratio, predicted_error = _predict_read_ratio(scene, predicted)
    forces, covariance = factors * charges, np.outer(factors, factors) * charge_covariance
    _check_films(forces, covariance)
    # a calibration shares the error of its force scale with the force channel of this reading
    unshared_gains = used_gains if measurement.force is None else used_gains.remove_force_scale_error()
    unshared_covariance = np.outer(factors, factors) * unshared_gains.compute_forces_covariance(films, noise)
    force, force_sd, unshared_force_sd = float(forces.sum()), _compute_sum_sd(covariance), _compute_sum_sd(unshared_covariance)
    _check_preload(force, force_sd, scene)
    scale = used_gains.force_scale
    # charges that were not predicted are forces only to their order of magnitude
    is_force = not reads_film_states(scene) or predicted.charge_per_force_inner is not None
    load_warnings = check_film_sum(force, unshared_force_sd if is_force else math.inf, measurement, bench, scale)
    load_warnings += check_scene_load(force, force_sd, measurement, scene, predicted, scale=scale)
    stresses, stress_sds, unshared_stress_sds = (
        forces / areas,
        _get_sds(covariance) / areas,
        _get_sds(unshared_covariance) / areas,
    )
    relative_sd = None if predicted_error is None else SD_PER_BOUND * predicted_error
    predicted_ratio_sd = None if predicted_ratio is None or relative_sd is None else abs(predicted_ratio) * relative_sd
    # where eq. (12) gives charges, they are multiples of the forces, which differ where the films do
    units = compute_charge_units(scene)
    charge_factor = float(units[0] / units[1]) if scene.observable == "charge" else 1.0
    is_scale_unknown = gains is None and bench.force is not None and not bench.force.verified
    scale_sd = unshared_force_sd / abs(force) if is_scale_unknown else 0.0
    predictions = _predict_at_load(measurement, scene, bench, predicted, scale=scale, scale_sd=scale_sd)
    z_ratio = _compute_z(ratio, ratio_sd, predicted_ratio, predicted_ratio_sd)
    z_inner, z_outer = (
        _compute_z(stress, sd, *prediction)
        for stress, sd, prediction in zip(stresses.tolist(), unshared_stress_sds.tolist(), predictions, strict=True)
    )
    phase, phase_sd = compute_ratio_phase(measurement, bench, used_gains)
    z_phase, phase_warnings = compare_ratio_phase(phase, phase_sd, predicted)
    film = scene.probe.film
    film_warnings = list_omitted_films(scene) if film is not None and film.has_bonds else []
    exchange_warnings = _warn_of_exchange(films, used_gains, predicted_ratio, z_ratio, areas)
    return StressReading(
        ratio=None if ratio is None else ratio * charge_factor,
        ratio_uncertainty=None if ratio_sd is None else ratio_sd * abs(charge_factor),
        stress_inner=float(stresses[0]),
        stress_inner_uncertainty=float(stress_sds[0]),
        stress_outer=float(stresses[1]),
        stress_outer_uncertainty=float(stress_sds[1]),
        force=force,
        force_uncertainty=force_sd,
        reference_force=None if measurement.force is None else measurement.force / scale.factor,
        evaluator=predicted.evaluator,
        predicted_ratio=None if predicted_ratio is None else predicted_ratio * charge_factor,
        predicted_ratio_uncertainty=None if predicted_ratio_sd is None else predicted_ratio_sd * abs(charge_factor),
        predicted_stress_inner=predictions[0][0],
        predicted_stress_outer=predictions[1][0],
        z_ratio=z_ratio,
        z_stress_inner=z_inner,
        z_stress_outer=z_outer,
        frequency=measurement.fit.frequency,
        cycles=measurement.fit.cycles,
        observable=scene.observable,
        ratio_phase=phase,
        ratio_phase_uncertainty=phase_sd,
        predicted_ratio_phase=predicted.ratio_phase,
        z_ratio_phase=z_phase,
        mains=measurement.fit.mains,
        calibrated=gains is not None,
        log_bonds=None if used_gains.bonds is None else used_gains.bonds.log_factor,
        samples=measurement.fit.rows,
        saturated=measurement.losses.saturated,
        gaps=measurement.losses.gaps,
        overruns=measurement.losses.overruns,
        warnings=(
            *_list_warnings(measurement, bench, gains, ratio),
            *load_warnings,
            *film_warnings,
            *exchange_warnings,
            *phase_warnings,
        ),
    )


def _predict_read_ratio(scene: Scene, predicted: Result) -> tuple[Floats, float | None, float | None]:
    """Return the factors from charges over their unit to forces, shape (2,), the ratio to be read, and its relative error.

    Where readings are stresses, the factors are 1. Where they are charges that were not predicted, they are 1, too.
    """
    if not reads_film_states(scene):
        return np.ones(2), predicted.ratio, predicted.error_estimate
    per_force = predicted.charge_per_force_inner, predicted.charge_per_force_outer
    if per_force[0] is None or per_force[1] is None:
        return np.ones(2), predicted.charge_ratio, predicted.charge_ratio_error
    factors = compute_charge_units(scene) / np.array(per_force, dtype=float)
    return factors, predicted.charge_ratio, predicted.charge_ratio_error


def _check_films(forces: Floats, covariance: Floats) -> None:
    """Refuse a film in tension, and an inner film without signal. An outer film without signal only makes the ratio null."""
    sds = _get_sds(covariance)
    for name, force, sd in zip(FILM_NAMES, forces.tolist(), sds.tolist(), strict=True):
        if force < -SIGNIFICANT_SD * sd:
            raise Flawed(f"the {name} film shows tension, {force:.3g} N: is its polarity reversed, or its cable another's?")
    if forces[0] < SIGNIFICANT_SD * sds[0]:
        shown = f"the inner film shows {forces[0]:.2g} N, uncertain by {sds[0]:.2g} N"
        raise Flawed(f"{shown}: is it dead, its cable off, or the load too small?")


def _check_preload(force: float, force_sd: float, scene: Scene) -> None:
    """Refuse a sinusoidal load that exceeds the scene's preload, N: at its trough the probe would pull."""
    preload = scene.load.preload
    if preload and force - SIGNIFICANT_SD * force_sd > preload:
        shown = f"the load of amplitude {force:.3g} N about load.preload = {preload:g} N pulls at its trough (net tension)"
        raise Flawed(f"{shown}: press harder, or shake less")


def _get_sds(covariance: Floats) -> Floats:
    """Return the standard deviations of a covariance; rounding may leave variances below 0."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _compute_sum_sd(covariance: Floats) -> float:
    """Return the standard deviation of both films' sum from their covariance; rounding may leave a variance below 0."""
    return math.sqrt(max(float(covariance.sum()), 0.0))


def _warn_of_exchange(films: Floats, gains: Gains, predicted: float | None, z: float | None, areas: Floats) -> list[str]:
    """Return a warning if a ratio is far from its prediction, and much nearer with the films' channels exchanged.

    Parameters
    ----------
    films
        Both films' readings, N of nominal gain, shape (2,).
    gains
        To convert them to forces.
    predicted, z
        The predicted ratio and the reading's difference from it in standard deviations; None if unknown.
    areas
        End areas of the inner and the outer block, m^2.
    """
    if predicted is None or z is None or predicted <= 0 or abs(z) <= CONTRADICTION_SD:
        return []
    stresses = [gains.compute_forces(pair) / areas for pair in (films, films[::-1])]
    deviation, exchanged_deviation = (abs(float(np.log(abs(pair[0] / pair[1] / predicted)))) for pair in stresses)
    if exchanged_deviation > deviation / EXCHANGE_FACTOR:
        return []
    return [f"the ratio is {abs(z):.2g} standard deviations from its prediction, and near it with the films' channels exchanged"]


def _compute_z(read: float | None, read_sd: float | None, predicted: float | None, predicted_sd: float | None) -> float | None:
    """Return the difference of a reading from its prediction over the standard deviation of both; None if one is unknown.

    ``read_sd`` and ``predicted_sd`` are their standard deviations, in the same unit.
    """
    if read is None or read_sd is None or predicted is None or predicted_sd is None:
        return None
    return (read - predicted) / math.hypot(read_sd, predicted_sd)


def _predict_at_load(
    measurement: Measurement, scene: Scene, bench: Bench, predicted: Result, *, scale: ForceScale, scale_sd: float
) -> list[tuple[float | None, float | None]]:
    """Return for each film the predicted stress at the load of the reading and its standard deviation, Pa; None if unknown.

    Without a force channel the load is the scene's.

    Parameters
    ----------
    measurement
        For the force channel.
    scene
        For the areas of the blocks.
    bench
        For the force channel's tolerance.
    predicted
        Result for the scene.
    scale, scale_sd
        The force channel's scale of a calibration, and its relative standard deviation.
    """
    if predicted.stress_inner is None or predicted.stress_outer is None or predicted.error_estimate is None:
        return [(None, None)] * 2
    stresses = np.array([predicted.stress_inner, predicted.stress_outer])
    relative_sd = SD_PER_BOUND * predicted.error_estimate
    if measurement.force is not None and bench.force is not None:
        predicted_force = float(stresses @ [scene.probe.inner_area, scene.probe.outer_area])
        stresses = stresses * measurement.force / scale.factor / predicted_force
        relative_sd = math.hypot(relative_sd, bench.force.tolerance, measurement.force_loss, scale_sd)
    return [(stress, abs(stress) * relative_sd) for stress in stresses.tolist()]


def _list_warnings(measurement: Measurement, bench: Bench, gains: Gains | None, ratio: float | None) -> list[str]:
    """List warnings: samples lost, those of the measurement, and the consequences of a missing calibration or ratio."""
    lost = {
        "gaps": measurement.losses.gaps,
        "overruns": measurement.losses.overruns,
        "saturated samples": measurement.losses.saturated,
    }
    warnings = [f"{count} {label}: left out, never filled in" for label, count in lost.items() if count]
    warnings += measurement.warnings
    if gains is None:
        channels = bench.channels
        text = f"gains to {format_percent(channels.gain, 6)}, cross-talk to {format_percent(channels.cross_talk, 6)}"
        warnings.append(f"not calibrated: the uncertainties count {text} of nominal")
    elif not gains.absolute:
        warnings.append("the calibration had no force channel: the stresses' common factor is nominal")
    if ratio is None:
        warnings.append("ratio is null: stress_outer is below its own uncertainty")
    return warnings


def _compute_ratio(forces: Floats, covariance: Floats, area_ratio: float) -> tuple[float | None, float | None]:
    """Return the ratio of stresses and its standard deviation; None if the outer force is below its own standard deviation.

    The delta method understates the deviation where the outer force is uncertain: it is enlarged by 1 / (1 - x), where x is the
    relative standard deviation of the outer force. ``area_ratio`` is the outer area over the inner.
    """
    outer_sd = float(np.sqrt(covariance[1, 1]))
    if outer_sd >= abs(forces[1]):
        return None, None
    variance = propagate_covariance(lambda pair: pair[:1] / pair[1:], forces, covariance)[0, 0]
    sd = float(np.sqrt(variance)) / (1 - outer_sd / float(abs(forces[1])))
    return float(forces[0] / forces[1] * area_ratio), sd * area_ratio
