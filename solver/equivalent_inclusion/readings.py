"""Readings of a probe over many sets of tumours at once: forces, ratio, stiffness, their derivatives and error bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import Refusal, SolveError
from geometry.scenes.probe import mm
from solver.equivalent_inclusion.first_order import Effects, effects
from solver.equivalent_inclusion.first_order_bound import first_order_error, first_order_share
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.inclusions.tumours import Tumours
from solver.linalg.threads import one_thread
from solver.multiple_scattering.lockstep import alone, together
from solver.multiple_scattering.solve import Scattered, scattering_steps

TOLERANCE = 0.1  # of the accuracy: truncation error of reflections, relative to a tumour's effect
SAFETY = 3.0  # on the estimate of the truncation error
LAYERED = 2.0  # further factor in layers: close under a stiff film errors reach 2.2 times the estimate
SENSITIVE = 5.0  # mesh error of derivatives, relative to that of the effect
TOGETHER = 8  # sets whose reflections are solved together
FEW = 400  # up to so many sets the matrix of each azimuthal order does not pay without PARDISO; in layers never
LEAST_REFLECTED, LEAST_LAYERED = 5e-4, 4e-3  # minimum error, of a tumour's effect: in one material, in layers


@dataclass(frozen=True)
class Readings:
    """Readings over n sets of tumours.

    Attributes:
        areas: nominal end areas of inner and outer block, m^2, shape (2,).
        forces: F_ij, force on film i per unit displacement of base j, N/m, shape (n, 2, 2).
        bound: on the error of each film's total, N/m, shape (n, 2).
        log_ratio_bound: on the error of ln(ratio), shape (n,); inf where a total is below its own error.
        slope_bound: on the error of each total of ``derivatives["youngs_modulus"]``, N/m, shape (n, 2).
        reflected: whether reflections were computed, shape (n,).
        first_share: bound on what leaving them out changes of ln(ratio), shape (n,).
        first_totals: of the forces to first order, N/m, shape (n, 2).
        derivatives: of ``forces`` by quantities of the target, shapes (n, 2, 2): by the logarithm of youngs_modulus, diameter
            and depth, by poisson_ratio, per m by offset from the probe's axis; all but the first only where asked for.
    """

    areas: Floats
    forces: Floats
    bound: Floats
    log_ratio_bound: Floats
    slope_bound: Floats
    reflected: Bools
    first_share: Floats
    first_totals: Floats
    by: dict[str, Floats] = field(default_factory=dict)

    def with_bounds_of(self, base: Undisturbed) -> Readings:
        """Add the error bounds without tumours to those of the tumours' effects."""
        bound, log_ratio = base.with_bounds(self.bound, self.forces)
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
        return np.asarray(np.expm1(np.minimum(self.log_ratio_bound, 700.0)))

    @property
    def worst(self) -> Floats:
        """Largest bound on the relative error of the ratio and of both stresses, shape (n,)."""
        stresses = (self.bound / np.maximum(np.abs(self.totals), 1e-300)).max(axis=1)
        return np.asarray(np.maximum(self.error_estimate, stresses))

    def log_ratio_by(self, key: str) -> Floats:
        """Return the derivative of ln(ratio) by a quantity of the target, see ``derivatives``; (n,), 0 where not ``resolved``."""
        changes = self.by[key].sum(axis=2)
        shares = np.divide(changes, self.totals, out=np.zeros_like(changes), where=self.resolved[:, None])
        return np.asarray(shares[:, 0] - shares[:, 1])

    def log_stiffness_by(self, key: str) -> Floats:
        """Return the derivative of ln(stiffness) by a quantity of the target (see ``derivatives``), shape (n,)."""
        return np.asarray(self.by[key].sum(axis=(1, 2)) / self.stiffness)

    @property
    def log_sensitivity(self) -> Floats:
        """Log-sensitivity to the target's Young's modulus, shape (n,)."""
        return self.log_ratio_by("youngs_modulus")

    @property
    def sensitivity_error(self) -> Floats:
        """Bound on the absolute error of ``log_sensitivity``, shape (n,); 0 where ``resolved`` is false."""
        totals = np.where(self.resolved[:, None], np.abs(self.totals), 1.0)
        slopes = np.abs(self.by["youngs_modulus"].sum(axis=2))
        errors = (self.slope_bound + slopes * self.bound / totals) / totals
        return np.asarray(np.where(self.resolved, errors.sum(axis=1), 0.0))


