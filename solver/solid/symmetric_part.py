"""Compute the rotationally symmetric part of film forces in the meridian plane, and choose what is meshed besides.

With A the exact forces of the reference (``domain.py``), D the difference on a mesh (``difference.py``) and
C the compliance by which the whole probe on the whole tissue, films, base and far tissue included, exceeds the reference,

    F = ((A + D)^-1 + C)^-1,    C = F_whole^-1 - A^-1                                              (SO.5)

with F_whole the film forces of the whole probe on the whole tissue; ``solver/axisymmetric/converged_forces.py`` computes both A
and F_whole. Where the tissue's edges are meshed, the reference is a narrow cylinder. The effect of tissue beyond it is as large
as A, and the mesh's error at the blocks' rims, which grows with the forces, does not cancel in D. For given forces the error is
the same in both, so that it cancels in a difference of compliances. With R the mesh's forces of the reference, and B those of the
same blocks on the whole tissue with its edges but without inclusions, A is replaced by

    (A^-1 + B^-1 - R^-1)^-1                                                                        (SO.10)

and D by the change of B by inclusions. A groove changes a rim and so the mesh's error there: then eq. SO.5 is used alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.common.limits import format_minimum_mm, is_at_least
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.tetra.layout import build_layout
from solver.axisymmetric.converged_forces import compute_converged_forces
from solver.linalg.workspace import keep_within_limits
from solver.results.film_forces import FilmForces
from solver.results.result import Decision
from solver.results.warnings import Note
from solver.solid.difference import SceneDifference
from solver.solid.domain import Domain, choose_domain, compute_free_radius, compute_reach, is_coaxial, remove_asymmetry

SYMMETRIC_ACCURACY_SHARE = 0.1  # of the accuracy, for the symmetric part
FAR_TISSUE_PRODUCT_SHARE = 0.3  # of the product of the changes by far tissue and by inclusions, groove and edges
MIN_SIDE_TISSUE_RADII = 0.11  # outer radii: minimum distance of the probe from the tissue's side
SPAN_GROWTH_FACTOR = 1.6  # factor by which the modelled tissue grows if its cut matters


@dataclass(frozen=True)
class Exact:
    """Film forces of a rotationally symmetric scene: ``Converged`` without its finite elements."""

    films: FilmForces
    plan: tuple[Decision, ...]
    notes: tuple[Note, ...]


@keep_within_limits
def _solve_exact(scene: Scene, accuracy: float) -> Exact:
    """Solve a rotationally symmetric scene in the meridian plane; results are cached."""
    converged = compute_converged_forces(scene, accuracy)
    return Exact(converged.films[0], converged.plan, converged.notes)


@dataclass(frozen=True)
class SymmetricPart:
    """The rotationally symmetric part of eq. SO.5.

    Attributes
    ----------
    domain
        The domain to mesh.
    exact
        A, N/m, shape (2, 2).
    compliance
        C, m/N, shape (2, 2).
    whole
        Film forces of the whole probe on the whole tissue, without inclusions and groove: F_whole.
    edges
        Relative change of the total forces by far tissue, the part of C that is not exact.
    """

    domain: Domain
    exact: Floats
    compliance: Floats
    whole: Exact
    edges: float

    def correct_forces(self, difference: SceneDifference) -> Floats:
        """Return the film forces by eq. SO.5, with eq. SO.10 if the mesh has edges, N/m, shape (k, 2, 2)."""
        return np.asarray(np.linalg.inv(np.linalg.inv(self._compute_bare_forces(difference)) + self.compliance))

    def propagate_change(self, difference: SceneDifference, small: Floats) -> Floats:
        """Return the change of F of eq. SO.5 for a small change of D, or of forces on the films.

        ``small`` holds changes of D, matrices of shape (k, 2, 2), or of the forces by a tilt, columns of shape (k, 2, 1).
        """
        # dF = F (A + D)^-1 dD (A + D)^-1 F, symmetric; columns, forces at a held base, take the left factor only
        left_factor = self.correct_forces(difference) @ np.linalg.inv(self._compute_bare_forces(difference))
        return np.asarray(left_factor @ small @ (left_factor.transpose(0, 2, 1) if small.shape[-1] == 2 else np.eye(1)))

    def _compute_bare_forces(self, difference: SceneDifference) -> Floats:
        """Return the film forces without the compliance C: A + D, or what eq. SO.10 puts in its place; shape (k, 2, 2)."""
        if difference.edges is None:
            return self.exact + difference.forces
        compliance_change = np.linalg.inv(difference.edges) - np.linalg.inv(difference.reference)
        return (
            np.linalg.inv(np.linalg.inv(self.exact) + compliance_change)
            + difference.forces
            - (difference.edges - difference.reference)
        )


def compute_symmetric_part(scene: Scene, accuracy: float) -> SymmetricPart:
    """Choose the domain to mesh and compute the symmetric part of its film forces.

    Far tissue is cut off as long as that changes the effect of inclusions by no more than the accuracy.
    """
    alone = remove_asymmetry(scene)
    whole = _solve_exact(alone, SYMMETRIC_ACCURACY_SHARE * accuracy)
    unsure = not is_coaxial(scene) and whole.films.compute_max_error(alone) > accuracy / 4
    span = np.inf if unsure else compute_reach(scene)  # the tissue's sides are known better where they are meshed
    while True:
        chosen = choose_domain(scene, span, find_reference_wall(scene))
        exact = _solve_exact(chosen.reference, SYMMETRIC_ACCURACY_SHARE * accuracy).films.forces
        symmetric = SymmetricPart(chosen, exact, *_compute_compliance(alone, chosen, exact, whole, accuracy))
        if not chosen.shortened or FAR_TISSUE_PRODUCT_SHARE * symmetric.edges <= accuracy:
            return symmetric
        span = SPAN_GROWTH_FACTOR * span if is_coaxial(scene) or span < compute_free_radius(scene) else np.inf


def find_reference_wall(scene: Scene) -> float | None:
    """Return the radius of the reference cylinder in tissue that is not coaxial with the probe, or None."""
    if is_coaxial(scene):
        return None
    tube = scene.probe.tube_radius
    if not is_at_least(compute_free_radius(scene) - tube, MIN_SIDE_TISSUE_RADII * tube):
        distance = Words(f"the probe {format_mm(compute_free_radius(scene) - tube)} from the tissue's edge")
        raise Refusal(
            "placement",
            distance,
            f"{format_minimum_mm(MIN_SIDE_TISSUE_RADII * tube)} or more for solid: the reference cylinder needs room",
        )
    return build_layout(scene, False, np.inf, None).wall


def _compute_compliance(
    alone: Scene, chosen: Domain, exact: Floats, whole: Exact, accuracy: float
) -> tuple[Floats, Exact, float]:
    """Return C of eq. SO.5, the converged film forces of the whole, and the relative effect of far tissue.

    Parameters
    ----------
    alone
        The scene without what is not rotationally symmetric.
    chosen
        The domain to mesh.
    exact
        A of eq. SO.5, N/m, shape (2, 2).
    whole
        Film forces of ``alone``.
    accuracy
        Relative accuracy.
    """
    if chosen.radius is not None:  # edges are meshed: only films and base are left for C
        probe = alone.probe
        whole = _solve_exact(chosen.reference.model_copy(update={"probe": probe}), SYMMETRIC_ACCURACY_SHARE * accuracy)
    forces = whole.films.forces
    compliance = np.linalg.inv(forces) - np.linalg.inv(exact)
    return compliance, whole, _compute_far_tissue_effect(alone, chosen, exact, accuracy) if chosen.shortened else 0.0


def _compute_far_tissue_effect(alone: Scene, chosen: Domain, exact: Floats, accuracy: float) -> float:
    """Return the relative change of the total forces by far tissue, for blocks on a rigid base; parameters as above."""
    bare = alone.model_copy(update={"probe": chosen.reference.probe})
    whole_totals = _solve_exact(bare, SYMMETRIC_ACCURACY_SHARE * accuracy).films.forces.sum(axis=1)
    return float(np.abs(whole_totals / exact.sum(axis=1) - 1).max())
