"""First order by finite elements: exact derivatives of what is read by everything that may be off.

Gains g_i multiply what is read: with F_i the films' forces and A_i areas, built or drawn,

    ln ratio = ln(g_1 F_1 A_2 / (g_2 F_2 A_1)),   ln stiffness = ln(g_1 F_1 + g_2 F_2) - ln indentation.   (TO.3)

A scene has radii and the gap; a workshop makes three radii: the inner block's, the hole's and the outer one. With S = dy/dx of
the scene's numbers, derivatives by the inner block's radius r_2 while the hole's r_h stays, and by r_h while r_2 stays, are

    dy/dr_2 = S_radius - S_gap,   dy/dr_h = S_gap.   (TO.6)
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene
from probe_design.tolerances.variables import GAINS, GAP, RADIUS, Toleranced
from solver.axisymmetric.gradients import Gradients, gradients
from solver.axisymmetric.level import Axisymmetric
from solver.axisymmetric.sections import sections
from solver.equivalent_inclusion.gradients import first_order, tumour_gradients
from solver.equivalent_inclusion.level import EquivalentInclusion


def level_of(scene: Scene) -> str:
    """Return the level whose derivatives are taken.

    Raises:
        Refusal: neither ``axisymmetric`` nor ``equivalent-inclusion`` takes the scene.
    """
    if Axisymmetric().refusal(scene) is None:
        return "axisymmetric"
    EquivalentInclusion().check(scene)
    return "equivalent-inclusion"


def slopes(scene: Scene, variables: Sequence[Toleranced], accuracy: float) -> Floats:
    """Return dy / dx of ``sampled.OUTPUTS`` by variables, per SI unit, shape (4, v); of the inner radius and the gap by eq. TO.6.

    Beside the axis what surface and blocks send back of a tumour's field is left out: slopes of the log-sensitivity are then good
    to some tenth where the cover is half a diameter.

    Raises:
        Refusal: see ``level_of``; or a block's height cannot be moved alone, as an elastic base lies on both films.
    """
    names = tuple(dict.fromkeys([*(one.name for one in variables if one.kind != "gain"), GAP]))
    found = _gradients(scene, names, accuracy)
    inner = found.values["stress_inner"][0] * scene.probe.inner_area
    outer = found.values["stress_outer"][0] * scene.probe.outer_area
    shares = np.array([inner, outer]) / (inner + outer)
    columns = [_of_gain(one, shares) if one.kind == "gain" else _of_length(scene, one.name, found) for one in variables]
    return np.array(columns).T


def _of_length(scene: Scene, name: str, found: Gradients) -> Floats:
    """Derivatives of ``OUTPUTS`` by a number of the scene as a workshop makes it, SI: eq. TO.6."""
    own = _of_number(scene, name, found)
    return own - _of_number(scene, GAP, found) if name == RADIUS else own


def _gradients(scene: Scene, names: tuple[str, ...], accuracy: float) -> Gradients:
    with threadpool_limits(1, user_api="blas"):
        if level_of(scene) == "equivalent-inclusion":
            return tumour_gradients(scene, first_order(scene, sections(scene)), names)
        found = gradients(scene, Axisymmetric().converged(scene, accuracy).sample)
    missing = [name for name in names if name not in found.variables]
    if missing:
        raise Refusal(missing[0], "a tolerance of its own", "a rigid base, or one height for both blocks")
    return found


def _of_number(scene: Scene, name: str, found: Gradients) -> Floats:
    """Derivatives of ``OUTPUTS`` by a number of the scene, SI."""
    place = found.variables.index(name)
    by = {output: float(part[0, place]) for output, part in found.derivatives.items()}
    value = {output: float(part[0]) for output, part in found.values.items()}
    ratio = by["ratio"] / value["ratio"]
    return np.array(
        [ratio, ratio + _by_areas(scene, name), by["stiffness"] / value["stiffness"], by["log_sensitivity"]], dtype=float
    )


def _of_gain(one: Toleranced, shares: Floats) -> Floats:
    """The ratio is read as gain_inner / gain_outer times itself, the stiffness as the gains' mean by each film's share."""
    place = GAINS.index(one.name)
    return np.array([1.0 - 2 * place, 1.0 - 2 * place, shares[place], 0.0])


def _by_areas(scene: Scene, name: str) -> float:
    """Derivative of ln(A_inner / A_outer), which turns a ratio of stresses into one of forces over areas that stay as drawn."""
    probe = scene.probe
    ring = probe.outer_area / math.pi
    by_ring = {
        "probe.inner_radius": -2 * probe.hole_radius,
        "probe.gap": -2 * probe.hole_radius,
        "probe.outer_radius": 2 * probe.tube_radius,
    }
    return (2 / probe.inner_radius if name == "probe.inner_radius" else 0.0) - by_ring.get(name, 0.0) / ring
