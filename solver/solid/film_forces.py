"""Film forces in three dimensions with their errors: an exact symmetric part, and what two meshes say of the rest.

With A the exact forces of the reference (``domain.py``), D the difference that a mesh finds (``difference.py``) and
C the compliance by which the whole probe on the whole tissue, films, base and far tissue included, exceeds the reference,

    F = ((A + D)^-1 + C)^-1,    C = F_whole^-1 - A^-1                                              (SO.5)

both A and F_whole by ``solver/axisymmetric/converged_forces.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.child_process import ProgramGroup
from geometry.common.errors import Refusal, Words
from geometry.common.limits import least_mm, reaches
from geometry.common.resources import LimitReached
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from geometry.tetra.layout import body_layout
from geometry.tetra.sizing import COARSE, FINE, ROUGH, TetraFineness
from geometry.tetra.tet_mesh import TetMesh
from solver.axisymmetric.converged_forces import converged_forces
from solver.linalg.workspace import current, kept_within_limits
from solver.results.film_forces import Bound, FilmForces
from solver.results.result import Decision
from solver.results.warnings import Note
from solver.solid.base_states import SolidStates
from solver.solid.cost import UNKNOWNS, check_mesh, check_unknowns
from solver.solid.difference import SceneDifference, difference
from solver.solid.domain import Domain, coaxial, domain, plain, reach, room
from solver.solid.domain_mesh import is_meshed, mesh_domain, moved_meshes

MESHES = ROUGH, COARSE, FINE
SHARE = 0.1  # of the accuracy that the symmetric part may take
SAFETY = 2.0  # times what two meshes differ by
SLOPES = 2.5  # likewise of log_sensitivity: on two meshes a stiff tumour's was 1.2 times outside 2.0
FLOOR = 0.02  # of what inclusions, groove and edges change: what two meshes may both have wrong; halved by a third mesh
RAW = 0.04  # of what the mesh gets wrong of the reference: what may not cancel
EDGES = 0.3  # of the product of what far tissue changes and what inclusions, groove and edges change
BESIDE = 0.11  # outer radii: the least tissue beside the probe
NEAR = 2.0  # times what is allowed of log_sensitivity: from where on a third mesh would not reach it
STEP = 1.6  # by which the tissue modelled grows where its edges matter
Tell = Callable[[str], None]


@dataclass(frozen=True)
class SolidForces:
    """Film forces of a scene, for k moduli of its target.

    Attributes:
        films: with their errors.
        tilt: film forces per unit rotation of the base about y, N/rad, shape (k, 2).
        tilt_slope: their derivative by ln E of the target.
        tilt_error: on ``tilt``, shape (2,).
        domain: what was meshed.
        difference: on the finest mesh.
        states: of the scene on that mesh, for pictures; of a curve those it begins with.
        plan: what is modelled or left out.
        notes: what stands in the way of a better answer.
    """

    films: tuple[FilmForces, ...]
    tilt: Floats
    tilt_slope: Floats
    tilt_error: Floats
    domain: Domain
    difference: SceneDifference
    states: SolidStates
    plan: tuple[Decision, ...]
    notes: tuple[Note, ...]


@dataclass(frozen=True)
class _Exact:
    """Film forces of a rotationally symmetric scene; see ``Converged``, whose finite elements are not kept here."""

    films: FilmForces
    plan: tuple[Decision, ...]
    notes: tuple[Note, ...]


@kept_within_limits
def _exact(scene: Scene, accuracy: float) -> _Exact:
    found = converged_forces(scene, accuracy)
    return _Exact(found.films[0], found.plan, found.notes)


@dataclass(frozen=True)
class _Symmetric:
    """The rotationally symmetric part of eq. SO.5.

    Attributes:
        domain: what is to be meshed.
        exact: A, N/m, shape (2, 2).
        compliance: C, m/N, shape (2, 2).
        whole: the whole probe on the whole tissue, without inclusions and groove.
        edges: what C changes of the totals that is not known exactly, relative; of the far tissue alone.
    """

    domain: Domain
    exact: Floats
    compliance: Floats
    whole: _Exact
    edges: float

    def corrected(self, change: Floats) -> Floats:
        """Eq. SO.5, for D of shape (k, 2, 2)."""
        return np.asarray(np.linalg.inv(np.linalg.inv(self.exact + change) + self.compliance))

    def carried(self, change: Floats, small: Floats) -> Floats:
        """What a small change of D, (k, 2, 2) or columns (k, 2, 1), becomes in F: rows and columns for the former."""
        inner = np.linalg.inv(self.exact + change)
        left = self.corrected(change) @ inner
        return np.asarray(left @ small @ (left.transpose(0, 2, 1) if small.shape[-1] == 2 else np.eye(1)))


def solid_forces(scene: Scene, accuracy: float, moduli: Floats | None = None, tell: Tell = lambda text: None) -> SolidForces:
    """Return film forces from two meshes, or from three where two do not agree to ``accuracy`` and three may.

    Args:
        scene: bonded or frictionless.
        accuracy: relative.
        moduli: of the target, Pa, shape (k,); or None for its own.
        tell: called with a line before each piece of work.

    Raises:
        InputError, Refusal: see ``geometry.tetra.cache.cached_mesh``.
        LimitReached: not even two meshes are within the limits of memory and time.
        SolveError: a mesh or a solution failed.
    """
    tell("the symmetric part")
    symmetric = _symmetric(scene, accuracy)
    current().begin()  # what that took may go
    films, differences, states, stopped = _agreed(scene, symmetric, accuracy, moduli, tell)
    notes = (*symmetric.whole.notes, *stopped)
    tilt = _tilted(symmetric, differences[-1])
    before = _tilted(symmetric, differences[-2])
    error = SAFETY * np.abs(tilt[0] - before[0]).max(axis=0) + FLOOR * np.abs(tilt[0]).max(axis=0)
    plan = (*symmetric.whole.plan, *_decisions(symmetric, differences[-1], accuracy))
    return SolidForces(films, *tilt, error, symmetric.domain, differences[-1], states, plan, notes)


def _agreed(
    scene: Scene, symmetric: _Symmetric, accuracy: float, moduli: Floats | None, tell: Tell
) -> tuple[tuple[FilmForces, ...], list[SceneDifference], SolidStates, tuple[Note, ...]]:
    """Film forces once two meshes agree, or of the finest within the limits; the differences on all meshes, and the last states.

    The notes say which limit forbade a further mesh.
    """
    differences: list[SceneDifference] = []
    films: tuple[FilmForces, ...] = ()
    meshes = _meshes(symmetric.domain, tell)
    while True:
        try:
            mesh = next(meshes)
            tell(f"solving on {len(mesh.elements)} tetrahedra")
            current().begin()  # a coarser mesh's factor may go
            one, states = difference(symmetric.domain, mesh, moduli)
        except LimitReached as limit:
            if not films:
                raise
            return films, differences, states, (Note("limit", f"no third mesh: {limit}"),)
        differences.append(one)
        if len(differences) > 1:
            films = _films(scene, symmetric, differences[-2], one, FLOOR / (len(differences) - 1))
            if len(differences) == len(MESHES) or not any(_may_improve(film, scene, accuracy) for film in films):
                return films, differences, states, ()


def _meshes(domain: Domain, tell: Tell) -> Iterator[TetMesh]:
    """Finer and finer ones; the first two are moved from a like scene's, or made side by side."""
    for finenesses, what in ((MESHES[:2], "meshing twice"), (MESHES[2:], "meshing more finely")):
        moved = moved_meshes(domain, finenesses)
        if moved is not None:
            for mesh in moved:
                check_unknowns(UNKNOWNS * len(mesh.elements))
            yield from moved
            continue
        for fineness in finenesses:
            _check(domain, fineness)
        tell(what)
        with ThreadPoolExecutor(len(finenesses)) as pool, ProgramGroup() as group:
            for made in [pool.submit(group.context().run, mesh_domain, domain, fineness) for fineness in finenesses]:
                yield made.result()


