"""Evaluate real solid harmonics, regular and irregular, at many points, with their derivatives as sparse matrices.

With orthonormal real spherical harmonics Y (cos m phi and sin m phi families, no Condon-Shortley sign) the regular ones are
rho^l Y and the irregular ones rho^(-l-1) Y. A sum of them is given by coefficients of shape (2 count, ...), the cosines
first; row (l, m) of a family is ``find_row(l, m)``. The rows of sin 0 exist, and are zero, so that both families are numbered
alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial, sqrt
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Floats

Side = Literal["regular", "outgoing"]


@dataclass(frozen=True)
class SolidHarmonics:
    """All harmonics up to a degree and an azimuthal order.

    Attributes
    ----------
    degree
        Largest l.
    order
        Largest m, at most ``degree``.
    """

    degree: int
    order: int

    @property
    def count(self) -> int:
        """Number of (l, m) with 0 <= m <= min(l, order): rows of one family."""
        return self.find_row(self.degree + 1, 0)

    def find_row(self, ell: int, m: int) -> int:
        """Return the row of (l, m) within a family: by rising l, then m."""
        full = min(ell, self.order + 1)  # degrees below l that have all their orders
        return full * (full + 1) // 2 + (ell - full) * (self.order + 1) + m

    def evaluate(self, points: Floats, side: Side) -> Floats:
        """Return the values of all harmonics at points (n, 3), shape (2 count, n).

        Irregular harmonics are Kelvin's images of the regular ones: h(x) = g(x / rho^2) / rho.
        """
        x, y, z = np.ascontiguousarray(points.T)
        square = x * x + y * y + z * z
        if side == "regular":
            return self._evaluate_products(x, y, z, square, np.ones_like(x))
        inverse = 1 / square
        return self._evaluate_products(x * inverse, y * inverse, z * inverse, inverse, np.sqrt(inverse))

    def _evaluate_products(self, x: Floats, y: Floats, z: Floats, square: Floats, factor: Floats) -> Floats:
        """Return products of Pi_l^m(z, rho^2) and the real and imaginary parts of (x + i y)^m, times a factor.

        The shape is (2 count, n); ``square`` is rho^2. Rows of the cosines' family (real parts) come first.

        DLMF 14.10.3 for orthonormal harmonics: Pi_l = a z Pi_(l-1) - b rho^2 Pi_(l-2),
        a^2 = (4 l^2 - 1) / (l^2 - m^2), b^2 = (2l+1) / (2l-3) ((l-1)^2 - m^2) / (l^2 - m^2) (IN.4).
        """
        out = np.empty((2, self.count, len(x)))
        power = np.empty((2, self.order + 1, len(x)))
        power[0, 0], power[1, 0] = factor, 0
        for m in range(1, self.order + 1):
            power[0, m] = x * power[0, m - 1] - y * power[1, m - 1]
            power[1, m] = x * power[1, m - 1] + y * power[0, m - 1]
        values = np.empty((self.count, len(x)))
        older, old, low = values[:0], values[:0], 0
        for ell, (a, b, top) in enumerate(_build_recursion(self.degree, self.order)):
            high = low + min(ell, self.order) + 1
            new, low = values[low:high], high
            scaled = np.multiply(old, z, out=new[: len(old)])
            scaled *= a
            if len(older):
                new[: len(older)] -= b * square * older
            if len(new) > len(old):
                new[ell] = top
            older, old = old, new
            np.multiply(new, power[:, : len(new)], out=out[:, high - len(new) : high])
        return out.reshape(2 * self.count, -1)


@lru_cache(maxsize=64)
def _build_recursion(degree: int, order: int) -> list[tuple[Floats, Floats, float]]:
    """Return for each degree the factors a and b of eq. IN.4, (m, 1), and Pi_l^l, that is Y_l^l without (x + i y)^l."""
    terms = []
    steps = [sqrt(1 / (4 * np.pi)), *(sqrt((2 * m + 1) / (2 * m) * (2 if m == 1 else 1)) for m in range(1, degree + 1))]
    tops = np.cumprod(steps)  # the mean of cos^2 m phi is 1 for m = 0 and 1/2 above
    for ell, top in enumerate(tops):
        m, n = np.arange(min(ell, order + 1))[:, None], np.arange(min(max(ell - 1, 0), order + 1))[:, None]
        a = np.sqrt((4 * ell**2 - 1) / (ell**2 - m**2))
        b = np.sqrt((2 * ell + 1) / (2 * ell - 3) * ((ell - 1) ** 2 - n**2) / (ell**2 - n**2))
        terms.append((a, b, float(top)))
    return terms


@lru_cache(maxsize=16)
def build_derivatives(harmonics: SolidHarmonics, side: Side) -> tuple[Any, Any, Any]:
    """Build sparse matrices D_x, D_y, D_z (2 count, 2 count) from coefficients of a sum to those of its derivatives.

    Exact for sums of degree below the largest and, across the axis, of order below the largest; higher harmonics are dropped.

    From Hobson's J_l^m = d_z^(l-m) (d_x + i d_y)^m (1 / rho) = (-1)^l (l-m)! P_l^m e^(i m phi) / rho^(l+1) and
    R_l^m = rho^l P_l^m e^(i m phi) / (l+m)!: with e = 1 (irregular, to degree l + 1) or -1 (regular, to l - 1)

        d_z F^m = F^m,  (d_x + i d_y) F^m = e F^(m+1),  (d_x - i d_y) F^m = -e F^(m-1), m > 0        (IN.5)
    """
    step = 1 if side == "outgoing" else -1
    entries: tuple[list[tuple[int, int, float]], ...] = ([], [], [])
    for ell in range(harmonics.degree + 1):
        for m in range(min(ell, harmonics.order) + 1):
            for axis, sine, order, factor in _list_terms(m, step):
                if 0 <= order <= min(ell + step, harmonics.order) and ell + step <= harmonics.degree:
                    # d_y (axis 1) leads from cosines to sines and back
                    row = (sine if axis != 1 else not sine) * harmonics.count + harmonics.find_row(ell + step, order)
                    scale = factor * _compute_scale(ell, m, side) / _compute_scale(ell + step, order, side)
                    entries[axis].append((row, sine * harmonics.count + harmonics.find_row(ell, m), scale))
    x, y, z = (_build_matrix(axis_entries, 2 * harmonics.count) for axis_entries in entries)
    return x, y, z


def _list_terms(m: int, e: int) -> list[tuple[int, bool, int, float]]:
    """Return the terms of eq. IN.5 in real form for order m and sign e.

    Each is the axis of the derivative, whether the harmonic itself is of the sines' family, the order of its derivative, and the
    factor. d_x and d_z keep the family, d_y changes it.
    """
    if m == 0:
        return [(2, False, 0, 1), (0, False, 1, e), (1, False, 1, e)]
    out: list[tuple[int, bool, int, float]] = []
    for sine in (False, True):
        sign = -1 if sine else 1  # d_y leads from cosines to sines and back with the other sign
        out += [(2, sine, m, 1), (0, sine, m + 1, e / 2), (1, sine, m + 1, sign * e / 2)]
        if m > 1 or not sine:
            out += [(0, sine, m - 1, -e / 2)]
        if m > 1 or sine:
            out += [(1, sine, m - 1, sign * e / 2)]
    return out


def _compute_scale(ell: int, m: int, side: Side) -> float:
    """Return the orthonormal harmonic divided by J_l^m (outgoing) or R_l^m (regular) of eq. IN.5."""
    norm = (2 * ell + 1) * (1 if m == 0 else 2) / (4 * np.pi)
    factorials = factorial(ell - m) * factorial(ell + m)
    return (-1) ** ell * sqrt(norm / factorials) if side == "outgoing" else sqrt(norm * factorials)


def _build_matrix(entries: list[tuple[int, int, float]], size: int) -> Any:
    """Build a sparse square matrix from entries (row, column, value)."""
    rows, columns, values = zip(*entries, strict=True) if entries else ((), (), ())
    return sp.csr_array((values, (rows, columns)), shape=(size, size))
