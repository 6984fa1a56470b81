"""Compute stresses, ratio, log-sensitivity and their errors from film forces per unit displacement."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import MODULUS_QUANTITY
from solver.results.result import ErrorKind
from solver.results.warnings import Note, explain_null_sensitivity

SENSITIVITY_ACCURACY_FACTOR = 5  # an accuracy promises a log-sensitivity within so many times itself, relative, ...
MIN_SENSITIVITY_TOLERANCE = 1e-5  # ... or within this, absolute, where that is more


def compute_sensitivity_tolerance(accuracy: float, log_sensitivity: float | Floats) -> Floats:
    """Return the absolute tolerance that an accuracy promises on log-sensitivities, of their shape."""
    return np.maximum(SENSITIVITY_ACCURACY_FACTOR * accuracy * np.abs(log_sensitivity), MIN_SENSITIVITY_TOLERANCE)


Outputs = TypeVar("Outputs")


def choose_observable(scene: Scene, forces: Outputs, charges: Outputs | None) -> Outputs:
    """Return what a scene's readings are the ratio of: ``charges``, or where it reads stresses ``forces``.

    Raises
    ------
    Refusal
        The scene reads charges, and these are not known.
    """
    if scene.observable == "stress":
        return forces
    if charges is None:
        raise Refusal("reading.observable", "charge", "'stress' where an evaluator is needed that computes no film's stress")
    return charges


@dataclass(frozen=True)
class Bound:
    """Bounds on the errors of film forces.

    Attributes
    ----------
    totals
        Bound on the error of each film's total force, N/m, >= 0, shape (2,).
    log_ratio
        Bound on the error of ln(ratio), in which equal relative errors of both films cancel.
    sum
        Bound for the force of both films together, N/m, where it is below the sum of ``totals``; else None.
    """

    totals: Floats
    log_ratio: float
    sum: float | None = None

    @classmethod
    def from_independent_errors(cls, totals: Floats, forces: Floats) -> Bound:
        """Return the bound for independent errors of the two films.

        With e_i the relative error of film i (0 inner, 1 outer), that of ln(ratio) is at most -ln(1 - e_0) - ln(1 - e_1) (RE.1).
        """
        with np.errstate(divide="ignore"):
            inner, outer = (totals / np.abs(forces.sum(axis=1))).tolist()
        return cls(totals, -math.log1p(-inner) - math.log1p(-outer) if max(inner, outer) < 1 else math.inf)

    def __add__(self, other: Bound) -> Bound:
        """Return the bound on the sum of two errors."""
        return Bound(self.totals + other.totals, self.log_ratio + other.log_ratio)


@dataclass(frozen=True)
class FilmForces:
    """Forces F_ij on film i (0 inner, 1 outer) per unit displacement of base j, with a bound on their errors.

    Attributes
    ----------
    forces
        N/m, symmetric, shape (2, 2).
    bound
        Bounds on the errors of the forces.
    modulus_derivative
        d forces / d ln E_object, N/m, shape (2, 2), or None without a target.
    sensitivity_error
        Estimate of the absolute error of the log-sensitivity.
    charges
        The charges of the films in the same form, with Q_ij in C/m (not symmetric) in place of F_ij; None where no charge follows
        from the films' stress.
    """

    forces: Floats
    bound: Bound
    modulus_derivative: Floats | None = None
    sensitivity_error: float = 0.0
    charges: FilmForces | None = None

    @cached_property
    def totals(self) -> Floats:
        """Force on each film per unit indentation of the whole base, N/m, shape (2,): F_i = sum_j F_ij (RE.2)."""
        return np.asarray(self.forces.sum(axis=1))

    @cached_property
    def relative_errors(self) -> Floats:
        """Bounds on the relative errors of both stresses at a given indentation; inf where a total is zero."""
        unknown = np.full(2, np.inf)
        return np.asarray(np.divide(self.bound.totals, np.abs(self.totals), out=unknown, where=self.totals != 0))

    @property
    def stress_below_error(self) -> str | None:
        """Name of a stress that is smaller than its error bound; None where there is none."""
        return next(
            (name for name, error in zip(("stress_inner", "stress_outer"), self.relative_errors, strict=True) if error >= 1), None
        )

    @property
    def log_sensitivity(self) -> float | None:
        """Log-sensitivity of the ratio: S = d ln(F_0 / F_1) / d ln E_object (RE.3).

        F_0 and F_1 are the forces on inner and outer film per unit indentation, E_object the target's Young's modulus.
        """
        if self.modulus_derivative is None:
            return None
        inner, outer = self.film_log_sensitivities or (0.0, 0.0)  # not None here: for the type checker
        return inner - outer

    def meets_sensitivity(self, accuracy: float) -> bool:
        """Return whether the error of the log-sensitivity is within what an accuracy promises."""
        return bool(self.sensitivity_error <= compute_sensitivity_tolerance(accuracy, self.log_sensitivity or 0.0))

    def get_observable(self, scene: Scene) -> FilmForces:
        """Return what a scene's readings are the ratio of: the charges, or where it reads stresses the forces themselves.

        Raises
        ------
        Refusal
            The scene reads charges, and these are not known.
        """
        return choose_observable(scene, self, self.find_charges(scene))

    def find_charges(self, scene: Scene) -> FilmForces | None:
        """Return the films' charges in the form of film forces, Q_ij in C per m of displacement of base j.

        Where the scene gives psi1 or psi2, each is the force times the charge per force of the paper's eq. (12). Otherwise they
        are the evaluator's; None where it has none.
        """
        film = scene.probe.film
        if film is None or not film.uses_psi:
            return self.charges
        factors = np.array([block_film.charge_per_force for block_film in film.by_block])[:, None]
        derivative = None if self.modulus_derivative is None else factors * self.modulus_derivative
        bound = replace(self.bound, totals=np.abs(factors[:, 0]) * self.bound.totals, sum=None)
        return FilmForces(factors * self.forces, bound, derivative, self.sensitivity_error)

    @cached_property
    def film_log_sensitivities(self) -> tuple[float, float] | None:
        """Log-sensitivities of the inner and the outer film's force at a given indentation: d ln F_i / d ln E_object."""
        if self.modulus_derivative is None:
            return None
        inner, outer = (self.modulus_derivative.sum(axis=1) / self.totals).tolist()
        return inner, outer

    @property
    def ratio_error(self) -> float:
        """Bound on the relative error of the ratio."""
        return math.expm1(min(self.bound.log_ratio, 700.0))  # exp(710) would overflow

    @cached_property
    def stiffness_error(self) -> float:
        """Bound on the relative error of the total force per indentation."""
        error = self.bound.totals.sum() if self.bound.sum is None else self.bound.sum
        return float(error / abs(self.totals.sum()))

    def compute_stress_errors(self, scene: Scene) -> tuple[float, float]:
        """Return the relative errors of the inner and the outer stress, for the scene's kind of load.

        Where the force is given, the stresses are fractions of it, so that the ratio's error bounds theirs.
        """
        inner, outer = (self.ratio_error,) * 2 if scene.load.force is not None else self.relative_errors.tolist()
        return inner, outer

    def compute_max_error(self, scene: Scene) -> float:
        """Return the largest relative error of ratio, both stresses and stiffness, for the scene's kind of load.

        Where a reading is the ratio of charges, and these are known, the error of that ratio counts, too.
        """
        charges = self.find_charges(scene) if scene.observable == "charge" else None
        read = 0.0 if charges is None else charges.ratio_error
        return max(self.ratio_error, *self.compute_stress_errors(scene), self.stiffness_error, read)


