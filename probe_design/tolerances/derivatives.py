"""Derivatives of the outputs with respect to all uncertain numbers, from the finite elements.

With F_i the force on film i (1 inner, 2 outer), g_i its gain and A_i its area, built or drawn,

    ln ratio = ln(g_1 F_1 A_2 / (g_2 F_2 A_1)),   ln stiffness = ln(g_1 F_1 + g_2 F_2) - ln indentation.   (TO.3)

A scene has radii and the gap; a workshop makes three radii: the inner block's r_2, the hole's r_h and the outer one. With y
an output and S_radius, S_gap its derivatives with respect to the scene's inner radius and gap, the derivatives with respect to
r_2 at fixed r_h, and with respect to r_h at fixed r_2, are

    dy/dr_2 = S_radius - S_gap,   dy/dr_h = S_gap.   (TO.6)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene
from probe_design.built_probe.block_predictions import differentiate_area_ratio
from probe_design.tolerances.uncertain_numbers import GAIN_NAMES, GAP_KEY, RADIUS_KEY, UncertainNumber
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import Gradients, compute_gradients
from solver.axisymmetric.sections import build_sections
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.gradients import compute_tumour_gradients, solve_first_order


def choose_evaluator(scene: Scene) -> str:
    """Return the name of the evaluator that computes the derivatives.

    Raises
    ------
    Refusal
        Neither ``axisymmetric`` nor ``equivalent-inclusion`` can evaluate the scene.
    """
    if Axisymmetric().refusal(scene) is None:
        return "axisymmetric"
    EquivalentInclusion().check(scene)
    return "equivalent-inclusion"


def compute_derivatives(scene: Scene, variables: Sequence[UncertainNumber], accuracy: float) -> Floats:
    """Return the derivatives of the four outputs with respect to v uncertain numbers, per SI unit, shape (4, v).

    Those of the inner radius and the gap follow eq. TO.6. Off the axis, reflections of a tumour's field at the surface and the
    blocks are neglected: the derivatives of the log-sensitivity then have errors of some 10 % where the overburden is half a
    diameter.

    Raises
    ------
    Refusal
        See ``choose_evaluator``; or a block's height has no derivative of its own, as an elastic base lies on both.
    """
    names = tuple(dict.fromkeys([*(variable.name for variable in variables if variable.kind != "gain"), GAP_KEY]))
    scene_gradients = _compute_gradients(scene, names, accuracy)
    inner = scene_gradients.values["stress_inner"][0] * scene.probe.inner_area
    outer = scene_gradients.values["stress_outer"][0] * scene.probe.outer_area
    shares = np.array([inner, outer]) / (inner + outer)
    columns = [
        _differentiate_gain(variable, shares)
        if variable.kind == "gain"
        else _differentiate_length(scene, variable.name, scene_gradients)
        for variable in variables
    ]
    return np.array(columns).T


def _differentiate_length(scene: Scene, name: str, scene_gradients: Gradients) -> Floats:
    """Return the derivatives of the outputs with respect to a length as the workshop makes it, SI: eq. TO.6."""
    derivative = _differentiate_number(scene, name, scene_gradients)
    return derivative - _differentiate_number(scene, GAP_KEY, scene_gradients) if name == RADIUS_KEY else derivative


def _compute_gradients(scene: Scene, names: tuple[str, ...], accuracy: float) -> Gradients:
    """Compute the evaluator's derivatives with respect to ``names``; refuse if one is missing."""
    with threadpool_limits(1, user_api="blas"):
        if choose_evaluator(scene) == "equivalent-inclusion":
            return compute_tumour_gradients(scene, solve_first_order(scene, build_sections(scene)), names)
        scene_gradients = compute_gradients(scene, Axisymmetric().compute_converged(scene, accuracy).sample)
    missing = [name for name in names if name not in scene_gradients.variables]
    if missing:
        raise Refusal(missing[0], "a tolerance of its own", "a rigid base, or one height for both blocks")
    return scene_gradients


def _differentiate_number(scene: Scene, name: str, scene_gradients: Gradients) -> Floats:
    """Return the derivatives of the outputs with respect to a number of the scene, SI."""
    index = scene_gradients.variables.index(name)
    derivatives = {output: float(part[0, index]) for output, part in scene_gradients.derivatives.items()}
    value = {output: float(part[0]) for output, part in scene_gradients.values.items()}
    ratio = derivatives["ratio"] / value["ratio"]
    return np.array(
        [
            ratio,
            ratio + differentiate_area_ratio(scene.probe, name),
            derivatives["stiffness"] / value["stiffness"],
            derivatives["log_sensitivity"],
        ],
        dtype=float,
    )


def _differentiate_gain(variable: UncertainNumber, shares: Floats) -> Floats:
    """Return the derivatives with respect to a gain, eq. TO.3; ``shares`` are the films' shares of the total force."""
    index = GAIN_NAMES.index(variable.name)
    return np.array([1.0 - 2 * index, 1.0 - 2 * index, shares[index], 0.0])
