"""Interpolate array-valued functions of one number by piecewise polynomials on equal steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

SLAB_SIZE = 64  # numbers evaluated at once: their polynomials then fit the processor's cache
Array = Any  # array of floats, or of complex numbers for derivatives by complex steps


class PiecewisePolynomials:
    """Polynomials that interpolate a function at Chebyshev's points of every step; complex steps differentiate them exactly.

    Parameters
    ----------
    function
        Function that takes numbers, shape (m,), and returns several arrays of shapes (m, ...).
    start, step, steps
        Where the first step begins, how long each is, and how many there are.
    degree
        Degree of the polynomials.
    """

    def __init__(self, function: Callable[[Any], Sequence[Any]], start: float, step: float, steps: int, degree: int) -> None:
        # Chebyshev's points, from -1 to 1
        places = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        grid = start + step * (np.arange(steps)[:, None] + (places + 1) / 2)
        parts = function(grid.ravel())
        values = np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
        self.start, self.step = start, step
        ends = np.cumsum([0, *(part[0].size for part in parts)]).tolist()
        self.parts = [(slice(*bounds), part.shape[1:]) for bounds, part in zip(pairwise(ends), parts, strict=True)]
        self.coefficients = np.linalg.inv(np.vander(places, increasing=True)) @ values.reshape(steps, degree + 1, -1)

    def __call__(self, x: Array) -> list[Array]:
        """Interpolate the function's arrays at n numbers x, shape (n,): shapes (..., n), numbers last; NaN outside the steps."""
        steps, powers, count = self.coefficients.shape
        position = (x - self.start) / self.step
        inside = (position.real >= 0) & (position.real <= steps)
        whole = inside.all()
        step_number = np.minimum((position if whole else np.where(inside, position, 0)).real.astype(np.intp), steps - 1)
        monomials = np.empty((len(x), 1, powers), dtype=position.dtype)
        monomials[:, 0, 0] = 1
        # powers of the position within the step, from -1 to 1: each is the product of those before
        monomials[:, 0, 1:] = (2 * (position - step_number) - 1)[:, None]
        np.multiply.accumulate(monomials, axis=2, out=monomials)
        values = np.empty((count, len(x)), dtype=monomials.dtype)
        for k in range(0, len(x), SLAB_SIZE):
            part = slice(k, k + SLAB_SIZE)
            values[:, part] = np.matmul(monomials[part], self.coefficients.take(step_number[part], axis=0))[:, 0].T
        if not whole:
            values[:, ~inside] = np.nan
        return [values[place].reshape(*shape, len(x)) for place, shape in self.parts]
