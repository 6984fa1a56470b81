"""Derivatives of ln(ratio) on one mesh: by the numbers of a scene, and along directions in the logarithms of all moduli."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.frame import MeridianFineness
from geometry.scenes.scene import Scene
from geometry.scenes.variables import values
from solver.axisymmetric.energy_derivatives import STEP
from solver.axisymmetric.gradients import Gradients, gradients
from solver.axisymmetric.level import Axisymmetric
from solver.axisymmetric.refinement import LEVELS
from solver.axisymmetric.sample import sample
from solver.axisymmetric.sections import sections, with_details
from solver.equivalent_inclusion.gradients import FirstOrder, first_order, tumour_gradients
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import FIELDS
from solver.phase.losses import Turns

COARSE, MEDIUM = 3e-3, 3e-4  # accuracies from which the mesh may be coarser
MODULUS = ".youngs_modulus"


@dataclass(frozen=True)
class Slopes:
    """The ratio and its derivatives on one mesh.

    Attributes:
        ratio: on this mesh; to first order in the tumours where they are off the axis.
        derivatives: d ln(ratio) by keys of ``geometry.scenes.variables.values``: by ln of moduli, else per SI unit.
        directional: derivative of ln(ratio) along each direction, shape (d,).
    """

    ratio: float
    by: dict[str, float]
    along: Floats


Sloped = Callable[[Scene, Sequence[Turns]], Slopes]


def sloped(scene: Scene, accuracy: float) -> tuple[str | None, Sloped]:
    """Return why this kind of scene has no derivatives, or None, and a function that differentiates such scenes on one mesh."""
    if Axisymmetric().refusal(scene) is None:
        fineness = LEVELS[3 if accuracy >= COARSE else 4 if accuracy >= MEDIUM else 5]
        return None, lambda one, directions: on_axis(one, directions, fineness)
    why = EquivalentInclusion().refusal(scene)
    if why is None and any(body.diameter is None for body in scene.inclusion):
        why = "an ellipsoid"
    fineness = FIELDS[0 if accuracy >= COARSE else 1]
    reason = None if why is None else f"derivatives are known of upright probes on spheres, each inside one layer ({why})"
    return reason, lambda one, directions: off_axis(one, directions, fineness)


def on_axis(scene: Scene, directions: Sequence[Turns], fineness: MeridianFineness) -> Slopes:
    """Return the derivatives for a scene that ``axisymmetric`` takes, on one mesh.

    Raises:
        SolveError: its equations cannot be solved in double precision.
    """
    of = with_details(scene, sections(scene))
    found = gradients(scene, sample(of.section, of, scene, fineness))
    ratio, by = _logarithmic(scene, found)
    return Slopes(ratio, by, np.array([_along(by, turns) for turns in directions]))


def off_axis(scene: Scene, directions: Sequence[Turns], fineness: MeridianFineness) -> Slopes:
    """Return the derivatives to first order in spheres anywhere, without reflections; the error of that shows in the ratio.

    Raises:
        SolveError: see ``differentiate_on_axis``.
    """
    solution = first_order(scene, with_details(scene, sections(scene)), fineness)
    ratio, by = _logarithmic(scene, tumour_gradients(scene, solution, tuple(values(scene))))
    rest = {name: slope for name, slope in by.items() if not name.startswith("inclusion")}
    along = [_along(rest, turns) + _by_tumours(solution, turns) for turns in directions]
    return Slopes(ratio, by, np.array(along))


def _logarithmic(scene: Scene, found: Gradients) -> tuple[float, dict[str, float]]:
    ratio, numbers = float(found.values["ratio"][0]), values(scene)
    slopes = dict(zip(found.variables, (found.derivatives["ratio"][0] / ratio).tolist(), strict=True))
    return ratio, {name: slope * (numbers[name] if name.endswith(MODULUS) else 1.0) for name, slope in slopes.items()}


def _along(by: dict[str, float], turns: Turns) -> float:
    return sum(by.get(f"{owner}{MODULUS}", 0.0) * turn for owner, turn in turns.items())


def _by_tumours(solution: FirstOrder, turns: Turns) -> float:
    """Return the derivative of ln(ratio) as the logarithms of all tumours' moduli move together, by a complex step."""
    turn = np.array([one for owner, one in turns.items() if owner.startswith("inclusion")])
    moved = solution.form(solution.strengths(youngs_modulus=solution.tumours.youngs_modulus * (1 + 1j * STEP * turn))[0])
    totals = (solution.states.forces + moved.real).sum(axis=1)
    change = moved.imag.sum(axis=1) / STEP / totals
    return float(change[0] - change[1])
