"""Compute the film forces of a scene to a given accuracy, with bounds on all known errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.axisymmetric.lower_order import graded_everywhere, near_errors, order_errors, own_errors
from solver.axisymmetric.omitted_details import IN_PLANE, Change, omitted_changes
from solver.axisymmetric.refinement import CROSSED, LEVELS, ONE_MESH, SampleErrors, refine
from solver.axisymmetric.sample import MeshSample, sample
from solver.axisymmetric.sections import sections, with_details
from solver.linalg.workspace import current
from solver.results.film_forces import Bound, FilmForces, above
from solver.results.result import Decision
from solver.results.warnings import Note

NEGLIGIBLE = 0.05  # of the accuracy: films and base with a smaller effect are left out
UNEVEN = 2.0  # where all meshes may share an error: corners of films and base, layers' ends


@dataclass(frozen=True)
class Converged:
    """Film forces at each modulus, with their errors.

    Attributes:
        films: with their errors.
        sample: where they come from; its states are those of one of the moduli, or of one between them.
        plan: what is modelled or left out, beyond blocks and tissue.
        notes: warnings that explain what limits the accuracy, one line each.
        stopped: why no finer mesh was used where one was needed; None where none was needed.
    """

    films: tuple[FilmForces, ...]
    sample: MeshSample
    plan: tuple[Decision, ...]
    notes: tuple[Note, ...]
    stopped: str | None = None


def converged_forces(scene: Scene, accuracy: float, moduli: Floats | None = None) -> Converged:
    """Return film forces on the first mesh that meets ``accuracy``, or on the finest.

    Raises:
        SolveError: the scene's equations cannot be solved in double precision.
        LimitReached: not even the meshes that an error bound needs are within the limits of memory and time.
    """
    current().begin()
    plain = sections(scene)
    rough = cache(lambda: sample(plain.section, plain, scene, LEVELS[0], moduli=moduli))
    changes = list(omitted_changes(scene, plain, rough, moduli))
    in_plane = [change for change in changes if change.feature in IN_PLANE]
    chosen = plain
    if any(change.effect > NEGLIGIBLE * accuracy for change in in_plane):
        chosen = with_details(scene, plain)
        changes = [replace(change, modelled=True) if change in in_plane else change for change in changes]
    missing = [change for change in changes if not change.modelled]
    solve = partial(sample, chosen.section, chosen, scene, moduli=moduli)

    def good(mesh_sample: MeshSample, errors: SampleErrors) -> bool:
        numerical = _films(scene, mesh_sample, errors)
        least = reached = max(one.error_under(scene) for one in numerical)
        if missing:
            reached = max(one.error_under(scene) for one in _films(scene, mesh_sample, errors, missing))
        small = reached <= accuracy or (reached - least > accuracy and least <= accuracy / 2)
        return small and all(_sensitive_enough(one, accuracy) for one in numerical)

    mesh_sample, errors, why = refine(
        lambda level: rough() if level == LEVELS[0] and chosen is plain else solve(level),
        accuracy,
        good,
        (own_errors, near_errors, order_errors) if graded_everywhere(chosen.section) else (),
        margin=UNEVEN if chosen.section.has_details or chosen.section.interfaces else 1.0,
        told=CROSSED if chosen.section.interfaces_apart[1] else ONE_MESH,
    )
    films = _films(scene, mesh_sample, errors, missing)
    plan = tuple(change.decision(accuracy) for change in changes)
    return Converged(films, mesh_sample, plan, tuple(_notes(scene, films, missing, accuracy, why)), why)


def _films(scene: Scene, sample: MeshSample, errors: SampleErrors, changes: Iterable[Change] = ()) -> tuple[FilmForces, ...]:
    films = []
    for k, forces in enumerate(sample.forces):
        bound = Bound.independent(errors.totals[k], forces)
        sensitivity_bound = float(errors.sensitivity[k])
        for change in changes:
            bound, sensitivity_bound = bound + change.bounds[k], sensitivity_bound + float(change.sensitivity[k])
            forces = forces + np.broadcast_to(change.shift, sample.forces.shape)[k]
        films.append(FilmForces(forces, bound, sample.slope[k] if scene.target is not None else None, sensitivity_bound))
    return tuple(films)


def _sensitive_enough(films: FilmForces, accuracy: float) -> bool:
    return films.sensitivity_error <= max(5 * accuracy * abs(films.log_sensitivity or 0.0), 1e-5)


def _notes(
    scene: Scene, films: tuple[FilmForces, ...], missing: Iterable[Change], accuracy: float, why: str | None
) -> Iterable[Note]:
    for change in missing:
        if change.effect > NEGLIGIBLE * accuracy:
            size = f"changes the ratio by at most about {change.effect:.2g}"
            yield Note("left_out", f"left out: {change.feature}, {size}, counted in error_estimate")
    reached = max(one.error_under(scene) for one in films)
    worst = max((one.sensitivity_error / max(abs(one.log_sensitivity or 0.0), 2e-6 / accuracy) for one in films), default=0.0)
    insensitive = scene.target is not None and worst > 5 * accuracy
    if isinstance(why, Note) and (reached > accuracy or insensitive):
        yield why
    if reached > accuracy:
        obstacle = f"; no finer mesh helped: {why}" if why else ": the warnings list why"
        yield Note("accuracy", above(reached, accuracy) + obstacle)
    if insensitive:
        yield Note("sensitivity", f"log_sensitivity is good to about {worst:.1g} of itself only")
