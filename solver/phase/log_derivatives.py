"""Differentiate ln of the ratio that a scene reads, of charges or of stresses, on one mesh.

Derivatives are by the numbers of a scene, and along directions in the logarithms of all moduli.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.film_states import COMPLEX_STEP
from solver.axisymmetric.gradients import Gradients, compute_gradients
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import add_details, build_sections
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.gradients import FirstOrder, compute_tumour_gradients, solve_first_order
from solver.equivalent_inclusion.probe_on_tissue import FIELD_FINENESSES
from solver.phase.losses import ValueOfMaterial
from solver.results.film_charges import reads_film_states

COARSE_ACCURACY, MEDIUM_ACCURACY = 3e-3, 3e-4  # accuracies from which the mesh may be coarser
MODULUS_SUFFIX = ".youngs_modulus"


@dataclass(frozen=True)
class LogDerivatives:
    """The ratio and its derivatives on one mesh.

    Attributes
    ----------
    ratio
        On this mesh; to first order in the tumours where they are off the axis.
    derivatives
        d ln(ratio) by keys of ``geometry.scenes.variables.list_values``: by ln of moduli, else per SI unit.
    directional
        Derivative of ln(ratio) along each direction, shape (d,).
    """

    ratio: float
    derivatives: dict[str, float]
    directional: Floats


Differentiate = Callable[[Scene, Sequence[ValueOfMaterial]], LogDerivatives]


def choose_derivatives(scene: Scene, accuracy: float) -> tuple[str | None, Differentiate]:
    """Choose how a scene is differentiated, on a mesh that suits ``accuracy``.

    Returns the reason why this kind of scene has no derivatives, or None, and a function that returns the derivatives of a
    variant of the scene, by its numbers and along directions, on one mesh.
    """
    if Axisymmetric().refusal(scene) is None:
        fineness = MESH_LEVELS[3 if accuracy >= COARSE_ACCURACY else 4 if accuracy >= MEDIUM_ACCURACY else 5]
        return None, lambda variant, directions: differentiate_on_axis(variant, directions, fineness)
    refusal = EquivalentInclusion().refusal(scene)
    if refusal is None and any(body.diameter is None for body in scene.inclusion):
        refusal = "an ellipsoid"
    fineness = FIELD_FINENESSES[0 if accuracy >= COARSE_ACCURACY else 1]
    reason = None if refusal is None else f"derivatives are known of upright probes on spheres, each inside one layer ({refusal})"
    return reason, lambda variant, directions: differentiate_off_axis(variant, directions, fineness)


def differentiate_on_axis(scene: Scene, directions: Sequence[ValueOfMaterial], fineness: MeridianFineness) -> LogDerivatives:
    """Return the derivatives for a scene that ``axisymmetric`` takes, on one mesh.

    ``directions`` hold a change of ln E for each material: derivatives are also taken along each of them.

    Raises
    ------
    SolveError
        Its equations cannot be solved in double precision.
    """
    scene_sections = add_details(scene, build_sections(scene))
    solution = compute_gradients(scene, solve_on_mesh(scene_sections.section, scene_sections, scene, fineness))
    ratio, derivatives = _convert_to_logarithms(scene, solution)
    return LogDerivatives(
        ratio, derivatives, np.array([_differentiate_along(derivatives, direction) for direction in directions])
    )


def differentiate_off_axis(scene: Scene, directions: Sequence[ValueOfMaterial], fineness: MeridianFineness) -> LogDerivatives:
    """Return the derivatives to first order in spheres anywhere, without reflections between them.

    The error of this shows in the ratio: it differs from that of the scene's result. ``directions`` are as in
    ``differentiate_on_axis``.

    Raises
    ------
    SolveError
        See ``differentiate_on_axis``.
    """
    solution = solve_first_order(scene, add_details(scene, build_sections(scene)), fineness)
    ratio, derivatives = _convert_to_logarithms(scene, compute_tumour_gradients(scene, solution, tuple(list_values(scene))))
    body_derivatives = {name: derivative for name, derivative in derivatives.items() if not name.startswith("inclusion")}
    directional = [
        _differentiate_along(body_derivatives, direction) + _differentiate_by_tumours(scene, solution, direction)
        for direction in directions
    ]
    return LogDerivatives(ratio, derivatives, np.array(directional))


def _convert_to_logarithms(scene: Scene, solution: Gradients) -> tuple[float, dict[str, float]]:
    """Return the ratio and the derivatives of ln(ratio): by ln of moduli, by all other numbers themselves."""
    key, factor, film = "ratio", 1.0, scene.probe.film
    if scene.observable == "charge" and film is not None:
        if film.uses_psi:  # each charge is a multiple of the force
            inner, outer = film.by_block
            factor = inner.charge_per_force / outer.charge_per_force
        else:
            key = "charge_ratio"
    ratio, numbers = float(solution.values[key][0]), list_values(scene)
    derivatives = dict(zip(solution.variables, (solution.derivatives[key][0] / ratio).tolist(), strict=True))
    return factor * ratio, {
        name: derivative * (numbers[name] if name.endswith(MODULUS_SUFFIX) else 1.0) for name, derivative in derivatives.items()
    }


def _differentiate_along(derivatives: dict[str, float], direction: ValueOfMaterial) -> float:
    """Return the derivative of ln(ratio) along a direction, from its derivatives by ln of each modulus."""
    return sum(derivatives.get(f"{owner}{MODULUS_SUFFIX}", 0.0) * log_change for owner, log_change in direction.items())


def _differentiate_by_tumours(scene: Scene, solution: FirstOrder, direction: ValueOfMaterial) -> float:
    """Return the derivative of ln(ratio) as the logarithms of all tumours' moduli move along a direction, by a complex step."""
    # the components of the tumours, in their order
    log_change = np.array([component for owner, component in direction.items() if owner.startswith("inclusion")])
    moved = solution.compute_form(
        solution.compute_strengths(youngs_modulus=solution.tumours.youngs_modulus * (1 + 1j * COMPLEX_STEP * log_change))[0]
    )
    totals = (solution.states.products + moved.real).sum(axis=1)
    change = moved.imag.sum(axis=1) / COMPLEX_STEP / totals
    inner, outer = change[2:] if reads_film_states(scene) else change[:2]  # charges come after forces
    return float(inner - outer)
