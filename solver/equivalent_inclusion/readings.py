"""Compute readings of a probe over many sets of tumours at once: forces, charges, ratios, their derivatives and error bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import Refusal, SolveError
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from solver.equivalent_inclusion.first_order import bound_first_order_error, bound_first_order_share, compute_effects
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, add_bounds
from solver.inclusions.tumours import Tumours
from solver.linalg.threads import limit_to_one_thread
from solver.multiple_scattering.lockstep import run_in_lockstep
from solver.multiple_scattering.solve import Scattered, iterate_scattering
from solver.results.film_forces import FilmForces, choose_observable, compute_sensitivity_tolerance

REFLECTION_TOLERANCE_RELATIVE = 0.1  # of the accuracy: truncation error of reflections, relative to a tumour's effect
SERIES_SAFETY_FACTOR = 3.0  # on the estimate of the truncation error
LAYERED_SAFETY_FACTOR = 2.0  # further factor in layers: close under a stiff film errors reach 2.2 times the estimate
SLOPE_ERROR_FACTOR = 5.0  # mesh error of derivatives, relative to that of the effect
SETS_AT_ONCE = 8  # sets whose reflections are solved together
CLOSE_SETS_AT_ONCE = 32  # likewise close to a face, where each order is factorised again for each reflection of all of them
MAX_SETS_WITHOUT_MATRIX = (
    400  # up to so many sets the matrix of each azimuthal order does not pay without PARDISO; in layers never
)
STORED_FIELDS = ("forces", "bound", "log_ratio_bound", "slope_bound", "reflected", "first_share", "first_totals")  # by set
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
    charges
        The charges of the films in the same form, C in place of N; None where no charge follows from the films' stress.
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
    charges: Readings | None = None

    def add_baseline_bounds(self, films: FilmForces) -> Readings:
        """Return the readings with the error bounds of the ``films`` without tumours added to those of the tumours' effects."""
        bound, log_ratio = add_bounds(films, self.bound, self.forces)
        charges = self.charges
        if charges is not None and films.charges is not None:
            charges = charges.add_baseline_bounds(films.charges)
        return replace(self, bound=bound, log_ratio_bound=log_ratio, charges=charges)

    def store(self, sets: Ints | Bools, readings: Readings) -> None:
        """Store in place the ``readings`` of some sets, given by indices or by a mask, in place of the previous ones."""
        for key in STORED_FIELDS:
            getattr(self, key)[sets] = getattr(readings, key)
        for key, values in self.derivatives.items():
            values[sets] = readings.derivatives[key]
        if self.charges is not None and readings.charges is not None:
            self.charges.store(sets, readings.charges)

    def select(self, sets: Ints | Bools) -> Readings:
        """Return the readings of some sets, given by indices or by a mask; a copy."""
        stored = {key: getattr(self, key)[sets] for key in STORED_FIELDS}
        derivatives = {key: values[sets] for key, values in self.derivatives.items()}
        return replace(self, **stored, derivatives=derivatives, charges=self.charges and self.charges.select(sets))

    def get_observable(self, scene: Scene) -> Readings:
        """Return the charges where the scene's ratio is that of charges, otherwise these readings of forces.

        Raises
        ------
        Refusal
            The scene reads charges, and these are not known.
        """
        return choose_observable(scene, self, self.find_charges(scene))

    def find_charges(self, scene: Scene) -> Readings | None:
        """Return the charges, which follow from the forces where the scene gives psi1 or psi2; None where they are not known."""
        film = scene.probe.film
        if film is None or not film.uses_psi:
            return self.charges
        return self._scale(np.array([block_film.charge_per_force for block_film in film.by_block]))

    def _scale(self, factors: Floats) -> Readings:
        """Return the readings with each film's forces multiplied by a factor, shape (2,)."""
        size = np.abs(factors)
        return replace(
            self,
            forces=self.forces * factors[:, None],
            bound=self.bound * size,
            slope_bound=self.slope_bound * size,
            first_totals=self.first_totals * factors,
            derivatives={key: values * factors[:, None] for key, values in self.derivatives.items()},
        )

    @property
    def parts(self) -> tuple[Readings, ...]:
        """The readings of the forces and, where they are known, of the charges."""
        return (self,) if self.charges is None else (self, self.charges)

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

    def compute_max_error(self, scene: Scene) -> Floats:
        """Return ``max_error``, or the bound on the relative error of the charges' ratio where that is read and larger; (n,)."""
        if self.charges is None or scene.observable == "stress":
            return self.max_error
        return np.maximum(self.max_error, self.charges.error_estimate)

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
        insufficient = (first.compute_max_error(base.scene) > base.accuracy) | bool(reflect)
        if sensitive and tumours.shape[1]:
            bounded = first.add_baseline_bounds(base.films)
            for part in bounded.parts if base.scene.observable == "charge" else (bounded,):
                insufficient |= part.sensitivity_error > compute_sensitivity_tolerance(base.accuracy, part.log_sensitivity)
        insufficient &= np.any(~left_out, axis=1) & (reflect is not False)
        chosen = np.flatnonzero(insufficient)
        often = len(chosen) > MAX_SETS_WITHOUT_MATRIX and not base.strata.interfaces
        is_close = np.array([base.choose_reflector(inside.select(k).select(~left_out[k])).close for k in chosen], dtype=bool)
        done = 0
        for group, at_once in ((chosen[is_close], CLOSE_SETS_AT_ONCE), (chosen[~is_close], 1 if often else SETS_AT_ONCE)):
            for k in range(0, len(group), at_once):
                if progress is not None:
                    progress(done, len(chosen))
                numbers = group[k : k + at_once].tolist()
                _add_reflections(base, inside, left_out, first, numbers=numbers, target=target, sensitive=sensitive, often=often)
                done += len(numbers)
        if progress is not None:
            progress(len(chosen), len(chosen))
    return first.add_baseline_bounds(base.films)


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
    (n, t), s = tumours.shape, base.field.count
    effects = compute_effects(base.energies, base.strata.find_hosts(tumours.flatten().depth), tumours.flatten(), places)
    changes = effects.products.reshape(n, t, s, s)
    outside = np.abs(np.where(left_out[..., None, None], changes, 0.0))[..., :2].sum(axis=(1, 3))
    changes = np.where(left_out[..., None, None], 0.0, changes)
    relative_errors = bound_first_order_share(base, tumours)
    bound = bound_first_order_error(relative_errors, changes) + 2 * outside
    slope_bound, derivatives = np.zeros((n, s)), {}
    if t:
        of_target = {key: values.reshape(n, t, s, s)[:, target] for key, values in effects.derivatives.items()}
        slope_bound = 2 * relative_errors[:, target, None] * _compute_slope_sizes(of_target["youngs_modulus"])
        derivatives = {key: np.where(left_out[:, target, None, None], 0.0, values) for key, values in of_target.items()}
    areas = np.array([base.scene.probe.inner_area, base.scene.probe.outer_area])

    def build_part(films: FilmForces, rows: slice, unit: float) -> Readings:
        """Build the readings of forces or charges, whose ``rows`` among the states have some ``unit``."""
        forces = films.forces + unit * changes[:, :, rows, :2].sum(axis=1)
        log_ratio = add_bounds(films, unit * bound[:, rows], forces)[1]
        return Readings(
            areas,
            forces,
            bound=unit * bound[:, rows],
            log_ratio_bound=log_ratio,
            slope_bound=unit * slope_bound[:, rows],
            reflected=np.zeros(n, dtype=bool),
            first_share=log_ratio,
            first_totals=forces.sum(axis=2),
            derivatives={key: unit * values[:, rows, :2] for key, values in derivatives.items()},
        )

    parts = [build_part(*observable) for observable in base.observables]
    return replace(parts[0], charges=parts[1]) if len(parts) > 1 else parts[0]


