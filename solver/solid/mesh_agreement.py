"""Bound the errors of film forces by the differences of meshes: with a safety factor from two, by the convergence of three.

Two meshes may agree by chance, so that their difference is multiplied by a safety factor. With three meshes, whose errors fall
with the square of the element size or faster, the bound is the larger of the last step and most of the step before, but at least
a third of the latter. If steps grow, the last is multiplied by their growth, up to the safety factor: in nearly incompressible
tissue the first two meshes agreed by chance, and the error of the log-sensitivity was 1.3 times its bound.

The error at the blocks' rims is smaller if inclusions are so soft that little force is left, but eq. SO.4 subtracts that of the
reference. For a soft tumour that nearly filled its tissue the ratio was wrong by 8 %, the reference by 2.5 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.results.film_forces import Bound, FilmForces
from solver.solid.difference import SceneDifference
from solver.solid.film_charges import compute_charges
from solver.solid.symmetric_part import FAR_TISSUE_PRODUCT_SHARE, SymmetricPart

FORCE_SAFETY_FACTOR = 2.0  # times the difference of two meshes
SENSITIVITY_SAFETY_FACTOR = 2.5  # likewise for log_sensitivity: with 2.0 a stiff tumour's error was 1.2 times its bound
EARLIER_STEP_SHARE = 0.85  # of the step before: second order leaves 0.66 as rims are refined, 0.81 as growth is
MIN_EARLIER_STEP_SHARE = 0.3  # of the step before: what is left at third order
ERROR_FLOOR_RELATIVE = 0.02  # of the change by inclusions, groove and edges: error common to all meshes; half on the finest
RATIO_CHANGE_SHARE = 0.25  # of the change of film forces: minimum change of ln ratio that counts
REFERENCE_ERROR_SHARE = 0.04  # of the mesh's error of the reference: what may not cancel
SOFT_RIM_FACTOR = 2.0  # likewise, times the fraction of force that the films lose


@dataclass(frozen=True)
class Doubt:
    """What is added to the differences between meshes, for film forces and charges alike.

    Attributes
    ----------
    floor
        See ``ERROR_FLOOR_RELATIVE``.
    volume
        Relative error of the volume of a body from a file.
    far_tissue
        Relative error by far tissue that is left out.
    reference_errors
        Relative errors of the reference's film forces on the finest mesh, shape (2,).
    safety_factors
        Safety factors of the last step, for forces and for log_sensitivity.
    """

    floor: float
    volume: float
    far_tissue: float
    reference_errors: Floats
    safety_factors: tuple[float, float]

    @property
    def mesh_errors(self) -> Floats:
        """Errors of both films on the finest mesh relative to the change by inclusions, groove and edges, shape (2,)."""
        return self.floor + self.volume + self.far_tissue + REFERENCE_ERROR_SHARE * self.reference_errors


def bound_film_forces(
    scene: Scene,
    symmetric: SymmetricPart,
    differences: Sequence[SceneDifference],
    floor: float,
    *,
    safety_factors: tuple[float, float] = (FORCE_SAFETY_FACTOR, SENSITIVITY_SAFETY_FACTOR),
) -> tuple[FilmForces, ...]:
    """Return the film forces of the finest mesh, the last of two or more, with error bounds from all meshes.

    Charges have bounds of the same kind; ``film_charges.widen_charge_bounds`` adds what no mesh shows.

    Parameters
    ----------
    scene
        The scene.
    symmetric
        Its rotationally symmetric part.
    differences
        Scene minus reference on each mesh, coarser meshes first.
    floor
        See ``ERROR_FLOOR_RELATIVE``.
    safety_factors
        Safety factors of the last step, for forces and for log_sensitivity.
    """
    fine, exact_films = differences[-1], symmetric.whole.films
    forces = [symmetric.correct_forces(entry) for entry in differences]
    derivatives = [symmetric.propagate_change(entry, entry.modulus_derivative) for entry in differences]
    reference_errors = np.abs(np.log(fine.reference.sum(axis=1) / symmetric.exact.sum(axis=1)))
    doubt = Doubt(floor, fine.volume_error, FAR_TISSUE_PRODUCT_SHARE * symmetric.edges, reference_errors, safety_factors)
    has_target = scene.target is not None
    films = _bound_products(forces, derivatives, exact_films, doubt, has_target)
    samples = [compute_charges(scene, symmetric, entry) for entry in differences]
    charges = [sample.charges for sample in samples if sample is not None]
    if exact_films.charges is None or not charges:
        return films
    charge_derivatives = [sample.derivative for sample in samples if sample is not None]
    charge_films = _bound_products(charges, charge_derivatives, exact_films.charges, doubt, has_target)
    return tuple(replace(film, charges=entry) for film, entry in zip(films, charge_films, strict=True))


def _bound_products(
    products: Sequence[Floats], derivatives: Sequence[Floats], exact: FilmForces, doubt: Doubt, has_target: bool
) -> tuple[FilmForces, ...]:
    """Return film forces, or charges, of the finest mesh with error bounds, for k moduli of the target.

    Parameters
    ----------
    products, derivatives
        Of each mesh, the finest last, shape (k, 2, 2) each: the forces, and their derivatives with respect to ln E of the target.
    exact
        Those of the rotationally symmetric part, with their errors.
    doubt
        What is added to the differences between meshes.
    has_target
        Whether there is a target.
    """
    symmetric_totals, mesh_errors = exact.forces.sum(axis=1), doubt.mesh_errors
    force_factor, sensitivity_factor = doubt.safety_factors
    films = []
    for k, mesh_forces in enumerate(products[-1]):
        totals = [entry[k].sum(axis=1) for entry in products]
        change = np.abs(totals[-1] - symmetric_totals)
        # errors at the rims that do not cancel, where inclusions take force from the films
        rim_forces = SOFT_RIM_FACTOR * doubt.reference_errors * change * np.clip(1 - totals[-1] / symmetric_totals, 0.0, None)
        error = bound_error(totals, force_factor) + mesh_errors * change + rim_forces + exact.bound.totals
        with np.errstate(divide="ignore", invalid="ignore"):
            rim_errors = np.nan_to_num(rim_forces / np.abs(totals[-1]))
            log_changes = np.nan_to_num(np.abs(np.log(np.abs(totals[-1] / symmetric_totals))))
        logs = [_compute_log_ratio(entry) for entry in totals]
        log_change = max(abs(logs[-1] - _compute_log_ratio(symmetric_totals)), RATIO_CHANGE_SHARE * float(log_changes.max()))
        log_ratio_error = float(bound_error(logs, force_factor) + mesh_errors.max() * log_change + rim_errors.sum())
        # a film force that may be zero has no ratio
        log_ratio_bound = log_ratio_error + exact.bound.log_ratio if np.all(error < np.abs(totals[-1])) else np.inf
        sensitivities: Floats = np.array(
            [
                _compute_sensitivities(modulus_derivative[k], entry[k])
                for modulus_derivative, entry in zip(derivatives, products, strict=True)
            ]
        )
        sensitivity_error = (
            bound_error(sensitivities @ [1.0, -1.0], sensitivity_factor)
            + (ERROR_FLOOR_RELATIVE + doubt.volume) * abs(sensitivities[-1] @ [1.0, -1.0])
            + np.abs(sensitivities[-1]) @ rim_errors
        )
        derivative = derivatives[-1][k] if has_target else None
        films.append(FilmForces(mesh_forces, Bound(error, log_ratio_bound), derivative, float(sensitivity_error)))
    return tuple(films)


def bound_error(values: Sequence[Floats | float] | Floats, safety_factor: float) -> Floats:
    """Bound the error of a value on the finest of several meshes by the differences between meshes.

    Parameters
    ----------
    values
        The value on each mesh, the finest last; numbers or arrays of shape (n,).
    safety_factor
        Factor of the difference of two meshes; with three it is only an upper limit, see the module.
    """
    steps = np.abs(np.diff(np.array(values), axis=0))
    bound = safety_factor * steps[-1]
    if len(steps) > 1:
        # where steps grow by more than the safety factor, or the step before is zero, the growth is the safety factor
        is_limited = safety_factor * steps[-2] > steps[-1]
        growth = np.maximum(np.divide(steps[-1], steps[-2], out=np.full_like(steps[-1], safety_factor), where=is_limited), 1.0)
        bound = np.maximum(
            np.minimum(bound, np.maximum(EARLIER_STEP_SHARE * steps[-2], growth * steps[-1])), MIN_EARLIER_STEP_SHARE * steps[-2]
        )
    return np.asarray(bound)


def _compute_log_ratio(totals: Floats) -> float:
    """Return ln |inner / outer film force| of both films' total forces, shape (2,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.log(np.abs(totals)) @ [1.0, -1.0])


def _compute_sensitivities(modulus_derivative: Floats, forces: Floats) -> Floats:
    """Return d ln F / d ln E of both film forces F, with the target's modulus E; shape (2,).

    ``forces`` and ``modulus_derivative`` are F_ij and its derivative with respect to ln E, N/m, shape (2, 2): film i, base j.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(modulus_derivative.sum(axis=1) / forces.sum(axis=1)))
