"""Compute film forces in three dimensions with errors: an exact symmetric part, and the difference from it on meshes.

Two meshes are made at once. If they do not agree to the accuracy, a third follows: a coarser one, in a tenth of the time of a
finer one, if its agreement with the coarser of both would suffice; else a finer one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.percent import format_percent
from geometry.common.resources import LimitReached
from geometry.processes.programs import ChildThreads
from geometry.scenes.scene import Scene
from geometry.tetra.sizing import COARSE_FINENESS, FINE_FINENESS, ROUGH_FINENESS, ROUGHEST_FINENESS, TetraFineness
from geometry.tetra.tet_mesh import TetMesh
from solver.linalg.workspace import get_workspace
from solver.results.evaluator import ProgressCallback, ignore_progress
from solver.results.film_forces import FilmForces, compute_sensitivity_tolerance
from solver.results.result import Decision
from solver.results.warnings import Note
from solver.solid.base_states import SolidStates
from solver.solid.difference import SceneDifference, solve_difference
from solver.solid.domain import Domain
from solver.solid.domain_mesh import (
    UNKNOWNS_PER_TETRAHEDRON,
    check_mesh,
    check_unknowns,
    is_meshed,
    mesh_domain,
    move_meshes,
)
from solver.solid.film_charges import (
    CORRECTION_SHARE,
    compute_charges,
    estimate_cut_changes,
    list_charge_decisions,
    widen_charge_bound,
)
from solver.solid.mesh_agreement import ERROR_FLOOR_RELATIVE, FORCE_SAFETY_FACTOR, bound_film_forces
from solver.solid.symmetric_part import FAR_TISSUE_PRODUCT_SHARE, SymmetricPart, compute_symmetric_part

FINENESSES = ROUGHEST_FINENESS, ROUGH_FINENESS, COARSE_FINENESS, FINE_FINENESS
ROUGH_ACCURACY = 0.015  # accuracy from which on the two coarsest meshes may suffice
MESH_STAGES = (
    ((ROUGHEST_FINENESS, ROUGH_FINENESS), (COARSE_FINENESS,), (FINE_FINENESS,)),
    ((ROUGH_FINENESS, COARSE_FINENESS), (ROUGHEST_FINENESS,), (FINE_FINENESS,)),
)  # from that accuracy on, and below it
MAX_SENSITIVITY_EXCESS = 2.0  # times the tolerance of log_sensitivity: above this a third mesh would not reach it


@dataclass(frozen=True)
class TiltForces:
    """Forces on both films, or their charges, per unit rotation of the base about y, for k moduli of the target.

    Attributes
    ----------
    forces
        N/rad or C/rad, shape (k, 2).
    derivative
        Their derivative with respect to ln E of the target.
    error
        Bound on the error of ``forces``, shape (2,).
    """

    forces: Floats
    derivative: Floats
    error: Floats

    @classmethod
    def from_meshes(cls, fine: tuple[Floats, Floats], coarse: Floats, more: Floats | float = 0.0) -> TiltForces:
        """Return forces and their derivative on the finest mesh, ``fine``; ``more`` adds to the error by a coarser one."""
        forces, derivative = fine
        step = FORCE_SAFETY_FACTOR * np.abs(forces - coarse).max(axis=0)
        return cls(forces, derivative, step + ERROR_FLOOR_RELATIVE * np.abs(forces).max(axis=0) + more)


@dataclass(frozen=True)
class SolidForces:
    """Film forces of a scene, for k moduli of its target.

    Attributes
    ----------
    films
        Film forces with their errors.
    tilt
        Film forces per unit rotation of the base about y, N/rad.
    tilt_charges
        The films' charges likewise, C/rad; None where the films have none of their own.
    domain
        The domain that was meshed.
    difference
        Scene minus reference on the finest mesh.
    states
        States of the scene on that mesh, for pictures; for a curve, those it starts from.
    plan
        Features that are modelled or left out.
    notes
        Limits of the accuracy.
    """

    films: tuple[FilmForces, ...]
    tilt: TiltForces
    tilt_charges: TiltForces | None
    domain: Domain
    difference: SceneDifference
    states: SolidStates
    plan: tuple[Decision, ...]
    notes: tuple[Note, ...]


def compute_solid_forces(
    scene: Scene, accuracy: float, moduli: Floats | None = None, progress: ProgressCallback = ignore_progress
) -> SolidForces:
    """Return film forces from two meshes, or from more if two do not agree to ``accuracy``.

    Parameters
    ----------
    scene
        A scene with bonded or frictionless faces.
    accuracy
        Relative accuracy.
    moduli
        Moduli of the target, Pa, shape (k,); or None for the scene's modulus.
    progress
        Called with a line of text before each piece of work.

    Raises
    ------
    InputError, Refusal
        See ``geometry.tetra.cache.read_or_make_mesh``.
    LimitReached
        Two meshes already exceed the limits of memory or time.
    SolveError
        A mesh or a solution failed.
    """
    progress("the symmetric part")
    symmetric = compute_symmetric_part(scene, accuracy)
    get_workspace().begin()  # its memory may be freed
    films, differences, states, stopped = _refine_until_agreed(scene, symmetric, accuracy, moduli, progress)
    notes = (*symmetric.whole.notes, *stopped)
    fine, coarse = differences[-1], differences[-2]
    tilt = TiltForces.from_meshes(_compute_tilt_forces(symmetric, fine), _compute_tilt_forces(symmetric, coarse)[0])
    sample, coarse_sample = (compute_charges(scene, symmetric, difference) for difference in (fine, coarse))
    plan = [*symmetric.whole.plan, *_list_decisions(symmetric, fine, accuracy)]
    tilt_charges = None
    if sample is not None and coarse_sample is not None:
        cut = estimate_cut_changes(scene, symmetric.whole.films)
        films = tuple(widen_charge_bound(film, sample, k, cut) for k, film in enumerate(films))
        tilt_charges = TiltForces.from_meshes(
            (sample.tilt, sample.tilt_derivative),
            coarse_sample.tilt,
            CORRECTION_SHARE * np.abs(sample.tilt_correction).max(axis=0) + cut * np.abs(sample.tilt).max(axis=0),
        )
        plan.extend(list_charge_decisions(sample, cut, accuracy))
    return SolidForces(films, tilt, tilt_charges, symmetric.domain, fine, states, tuple(plan), notes)


def _refine_until_agreed(
    scene: Scene, symmetric: SymmetricPart, accuracy: float, moduli: Floats | None, progress: ProgressCallback
) -> tuple[tuple[FilmForces, ...], list[SceneDifference], SolidStates, tuple[Note, ...]]:
    """Solve on more and finer meshes until they agree to the accuracy or a limit is reached.

    For the parameters see ``compute_solid_forces``.

    Returns
    -------
    tuple
        Film forces with their errors for each modulus; the differences from the reference on all meshes, coarser first; the
        states on the finest mesh; and a note that names the limit of memory or time that prevented a further mesh, if one did.
    """
    solutions: dict[TetraFineness, tuple[SceneDifference, SolidStates]] = {}
    films: tuple[FilmForces, ...] = ()
    differences: list[SceneDifference] = []
    states: list[SolidStates] = []
    is_rough = accuracy >= ROUGH_ACCURACY
    for stage in MESH_STAGES[0] if is_rough else MESH_STAGES[1]:
        # a third, coarser mesh is cheap but only worth it if the convergence that it may show would suffice
        if stage == (ROUGHEST_FINENESS,) and not _may_suffice(scene, symmetric, differences, accuracy):
            continue
        try:
            for fineness, mesh in zip(stage, _iterate_meshes(symmetric.domain, stage, progress), strict=True):
                progress(f"solving on {len(mesh.elements)} tetrahedra")
                get_workspace().begin()  # a coarser mesh's factor may be freed
                solutions[fineness] = solve_difference(symmetric.domain, mesh, moduli)
        except LimitReached as limit:
            if not states:
                raise
            return films, differences, states[-1], (Note("limit", f"no finer mesh: {limit}"),)
        solved = [solutions[fineness] for fineness in FINENESSES if fineness in solutions]  # coarser meshes first
        differences, states = [difference for difference, _ in solved], [mesh_states for _, mesh_states in solved]
        # the error common to all meshes is half as large on the finest
        floor = ERROR_FLOOR_RELATIVE / 2 if FINE_FINENESS in solutions else ERROR_FLOOR_RELATIVE
        films = bound_film_forces(scene, symmetric, differences, floor)
        max_excess = np.inf if is_rough and len(solved) == 2 else MAX_SENSITIVITY_EXCESS
        if not any(_may_improve(film, scene, accuracy, max_excess) for film in films):
            break
    return films, differences, states[-1], ()


def _may_suffice(scene: Scene, symmetric: SymmetricPart, differences: list[SceneDifference], accuracy: float) -> bool:
    """Return whether a third, coarser mesh may make the two present ones suffice.

    If it shows steady convergence, the difference of the two counts once, without a safety factor.
    """
    films = bound_film_forces(scene, symmetric, differences, ERROR_FLOOR_RELATIVE, safety_factors=(1.0, 1.0))
    return not any(_may_improve(film, scene, accuracy) for film in films)


def _iterate_meshes(domain: Domain, finenesses: tuple[TetraFineness, ...], progress: ProgressCallback) -> Iterator[TetMesh]:
    """Yield the meshes of a domain in the order of ``finenesses``, moved from those of a similar scene or made in parallel."""
    moved = move_meshes(domain, finenesses)
    if moved is not None:
        for mesh in moved:
            check_unknowns(UNKNOWNS_PER_TETRAHEDRON * len(mesh.elements))
        yield from moved
        return
    for fineness in finenesses:
        _check_cost(domain, fineness)
    progress(
        "meshing twice"
        if len(finenesses) > 1
        else "meshing again"
        if finenesses == (ROUGHEST_FINENESS,)
        else "meshing more finely"
    )
    with ChildThreads(len(finenesses)) as threads:
        for made in [threads.submit(mesh_domain, domain, fineness) for fineness in finenesses]:
            yield made.result()


def _check_cost(domain: Domain, fineness: TetraFineness) -> None:
    """Raise ``LimitReached`` if making a mesh, or solving on a cached one, would exceed the limits of memory or time."""
    if is_meshed(domain, fineness):
        check_unknowns(UNKNOWNS_PER_TETRAHEDRON * len(mesh_domain(domain, fineness).elements))
    else:
        check_mesh(domain, fineness)


def _may_improve(films: FilmForces, scene: Scene, accuracy: float, max_excess: float = MAX_SENSITIVITY_EXCESS) -> bool:
    """Return whether another mesh is worth its cost: errors of forces are too large, or log_sensitivity is within reach.

    A finer mesh divides the bound by two to four. Where that would not suffice, the present bound is reported.
    """
    allowed = float(compute_sensitivity_tolerance(accuracy, films.log_sensitivity or 0.0))
    return allowed < films.sensitivity_error <= max_excess * allowed or films.compute_max_error(scene) > accuracy


def _compute_tilt_forces(symmetric: SymmetricPart, difference: SceneDifference) -> tuple[Floats, Floats]:
    """Return film forces per unit rotation of the base about y, N/rad, corrected by eq. SO.5, and their derivatives.

    The derivatives are those with respect to ln E of the target; shape (k, 2) each, for k moduli.
    """
    tilt, derivative = (
        symmetric.propagate_change(difference, part[..., None])[..., 0] for part in (difference.tilt, difference.tilt_derivative)
    )
    return tilt, derivative


def _list_decisions(symmetric: SymmetricPart, difference: SceneDifference, accuracy: float) -> Iterator[Decision]:
    """Yield the decisions on features of the scene that were meshed or left out."""
    exact, whole = symmetric.exact, symmetric.exact + difference.forces[0]
    # change of ln(inner / outer film force) by inclusions, groove and edges
    effect = abs(float(np.log(np.abs(whole.sum(axis=1) / exact.sum(axis=1))) @ [1.0, -1.0]))
    size = f"changes the ratio by about {format_percent(effect)}"
    yield Decision("inclusions, groove and edges, in three dimensions", True, effect, accuracy, f"modelled: {size}")
    if symmetric.domain.shortened:
        left = FAR_TISSUE_PRODUCT_SHARE * symmetric.edges * effect
        change = f"changes the ratio by at most about {format_percent(left)}"
        reason = f"left out but for its compliance: {change}, counted in error_estimate"
        yield Decision("far tissue's effect on the change by inclusions", False, left, accuracy, reason)
    if symmetric.domain.half:
        yield Decision("the other half of a mirror-symmetric scene", False, 0.0, accuracy, "left out: exactly the same")
