"""Tabulate hierarchical shape functions on the unit square at Gauss points.

Along each axis: 1 - x, x and, for degrees 2 to p, integrated Legendre polynomials, which vanish at both
ends (Szabo & Babuska, Finite Element Analysis, 1991, section 6.1). An element of order p - 1 uses a subset of the functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from geometry.common.arrays import Floats, Ints
from solver.elements.tensor_products import ElementTables
from solver.linalg.workspace import keep_result


@dataclass(frozen=True)
class Shapes:
    """The s = (p+1)^2 functions of order p, the first 4 p on corners and edges.

    Attributes
    ----------
    order
        Polynomial order p along each axis.
    degrees
        Degrees of the functions along x and y; 0 and 1 stand for the two linear ones, 1 - x and x. Shape (s, 2).
    points, weights
        Points and weights of Gauss quadrature on the unit square, shapes (q, 2) and (q,).
    value, derivative
        Values of the functions at the points, and derivatives with respect to x and y, shapes (q, s) and (2, q, s).
    pressure
        Polynomials of total degree below p at the points, shape (q, p (p+1) / 2).
    places
        Nodes (u, v) whose positions define an element's geometry, shape (s, 2).
    geometry, tangents
        Interpolation from these nodes to the points, shapes (q, s) and (2, q, s).
    tables
        Tables of products of the functions, from which the elements' matrices are summed.
    mass
        Products of two pressures at the points, shape (q, m^2) with m of them.
    """

    order: int
    degrees: Ints
    points: Floats
    weights: Floats
    value: Floats
    derivative: Floats
    pressure: Floats
    places: Floats
    geometry: Floats
    tangents: Floats
    tables: ElementTables
    mass: Floats

    @property
    def corners(self) -> Ints:
        """Indices in ``places`` of the unit square's corners, counted as in ``geometry.meridian.mesh_cells.UNIT_SQUARE``."""
        return np.array([0, self.order * (self.order + 1), len(self.places) - 1, self.order])

    @property
    def skeleton(self) -> int:
        """Number of functions on corners and edges."""
        return 4 * self.order

    @cached_property
    def places_in_sums(self) -> BlockPlaces:
        """Where blocks of an element's matrix and of its moments lie in the sums of ``tables``.

        The blocks are those of corners and edges and of the inside, u_r before u_z in each.
        """
        s, m = len(self.degrees), self.skeleton
        edge, inner = np.r_[:m, s : s + m], np.r_[m:s, s + m : 2 * s]
        stiffness, moments = self.tables.stiffness, self.tables.moments
        outside, across, inside = (stiffness[np.ix_(*pair)] for pair in ((edge, edge), (inner, edge), (inner, inner)))
        return BlockPlaces(outside, across, inside, moments[:, edge], moments[:, inner])


@dataclass(frozen=True)
class BlockPlaces:
    """Where blocks of an element's matrix and of its moments lie in the sums of ``ElementTables``.

    Attributes
    ----------
    outside, across, inside
        Entries of the matrix, as in ``Blocks``.
    edge, inner
        Moments of the functions on corners and edges, and of those inside.
    """

    outside: Ints
    across: Ints
    inside: Ints
    edge: Ints
    inner: Ints


@keep_result
def build_shapes(order: int) -> Shapes:
    """Tabulate the functions of one order at its Gauss points, order + 2 along each axis."""
    x, w = legendre.leggauss(order + 2)
    x, w = (x + 1) / 2, w / 2
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    degrees = _list_degrees(order)
    value, derivative = evaluate_functions(points, degrees)
    pressure = evaluate_pressures(points, order)
    # nodes of the geometry: Chebyshev's points with both ends, so that high orders interpolate without oscillation
    lobatto = (1 - np.cos(np.linspace(0, np.pi, order + 1))) / 2
    places = np.stack(np.meshgrid(lobatto, lobatto, indexing="ij"), axis=-1).reshape(-1, 2)
    inverse = np.linalg.inv(evaluate_functions(places, degrees)[0])
    geometry, tangents, weights = value @ inverse, derivative @ inverse, np.outer(w, w).ravel()
    mass = (pressure[:, :, None] * pressure[:, None]).reshape(len(pressure), -1)
    axis_values = evaluate_legendre(x, order)
    tables = ElementTables.from_functions(
        evaluate_edge_functions(x, axis_values), axis_values[:, :order], (degrees, list_pressure_degrees(order))
    )
    return Shapes(
        order,
        degrees,
        points=points,
        weights=weights,
        value=value,
        derivative=derivative,
        pressure=pressure,
        places=places,
        geometry=geometry,
        tangents=tangents,
        tables=tables,
        mass=mass,
    )


