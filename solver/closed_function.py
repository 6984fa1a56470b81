"""The closed form as a casadi function with exact derivatives: what the search gives to IPOPT."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi
import numpy as np

from geometry.grading import Floats
from solver.closed_form import Shape, gradients


class ClosedFormFunction(casadi.Callback):  # type: ignore[misc]
    """x -> (F_00, F_01, F_10, F_11 and their slopes), x some of the closed form's parameters, SI; the rest stay.

    The derivatives are those of the formula itself, by complex steps. Tell IPOPT ``hessian_approximation = "limited-memory"``;
    keep a reference as long as casadi uses it.

    Args:
        shape, values: of a scene, see ``closed_form.parameters``.
        which: indices of the parameters that x holds.
    """

    def __init__(self, shape: Shape, values: Floats, which: Sequence[int]) -> None:
        super().__init__()
        self.shape, self.values, self.which = shape, values, list(which)
        self.last: tuple[Floats, tuple[Floats, Floats]] | None = None
        self.jacobians: list[_Jacobian] = []
        self.construct("closed_form", {"enable_fd": False})

    def get_n_in(self) -> int:  # noqa: D102
        return 1

    def get_n_out(self) -> int:  # noqa: D102
        return 1

    def get_sparsity_in(self, i: int) -> Any:  # noqa: D102
        return casadi.Sparsity.dense(len(self.which), 1)

    def get_sparsity_out(self, i: int) -> Any:  # noqa: D102
        return casadi.Sparsity.dense(8, 1)

    def eval(self, arg: list[Any]) -> list[Any]:
        """Return forces and slopes at x."""
        return [casadi.DM(self.gradients(arg[0])[0].ravel())]

    def has_jacobian(self) -> bool:  # noqa: D102
        return True

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], opts: dict[str, Any]) -> Any:  # noqa: D102
        self.jacobians.append(_Jacobian(self, name, opts))
        return self.jacobians[-1]

    def gradients(self, argument: Any) -> tuple[Floats, Floats]:
        """Return ``closed_form.gradients`` at x, NaN where the formulas break down; the last x is remembered."""
        x = np.array(argument, dtype=float).ravel()
        if self.last is None or not np.array_equal(self.last[0], x):
            values = self.values.copy()
            values[self.which] = x
            with np.errstate(all="ignore"):  # IPOPT steps back from what is not finite
                self.last = x, gradients(self.shape, values, self.which)
        return self.last[1]


class _Jacobian(casadi.Callback):  # type: ignore[misc]
    """(x, outputs) -> the outputs' derivatives by x."""

    def __init__(self, formula: ClosedFormFunction, name: str, options: dict[str, Any]) -> None:
        super().__init__()
        self.formula = formula
        self.construct(name, options)

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        return casadi.Sparsity.dense(len(self.formula.which) if i == 0 else 8, 1)

    def get_sparsity_out(self, i: int) -> Any:
        return casadi.Sparsity.dense(8, len(self.formula.which))

    def eval(self, arg: list[Any]) -> list[Any]:
        found = self.formula.gradients(arg[0])[1]
        return [casadi.DM(found.reshape(len(found), -1).T)]