def compute_result_fields(scene: Scene, films: FilmForces) -> JsonObject:
    """Return the fields of a ``Result`` that follow from film forces, warnings included.

    Raises
    ------
    Refusal
        The load drives the probe deeper than the tissue.
    """
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])
    indentation = compute_indentation(scene, float(films.totals.sum()))  # m
    stress = films.totals * indentation / areas
    reasons = [] if films.modulus_derivative is not None else [explain_null_sensitivity(len(scene.inclusion))]
    if films.stress_below_error is not None:
        reason = f"ratio, log_sensitivity and error_estimate are null: {films.stress_below_error} is below its own error"
        reasons = [Note("null", reason)]
    return {
        "stress_inner": float(stress[0]),
        "stress_outer": float(stress[1]),
        "stiffness": float(films.totals.sum()),
        "stiffness_error": films.stiffness_error,
        **compute_ratio_fields(scene, films),
        "warnings": tuple(reasons),
    }


def compute_indentation(scene: Scene, stiffness: float) -> float:
    """Return the indentation whose response the readings are, m, from the stiffness, N/m; see ``Load``.

    Raises
    ------
    Refusal
        The indentation reaches the depth of the tissue.
    """
    if scene.load.indentation is not None:
        return scene.load.indentation
    force = scene.load.force or 0.0
    indentation = force / stiffness  # of the peak
    if indentation >= scene.tissue.bottom:
        reason = f"it drives the probe {1e3 * indentation:.3g} mm into tissue {format_mm(scene.tissue.bottom)} deep"
        raise Refusal("load.force", Words(f"{force:g} N"), f"below {stiffness * scene.tissue.bottom:.3g} N ({reason})")
    return float(scene.load.find_indentation(stiffness))


