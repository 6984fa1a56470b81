"""Compute the largest force on a design beyond linear elasticity, by the limits of a design file and of the contact evaluator.

A search estimates them from the linear stiffness for many designs at once; ``loaded_pressing`` has those of one design.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from probe_design.populations.tables import DesignLimits
from solver.contact.evaluator import ContactEvaluator
from solver.contact.tumours_anywhere import SEARCHED_X
from solver.planning.strains import compute_tissue_strain

SEARCH_CLOSURE_SHARE = 0.25  # of the linear closure force: contact closes gaps at 0.16 to 0.7 of it on tissue up to nu = 0.45


@dataclass(frozen=True)
class PressedDesign:
    """The force on a design.

    Attributes
    ----------
    force
        Force, N.
    indentation
        Largest indentation over all tissues, m.
    tissue_strain
        Largest tissue strain over all tissues.
    charge
        Charges of the weaker and of the stronger channel, C.
    limited_by
        The limit of the force: scene, force, largest force (of the design file's variable), indentation, tissue_strain,
        pressure, gap_closure, charge, linearity; beyond linear elasticity also indentation_per_depth, contact (the deepest
        indentation that it models off the axis) or last_converged.
    allowed
        The force that each of these allows, N.
    loaded
        Whether the force is beyond linear elasticity, so that ``contact`` verifies.
    """

    force: float
    indentation: float
    tissue_strain: float
    charge: tuple[float, float]
    limited_by: str
    allowed: dict[str, float]
    loaded: bool = False


def supports_loads(scene: Scene) -> bool:
    """Return whether ``contact`` models tumours anywhere under the loads of a scene's probe."""
    return not scene.load.preload and scene.contact.interface == "bonded" and ContactEvaluator().refusal(scene) is None


def compute_search_limits(limits: DesignLimits, tissue: Scene, radius: Any, stiffness: Any, closure: Any) -> JsonObject:
    """Return the forces that the limits beyond linear elasticity allow, N, by name; estimates from the linear stiffness.

    Parameters
    ----------
    limits
        Limits of the design file.
    tissue
        Scene with the tissue.
    radius, stiffness, closure
        Outer radius, m, force per indentation, N/m, and linear force that closes the gap, N; floats or arrays.
    """
    allowed = {"contact": SEARCHED_X * radius * stiffness, "gap_closure": SEARCH_CLOSURE_SHARE * closure}
    if tissue.tissue.shape != "half-space":
        allowed["indentation_per_depth"] = limits.indentation_per_depth * tissue.tissue.depth * stiffness
    return allowed


def list_indentation_limits(limits: DesignLimits, scene: Scene) -> dict[str, float]:
    """Return the indentations that a design file's limits allow on a scene's tissue, m, by name."""
    allowed = {}
    if scene.tissue.shape != "half-space":
        allowed["indentation_per_depth"] = limits.indentation_per_depth * scene.tissue.depth
    if limits.indentation is not None:
        allowed["indentation"] = limits.indentation
    if limits.tissue_strain is not None:
        allowed["tissue_strain"] = limits.tissue_strain / float(compute_tissue_strain(scene.probe.tube_radius, scene.tissue))
    return allowed
