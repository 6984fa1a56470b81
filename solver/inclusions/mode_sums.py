"""Evaluate sums of modes at many points, and the transpose: weighted sums over many points for each mode.

A component a of displacement or stress of modes is a sum of polynomials p_j of the place x times solid harmonics, eqs. IN.6 to
IN.9:

    field_a (x) = sum_j p_j (x) h_aj (x),   p = 1, x, y, rho^2, z,   h_aj a sum of solid harmonics         (IN.11)

so that one product with a table of harmonics, which all modes share, gives all sums. Points of one plane z = const need no p = z.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Floats, Ints
from solver.inclusions.solid_harmonics import Side, SolidHarmonics

Values = NDArray[Any]  # real, or complex for derivatives by complex steps
FACTOR_COUNT = 5  # p_j of eq. IN.11
FACTOR_ONE, FACTOR_X, FACTOR_Y, FACTOR_RHO2, FACTOR_Z = range(FACTOR_COUNT)
MAX_CACHED_VALUES = 4_000_000  # values of harmonics that a table caches: 32 MB
POINTS_PER_BLOCK = 2048  # points at a time: a table of harmonics that stays in the cache


@dataclass(frozen=True)
class Stack:
    """The sums h_aj of eq. IN.11 of some components a.

    Attributes
    ----------
    matrix
        Coefficients of the harmonics per mode, sparse (a FACTORS 2 count, modes).
    harmonics, side
        The solid harmonics of which these are sums, regular or outgoing ones.
    """

    matrix: Any
    harmonics: SolidHarmonics
    side: Side
    _rows: dict[tuple[bool, int], tuple[Ints, Ints]] = field(default_factory=dict, repr=False)

    @property
    def components(self) -> int:
        """Number of components a."""
        return int(self.matrix.shape[0] // (2 * FACTOR_COUNT * self.harmonics.count))

    def compute_sums(self, coefficients: Values) -> Values:
        """Return the harmonics' coefficients of h_aj for mode coefficients (modes, k), shape (a, FACTOR_COUNT, 2 count, k)."""
        sums: Values = (self.matrix @ coefficients).reshape(self.components, FACTOR_COUNT, -1, coefficients.shape[1])
        return sums

    def apply_transpose(self, sums: Floats) -> Floats:
        """Apply the transpose of ``compute_sums`` to sums of its shape; return shape (modes, k)."""
        return np.asarray(self._transposed @ sums.reshape(self.matrix.shape[0], -1))

    @cached_property
    def _transposed(self) -> Any:
        """The matrix's transpose by rows."""
        return self.matrix.T.tocsr()

    def list_rows(self, flat: bool, k: int) -> tuple[Ints, Ints]:
        """Return which rows (a, j, k) have harmonics of the cosines' family, and which of the sines'; flat indices of these rows.

        Rows are all combinations of components a, factors j and ``k`` fields. ``flat`` merges p = z into p = 1.
        """
        if (flat, k) not in self._rows:
            filled = np.diff(self.matrix.indptr).reshape(self.components, FACTOR_COUNT, 2, -1).any(axis=-1)
            if flat:
                filled = np.concatenate([filled[:, :1] | filled[:, FACTOR_Z:], filled[:, 1:FACTOR_Z]], axis=1)
            repeated = np.repeat(filled.reshape(-1, 2), k, axis=0)
            self._rows[flat, k] = np.flatnonzero(repeated[:, 0]), np.flatnonzero(repeated[:, 1])
        return self._rows[flat, k]


def count_cached_bytes(harmonics: SolidHarmonics, count: int) -> int:
    """Return how many bytes a table with ``count`` points and its samplers cache: places, factors, values unless too many."""
    values = 2 * harmonics.count * count
    return 8 * ((3 + FACTOR_COUNT) * count + (values if values <= MAX_CACHED_VALUES else 0))


@dataclass(frozen=True)
class Table:
    """Values of harmonics at points, cached unless there are many.

    Attributes
    ----------
    harmonics, side
        The harmonics, regular or outgoing ones.
    points
        Points in units of the sphere's radius from its centre, shape (n, 3).
    """

    harmonics: SolidHarmonics
    side: Side
    points: Floats

    def evaluate(self, part: slice) -> Floats:
        """Return the values of all harmonics at some of the points, shape (2 count, points)."""
        if 2 * self.harmonics.count * len(self.points) > MAX_CACHED_VALUES:
            return self.harmonics.evaluate(self.points[part], self.side)
        return self._all_values[:, part]

    @cached_property
    def _all_values(self) -> Floats:
        """Values at all points."""
        return self.harmonics.evaluate(self.points, self.side)


