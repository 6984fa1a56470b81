"""Compute readings of a probe over many sets of tumours at once: forces, ratio, stiffness, their derivatives and error bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal, SolveError
from geometry.scenes.probe import format_mm
from solver.equivalent_inclusion.first_order import bound_first_order_error, bound_first_order_share, compute_effects
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.inclusions.tumours import Tumours
from solver.linalg.threads import limit_to_one_thread
from solver.multiple_scattering.lockstep import run_in_lockstep, run_steps
from solver.multiple_scattering.solve import Scattered, iterate_scattering
from solver.results.film_forces import compute_sensitivity_tolerance

REFLECTION_TOLERANCE_RELATIVE = 0.1  # of the accuracy: truncation error of reflections, relative to a tumour's effect
SERIES_SAFETY_FACTOR = 3.0  # on the estimate of the truncation error
LAYERED_SAFETY_FACTOR = 2.0  # further factor in layers: close under a stiff film errors reach 2.2 times the estimate
SLOPE_ERROR_FACTOR = 5.0  # mesh error of derivatives, relative to that of the effect
SETS_AT_ONCE = 8  # sets whose reflections are solved together
MAX_SETS_WITHOUT_MATRIX = (
    400  # up to so many sets the matrix of each azimuthal order does not pay without PARDISO; in layers never
)
MIN_REFLECTED_ERROR, MIN_LAYERED_ERROR = 5e-4, 4e-3  # minimum error, of a tumour's effect: in one material, in layers


@dataclass(frozen=True)
class Readings:
    """Readings over n sets of tumours.

    Attributes
    ----------
    areas
        Nominal end areas of inner and outer block, m^2, shape (2,).
    forces
        F_ij, force on film i per unit displacement of base j, N/m, shape (n, 2, 2).
    bound
        Bound on the error of each film's total, N/m, shape (n, 2).
    log_ratio_bound
        Bound on the error of ln(ratio), shape (n,); inf where a total is below its own error.
    slope_bound
        Bound on the error of each total of ``derivatives["youngs_modulus"]``, N/m, shape (n, 2).
    reflected
        Whether reflections were computed, shape (n,).
    first_share
        Bound on the error of ln(ratio) without reflections, shape (n,).
    first_totals
        Totals of the film forces to first order, N/m, shape (n, 2).
    derivatives
        Derivatives of ``forces`` by quantities of the target, shapes (n, 2, 2): by the logarithm of youngs_modulus, diameter and
        depth, by poisson_ratio, per m by offset from the probe's axis; all but the first only where requested.
    """

    areas: Floats
    forces: Floats
    bound: Floats
    log_ratio_bound: Floats
    slope_bound: Floats
    reflected: Bools
    first_share: Floats
    first_totals: Floats
    derivatives: dict[str, Floats] = field(default_factory=dict)

    def add_baseline_bounds(self, base: Undisturbed) -> Readings:
        """Return the readings with the error bounds of the film forces without tumours added to those of the tumours' effects."""
        bound, log_ratio = base.compute_bounds(self.bound, self.forces)
        return replace(self, bound=bound, log_ratio_bound=log_ratio)

    @property
    def totals(self) -> Floats:
        """Force on each film per unit indentation, N/m, shape (n, 2)."""
        return np.asarray(self.forces.sum(axis=2))

    @property
    def stiffness(self) -> Floats:
        """Force on the base per unit indentation, N/m, shape (n,)."""
        return np.asarray(self.forces.sum(axis=(1, 2)))

    @property
    def resolved(self) -> Bools:
        """Whether both stresses are above their errors, so that there is a ratio, shape (n,)."""
        return np.asarray(np.isfinite(self.log_ratio_bound))

    @property
    def ratio(self) -> Floats:
        """Stress on the inner over stress on the outer film, shape (n,); 0 where ``resolved`` is false."""
        inner, outer = self.totals.T
        shares = np.divide(inner, outer, out=np.zeros_like(inner), where=self.resolved)
        return np.asarray(shares * self.areas[1] / self.areas[0])

    @property
    def error_estimate(self) -> Floats:
        """Bound on the relative error of ``ratio``, shape (n,)."""
        return np.asarray(np.expm1(np.minimum(self.log_ratio_bound, 700.0)))  # exp(710) would overflow

    @property
    def max_error(self) -> Floats:
        """Largest bound on the relative error of the ratio and of both stresses, shape (n,)."""
        stresses = (self.bound / np.maximum(np.abs(self.totals), 1e-300)).max(axis=1)  # 1e-300 avoids a division by zero
        return np.asarray(np.maximum(self.error_estimate, stresses))

    def compute_log_ratio_derivative(self, key: str) -> Floats:
        """Return the derivative of ln(ratio) by a quantity of the target, see ``derivatives``; (n,), 0 where not ``resolved``."""
        changes = self.derivatives[key].sum(axis=2)
        relative_changes = np.divide(changes, self.totals, out=np.zeros_like(changes), where=self.resolved[:, None])
        return np.asarray(relative_changes[:, 0] - relative_changes[:, 1])

    def compute_log_stiffness_derivative(self, key: str) -> Floats:
        """Return the derivative of ln(stiffness) by a quantity of the target (see ``derivatives``), shape (n,)."""
        return np.asarray(self.derivatives[key].sum(axis=(1, 2)) / self.stiffness)

    @property
    def log_sensitivity(self) -> Floats:
        """Log-sensitivity to the target's Young's modulus, shape (n,)."""
        return self.compute_log_ratio_derivative("youngs_modulus")

    @property
    def sensitivity_error(self) -> Floats:
        """Bound on the absolute error of ``log_sensitivity``, shape (n,); 0 where ``resolved`` is false."""
        totals = np.where(self.resolved[:, None], np.abs(self.totals), 1.0)  # 1 where not used, to avoid divisions by zero
        derivatives = np.abs(self.derivatives["youngs_modulus"].sum(axis=2))
        errors = (self.slope_bound + derivatives * self.bound / totals) / totals
        return np.asarray(np.where(self.resolved, errors.sum(axis=1), 0.0))


