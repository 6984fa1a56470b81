"""Wrap functions with exact Jacobians as casadi functions for IPOPT."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import casadi
import numpy as np

from geometry.common.arrays import Floats

Option: TypeAlias = bool | int | float | str | casadi.Function | Sequence["Option"] | Mapping[str, "Option"] | None
"""Value of an option of casadi."""


class DifferentiableFunction(casadi.Callback):
    """A casadi function from a vector x to a vector y with dy/dx; subclasses define ``compute`` and then call ``begin``.

    Values at the last x are cached. Set IPOPT's option ``hessian_approximation = "limited-memory"``; keep a reference as long as
    casadi uses it.
    """

    def begin(self, name: str, inputs: int, outputs: int) -> None:
        """Construct the casadi function with the given numbers of inputs and outputs."""
        self.inputs, self.outputs = inputs, outputs
        self.last: tuple[Floats, tuple[Floats, Floats]] | None = None
        self.jacobians: list[_Jacobian] = []
        self.construct(name, {"enable_fd": False})

    def compute(self, x: Floats) -> tuple[Floats, Floats]:
        """Return y and dy/dx, shapes (outputs,) and (outputs, inputs); NaN where undefined, so that IPOPT steps back."""
        raise NotImplementedError

    def compute_cached(self, argument: casadi.DM) -> tuple[Floats, Floats]:
        """Return ``compute`` at x; the result at the last x is cached, as casadi asks for y and dy/dx separately."""
        x = np.array(argument, dtype=float).ravel()
        if self.last is None or not np.array_equal(self.last[0], x):
            self.last = x, self.compute(x)
        return self.last[1]

    def get_sparsity_in(self, i: int) -> casadi.Sparsity:
        """Return the shape of x."""
        return casadi.Sparsity.dense(self.inputs, 1)

    def get_sparsity_out(self, i: int) -> casadi.Sparsity:
        """Return the shape of y."""
        return casadi.Sparsity.dense(self.outputs, 1)

    def eval(self, arg: Sequence[casadi.DM]) -> list[casadi.DM]:
        """Return y at x."""
        return [casadi.DM(self.compute_cached(arg[0])[0])]

    def has_jacobian(self) -> bool:
        """Return True: the Jacobian is computed exactly, so that casadi takes no finite differences."""
        return True

    def get_jacobian(
        self, name: str, inames: Sequence[str], onames: Sequence[str], opts: Mapping[str, Option]
    ) -> casadi.Function:
        """Return the Jacobian as a casadi function; a reference to it is kept as long as this function exists."""
        self.jacobians.append(_Jacobian(self, name, opts))
        return self.jacobians[-1]


class _Jacobian(casadi.Callback):
    """The Jacobian dy/dx as a casadi function of x and y."""

    def __init__(self, function: DifferentiableFunction, name: str, options: Mapping[str, Option]) -> None:
        super().__init__()
        self.function = function
        self.construct(name, options)

    def get_n_in(self) -> int:
        """Return the number of arguments: x and y."""
        return 2

    def get_sparsity_in(self, i: int) -> casadi.Sparsity:
        """Return the shape of x or of y."""
        return self.function.get_sparsity_in(0) if i == 0 else self.function.get_sparsity_out(0)

    def get_sparsity_out(self, i: int) -> casadi.Sparsity:
        """Return the shape of dy/dx."""
        return casadi.Sparsity.dense(self.function.outputs, self.function.inputs)

    def eval(self, arg: Sequence[casadi.DM]) -> list[casadi.DM]:
        """Return dy/dx at x."""
        return [casadi.DM(self.function.compute_cached(arg[0])[1])]
