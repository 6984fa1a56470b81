"""Compute the change of the film forces by inclusions, groove and edges: scene minus symmetric reference, on one mesh.

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
from geometry.tetra.mesh_check import find_max_file_error
from geometry.tetra.tet_mesh import MeshBody, TetMesh
from solver.axisymmetric.film_states import CHARGE_UNIT
from solver.linalg.conjugate_gradients import TARGET_RESIDUAL
from solver.materials.linear import Elastic, Isotropic
from solver.solid.base_states import FactorisedStates, SolidStates, compute_solid_response
from solver.solid.cached_mesh import find_cached_mesh
from solver.solid.domain import Domain
from solver.solid.domain_mesh import build_domain_layout
from solver.solid.end_motion import build_end_motion
from solver.solid.problem import Solid
from solver.solid.regions import Region, find_base_material, find_material_at_depth, find_reference_material, find_scene_material

MAX_RESIDUAL = 1e-6  # relative residual: errors are about its square in forces, its size in their derivatives
INCOMPRESSIBLE_SHEAR_RATIO = (
    0.04  # shear over bulk modulus (nu = 0.48) below which the residual is smaller: loads grow with the bulk modulus
)
MAX_TARGET_RATIO = 30.0  # maximum ratio of moduli of target and tissue at which curves start


@dataclass(frozen=True)
class MeshCharges:
    """Charges of films on blocks that end on a rigid face (``film_charges.py``), for k moduli of the target.

    Attributes
    ----------
    scene
        Charges of both films in the three base states, C/m and C/rad, shape (k, 2, 3).
    derivative
        Their derivative with respect to ln E of the target, zeros without one.
    reference
        Those of the reference on the same mesh, shape (2, 3).
    """

    scene: Floats
    derivative: Floats
    reference: Floats


@dataclass(frozen=True)
class SceneDifference:
    """A scene minus its reference on one mesh, for k moduli of the target.

    Attributes
    ----------
    forces
        Film forces, N/m, shape (k, 2, 2).
    modulus_derivative
        Their derivative with respect to ln E of the target, zeros without one, shape (k, 2, 2).
    tilt
        Film forces per unit rotation about y, N/rad, shape (k, 2).
    tilt_derivative
        Their derivative with respect to ln E of the target, shape (k, 2).
    reference
        The reference's film forces on this mesh, shape (2, 2).
    edges
        Film forces of the reference's blocks on the whole tissue, without inclusions, (2, 2), if eq. SO.10 holds; or None.
    unknowns
        Number of unknowns of the scene.
    residual
        The larger relative residual of both solutions.
    volume_error
        Relative error of the volume of a body from a file on this mesh.
    charges
        Of films that have charges of their own; None without.
    """

    forces: Floats
    modulus_derivative: Floats
    tilt: Floats
    tilt_derivative: Floats
    reference: Floats
    edges: Floats | None
    unknowns: int
    residual: float
    volume_error: float
    charges: MeshCharges | None = None


def solve_difference(domain: Domain, mesh: TetMesh, moduli: Floats | None = None) -> tuple[SceneDifference, SolidStates]:
    """Solve reference and scene on one mesh; return their difference and the states of the scene.

    ``moduli`` are Young's moduli of the target, Pa, shape (k,); None for the scene's own. For several moduli the states are those
    at the geometric mean of their range (within limits), from which the curve starts. The factor takes most of the memory:
    reference and scene share one, which the workspace caches with the states for other materials.

    Raises
    ------
    SolveError
        The equations could not be solved.
    """
    scene, target = domain.scene, domain.scene.target
    if moduli is not None and target is not None:
        scene = _replace_modulus(scene, target, float(np.sqrt(moduli.min() * moduli.max())))
    cached_mesh = find_cached_mesh(mesh, scene.contact.interface == "frictionless")
    reference_laws, scene_laws = (
        _find_laws(scene, cached_mesh.solid, find_material) for find_material in (find_reference_material, find_scene_material)
    )
    base = _find_laws(scene, cached_mesh.solid, find_base_material)
    max_residual = _choose_residual(scene_laws) if moduli is None else TARGET_RESIDUAL
    reference = cached_mesh.find_states("reference", reference_laws, base, max_residual)
    reference_reactions, residual = reference.reactions, reference.residual
    edges = cached_mesh.find_states("edges", base, base, max_residual).forces if _has_edges(domain) else None
    film_lift = build_end_motion(domain, cached_mesh.solid) if scene.models_charges else None
    states = cached_mesh.find_states("scene", scene_laws, base, max_residual, film_lift)
    products, modulus_derivative = _compute_products(states, scene, target, moduli)
    reactions = products[:, :3]
    charges = (
        None
        if film_lift is None
        else MeshCharges(
            CHARGE_UNIT * products[:, 3:],
            CHARGE_UNIT * modulus_derivative[:, 3:],
            CHARGE_UNIT * reference.compute_charges(film_lift),
        )
    )
    result = SceneDifference(
        reactions[:, :2, :2] - reference_reactions[:2, :2],
        modulus_derivative[:, :2, :2],
        tilt=reactions[:, :2, 2] - reference_reactions[:2, 2],
        tilt_derivative=modulus_derivative[:, :2, 2],
        reference=reference_reactions[:2, :2],
        edges=edges,
        unknowns=states.problem.supports.unknowns,
        residual=max(residual, states.residual),
        volume_error=_compute_volume_error(domain, mesh),
        charges=charges,
    )
    return result, states.bare_states


def _has_edges(domain: Domain) -> bool:
    """Return whether eq. SO.10 holds: the tissue's edges are meshed, and the blocks' rims are those of the reference."""
    return domain.radius is not None and domain.scene.probe.groove is None


def _choose_residual(laws: Mapping[int, Isotropic]) -> float:
    """Choose the residual at which the iteration ends, smaller in nearly incompressible tissue.

    There, a relative residual of 1e-6 left an error of 18 % in a soft tumour's ratio.
    """
    poisson = max(law.poisson_ratio for body, law in laws.items() if Region.from_number(body).body >= MeshBody.TISSUE)
    return float(
        np.clip(
            MAX_RESIDUAL / INCOMPRESSIBLE_SHEAR_RATIO * 1.5 * (1 - 2 * poisson) / (1 + poisson), TARGET_RESIDUAL, MAX_RESIDUAL
        )
    )


def _compute_volume_error(domain: Domain, mesh: TetMesh) -> float:
    """Return the relative volume error of inclusions from surface files on this mesh; 0 without any.

    Other bodies do not count: nodes lie exactly on blocks and ellipsoids, whose volumes the mesher checks more strictly.
    """
    if all(body.surface is None for body in domain.scene.inclusion):
        return 0.0
    return find_max_file_error(mesh, build_domain_layout(domain))


def _replace_modulus(scene: Scene, target: int, modulus: float) -> Scene:
    """Return the scene with another Young's modulus of inclusion number ``target``, Pa, limited to a range about the tissue's."""
    tissue = find_material_at_depth(scene, scene.inclusion[target].depth).youngs_modulus
    limited_modulus = float(np.clip(modulus, tissue / MAX_TARGET_RATIO, tissue * MAX_TARGET_RATIO))
    return scene.with_modulus(target, limited_modulus)


def _compute_products(states: FactorisedStates, scene: Scene, target: int | None, moduli: Floats | None) -> tuple[Floats, Floats]:
    """Return products of s states and their derivatives with respect to ln E of the target, for k moduli; shape (k, s, 3) each.

    ``states`` are those of ``scene``, ``target`` is the number of its target inclusion or None, and ``moduli`` are as in
    ``solve_difference``. Products are those of ``SolidStates``: forces on both films, the moment and, with films, charges.
    """
    if target is None:
        return states.products[None], np.zeros((1, *states.products.shape))
    bodies = tuple(b for b in states.energies if Region.from_number(b).body == MeshBody.FIRST_INCLUSION + target)
    if moduli is None:
        return states.products[None], states.compute_modulus_derivative(bodies)[None]
    multiples = moduli / scene.inclusion[target].youngs_modulus
    return compute_solid_response(states, bodies, float(multiples.min()), float(multiples.max())).evaluate(multiples)


def _find_laws(scene: Scene, solid: Solid, find_material: Callable[[Scene, int], Elastic | None]) -> Mapping[int, Isotropic]:
    """Return the laws of the regions that are present: those for which ``find_material`` gives a material."""
    materials = {number: find_material(scene, number) for number in solid.parts}
    return {number: Isotropic.from_material(material) for number, material in materials.items() if material is not None}
