"""The closed form as a casadi function with exact derivatives, for design searches by IPOPT."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from solver.casadi_functions.base import DifferentiableFunction
from solver.closed_form.designs import Shape, compute_gradients


class ClosedFormFunction(DifferentiableFunction):
    """Film forces F_00, F_01, F_10, F_11 and their derivatives by ln E_object, as a function of some parameters x in SI units.

    The derivatives are those of the formula itself, by complex steps.

    Args:
        shape, start: of a scene, see ``solver.closed_form.designs.build_parameters``.
        indices: indices of the parameters that x holds; the others stay constant.
    """

    def __init__(self, shape: Shape, start: Floats, indices: Sequence[int]) -> None:
        super().__init__()
        self.shape, self.start, self.indices = shape, start, list(indices)
        self.begin("closed_form", len(self.indices), 8)

    def compute(self, x: Floats) -> tuple[Floats, Floats]:
        """Return forces and their derivatives by ln E_object, shape (8,), and the Jacobian, shape (8, x); NaN where undefined."""
        values = self.start.copy()
        values[self.indices] = x
        with np.errstate(all="ignore"):  # IPOPT steps back from what is not finite
            outputs, derivatives = compute_gradients(self.shape, values, self.indices)
        return outputs.ravel(), derivatives.reshape(len(x), -1).T