def evaluate_legendre(points: Floats, order: int) -> Floats:
    """Return Legendre polynomials of degrees 0 to p = ``order`` of each coordinate, from 0 to 1, of some points.

    Points of the unit square, (n, 2), give shape (n, 2, p + 1), points of an edge, (n,), shape (n, p + 1).
    """
    return np.asarray(legendre.legvander(2 * points - 1, order))


def evaluate_pressures(points: Floats, order: int, precomputed: Floats | None = None) -> Floats:
    """Return the pressure functions at points of the unit square, (n, 2): shape (n, p (p+1) / 2).

    They are products of Legendre polynomials of total degree below p. ``precomputed`` is ``evaluate_legendre`` of the same
    points, where that is known.
    """
    axis_values = evaluate_legendre(points, order) if precomputed is None else precomputed
    i, j = list_pressure_degrees(order).T
    return np.asarray(axis_values[:, 0, i] * axis_values[:, 1, j])


def list_pressure_degrees(order: int) -> Ints:
    """Return the degrees along x and y of the pressure functions, shape (p (p+1) / 2, 2)."""
    return np.array([(i, j) for i in range(order) for j in range(order - i)])


def evaluate_functions(points: Floats, degrees: Ints, precomputed: Floats | None = None) -> tuple[Floats, Floats]:
    """Return values (n, s) and derivatives (2, n, s) of functions of given degrees at points of the unit square, (n, 2).

    ``precomputed`` is ``evaluate_legendre`` of the same points, where that is known.
    """
    P = evaluate_legendre(points, int(degrees.max())) if precomputed is None else precomputed
    value, derivative = evaluate_edge_functions(points, P)
    i, j = degrees.T
    x, y, dx, dy = value[:, 0][:, i], value[:, 1][:, j], derivative[:, 0][:, i], derivative[:, 1][:, j]
    return x * y, np.stack([dx * y, x * dy])


def evaluate_edge_functions(x: Floats, P: Floats) -> tuple[Floats, Floats]:
    """Return values and derivatives of the one-dimensional functions at x in the unit interval, shape (..., p + 1) both.

    ``P`` are Legendre polynomials at the same x.
    """
    # integrated Legendre polynomials of degree k are (P_k - P_(k-2)) / scale, with derivatives P_(k-1) scale
    scale = np.sqrt(4 * np.arange(2, P.shape[-1]) - 2)
    value, derivative = np.empty_like(P), np.empty_like(P)
    value[..., 0], value[..., 1], value[..., 2:] = 1 - x, x, (P[..., 2:] - P[..., :-2]) / scale
    derivative[..., 0], derivative[..., 1], derivative[..., 2:] = -1, 1, P[..., 1:-1] * scale
    return value, derivative


def _list_degrees(order: int) -> Ints:
    """Return the functions' degrees: corners counter-clockwise; edges bottom, right, top, left, by rising degree; the inside."""
    high = range(2, order + 1)
    edges = [(k, 0) for k in high] + [(1, k) for k in high] + [(k, 1) for k in high] + [(0, k) for k in high]
    inside = sorted(((i, j) for i in high for j in high), key=max)
    return np.array([(0, 0), (1, 0), (1, 1), (0, 1), *edges, *inside])