def compute_readings(
    base: Undisturbed,
    tumours: Tumours,
    target: int = 0,
    places: bool = False,
    *,
    progress: Callable[[int, int], None] | None = None,
    reflect: bool | None = None,
    sensitive: bool = False,
) -> Readings:
    """Compute a probe's readings over n sets of t tumours each, arrays of shape (n, t).

    All are computed to first order, some 20 000 tumours a second (a few 1000 within 0.15 outer radii of the surface); then those
    whose error bound is above ``base.accuracy`` once more with reflections, some 5 to 100 ms each.

    Parameters
    ----------
    base
        The probe on the tissue without tumours.
    tumours
        Spheres, relative to the probe's axis.
    target
        Number of the tumour among the t to which the derivatives refer.
    places
        Whether to compute the derivatives by depth, offset, diameter and Poisson's ratio too.
    progress
        Called with the number of sets whose reflections are computed, and with the number of sets that need them.
    reflect
        Whether to use reflections for all sets (True) or none (False); None for those sets that need them.
    sensitive
        Whether to use reflections also where the log-sensitivity's error is above 5 times the accuracy and above 1e-5.

    Raises
    ------
    InputError
        A sphere lies partly outside the tissue.
    Refusal
        The reflections of a set cannot be computed in double precision; an interface of the tissue crosses a sphere.
    """
    with limit_to_one_thread():
        inside, left_out = base.move_inside(tumours)
        _check_layers(base, inside, ~left_out)
        first = _compute_first_order(base, inside, left_out, target, places)
        insufficient = (first.max_error > base.accuracy) | bool(reflect)
        if sensitive and tumours.shape[1]:
            tolerance = compute_sensitivity_tolerance(base.accuracy, first.log_sensitivity)
            insufficient |= first.add_baseline_bounds(base).sensitivity_error > tolerance
        insufficient &= np.any(~left_out, axis=1) & (reflect is not False)
        chosen = np.flatnonzero(insufficient)
        often = len(chosen) > MAX_SETS_WITHOUT_MATRIX and not base.strata.interfaces
        at_once = 1 if often else SETS_AT_ONCE
        for k in range(0, len(chosen), at_once):
            if progress is not None:
                progress(k, len(chosen))
            numbers = chosen[k : k + at_once].tolist()
            _add_reflections(base, inside, left_out, first, numbers=numbers, target=target, sensitive=sensitive, often=often)
        if progress is not None:
            progress(len(chosen), len(chosen))
    return first.add_baseline_bounds(base)


def _check_layers(base: Undisturbed, tumours: Tumours, counted: Bools) -> None:
    """Raise ``Refusal`` if an interface of the tissue's layers crosses a sphere that is ``counted``, that is not left out."""
    across = np.flatnonzero(counted & (base.strata.compute_gap(tumours) < 0))
    if len(across):
        depth, diameter = (format_mm(float(values.flat[across[0]])) for values in (tumours.depth, tumours.diameter))
        raise Refusal("inclusion.depth", depth, f"spheres of {diameter} that no interface of the tissue's layers crosses")