def readings(
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

    Args:
        base: the probe on the tissue without tumours.
        tumours: spheres, relative to the probe's axis.
        target: which of the t tumours the derivatives refer to.
        places: whether to compute the derivatives by depth, offset, diameter and Poisson's ratio too.
        progress: called with how many sets are done with reflections, and of how many.
        reflect: whether to use reflections for all sets (True) or none (False).
        sensitive: whether to use them also where the log-sensitivity's error is above 5 times the accuracy and above 1e-5.

    Raises:
        InputError: a sphere lies partly outside the tissue.
        Refusal: the reflections of a set cannot be computed in double precision; an interface of the tissue crosses a sphere.
    """
    with one_thread():
        inside, left_out = base.inside(tumours)
        _check_layers(base, inside, ~left_out)
        first = _first_order(base, inside, left_out, target, places)
        insufficient = (first.worst > base.accuracy) | bool(reflect)
        if sensitive and tumours.shape[1]:
            allowed = np.maximum(5 * base.accuracy * np.abs(first.log_sensitivity), 1e-5)
            insufficient |= first.with_bounds_of(base).sensitivity_error > allowed
        insufficient &= np.any(~left_out, axis=1) & (reflect is not False)
        chosen = np.flatnonzero(insufficient)
        often = len(chosen) > FEW and not base.strata.interfaces
        at_once = 1 if often else TOGETHER
        for k in range(0, len(chosen), at_once):
            if progress is not None:
                progress(k, len(chosen))
            numbers = chosen[k : k + at_once].tolist()
            _reflect(base, inside, left_out, first, numbers=numbers, target=target, sensitive=sensitive, often=often)
        if progress is not None:
            progress(len(chosen), len(chosen))
    return first.with_bounds_of(base)


def _check_layers(base: Undisturbed, tumours: Tumours, counted: Bools) -> None:
    across = np.flatnonzero(counted & (base.strata.gap(tumours) < 0))
    if len(across):
        depth, diameter = (mm(float(values.flat[across[0]])) for values in (tumours.depth, tumours.diameter))
        raise Refusal("inclusion.depth", depth, f"spheres of {diameter} that no interface of the tissue's layers crosses")


def _first_order(base: Undisturbed, tumours: Tumours, left_out: Bools, target: int, places: bool) -> Readings:
    """Compute first-order readings; ``bound`` is for tumours alone: those left out count twice in it, not in the forces."""
    n, t = tumours.shape
    single = effects(base.energies, base.strata.hosts(tumours.flat().depth), tumours.flat(), places)
    changes = single.forces.reshape(n, t, 2, 2)
    outside = np.abs(np.where(left_out[..., None, None], changes, 0.0)).sum(axis=(1, 3))
    changes = np.where(left_out[..., None, None], 0.0, changes)
    forces = base.films.forces + changes.sum(axis=1)
    share = first_order_share(base, tumours)
    bound = first_order_error(share, changes) + 2 * outside
    slope = np.abs(single.by_log_modulus.reshape(n, t, 2, 2)[:, target]).sum(axis=2) if t else np.zeros((n, 2))
    slope_bound = 2 * share[:, target, None] * slope if t else slope
    areas = np.array([base.scene.probe.inner_area, base.scene.probe.outer_area])
    log_ratio = base.with_bounds(bound, forces)[1]
    by = _derivatives(single, tumours, left_out, target) if t else {}
    return Readings(
        areas,
        forces,
        bound=bound,
        log_ratio_bound=log_ratio,
        slope_bound=slope_bound,
        reflected=np.zeros(n, dtype=bool),
        first_share=log_ratio,
        first_totals=forces.sum(axis=2),
        by=by,
    )


def _derivatives(single: Effects, tumours: Tumours, left_out: Bools, target: int) -> dict[str, Floats]:
    """Collect the derivatives by quantities of the target, see ``Readings.derivatives``."""

    def of_target(values: Floats) -> Floats:
        mine = values.reshape(*tumours.shape, 2, 2)[:, target]
        return np.asarray(np.where(left_out[:, target, None, None], 0.0, mine))

    by = {"youngs_modulus": of_target(single.by_log_modulus)}
    if single.by_depth is not None and single.by_offset is not None and single.by_log_diameter is not None:
        by |= {"depth": of_target(single.by_depth) * tumours.depth[:, target, None, None], "offset": of_target(single.by_offset)}
        by |= {"diameter": of_target(single.by_log_diameter), "poisson_ratio": of_target(single.by_poisson)}
    return by


def _reflect(
    base: Undisturbed,
    tumours: Tumours,
    left_out: Bools,
    into: Readings,
    *,
    numbers: list[int],
    target: int,
    sensitive: bool,
    often: bool,
) -> None:
    """Replace some sets' first-order readings by those with reflections."""
    mine = [tumours.of_index(number).of_index(np.flatnonzero(~left_out[number])) for number in numbers]
    tolerance, places = TOLERANCE * base.accuracy, "depth" in into.by
    try:
        steps = [
            scattering_steps(base.field, base.reflector(one), base.strata, one, tolerance, places=places, sensitive=sensitive)
            for one in mine
        ]
        found = [alone(steps[0], often)] if len(steps) == 1 else together(steps)
    except SolveError as fault:
        sets = f"set {numbers[0]}" if len(numbers) == 1 else f"one of the sets {numbers[0]} to {numbers[-1]}"
        raise Refusal("inclusion", sets, f"tumours whose reflections can be computed ({fault})") from fault
    for number, one, scattering in zip(numbers, mine, found, strict=True):
        _put(base, tumours.of_index(number), left_out[number], one, scattering, into=into, number=number, target=target)


def _put(
    base: Undisturbed,
    tumours: Tumours,
    left_out: Bools,
    mine: Tumours,
    scattering: Scattered,
    *,
    into: Readings,
    number: int,
    target: int,
) -> None:
    """Store one set's readings with reflections."""
    into.forces[number] = base.films.forces + scattering.forces
    least, safety = (LEAST_LAYERED, SAFETY * LAYERED) if base.strata.interfaces else (LEAST_REFLECTED, SAFETY)
    share = float((base.field_error(mine) + base.reflection_error(mine)).max()) + least
    into.bound[number] = safety * scattering.error + first_order_error(np.full((1, 1), share), scattering.forces[None, None])[0]
    into.reflected[number] = True
    included = np.flatnonzero(~left_out)
    if target in included:
        k = int(np.searchsorted(included, target))
        into.by["youngs_modulus"][number] = scattering.by_log_modulus[k]
        if scattering.moved:
            into.by["depth"][number] = scattering.moved[k].by_depth * tumours.depth[target]
            into.by["diameter"][number] = scattering.moved[k].by_log_diameter
            into.by["offset"][number] = scattering.moved[k].by_offset
            into.by["poisson_ratio"][number] = scattering.moved[k].by_poisson
        spread = safety * scattering.slope_error[k] + SENSITIVE * share * np.abs(scattering.by_log_modulus[k])
        into.slope_bound[number] = spread.sum(axis=1)