def _compute_slope_sizes(derivatives: Floats) -> Floats:
    """Return the sizes to which errors of d products / d ln E are relative, (..., s, s) to (..., s).

    For forces they are the sums of the derivatives' sizes; for charges the Cauchy-Schwarz bounds, as in
    ``bound_first_order_error``.
    """
    sizes = np.abs(derivatives[..., :2]).sum(axis=-1)
    state_sizes = np.abs(np.diagonal(derivatives, axis1=-2, axis2=-1))
    total_size = np.abs(derivatives[..., :2, :2].sum(axis=(-2, -1)))[..., None]
    sizes[..., 2:] = np.sqrt(state_sizes[..., 2:] * total_size)
    return np.asarray(sizes)


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
        solutions = run_in_lockstep(steps, often)
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
    effect_error = bound_first_order_error(np.full((1, 1), relative_error), scattered.products[None, None])[0]
    bound = safety * scattered.error + effect_error
    for part, (films, rows, unit) in zip(readings.parts, base.observables, strict=True):
        part.forces[number] = films.forces + unit * scattered.products[rows, :2]
        part.bound[number] = unit * bound[rows]
        part.reflected[number] = True
    if target is None:
        return
    derivatives = scattered.by_log_modulus[target]
    slope_errors = safety * scattered.slope_error[target] + SLOPE_ERROR_FACTOR * relative_error * np.abs(derivatives)
    slope_bound = slope_errors[:, :2].sum(axis=1)
    slope_bound[2:] = np.maximum(slope_bound, SLOPE_ERROR_FACTOR * relative_error * _compute_slope_sizes(derivatives))[2:]
    for part, (_, rows, unit) in zip(readings.parts, base.observables, strict=True):
        part.derivatives["youngs_modulus"][number] = unit * derivatives[rows, :2]
        for key, derivative in scattered.shape_derivatives[target].items() if scattered.shape_derivatives else ():
            part.derivatives[key][number] = unit * derivative[rows, :2]
        part.slope_bound[number] = unit * slope_bound[rows]
