"""Sums of modes at many points, and the transpose: what many points give to each mode.

Displacements and stresses of modes are polynomials of the place times solid harmonics, eqs. (M3) to (M6) of ``multipoles.py``:

    field_a (x) = sum_j p_j (x) h_aj (x),   p = 1, x, y, rho^2, z,   h_aj a sum of solid harmonics         (M8)

so that one product with a table of harmonics, which all modes share, gives all sums. Points of one plane z = const need no p = z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.grading import Floats
from solver.harmonics import Harmonics, Side

Values = NDArray[Any]  # real, or complex for derivatives by complex steps
FACTORS = 5  # p_j of eq. (M8)
ONE, X, Y, SQUARE, Z = range(FACTORS)
KEPT = 4_000_000  # values of harmonics that a sampler keeps: 32 MB
BLOCK = 2048  # points at a time: a table of harmonics that stays in the cache


@dataclass(frozen=True)
class Stack:
    """The sums h_aj of eq. (M8) of some components a.

    Attributes:
        matrix: coefficients of the harmonics per mode, sparse (a FACTORS 2 count, modes).
        harmonics, side: of which they are sums.
    """

    matrix: Any
    harmonics: Harmonics
    side: Side

    @property
    def components(self) -> int:
        """Number of components a."""
        return int(self.matrix.shape[0] // (2 * FACTORS * self.harmonics.count))

    @cached_property
    def transposed(self) -> Any:
        """The matrix's transpose by rows."""
        return self.matrix.T.tocsr()

    @cached_property
    def filled(self) -> NDArray[np.bool_]:
        """Which sums have harmonics of the cosines' and of the sines' family, shape (a, FACTORS, 2)."""
        entries = np.diff(self.matrix.indptr).reshape(self.components, FACTORS, 2, -1)
        return np.asarray(entries.any(axis=-1))


@dataclass(frozen=True)
class Sampler:
    """Sums of modes at points that stay the same: what does not depend on the coefficients is kept, unless it is large.

    Attributes:
        stack: of the components.
        points: in units of the sphere's radius from its centre, shape (n, 3).
        flat: whether all points have one z.
    """

    stack: Stack
    points: Floats
    flat: bool = False

    def values(self, coefficients: Values) -> Values:
        """Components of sums of modes with coefficients (modes, k), shape (a, k, n)."""
        a, size, k = self.stack.components, 2 * self.stack.harmonics.count, coefficients.shape[1]
        sums = (self.stack.matrix @ coefficients).reshape(a, FACTORS, size, k)
        if self.flat:
            sums[:, ONE] += self._level * sums[:, Z]
        narrow = sums[:, : self._used].transpose(0, 1, 3, 2).reshape(-1, size)
        out = np.empty((a, k, len(self.points)), narrow.dtype)
        for part in self._parts:
            table = self._table(part)
            columns = np.zeros((len(narrow), table.shape[1]), narrow.dtype)
            for rows, family in self._families(k):
                columns[rows] += narrow[rows, family] @ table[family]
            np.einsum("ajkn,jn->akn", columns.reshape(a, self._used, k, -1), self._factors[:, part], out=out[:, :, part])
        return out

    def adjoint(self, weights: Floats) -> Floats:
        """The transpose of ``values``: sums over components and points, shape (modes, k), of weights (a, k, n)."""
        a, k, _ = weights.shape
        size = 2 * self.stack.harmonics.count
        narrow = np.zeros((a * self._used * k, size))
        for part in self._parts:
            table = self._table(part)
            columns = (weights[:, None, :, part] * self._factors[:, None, part]).reshape(len(narrow), -1)
            for rows, family in self._families(k):
                narrow[rows, family] += columns[rows] @ table[family].T
        sums = np.zeros((a, FACTORS, size, k))
        sums[:, : self._used] = narrow.reshape(a, self._used, k, size).transpose(0, 1, 3, 2)
        if self.flat:
            sums[:, Z] = self._level * sums[:, ONE]
        return np.asarray(self.stack.transposed @ sums.reshape(-1, k))

    @property
    def _used(self) -> int:
        return FACTORS - int(self.flat)

    @property
    def _level(self) -> float:
        return float(self.points[0, 2])

    def _families(self, k: int) -> list[tuple[Any, slice]]:
        """Rows (a, j, k) that have harmonics of a family, and these: where fields mirror, every sum has those of one alone."""
        filled, half = self.stack.filled.copy(), self.stack.harmonics.count
        if self.flat:
            filled[:, ONE] |= filled[:, Z]
        rows = np.repeat(filled[:, : self._used].reshape(-1, 2), k, axis=0)
        families = enumerate((slice(0, half), slice(half, None)))
        return [(np.flatnonzero(rows[:, which]), family) for which, family in families if rows[:, which].any()]

    @property
    def _parts(self) -> list[slice]:
        n = len(self.points)
        return [slice(low, min(low + BLOCK, n)) for low in range(0, n, BLOCK)]

    @cached_property
    def _factors(self) -> Floats:
        x, y, z = self.points.T
        return np.stack([np.ones_like(x), x, y, x * x + y * y + z * z, z][: self._used])

    def _table(self, part: slice) -> Floats:
        if 2 * self.stack.harmonics.count * len(self.points) > KEPT:
            return self.stack.harmonics.table(self.points[part], self.stack.side)
        return self._kept[:, part]

    @cached_property
    def _kept(self) -> Floats:
        return self.stack.harmonics.table(self.points, self.stack.side)
