"""Integrals of products of two functions over the unit square, all elements at once, one direction after the other.

Functions are products of one-dimensional ones, N(x) M(y), and so are products of two of them. So a sum over points (x_a, y_b)

    int c f_i g_j = sum_b F_y(b; i_2 j_2) sum_a F_x(a; i_1 j_1) c(a, b)        (EL.1)

takes (p + 2) / 2 times fewer operations than one over all points at once would (Orszag, J. Comput. Phys. 37, 1980, 70-92).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints

Coefficients = Sequence[Floats | None]  # each (n, points), or None for those that vanish


@dataclass(frozen=True)
class TensorSums:
    """Sums of terms c f_i g_j whose y-factors are tables that several terms share.

    Attributes:
        along: the terms' tables by x, each (points along x, pairs), in groups of one y-table.
        across: the groups' tables by y, one below the other, shape (groups times points along y, pairs).
        groups: for each group the numbers of its terms.
    """

    along: tuple[Floats, ...]
    across: Floats
    groups: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, *terms: tuple[Floats, Floats]) -> TensorSums:
        """Group terms, each its tables by x and y, by the latter."""
        tables = list({id(by_y): by_y for _, by_y in terms}.values())
        groups = tuple(tuple(k for k, (_, by_y) in enumerate(terms) if by_y is one) for one in tables)
        return cls(tuple(by_x for by_x, _ in terms), np.concatenate(tables), groups)

    def __call__(self, coefficients: Coefficients) -> Floats:
        """Return the sums, shape (n, pairs by x, pairs by y)."""
        n = next(len(one) for one in coefficients if one is not None)
        points = len(self.along[0])
        parts = []
        for group in self.groups:
            chosen = [k for k in group if coefficients[k] is not None]
            tables = np.concatenate([self.along[k] for k in chosen])
            values = [np.asarray(coefficients[k]).reshape(n, points, points) for k in chosen]
            parts.append(tables.T @ (values[0] if len(values) == 1 else np.concatenate(values, axis=1)))
        by_x = np.concatenate(parts, axis=2)
        pairs, depth = by_x.shape[1:]
        return np.asarray((by_x.reshape(n * pairs, depth) @ self.across).reshape(n, pairs, self.across.shape[1]))


@dataclass(frozen=True)
class ElementTables:
    """What an order's element matrices are sums of.

    Attributes:
        even: sums of N N, X X, X Y + Y X and Y Y (its two halves), N a function, X and Y its slopes.
        odd: of X X, X Y, Y X and Y Y.
        dilation: of P X, P Y and P N, P a pressure.
        stiffness: where the entries of an element's matrix, (2 s)^2 of them, lie in the sums for r r, z z and r z, one after
            the other.
        moments: where the moments, pressures times s, lie in theirs.
    """

    even: TensorSums
    odd: TensorSums
    dilation: TensorSums
    stiffness: Ints
    moments: Ints

    @classmethod
    def of(cls, functions: tuple[Floats, Floats], pressures: Floats, degrees: tuple[Ints, Ints]) -> ElementTables:
        """Tabulate products of functions.

        Args:
            functions: one-dimensional, at the Gauss points of an edge, and their slopes, shape (points, p + 1) both.
            pressures: likewise, (points, p).
            degrees: along x and y of the functions, (s, 2), and of the pressures.
        """
        (N, S), L = functions, pressures
        size, order = N.shape[1], L.shape[1]
        NN, SN, NS, SS = (_pairs(a, b) for a, b in ((N, N), (S, N), (N, S), (S, S)))
        LN, LS = _pairs(L, N), _pairs(L, S)
        even = TensorSums.of((NN, NN), (SS, NN), (SN, NS), (NS, SN), (NN, SS))
        odd = TensorSums.of((SS, NN), (SN, NS), (NS, SN), (NN, SS))
        dilation = TensorSums.of((LS, LN), (LN, LS), (LN, LN))
        i, j = degrees[0][:, None], degrees[0][None]
        place = ((i * size + j) @ [size**2, 1]).astype(np.intp)
        rr, zz, rz = (place + k * size**4 for k in range(3))
        whole = np.block([[rr, rz], [rz.T, zz]])
        k = degrees[1][:, None]
        moments = ((k * size + j) @ [order * size, 1]).astype(np.intp)
        return cls(even, odd, dilation, stiffness=whole.ravel(), moments=moments.ravel())


def _pairs(a: Floats, b: Floats) -> Floats:
    """Products of two sets of functions at the same points, (points, i) and (points, j) to (points, i j)."""
    return np.asarray((a[:, :, None] * b[:, None]).reshape(len(a), -1))
