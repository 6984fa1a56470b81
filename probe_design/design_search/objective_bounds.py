"""Compute the objective of one tumour, the standard deviation of ln E_object, and bound it by the errors of an evaluation."""

from __future__ import annotations

import math

import numpy as np

from geometry.scenes.scene import Scene
from probe_design.design_search.loads import Pressing
from probe_design.design_search.tumour_objective import Noise, compute_standard_deviation
from solver.planning.loads import bound_log_sensitivity_change, compute_sensitivity_size
from solver.results.film_forces import FilmForces

MIN_CHARGE_FRACTION = 1e-6  # of a charge, which is left of it where its error is as large: its noise is then without bound


def compute_objective(scene: Scene, films: FilmForces, noise: Noise, force: float) -> float:
    """Return the standard deviation of ln E_object under a force, N; inf where a film's stress or charge is below its own error.

    Parameters
    ----------
    scene
        The scene, whose readings are ratios of charges or of stresses.
    films
        Forces on both films with the log-sensitivity, and their charges where these are read.
    noise
        Noise of a reading.
    force
        Force on the probe, N.

    Raises
    ------
    Refusal
        The scene reads charges, and these are not known.
    """
    observable = films.get_observable(scene)
    if not _is_resolved(films, observable) or observable.log_sensitivity is None:
        return math.inf
    per_force = _compute_charge_per_force(films, observable)
    information = noise.compute_information(observable.log_sensitivity, _compute_inner_fraction(films), force, per_force)
    return compute_standard_deviation(information)


def _is_resolved(films: FilmForces, observable: FilmForces) -> bool:
    """Return whether forces and what is read of them are above their own errors, on both films."""
    return films.stress_below_error is None and observable.stress_below_error is None


def _compute_charge_per_force(films: FilmForces, observable: FilmForces) -> tuple[float, float] | None:
    """Return the charge per force of both films, C/N, without sign; None where the observable are the forces themselves."""
    if observable is films:
        return None
    inner, outer = np.abs(observable.totals / films.totals).tolist()
    return inner, outer


def _compute_inner_fraction(films: FilmForces) -> float:
    """Return the inner film's fraction of the force."""
    return float(films.totals[0] / films.totals.sum())


def bound_objective(scene: Scene, films: FilmForces, noise: Noise, pressed: Pressing) -> tuple[float, float]:
    """Return lower and upper bounds of the standard deviation of ln E_object under the load of ``pressed``.

    The log-sensitivity errs by the evaluator's error and by finite strain. The ratio does as well, which changes how the force
    is divided between the films and so the charge noise; charges err by their own errors. The upper bound is inf where the
    sensitivity may be 0.

    Raises
    ------
    Refusal
        The scene reads charges, and these are not known.
    """
    observable = films.get_observable(scene)
    sensitivities = observable.film_log_sensitivities
    if not _is_resolved(films, observable) or observable.log_sensitivity is None or sensitivities is None:
        return 0.0, math.inf
    sensitivity = abs(observable.log_sensitivity)
    strain_error = compute_sensitivity_size(sensitivities) * bound_log_sensitivity_change(pressed.x)
    error = observable.sensitivity_error + strain_error
    if observable is films:
        unit_sds = _bound_noise_of_forces(films, noise, pressed)
    else:
        unit_sds = _bound_noise_of_charges(films, observable, noise, pressed)
    return min(unit_sds) / (sensitivity + error), max(unit_sds) / (sensitivity - error) if sensitivity > error else math.inf


def _bound_noise_of_forces(films: FilmForces, noise: Noise, pressed: Pressing) -> list[float]:
    """Return standard deviations for a log-sensitivity of 1 at the lowest, computed and highest ratio of the forces."""
    inner_fraction, shift = _compute_inner_fraction(films), films.bound.log_ratio + pressed.change
    force_ratios = inner_fraction / (1 - inner_fraction) * np.exp([-shift, 0.0, shift])  # inner over outer force
    return [
        compute_standard_deviation(noise.compute_information(1.0, ratio / (1 + ratio), pressed.force))
        for ratio in force_ratios.tolist()
    ]


def _bound_noise_of_charges(films: FilmForces, charges: FilmForces, noise: Noise, pressed: Pressing) -> list[float]:
    """Return standard deviations for a log-sensitivity of 1 with both charges at their lowest, computed and highest values.

    A charge at a given force errs by its own error at a given indentation, by that of the stiffness and by finite strain.
    """
    fraction, per_force = _compute_inner_fraction(films), np.abs(charges.totals / films.totals)
    errors = charges.relative_errors + films.stiffness_error + pressed.change
    unit_sds = []
    for sign in (-1.0, 0.0, 1.0):
        inner, outer = (per_force * np.maximum(1 + sign * errors, MIN_CHARGE_FRACTION)).tolist()
        unit_sds.append(compute_standard_deviation(noise.compute_information(1.0, fraction, pressed.force, (inner, outer))))
    return unit_sds
