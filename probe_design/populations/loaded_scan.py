"""Add to a population's linear signals what the load changes of them, by the contact evaluator.

At constant force the signals of eq. PO.1 are changes of logarithms, of which eq. CT.10 gives what the load adds. Derivatives by a
tumour's numbers are differences of it, with the same factor f. A signal does not change if all moduli and the force change by the
same factor; what the load adds, g, is proportional to the force to first order, so that with stiffer blocks

    dg/d ln E_host = -g - dg/d ln E_object                                                            (PO.15)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from solver.contact.pressed_tissue import Growths, PressedTissue, compute_linear_changes
from solver.contact.tumours_anywhere import prepare_tissue
from solver.equivalent_inclusion.readings import Readings
from solver.inclusions.tumours import Tumours

CONTACT_ACCURACY = 0.05  # of the ratio without tumours: a baseline reading cancels its error, what tumours change has its own
DIFFERENCE_STEP_RELATIVE = 0.1  # of the radius, for depth and place, and of the diameter: smaller ones would show the elements


@dataclass(frozen=True)
class LoadedChange:
    """What the load adds to the signals of u tumours, ratio and stiffness, at one force.

    Attributes
    ----------
    signal, error
        The change and the bound on its error, shape (u, 2).
    derivatives
        Of the change with respect to the logarithms of object, diameter and depth, and per m of the distance from the axis, "x";
        shape (u, 2) each.
    """

    signal: Floats
    error: Floats
    derivatives: dict[str, Floats]


def press_tissue(scene: Scene, force: float) -> PressedTissue:
    """Press a scene's probe on its tissue without tumours to a force, N.

    Raises
    ------
    Refusal
        The force is above what ``contact`` models.
    SolveError
        No step converges.
    """
    return prepare_tissue(scene.model_copy(update={"inclusion": ()}), CONTACT_ACCURACY).press(force)


@dataclass(frozen=True)
class PressedScan:
    """The tumours of a scan under a load, for any number of linear readings over them.

    Attributes
    ----------
    pressed
        The tissue.
    tumours
        The tumours at their distances from the probe, shape (u, 1).
    growths
        What the load adds to their first-order effects.
    derivatives
        Derivatives of what it adds to the outputs by the names of ``LoadedChange``, but for "object", shape (u, k + 1).
    """

    pressed: PressedTissue
    tumours: Tumours
    growths: Growths
    derivatives: dict[str, Floats]

    @classmethod
    def from_tumours(cls, pressed: PressedTissue, tumours: Tumours, names: tuple[str, ...] = ()) -> PressedScan:
        """Compute what the load adds over tumours, and its derivatives of these names; other names are left out."""
        tables = pressed.tabulate(tumours)
        step, derivatives = DIFFERENCE_STEP_RELATIVE * tumours.diameter / 2, {}
        distance = {"x"} if {"x", "y"} & set(names) else set()  # one derivative by it serves both
        for name in ({"diameter", "depth"} & set(names)) | distance:
            field_step = 2 * step if name == "diameter" else step
            values = getattr(tumours, name)
            moved = (replace(tumours, **{name: values + sign * field_step}) for sign in (1, -1))
            upper, lower = (tables.compute_growths(item).mean[0] for item in moved)
            derivatives[name] = (upper - lower) / (2 * (field_step if name == "x" else field_step / values))
        return cls(pressed, tumours, tables.compute_growths(tumours), derivatives)

    def compute_change(self, readings: Readings) -> LoadedChange:
        """Return what the load adds to the signals of the tumours, given their linear readings."""
        pressed = self.pressed
        linear = compute_linear_changes(pressed.base, readings)[:2]
        changes = pressed.compute_changes(readings, self.tumours, growths=self.growths)
        number = 1 if pressed.base.scene.observable == "charge" and changes.ratios.shape[-1] > 1 else 0

        def read(values: Floats) -> Floats:
            """Return the changes of ln ratio and ln stiffness from those of the outputs and the stiffness, (..., k + 1)."""
            ratio = values[..., 2 * number] - values[..., 2 * number + 1]
            return np.stack([ratio, values[..., -1]], axis=-1)

        signal, by_object = (read(values) for values in changes.changes - linear)
        error = np.stack([changes.ratio_errors[0, :, number], changes.errors[0, :, -1]], axis=-1)
        factor = self.growths.compute_factor(linear)[0]
        derivatives = {name: read(factor * values) for name, values in self.derivatives.items()}
        return LoadedChange(signal, error, {"object": by_object, **derivatives})
