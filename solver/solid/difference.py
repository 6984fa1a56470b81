"""Compute by how much inclusions, groove and edges change the film forces: scene minus symmetric reference, on one mesh.

Both are solved on the same mesh, so that most of the discretisation error (rims, gap) cancels in the difference. With
film forces F,

    F = F_reference, exact + (F_scene - F_reference) on the mesh                                  (SO.4)

"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.tetra.check import files_error
from geometry.tetra.layout import body_layout, extent
from geometry.tetra.tet_mesh import INCLUSION, TISSUE, TetMesh
from solver.linalg.conjugate_gradients import TARGET_RESIDUAL
from solver.solid.base_states import FactorisedStates, SolidStates
from solver.solid.body_stiffness import Elastic
from solver.solid.domain import Domain
from solver.solid.kept_mesh import kept_mesh
from solver.solid.modulus_response import solid_response
from solver.solid.problem import Solid
from solver.solid.regions import Region, own_material, reference_material, tissue_about, without_inclusions

ENOUGH = 1e-6  # relative residual: errors are about its square in forces, its size in their derivatives
NEARLY = 0.04  # shear over bulk modulus (nu = 0.48) below which the residual is smaller: loads grow with the bulk modulus
TAMED = 30.0  # maximum ratio of moduli of target and tissue at which curves start


@dataclass(frozen=True)
class SceneDifference:
    """A scene minus its reference on one mesh, for k moduli of the target.

    Attributes:
        forces: film forces, N/m, shape (k, 2, 2).
        slope: their derivative with respect to ln E of the target, zeros without one, shape (k, 2, 2).
        tilt: film forces per unit rotation about y, N/rad, shape (k, 2).
        tilt_slope: their derivative with respect to ln E of the target, shape (k, 2).
        reference: the reference's film forces on this mesh, shape (2, 2).
        edges: film forces of the reference's blocks on the whole tissue, without inclusions, (2, 2), if eq. SO.10 holds; or None.
        unknowns: number of unknowns of the scene.
        residual: the larger relative residual of both solutions.
        lost: relative error of the volume of a body from a file on this mesh.
    """

    forces: Floats
    slope: Floats
    tilt: Floats
    tilt_slope: Floats
    reference: Floats
    edges: Floats | None
    unknowns: int
    residual: float
    lost: float


def difference(domain: Domain, mesh: TetMesh, moduli: Floats | None = None) -> tuple[SceneDifference, SolidStates]:
    """Solve reference and scene, at the scene's modulus of the target or at all ``moduli``; return also the scene's states.

    The factor takes most of the memory. Both share one, which the workspace caches with the states for other materials.

    Raises:
        SolveError: the equations could not be solved.
    """
    scene, target = domain.scene, domain.scene.target
    if moduli is not None and target is not None:
        scene = _with_modulus(scene, target, float(np.sqrt(moduli.min() * moduli.max())))
    kept = kept_mesh(mesh, scene.contact.interface == "frictionless")
    plain, own = (_materials(scene, kept.solid, of) for of in (reference_material, own_material))
    base = _materials(scene, kept.solid, without_inclusions)
    enough = _enough(own) if moduli is None else TARGET_RESIDUAL
    reference = kept.states("reference", plain, base, enough)
    less, residual = reference.reactions, reference.residual
    edges = kept.states("edges", base, base, enough).forces if _has_edges(domain) else None
    states = kept.states("scene", own, base, enough)
    reactions, slope = _reactions(states, scene, target, moduli)
    found = SceneDifference(
        reactions[:, :2, :2] - less[:2, :2],
        slope[:, :2, :2],
        tilt=reactions[:, :2, 2] - less[:2, 2],
        tilt_slope=slope[:, :2, 2],
        reference=less[:2, :2],
        edges=edges,
        unknowns=states.problem.supports.unknowns,
        residual=max(residual, states.residual),
        lost=_lost(domain, mesh),
    )
    return found, states.bare


def _has_edges(domain: Domain) -> bool:
    """Return whether eq. SO.10 holds: the tissue's edges are meshed, and the blocks' rims are those of the reference."""
    return domain.radius is not None and domain.scene.probe.groove is None


def _enough(materials: Mapping[int, Elastic]) -> float:
    """Choose the residual at which the iteration ends, smaller in nearly incompressible tissue.

    There, a relative residual of 1e-6 left an error of 18 % in a soft tumour's ratio.
    """
    poisson = max(stuff.poisson_ratio for body, stuff in materials.items() if Region.of(body).body >= TISSUE)
    return float(np.clip(ENOUGH / NEARLY * 1.5 * (1 - 2 * poisson) / (1 + poisson), TARGET_RESIDUAL, ENOUGH))


def _lost(domain: Domain, mesh: TetMesh) -> float:
    """Return the relative volume error of bodies from files; see ``SceneDifference``.

    Nodes lie on blocks and ellipsoids, whose volumes the mesher checks more strictly.
    """
    if all(body.surface is None for body in domain.scene.inclusion):
        return 0.0
    return files_error(mesh, body_layout(domain.scene, domain.half, extent(domain.scene, None), domain.radius))


def _with_modulus(scene: Scene, target: int, modulus: float) -> Scene:
    """Return the scene with another modulus of its target, limited to a range about the tissue's."""
    tissue = tissue_about(scene, scene.inclusion[target].depth).youngs_modulus
    begin = float(np.clip(modulus, tissue / TAMED, tissue * TAMED))
    bodies = list(scene.inclusion)
    bodies[target] = bodies[target].model_copy(update={"youngs_modulus": begin})
    return scene.model_copy(update={"inclusion": tuple(bodies)})


def _reactions(states: FactorisedStates, scene: Scene, target: int | None, moduli: Floats | None) -> tuple[Floats, Floats]:
    """Return reactions and their derivatives with respect to ln E of the target, for k moduli; shape (k, 3, 3) each."""
    if target is None:
        return states.reactions[None], np.zeros((1, 3, 3))
    bodies = tuple(b for b in states.energies if Region.of(b).body == INCLUSION + target)
    if moduli is None:
        return states.reactions[None], states.slope(bodies)[None]
    times = moduli / scene.inclusion[target].youngs_modulus
    return solid_response(states, bodies, float(times.min()), float(times.max())).reactions(times)


def _materials(scene: Scene, solid: Solid, of: Callable[[Scene, int], Elastic | None]) -> Mapping[int, Elastic]:
    """Return the materials of the regions that are present."""
    found = {number: of(scene, number) for number in solid.parts}
    return {number: material for number, material in found.items() if material is not None}
