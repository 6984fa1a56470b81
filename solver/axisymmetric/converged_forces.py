"""Compute the film forces of a scene to a given accuracy, with bounds on all known errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.percent import format_percent
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.scene import Scene
from solver.axisymmetric.film_states import CHARGE_UNIT
from solver.axisymmetric.lower_order import bound_by_descent, bound_by_last_degree, bound_by_lower_order, is_graded_everywhere
from solver.axisymmetric.omitted_details import (
    IN_PLANE_DETAILS,
    Change,
    bound_detail,
    bound_omitted_changes,
)
from solver.axisymmetric.refinement import CROSSED_SPHERE_ORDERS, MESH_LEVELS, ONE_MESH_ORDERS, SampleErrors, refine
from solver.axisymmetric.sample import MeshSample, solve_on_mesh
from solver.axisymmetric.sections import add_details, build_sections
from solver.axisymmetric.stack_cells import choose_stack_fineness, has_bare_film
from solver.linalg.workspace import get_workspace
from solver.results.detail_compliance import CHARGE_CHANGE_FACTOR, FILM_DETAIL, iterate_details
from solver.results.film_forces import Bound, FilmForces, describe_sensitivity_error, describe_shortfall
from solver.results.result import Decision
from solver.results.warnings import Note

NEGLIGIBLE_SHARE = 0.05  # of the accuracy: films and base with a smaller effect are left out
BARE_LIGHT_MIN_ACCURACY = 0.01  # below it, or without a sphere, films bonded rigidly on both sides need more than the light mesh
UNEVEN_MARGIN_FACTOR = 2.0  # where all meshes may share an error: thin films and bonds, an elastic base, layers' ends


@dataclass(frozen=True)
class Converged:
    """Film forces at each modulus, with their errors.

    Attributes
    ----------
    films
        Forces per unit displacement with error bounds, one for each modulus.
    sample
        The solution from which they are computed; its states are those of one of the moduli, or of one between them.
    plan
        Features that are modelled or left out, beyond blocks and tissue.
    notes
        Warnings that explain what limits the accuracy, one line each.
    stopped
        The reason why no finer mesh was used where one was needed; None where none was needed.
    """

    films: tuple[FilmForces, ...]
    sample: MeshSample
    plan: tuple[Decision, ...]
    notes: tuple[Note, ...]
    stopped: str | None = None


def compute_converged_forces(scene: Scene, accuracy: float, moduli: Floats | None = None) -> Converged:
    """Return film forces on the first mesh that meets ``accuracy``, or on the finest.

    First the effects of all features beyond blocks and tissue are bounded with a solution on the coarsest mesh. If films or base
    matter, both are modelled; the effects of all other features are added to the error bounds.

    Parameters
    ----------
    scene
        Of a kind that ``axisymmetric`` takes.
    accuracy
        Relative, of the stresses, their ratio and the stiffness.
    moduli
        Young's moduli of the inclusion, Pa, shape (k,); None for its own.

    Raises
    ------
    SolveError
        The scene's equations cannot be solved in double precision.
    LimitReached
        Even the coarsest meshes that give an error bound exceed the limits of memory or time.
    """
    get_workspace().begin()
    bare_sections = build_sections(scene)
    solve_coarsest = cache(lambda: solve_on_mesh(bare_sections.section, bare_sections, scene, MESH_LEVELS[0], moduli=moduli))
    feature_changes = list(bound_omitted_changes(scene, bare_sections, solve_coarsest, moduli))
    in_plane_changes = [change for change in feature_changes if change.feature in IN_PLANE_DETAILS]
    sections = bare_sections
    if scene.models_charges or any(change.effect > NEGLIGIBLE_SHARE * accuracy for change in in_plane_changes):
        sections = add_details(scene, bare_sections)
        feature_changes = [replace(change, modelled=True) if change in in_plane_changes else change for change in feature_changes]
    omitted = [change for change in feature_changes if not change.modelled]

    # bounds from one mesh assume that errors fall with the order as on meshes graded at every singular point, eq. AX.10
    graded = is_graded_everywhere(sections.section)

    def solve(fineness: MeridianFineness) -> MeshSample:
        """Solve with all features that are modelled."""
        # differences of meshes show the error of corners only if the corners' layers differ, too
        chosen = choose_stack_fineness(scene, fineness) if graded and any(sections.section.stacks) else fineness
        return solve_on_mesh(sections.section, sections, scene, chosen, moduli=moduli)

    def is_good(mesh_sample: MeshSample, errors: SampleErrors) -> bool:
        """Return whether errors are within the accuracy, or finer meshes could not bring them there."""
        numerical = _build_films(scene, mesh_sample, errors)
        numerical_error = reached = max(film.compute_max_error(scene) for film in numerical)
        if omitted:
            reached = max(film.compute_max_error(scene) for film in _build_films(scene, mesh_sample, errors, omitted))
        # the second case: the features left out exceed the accuracy, and finer meshes cannot reduce their effect
        small = reached <= accuracy or (reached - numerical_error > accuracy and numerical_error <= accuracy / 2)
        return small and all(film.meets_sensitivity(accuracy) for film in numerical)

    mesh_sample, errors, reason = refine(
        lambda level: solve_coarsest() if level == MESH_LEVELS[0] and sections is bare_sections else solve(level),
        accuracy,
        is_good,
        (bound_by_last_degree, bound_by_descent, bound_by_lower_order) if graded else (),
        margin=UNEVEN_MARGIN_FACTOR if sections.section.has_details or sections.section.interfaces else 1.0,
        one_mesh_orders=CROSSED_SPHERE_ORDERS if sections.section.interfaces_apart[1] else ONE_MESH_ORDERS,
        starts_light=not has_bare_film(scene) or (accuracy >= BARE_LIGHT_MIN_ACCURACY and bool(scene.inclusion)),
    )
    films = _build_films(scene, mesh_sample, errors, omitted)
    if scene.models_charges:
        stacks = next(detail for detail in iterate_details(scene.probe) if detail.name == FILM_DETAIL)
        feature_changes.append(replace(bound_detail(stacks, mesh_sample), modelled=True))
    plan = tuple(change.build_decision(accuracy) for change in feature_changes)
    return Converged(films, mesh_sample, plan, tuple(_write_notes(scene, films, omitted, accuracy, reason)), reason)


def _build_films(
    scene: Scene, sample: MeshSample, errors: SampleErrors, feature_changes: Iterable[Change] = ()
) -> tuple[FilmForces, ...]:
    """Return the film forces at each modulus, corrected and with bounds widened by the features that are left out."""
    films = []
    for k, forces in enumerate(sample.forces):
        bound = Bound.from_independent_errors(errors.totals[k, :2], forces)
        sensitivity_bound = float(errors.sensitivity[k, 0])
        charges = _build_charges(scene, sample, errors, k)
        for change in feature_changes:
            bound, sensitivity_bound = bound + change.bounds[k], sensitivity_bound + float(change.sensitivity[k])
            shifted = forces + np.broadcast_to(change.shift, sample.forces.shape)[k]
            charges = None if charges is None else _change_charges(charges, change, k, shifted.sum(axis=1) / forces.sum(axis=1))
            forces = shifted
        derivative = sample.modulus_derivative[k] if scene.target is not None else None
        films.append(FilmForces(forces, bound, derivative, sensitivity_bound, charges))
    return tuple(films)


def _build_charges(scene: Scene, sample: MeshSample, errors: SampleErrors, k: int) -> FilmForces | None:
    """Return the films' charges at the modulus k with their errors on the mesh, C/m; None where the sample has none."""
    if sample.products.shape[1] == 2:
        return None
    charges, derivatives = (CHARGE_UNIT * products[k, 2:] for products in (sample.products, sample.product_derivatives))
    bound = Bound.from_independent_errors(CHARGE_UNIT * errors.totals[k, 2:], charges)
    return FilmForces(charges, bound, derivatives if scene.target is not None else None, float(errors.sensitivity[k, 1]))


