"""Hierarchical shape functions on the unit square, tabulated at Gauss points.

Along each axis: 1 - x, x and, for degrees 2 to p, integrated Legendre polynomials, which vanish at both
ends (Szabo & Babuska, Finite Element Analysis, 1991, section 6.1). An element of order p - 1 uses a subset of the functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from geometry.grading import Floats

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Products:
    """Products of two functions i, j at the q points, with N a function, X and Y its slopes and P a pressure.

    Attributes:
        even: N N, X X, X Y + Y X and Y Y, shape (4 q, s^2).
        odd: X X, X Y, Y X and Y Y, shape (4 q, s^2).
        dilation: P X, P Y and P N, shape (3 q, m s).
        mass: P P, shape (q, m^2).
    """

    even: Floats
    odd: Floats
    dilation: Floats
    mass: Floats


@dataclass(frozen=True)
class Shapes:
    """Functions of order p; s = (p+1)^2 of them, the first 4 p on corners and edges.

    Attributes:
        order: p.
        degrees: along x and y, 0 and 1 for the two linear ones, shape (s, 2).
        points, weights: of Gauss quadrature, shapes (q, 2) and (q,).
        value, slope: of the functions at the points, shapes (q, s) and (2, q, s).
        pressure: polynomials of total degree below p at the points, shape (q, p (p+1) / 2).
        places: nodes (u, v) by whose positions an element's geometry is told, shape (s, 2).
        geometry, tangents: interpolation from these nodes to the points, shapes (q, s) and (2, q, s).
        products: of the functions, from which elements' matrices are sums.
    """

    order: int
    degrees: Ints
    points: Floats
    weights: Floats
    value: Floats
    slope: Floats
    pressure: Floats
    places: Floats
    geometry: Floats
    tangents: Floats
    products: Products

    @property
    def skeleton(self) -> int:
        """Number of functions on corners and edges."""
        return 4 * self.order


@lru_cache(maxsize=16)
def shapes(order: int) -> Shapes:
    """Tabulate the functions of an order."""
    x, w = legendre.leggauss(order + 2)
    x, w = (x + 1) / 2, w / 2
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    degrees = _degrees(order)
    value, slope = functions(points, degrees)
    pressure = pressures(points, order)
    lobatto = (1 - np.cos(np.linspace(0, np.pi, order + 1))) / 2
    places = np.stack(np.meshgrid(lobatto, lobatto, indexing="ij"), axis=-1).reshape(-1, 2)
    known = np.linalg.inv(functions(places, degrees)[0])
    geometry, tangents, weights = value @ known, slope @ known, np.outer(w, w).ravel()
    tables = _products(value, slope, pressure)
    return Shapes(order, degrees, points, weights, value, slope, pressure, places, geometry, tangents, tables)


def _products(value: Floats, slope: Floats, pressure: Floats) -> Products:
    def table(*pairs: tuple[Floats, Floats]) -> Floats:
        return np.concatenate([(a[:, :, None] * b[:, None]).reshape(len(a), -1) for a, b in pairs])

    x, y = slope
    crossed = table((x, y))
    mirrored = table((y, x))
    even = np.concatenate([table((value, value), (x, x)), crossed + mirrored, table((y, y))])
    odd = np.concatenate([table((x, x)), crossed, mirrored, table((y, y))])
    return Products(even, odd, table((pressure, x), (pressure, y), (pressure, value)), table((pressure, pressure)))


def pressures(points: Floats, order: int) -> Floats:
    """Products of Legendre polynomials of total degree below p at points of the unit square, (n, 2), shape (n, p (p+1) / 2)."""
    along = legendre.legvander(2 * points - 1, order - 1)
    return np.stack([along[:, 0, i] * along[:, 1, j] for i in range(order) for j in range(order - i)], axis=-1)


def functions(points: Floats, degrees: Ints) -> tuple[Floats, Floats]:
    """Values (n, s) and slopes (2, n, s) of the functions with the given degrees at points of the unit square, (n, 2)."""
    order = int(degrees.max())
    (x, dx), (y, dy) = (_along(points[:, axis], order) for axis in (0, 1))
    i, j = degrees.T
    return x[:, i] * y[:, j], np.stack([dx[:, i] * y[:, j], x[:, i] * dy[:, j]])


def _along(x: Floats, order: int) -> tuple[Floats, Floats]:
    """Values and derivatives of the one-dimensional functions at points x of the unit interval, shape (n, order + 1)."""
    P = legendre.legvander(2 * x - 1, order)
    k = np.arange(2, order + 1)
    value = np.concatenate([1 - x[:, None], x[:, None], (P[:, 2:] - P[:, :-2]) / np.sqrt(4 * k - 2)], axis=1)
    slope = np.concatenate([-np.ones((len(x), 1)), np.ones((len(x), 1)), P[:, 1:-1] * np.sqrt(4 * k - 2)], axis=1)
    return value, slope


def _degrees(order: int) -> Ints:
    """Corners counter-clockwise; edges bottom, right, top, left, each by rising degree; the inside."""
    high = range(2, order + 1)
    edges = [(k, 0) for k in high] + [(1, k) for k in high] + [(k, 1) for k in high] + [(0, k) for k in high]
    inside = sorted(((i, j) for i in high for j in high), key=max)
    return np.array([(0, 0), (1, 0), (1, 1), (0, 1), *edges, *inside])