def _check(domain: Domain, fineness: TetraFineness) -> None:
    """Refuse what would pass the limits before it is made: a mesh, or the equations of one that is there."""
    if is_meshed(domain, fineness):
        check_unknowns(UNKNOWNS * len(mesh_domain(domain, fineness).elements))
    else:
        check_mesh(domain, fineness)


def _symmetric(scene: Scene, accuracy: float) -> _Symmetric:
    """Cut far tissue off where that changes what inclusions do by little enough."""
    alone = plain(scene)
    whole = _exact(alone, SHARE * accuracy)
    span = reach(scene)
    while True:
        chosen = domain(scene, span, _wall(scene))
        unsure = whole.films.error_under(alone) > accuracy / 4
        if chosen.shortened and not coaxial(scene) and unsure:  # the tissue's sides are known better where they are meshed
            span = np.inf
            continue
        exact = _exact(chosen.reference, SHARE * accuracy).films.forces
        symmetric = _Symmetric(chosen, exact, *_compliance(alone, chosen, exact, whole, accuracy))
        if not chosen.shortened or EDGES * symmetric.edges <= accuracy:
            return symmetric
        span *= STEP


def _wall(scene: Scene) -> float | None:
    """Radius of the reference cylinder in tissue that is not round about the probe, or None."""
    if coaxial(scene):
        return None
    tube = scene.probe.tube_radius
    if not reaches(room(scene) - tube, BESIDE * tube):
        near = Words(f"the probe {mm(room(scene) - tube)} from the tissue's edge")
        raise Refusal("placement", near, f"{least_mm(BESIDE * tube)} or more for solid: the reference cylinder needs room")
    return body_layout(scene, False, np.inf, None).wall


