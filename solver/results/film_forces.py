"""From film forces per unit displacement to stresses, ratio, sensitivity and their errors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from solver.results.warnings import Note, null_sensitivity


@dataclass(frozen=True)
class Bound:
    """How far film forces may be off.

    Attributes:
        totals: of each film's total force, N/m, >= 0, shape (2,).
        log_ratio: of ln(ratio); what shifts both films alike shifts it less than the totals.
    """

    totals: Floats
    log_ratio: float

    @classmethod
    def independent(cls, totals: Floats, forces: Floats) -> Bound:
        """Return the bound where the two films' errors know nothing of each other.

        With e_i their relative errors that of ln(ratio) is at most -ln(1 - e_0) - ln(1 - e_1) (RE.1).
        """
        with np.errstate(divide="ignore"):
            inner, outer = (totals / np.abs(forces.sum(axis=1))).tolist()
        return cls(totals, -math.log1p(-inner) - math.log1p(-outer) if max(inner, outer) < 1 else math.inf)

    def __add__(self, other: Bound) -> Bound:
        """Return the bound on both errors together."""
        return Bound(self.totals + other.totals, self.log_ratio + other.log_ratio)


@dataclass(frozen=True)
class FilmForces:
    """Forces F_ij on film i (0 inner, 1 outer) per unit displacement of base j, with a bound on their errors.

    Attributes:
        forces: N/m, symmetric, shape (2, 2).
        bound: on what they may be off.
        slope: d forces / d ln E_object, shape (2, 2), or None without a target.
        sensitivity_error: estimate of the absolute error of the log-sensitivity.
    """

    forces: Floats
    bound: Bound
    slope: Floats | None = None
    sensitivity_error: float = 0.0

    @cached_property
    def totals(self) -> Floats:
        """Force on each film per unit indentation of the whole base, N/m: F_i = sum_j F_ij (RE.2)."""
        return np.asarray(self.forces.sum(axis=1))

    @cached_property
    def relative_errors(self) -> Floats:
        """Bounds on the relative errors of both stresses at a given indentation; inf where a total is zero."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.bound.totals / np.abs(self.totals))

    @property
    def unresolved_stress(self) -> str | None:
        """Name of a stress that is below its own error, if there is one."""
        return next(
            (name for name, error in zip(("stress_inner", "stress_outer"), self.relative_errors, strict=True) if error >= 1), None
        )

    @property
    def log_sensitivity(self) -> float | None:
        """Log-sensitivity of the ratio: S = d ln(F_0 / F_1) / d ln E_object (RE.3)."""
        if self.slope is None:
            return None
        inner, outer = self.film_log_sensitivities or (0.0, 0.0)
        return inner - outer

    @cached_property
    def film_log_sensitivities(self) -> tuple[float, float] | None:
        """Those of both film forces at a given indentation, inner and outer: d ln F_i / d ln E_object."""
        if self.slope is None:
            return None
        inner, outer = (self.slope.sum(axis=1) / self.totals).tolist()
        return inner, outer

    @property
    def ratio_error(self) -> float:
        """Bound on the relative error of the ratio."""
        return math.expm1(min(self.bound.log_ratio, 700.0))

    @cached_property
    def stiffness_error(self) -> float:
        """Bound on the relative error of the total force per indentation."""
        return float(self.bound.totals.sum() / abs(self.totals.sum()))

    def error_under(self, scene: Scene) -> float:
        """Largest relative error bound of ratio, both stresses and stiffness at the scene's kind of load.

        Under a force the stresses are shares of it, so that the ratio's error bounds theirs.
        """
        stresses = self.ratio_error if scene.load.force is not None else float(self.relative_errors.max())
        return max(self.ratio_error, stresses, self.stiffness_error)


