"""Expand smooth functions in products of Chebyshev polynomials: of the lateral offset, even, and of the cube of tumours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from geometry.common.arrays import Floats, Ints


def build_points(count: int) -> Floats:
    """Return the Chebyshev points in [-1, 1], falling, shape (count,)."""
    return np.asarray(np.cos(np.pi * (np.arange(count) + 0.5) / count))


def build_cube_points(counts: tuple[int, int, int]) -> Floats:
    """Return the products of Chebyshev points in the cube, shape (n, 3)."""
    return np.stack(np.meshgrid(*map(build_points, counts), indexing="ij"), axis=-1).reshape(-1, 3)


def evaluate_cube_basis(points: Floats, degrees: Ints) -> Floats:
    """Return products of Chebyshev polynomials of p degrees, shape (p, 3), at points of the cube, shape (n, 3); shape (n, p)."""
    # polynomials in rows: whole rows are copied, not elements
    rows = [chebyshev.chebvander(points[:, axis], int(degrees[:, axis].max())).T for axis in range(3)]
    product = rows[0].take(degrees[:, 0], axis=0)
    for axis in (1, 2):
        product *= rows[axis].take(degrees[:, axis], axis=0)
    return np.asarray(product.T)


@dataclass(frozen=True)
class OffsetGrid:
    """Even functions of the lateral offset, expanded in asinh(offset / scale): their derivative at 0 vanishes.

    Attributes
    ----------
    scale
        Offsets below it are resolved evenly, those above it by their logarithm, m.
    end
        Largest offset, m.
    count
        Number of functions, and of points.
    """

    scale: float
    end: float
    count: int

    @property
    def points(self) -> Floats:
        """Offsets of the expansion's points, m, shape (count,)."""
        return np.asarray(self.scale * np.sinh(np.arcsinh(self.end / self.scale) * build_points(2 * self.count)[: self.count]))

    def evaluate_basis(self, offsets: Floats) -> Floats:
        """Return the even functions at offsets, m, shape (n, count)."""
        coordinates = np.arcsinh(offsets / self.scale) / np.arcsinh(self.end / self.scale)
        return np.asarray(chebyshev.chebvander(coordinates, 2 * self.count - 2)[:, ::2])

    def build_interpolation(self, offsets: Floats) -> Floats:
        """Return the matrix from values at the points to values at offsets, m, shape (n, count).

        Beyond the end values fall like (end / offset)^4, the far field of a tumour's effect, to 0 at twice the end.
        """
        basis = self.evaluate_basis(np.minimum(offsets, self.end))
        decay = np.clip(2 - offsets / self.end, 0, 1) ** 4
        return np.asarray(np.linalg.solve(self.evaluate_basis(self.points).T, basis.T).T * decay[:, None])