@dataclass(frozen=True)
class Sampler:
    """Sums of modes at some points of a table.

    Attributes
    ----------
    stack
        The sums of eq. IN.11 for the sampled components.
    table
        Harmonics at points, among them the n of this sampler.
    part
        Slice of these n points in the table.
    flat
        Whether the n points all have one z.
    """

    stack: Stack
    table: Table
    part: slice
    flat: bool = False

    def evaluate(self, coefficients: Values) -> Values:
        """Return the components of sums of modes with coefficients (modes, k), shape (a, k, n)."""
        return self.evaluate_sums(self.stack.compute_sums(coefficients))

    def evaluate_sums(self, sums: Values) -> Values:
        """Return the components of sums of modes given by ``Stack.compute_sums``, shape (a, k, n)."""
        a, _, size, k = sums.shape
        if self.flat:
            sums = np.concatenate([sums[:, :1] + self._plane_height * sums[:, FACTOR_Z:], sums[:, 1:FACTOR_Z]], axis=1)
        coefficients = sums.transpose(0, 1, 3, 2).reshape(-1, size)
        out = np.empty((a, k, self.count), coefficients.dtype)
        for part, table in self._blocks:
            columns = np.zeros((len(coefficients), table.shape[1]), coefficients.dtype)
            for rows, family in self._list_families(k):
                columns[rows] += coefficients[rows, family] @ table[family]
            np.einsum("ajkn,jn->akn", columns.reshape(a, self._factor_count, k, -1), self._factors[:, part], out=out[:, :, part])
        return out

    def apply_transpose(self, weights: Floats) -> Floats:
        """Apply the transpose of ``evaluate_sums`` to weights (a, k, n), shape (a, FACTOR_COUNT, 2 count, k)."""
        a, k, _ = weights.shape
        size = 2 * self.stack.harmonics.count
        coefficients = np.zeros((a * self._factor_count * k, size))
        for part, table in self._blocks:
            columns = (weights[:, None, :, part] * self._factors[:, None, part]).reshape(len(coefficients), -1)
            for rows, family in self._list_families(k):
                coefficients[rows, family] += columns[rows] @ table[family].T
        sums = coefficients.reshape(a, self._factor_count, k, size).transpose(0, 1, 3, 2)
        return np.concatenate([sums, self._plane_height * sums[:, :1]], axis=1) if self.flat else sums

    @property
    def _factor_count(self) -> int:
        """Number of factors p_j; a plane z = const needs no p = z."""
        return FACTOR_COUNT - int(self.flat)

    @property
    def _plane_height(self) -> float:
        """The common z of all points of a plane."""
        return float(self.table.points[self.part.start, 2])

    @property
    def count(self) -> int:
        """Number n of the points of ``part``."""
        return int(self.part.stop - self.part.start)

    def _list_families(self, k: int) -> list[tuple[Any, slice]]:
        """Return pairs of rows (a, j, k) and the slice of their family of harmonics; mirrored fields have one family per sum."""
        half = self.stack.harmonics.count
        families = zip(self.stack.list_rows(self.flat, k), (slice(0, half), slice(half, None)), strict=True)
        return [(rows, family) for rows, family in families if len(rows)]

    @property
    def _blocks(self) -> Iterator[tuple[slice, Floats]]:
        """Slices of the part's points, ``POINTS_PER_BLOCK`` at a time, with the values of the harmonics there."""
        for low in range(0, self.count, POINTS_PER_BLOCK):
            high = min(low + POINTS_PER_BLOCK, self.count)
            yield slice(low, high), self.table.evaluate(slice(self.part.start + low, self.part.start + high))

    @cached_property
    def _factors(self) -> Floats:
        """Values of the factors p_j at the points, shape (factors, n)."""
        x, y, z = self.table.points[self.part].T
        return np.stack([np.ones_like(x), x, y, x * x + y * y + z * z, z][: self._factor_count])
