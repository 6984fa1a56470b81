"""Compute the tangent response over tumours anywhere: what films answer to a small change of the force about a preload.

With f_j(F) the output j without tumours at the force F and a_j(F) what tumours change of its logarithm, eq. CT.10, the tangent
response of output j over the tumours is

    d(f_j e^a_j) / dF = e^a_j (df_j/dF + f_j / F  da_j/d ln F)                                      (CT.11)

and that of the indentation, F over the secant stiffness, likewise. The faces are bonded and the materials elastic: the response
to a small change of the force is the derivative along the load path. df_j/dF is exact, see ``tangent_outputs.py``; da_j/d ln F
follows from two forces to either side, wide enough that points of a mesh that meet a wall between them do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np

from geometry.common.arrays import Floats
from solver.contact.loaded_scene import LoadedForces
from solver.contact.pressed_tissue import (
    LoadedChanges,
    PressedTissue,
    bound_effects,
    list_films,
    replace_derivatives,
    replace_totals,
)
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.readings import Readings
from solver.inclusions.tumours import Tumours

STEP_RELATIVE = 0.2  # of the preload: the two forces' distances
MODEL_ERROR_FACTOR = 2.0  # of errors of a: they grow with the load, and so does their derivative by ln F


@dataclass(frozen=True)
class PreloadedTissue:
    """A probe on tissue without tumours about a preload, with what tumours anywhere change there.

    Attributes
    ----------
    pressed
        Pressed by the preload.
    sides
        Pressed by less and by more than the preload.
    bare
        The tangent response without tumours, per indentation.
    """

    pressed: PressedTissue
    sides: tuple[PressedTissue, PressedTissue]
    bare: LoadedForces

    @classmethod
    def from_pressed(cls, pressed: PressedTissue, preload: float) -> PreloadedTissue:
        """Press beside a preload, N, at which tissue is ``pressed``; for errors see ``LoadedScene.press_to_force``."""
        low, high = (
            PressedTissue.from_loaded(pressed.base, pressed.loaded, preload * (1 + step * STEP_RELATIVE)) for step in (-1, 1)
        )
        return cls(pressed, (low, high), pressed.loaded.press_to_preload(preload))

    @property
    def base(self) -> Undisturbed:
        """The linear solution."""
        return self.pressed.base

    def tabulate(self, tumours: Tumours) -> PreloadedTissue:
        """Return the same with tabulated responses, see ``PressedTissue.tabulate``."""
        low, high = (pressed.tabulate(tumours) for pressed in self.sides)
        return replace(self, pressed=self.pressed.tabulate(tumours), sides=(low, high))

    def compute_readings(self, linear: Readings, tumours: Tumours, target: int = 0, *, shape_error: float = 0.0) -> Readings:
        """Return the tangent response, per indentation, from ``linear`` readings; see ``PressedTissue.compute_readings``."""
        low, middle, high = (
            pressed.compute_changes(linear, tumours, target, shape_error=shape_error)
            for pressed in (self.sides[0], self.pressed, self.sides[1])
        )
        slopes, slope_errors, ratio_slope_errors = _differentiate(low, middle, high)
        secant, tangent = self.pressed.bare.films.totals.sum(), self.bare.films.totals.sum()
        rise, rise_slope = middle.changes[0, :, -1:], slopes[0, :, -1:]
        yielding = 1 / tangent - rise_slope / secant  # indentation per force, times e^rise
        stiffness, weight = np.exp(rise) / yielding, 1 / (secant * yielding)
        stiffness_errors = middle.errors[0, :, -1:] + weight * slope_errors[0, :, -1:]
        parts = []
        films = list_films(self.base.films), list_films(self.pressed.bare.films), list_films(self.bare.films)
        for number, (at_rest, pressed, about, part) in enumerate(zip(*films, linear.parts, strict=True)):
            columns = slice(2 * number, 2 * number + 2)
            values, by_load = middle.changes[0, :, columns], slopes[0, :, columns]
            share = pressed.totals / secant
            sums = about.totals / tangent + share * by_load
            weights = np.abs(share / sums)
            responses = np.exp(values) * sums
            if number == 0:  # they add up to the change of the force, not only to first order
                responses /= responses.sum(axis=1, keepdims=True)
            totals = responses * stiffness
            errors = about.relative_errors + bound_effects(part, at_rest) / np.abs(part.totals) + stiffness_errors
            errors = errors + middle.errors[0, :, columns] + weights * slope_errors[0, :, columns]
            largest = weights.max(axis=1)
            log_ratio = about.bound.log_ratio + part.log_ratio_bound - at_rest.bound.log_ratio
            log_ratio = log_ratio + middle.ratio_errors[0, :, number] + largest * ratio_slope_errors[0, :, number]
            loaded = replace_totals(part, totals, errors, log_ratio)
            if linear.derivatives:
                by_log = middle.changes[1:, :, columns] + share / sums * slopes[1:, :, columns]
                by_log = by_log + middle.changes[1:, :, -1:] + weight * slopes[1:, :, -1:]
                added = middle.ratio_errors[1, :, number] + largest * ratio_slope_errors[1, :, number]
                loaded = replace_derivatives(loaded, part, by_log, part.sensitivity_error + added)
            parts.append(loaded)
        return replace(parts[0], charges=parts[1]) if len(parts) > 1 else parts[0]


def _differentiate(low: LoadedChanges, middle: LoadedChanges, high: LoadedChanges) -> tuple[Floats, Floats, Floats]:
    """Return derivatives by ln F of changes, as in ``LoadedChanges``, and bounds on their errors and on those of ratios'."""
    below, above = -log(1 - STEP_RELATIVE), log(1 + STEP_RELATIVE)

    def bound(values: list[Floats], spreads: list[Floats], errors: Floats) -> Floats:
        """Bound errors of derivatives: of the model, by the two meshes' difference, by both sides' difference."""
        sides = (values[2] - values[1]) / above - (values[1] - values[0]) / below
        return MODEL_ERROR_FACTOR * errors + np.abs(spreads[2] - spreads[0]) / (below + above) + np.abs(sides) / 2

    three = (low, middle, high)
    return (
        (high.changes - low.changes) / (below + above),
        bound([x.changes for x in three], [x.spreads for x in three], middle.errors),
        bound([x.ratios for x in three], [x.ratio_spreads for x in three], middle.ratio_errors),
    )