def compute_ratio_fields(scene: Scene, films: FilmForces) -> JsonObject:
    """Return the ratio of a ``Result``, its log-sensitivities and the errors of ratio and stresses.

    All are None where a stress is smaller than its error.
    """
    with np.errstate(divide="ignore"):
        inner, outer = films.totals / [scene.probe.inner_area, scene.probe.outer_area]
        ratio = float(inner / outer)
    inner_error, outer_error = films.compute_stress_errors(scene)
    fields = {
        "ratio": ratio,
        "log_sensitivity": films.log_sensitivity,
        "film_log_sensitivities": films.film_log_sensitivities,
        "error_estimate": films.ratio_error,
        "stress_inner_error": inner_error,
        "stress_outer_error": outer_error,
    }
    return fields if films.stress_below_error is None else dict.fromkeys(fields)


def check_moduli(scene: Scene, moduli: Floats) -> Floats:
    """Return the moduli of a curve, Pa, as an array of shape (k,), after checks.

    Raises
    ------
    InputError
        The scene has no target, or a modulus is not positive and finite.
    """
    allowed = "one or more positive finite moduli, Pa, or texts with units, such as ['10 kPa', '30 kPa']"
    if np.ndim(moduli) != 1:
        raise InputError("moduli", moduli, allowed)
    values = np.asarray([MODULUS_QUANTITY.read("moduli", value) if isinstance(value, str) else value for value in moduli], float)
    if scene.target is None:
        raise InputError("inclusion.target", Words("none"), "one inclusion, or one of several marked target = true")
    if not values.size or not np.all(np.isfinite(values) & (values > 0)):
        raise InputError("moduli", Words("not all positive" if values.size else "an empty list"), allowed)
    return values


def find_shortfalls(
    films: FilmForces, reached: float, accuracy: float, stopped: Iterable[Note] = (), kind: ErrorKind = "bound"
) -> list[Note]:
    """Return warnings of errors above the accuracy, preceded by the notes ``stopped`` on what ended the refinement.

    Nothing is returned where ratio, stresses, stiffness and log-sensitivity are all within what the accuracy promises.

    ``reached`` is the largest of the errors of ratio, stresses and stiffness, ``kind`` whether errors are bounds or quantiles.
    """
    notes = []
    if reached > accuracy:
        notes.append(Note("accuracy", f"{describe_shortfall(reached, accuracy, kind)}: the best of this evaluator"))
    size = abs(films.log_sensitivity or 0.0)
    if films.modulus_derivative is not None and not films.meets_sensitivity(accuracy):
        relative_error = films.sensitivity_error / size if size > 0 else np.inf
        notes.append(Note("sensitivity", describe_sensitivity_error(relative_error)))
    return [*stopped, *notes] if notes else []


def describe_sensitivity_error(relative_error: float) -> str:
    """Return a sentence that states the error of a log-sensitivity, relative to its value, in per cent with one digit."""
    if relative_error >= 10:  # where one digit of the value's own size is unknown, too, a percentage says nothing
        return "log_sensitivity is smaller than its own error"
    return f"log_sensitivity is known within {format_percent(relative_error, 1)} of its value"


def describe_shortfall(reached: float, accuracy: float, kind: ErrorKind = "bound") -> str:
    """Return a text which says that the largest error, ``reached``, is above the accuracy."""
    errors = "error bounds" if kind == "bound" else f"{kind} errors"
    size = f"of {format_percent(reached)}" if reached < 1 else "no smaller than the values themselves"
    return f"{errors} {size} reached, accuracy {format_percent(accuracy, 6)} requested"