def _compliance(alone: Scene, chosen: Domain, exact: Floats, whole: _Exact, accuracy: float) -> tuple[Floats, _Exact, float]:
    """C of eq. SO.5, the converged whole, and what of it far tissue makes."""
    if chosen.radius is not None:  # edges are meshed: only films and base are left for C
        probe = alone.probe
        whole = _exact(chosen.reference.model_copy(update={"probe": probe}), SHARE * accuracy)
    forces = whole.films.forces
    compliance = np.linalg.inv(forces) - np.linalg.inv(exact)
    totals = np.abs(forces.sum(axis=1) - exact.sum(axis=1)) / np.abs(exact.sum(axis=1))
    return compliance, whole, float(totals.max()) if chosen.shortened else 0.0


def _films(
    scene: Scene, symmetric: _Symmetric, coarse: SceneDifference, fine: SceneDifference, floor: float
) -> tuple[FilmForces, ...]:
    """Film forces of the finer mesh, with bounds from both."""
    whole = symmetric.whole.films
    forces, before = symmetric.corrected(fine.forces), symmetric.corrected(coarse.forces)
    slope, slope_before = (symmetric.carried(one.forces, one.slope) for one in (fine, coarse))
    none = symmetric.whole.films.forces
    raw = np.abs(np.log(fine.reference.sum(axis=1) / symmetric.exact.sum(axis=1)))
    films = []
    for k, now in enumerate(forces):
        totals, was, plainly = (one.sum(axis=1) for one in (now, before[k], none))
        change = np.abs(totals - plainly)
        doubt = floor + fine.lost + EDGES * symmetric.edges
        error = SAFETY * np.abs(totals - was) + doubt * change + RAW * raw * change + whole.bound.totals
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = [float(np.log(np.abs(one)) @ [1.0, -1.0]) for one in (totals, was, plainly)]
        moved = abs(logs[0] - logs[2])
        log_ratio = SAFETY * abs(logs[0] - logs[1]) + doubt * moved + RAW * float(raw.max()) * moved + whole.bound.log_ratio
        one, other = _log_sensitivity(slope[k], now), _log_sensitivity(slope_before[k], before[k])
        sensitivity_bound = SLOPES * abs(one - other) + (FLOOR + fine.lost) * abs(one)
        bound = Bound(error, log_ratio if np.all(error < np.abs(totals)) else np.inf)
        films.append(FilmForces(now, bound, slope[k] if scene.target is not None else None, sensitivity_bound))
    return tuple(films)


def _log_sensitivity(slope: Floats, forces: Floats) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.nan_to_num((slope.sum(axis=1) / forces.sum(axis=1)) @ [1.0, -1.0]))


def _may_improve(films: FilmForces, scene: Scene, accuracy: float) -> bool:
    """Whether a third mesh is worth its price: stresses and ratio are not good enough, or log_sensitivity is not, but near to it.

    A third mesh halves its bound or better, seldom more than four times: where that would not do, two meshes' bound is told.
    """
    allowed = max(5 * accuracy * abs(films.log_sensitivity or 0.0), 1e-5)
    near = allowed < films.sensitivity_error <= NEAR * allowed
    return near or films.error_under(scene) > accuracy


def _tilted(symmetric: _Symmetric, one: SceneDifference) -> tuple[Floats, Floats]:
    """Film forces per unit rotation and their slopes, carried through eq. SO.5, shape (k, 2) each."""
    tilt, slope = (symmetric.carried(one.forces, part[..., None])[..., 0] for part in (one.tilt, one.tilt_slope))
    return tilt, slope


def _decisions(symmetric: _Symmetric, difference: SceneDifference, accuracy: float) -> Iterator[Decision]:
    """What of the scene was meshed."""
    none, every = symmetric.exact, symmetric.exact + difference.forces[0]
    effect = abs(float(np.log(np.abs(every.sum(axis=1) / none.sum(axis=1))) @ [1.0, -1.0]))
    size = f"changes the ratio by about {effect:.2g}"
    yield Decision("inclusions, groove and edges, in three dimensions", True, effect, accuracy, f"modelled: {size}")
    if symmetric.domain.shortened:
        left = EDGES * symmetric.edges * effect
        reason = f"left out but for its compliance: changes the ratio by at most about {left:.2g}, counted in error_estimate"
        yield Decision("far tissue's effect on what inclusions change", False, left, accuracy, reason)
    if symmetric.domain.half:
        yield Decision("the other half of a mirror-symmetric scene", False, 0.0, accuracy, "left out: exactly the same")