def _compute_first_order(base: Undisturbed, tumours: Tumours, left_out: Bools, target: int, places: bool) -> Readings:
    """Compute the first-order readings of n sets of t tumours.

    ``bound`` holds the errors of the tumours' effects alone. Tumours that are ``left_out``, (n, t), change no force; twice their
    effect is added to the bound instead.
    """
    n, t = tumours.shape
    effects = compute_effects(base.energies, base.strata.find_hosts(tumours.flatten().depth), tumours.flatten(), places)
    changes = effects.forces.reshape(n, t, 2, 2)
    outside = np.abs(np.where(left_out[..., None, None], changes, 0.0)).sum(axis=(1, 3))
    changes = np.where(left_out[..., None, None], 0.0, changes)
    forces = base.films.forces + changes.sum(axis=1)
    relative_errors = bound_first_order_share(base, tumours)
    bound = bound_first_order_error(relative_errors, changes) + 2 * outside
    derivative = (
        np.abs(effects.derivatives["youngs_modulus"].reshape(n, t, 2, 2)[:, target]).sum(axis=2) if t else np.zeros((n, 2))
    )
    slope_bound = 2 * relative_errors[:, target, None] * derivative if t else derivative
    areas = np.array([base.scene.probe.inner_area, base.scene.probe.outer_area])
    log_ratio = base.compute_bounds(bound, forces)[1]
    derivatives = {}
    if t:
        derivatives = {
            key: np.where(left_out[:, target, None, None], 0.0, values.reshape(n, t, 2, 2)[:, target])
            for key, values in effects.derivatives.items()
        }
    return Readings(
        areas,
        forces,
        bound=bound,
        log_ratio_bound=log_ratio,
        slope_bound=slope_bound,
        reflected=np.zeros(n, dtype=bool),
        first_share=log_ratio,
        first_totals=forces.sum(axis=2),
        derivatives=derivatives,
    )


def _add_reflections(
    base: Undisturbed,
    tumours: Tumours,
    left_out: Bools,
    readings: Readings,
    *,
    numbers: list[int],
    target: int,
    sensitive: bool,
    often: bool,
) -> None:
    """Replace in place the first-order readings of the sets with some numbers by those with reflections.

    ``often`` as in ``BoundaryResponse.apply``; the other parameters are those of ``compute_readings``.
    """
    included = [np.flatnonzero(~left_out[number]) for number in numbers]
    tumour_sets = [tumours.select(number).select(chosen) for number, chosen in zip(numbers, included, strict=True)]
    tolerance, places = REFLECTION_TOLERANCE_RELATIVE * base.accuracy, "depth" in readings.derivatives
    try:
        steps = [
            iterate_scattering(
                base.field,
                base.choose_reflector(tumour_set),
                base.strata,
                tumour_set,
                tolerance,
                places=places,
                sensitive=sensitive,
            )
            for tumour_set in tumour_sets
        ]
        solutions = [run_steps(steps[0], often)] if len(steps) == 1 else run_in_lockstep(steps)
    except SolveError as fault:
        sets = f"set {numbers[0]}" if len(numbers) == 1 else f"one of the sets {numbers[0]} to {numbers[-1]}"
        raise Refusal("inclusion", sets, f"tumours whose reflections can be computed ({fault})") from fault
    for number, chosen, tumour_set, scattered in zip(numbers, included, tumour_sets, solutions, strict=True):
        k = int(np.searchsorted(chosen, target)) if target in chosen else None  # the target's number among those not left out
        _store_reflected(base, tumour_set, scattered, readings, number=number, target=k)


def _store_reflected(
    base: Undisturbed, tumours: Tumours, scattered: Scattered, readings: Readings, *, number: int, target: int | None
) -> None:
    """Store the readings with reflections of one set, by its number, in place.

    ``target`` is the number of the target in ``tumours``, None where the target was left out.
    """
    min_error, safety = MIN_REFLECTED_ERROR, SERIES_SAFETY_FACTOR
    if base.strata.interfaces:
        min_error, safety = MIN_LAYERED_ERROR, SERIES_SAFETY_FACTOR * LAYERED_SAFETY_FACTOR
    relative_error = float((base.bound_field_error(tumours) + base.bound_reflection_error(tumours)).max()) + min_error
    effect_error = bound_first_order_error(np.full((1, 1), relative_error), scattered.forces[None, None])[0]
    readings.forces[number] = base.films.forces + scattered.forces
    readings.bound[number] = safety * scattered.error + effect_error
    readings.reflected[number] = True
    if target is None:
        return
    derivatives = scattered.by_log_modulus[target]
    readings.derivatives["youngs_modulus"][number] = derivatives
    for key, derivative in scattered.shape_derivatives[target].items() if scattered.shape_derivatives else ():
        readings.derivatives[key][number] = derivative
    slope_errors = safety * scattered.slope_error[target] + SLOPE_ERROR_FACTOR * relative_error * np.abs(derivatives)
    readings.slope_bound[number] = slope_errors.sum(axis=1)