def outputs(scene: Scene, films: FilmForces) -> dict[str, Any]:
    """Return the fields of a ``Result`` that follow from film forces, warnings included.

    Raises:
        Refusal: the load drives the probe deeper than the tissue.
    """
    areas = np.array([scene.probe.inner_area, scene.probe.outer_area])
    indentation = indented(scene, float(films.totals.sum()))
    stress = films.totals * indentation / areas
    film = scene.probe.film
    charge = stress * areas * film.charge_per_force if film is not None else (None, None)
    reasons = [] if films.slope is not None else [null_sensitivity(len(scene.inclusion))]
    if films.unresolved_stress is not None:
        why = f"ratio, log_sensitivity and error_estimate are null: {films.unresolved_stress} is below its own error"
        reasons = [Note("null", why)]
    return {
        "stress_inner": float(stress[0]),
        "stress_outer": float(stress[1]),
        "stiffness": float(films.totals.sum()),
        "charge_inner": None if charge[0] is None else float(charge[0]),
        "charge_outer": None if charge[1] is None else float(charge[1]),
        **ratio(scene, films),
        "warnings": tuple(reasons),
    }


def indented(scene: Scene, stiffness: float) -> float:
    """Return the indentation at the scene's load, m, where the stiffness is that, N/m.

    Raises:
        Refusal: it is deeper than the tissue.
    """
    if scene.load.indentation is not None:
        return scene.load.indentation
    force = scene.load.force or 0.0
    deep = force / stiffness
    if scene.tissue.shape != "half-space" and deep >= scene.tissue.depth:
        why = f"it drives the probe {1e3 * deep:.3g} mm into tissue {mm(scene.tissue.depth)} deep"
        raise Refusal("load.force", Words(f"{force:g} N"), f"below {stiffness * scene.tissue.depth:.3g} N ({why})")
    return deep


def ratio(scene: Scene, films: FilmForces) -> dict[str, Any]:
    """Return ratio, its and the films' log-sensitivities and its error; all None where a stress is below its own error."""
    if films.unresolved_stress is not None:
        return dict.fromkeys(("ratio", "log_sensitivity", "film_log_sensitivities", "error_estimate"))
    inner, outer = films.totals / [scene.probe.inner_area, scene.probe.outer_area]
    return {
        "ratio": float(inner / outer),
        "log_sensitivity": films.log_sensitivity,
        "film_log_sensitivities": films.film_log_sensitivities,
        "error_estimate": films.ratio_error,
    }


def checked_moduli(scene: Scene, moduli: Floats) -> Floats:
    """Return the moduli of a curve, Pa, as an array.

    Raises:
        InputError: the scene has no target, or a modulus is not positive and finite.
    """
    values = np.asarray(moduli, dtype=float)
    if scene.target is None:
        raise InputError("inclusion.target", Words("none"), "one inclusion, or one of several marked target = true")
    if values.ndim != 1 or not values.size or not np.all(np.isfinite(values) & (values > 0)):
        raise InputError("youngs_modulus", Words("not all positive"), "one or more positive finite moduli, Pa")
    return values


def shortfalls(films: FilmForces, reached: float, accuracy: float, stopped: Iterable[Note] = ()) -> list[Note]:
    """Say what is not as accurate as was asked for, ``reached`` being the largest of the bounds, behind what was ``stopped``."""
    notes = [] if reached <= accuracy else [Note("accuracy", f"{above(reached, accuracy)}: this level's best")]
    size = abs(films.log_sensitivity or 0.0)
    if films.slope is not None and films.sensitivity_error > max(5 * accuracy * size, 1e-5):
        share = films.sensitivity_error / size if size > 0 else np.inf
        good = f"good to about {share:.1g} of itself only" if share < 10 else "smaller than its own error"
        notes.append(Note("sensitivity", f"log_sensitivity is {good}"))
    return [*stopped, *notes] if notes else []


def above(reached: float, accuracy: float) -> str:
    """Say that the largest bound on the errors is above the accuracy."""
    bounds = f"error bounds of {reached:.2g}" if reached < 1 else "error bounds no smaller than the values themselves"
    return f"{bounds} reached, accuracy {accuracy:g} asked for"