def _change_charges(charges: FilmForces, change: Change, k: int, factors: Floats) -> FilmForces:
    """Return the films' charges changed by a feature as the film forces are, with their bounds widened.

    ``factors`` are the relative changes of the forces that are known, shape (2,). A charge is assumed to change by at most
    ``CHARGE_CHANGE_FACTOR`` times as much as the force.
    """
    relative_bound = CHARGE_CHANGE_FACTOR * change.bounds[k].totals / np.abs(change.totals[k, :2])
    log_ratio = CHARGE_CHANGE_FACTOR * (change.bounds[k].log_ratio + abs(float(np.log(np.abs(factors)) @ [1.0, -1.0])))
    shifts = np.abs(factors - 1) * (CHARGE_CHANGE_FACTOR - 1)
    bound = Bound((relative_bound + shifts) * np.abs(charges.totals), log_ratio)
    return replace(
        charges,
        forces=charges.forces * factors[:, None],
        bound=charges.bound + bound,
        modulus_derivative=None if charges.modulus_derivative is None else charges.modulus_derivative * factors[:, None],
        sensitivity_error=charges.sensitivity_error + CHARGE_CHANGE_FACTOR * float(change.sensitivity[k]),
    )


def _write_notes(
    scene: Scene, films: tuple[FilmForces, ...], omitted: Iterable[Change], accuracy: float, reason: str | None
) -> Iterable[Note]:
    """Yield warnings: features left out, the limit that stopped refinement, and accuracies that were not reached."""
    for change in omitted:
        if change.effect > NEGLIGIBLE_SHARE * accuracy:
            size = f"changes the ratio by at most about {format_percent(change.effect)}"
            yield Note("left_out", f"left out: {change.feature}, {size}, counted in error_estimate")
    reached = max(film.compute_max_error(scene) for film in films)
    # relative error; 2e-6 / accuracy keeps it finite where the log-sensitivity vanishes
    worst_sensitivity = max(
        (film.sensitivity_error / max(abs(film.log_sensitivity or 0.0), 2e-6 / accuracy) for film in films), default=0.0
    )
    insensitive = scene.target is not None and worst_sensitivity > 5 * accuracy
    if isinstance(reason, Note) and (reached > accuracy or insensitive):
        yield reason
    if reached > accuracy:
        obstacle = f"; no finer mesh helped: {reason}" if reason else ": the warnings list why"
        yield Note("accuracy", describe_shortfall(reached, accuracy) + obstacle)
    if insensitive:
        yield Note("sensitivity", describe_sensitivity_error(worst_sensitivity))
