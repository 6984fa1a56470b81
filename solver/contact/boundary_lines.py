"""Find the lines of the meridian section that may touch: walls of the gap, walls of the blocks, the tissue's top."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import SolveError
from geometry.meridian.mesh import ELEMENT_SIDES, Topology, compute_labels, label_line
from geometry.meridian.section import TISSUES, Body
from solver.elements.shape_functions import evaluate_edge_functions, evaluate_legendre
from solver.linalg.workspace import keep_table

MAX_NEWTON_PASSES, HEIGHT_TOLERANCE_RELATIVE = (
    30,
    1e-13,
)  # of Newton's search for a point on an edge; the tolerance is relative to the edge's rise


@dataclass(frozen=True, eq=False)
class BoundaryLine:
    """A line of the mesh as consecutive edges of elements, from its end at a block's lower corner.

    Attributes
    ----------
    element
        Element of each edge, shape (k,).
    values
        Indices of the element's values (u_r, u_z) that belong to the edge's functions, shape (k, 2, p + 1).
    signs
        -1 where an odd function runs against the line, shape (k, p + 1).
    place
        Coefficients of the undeformed edge, m: its two ends, then zeros; shape (k, 2, p + 1).
    """

    element: Ints
    values: Ints
    signs: Floats
    place: Floats

    def reverse(self) -> BoundaryLine:
        """Return the same line, started at its other end."""
        swap = [1, 0, *range(2, self.order + 1)]  # the two end functions change places
        # functions of odd degree from 3 on are odd about the edge's middle: they change sign
        odd = np.where((np.arange(self.order + 1) > 2) & (np.arange(self.order + 1) % 2 == 1), -1.0, 1.0)
        return BoundaryLine(
            self.element[::-1], self.values[::-1][..., swap], (self.signs * odd)[::-1][..., swap], self.place[::-1][..., swap]
        )

    def take_edges(self, start: int, end: int | None = None) -> BoundaryLine:
        """Return the line of the edges from number ``start`` up to but not including ``end``; None is the line's end."""
        edges = slice(start, end)
        return BoundaryLine(self.element[edges], self.values[edges], self.signs[edges], self.place[edges])

    def join(self, line: BoundaryLine) -> BoundaryLine:
        """Return this line continued by one that begins where it ends."""
        return BoundaryLine(
            np.concatenate([self.element, line.element]),
            np.concatenate([self.values, line.values]),
            np.concatenate([self.signs, line.signs]),
            np.concatenate([self.place, line.place]),
        )

    @property
    def order(self) -> int:
        """Polynomial degree along each edge."""
        return int(self.place.shape[-1]) - 1

    @cached_property
    def lengths(self) -> Floats:
        """Lengths of the undeformed edges, m, shape (k,)."""
        return np.asarray(np.linalg.norm(self.place[:, :, 1] - self.place[:, :, 0], axis=1))

    @cached_property
    def starts(self) -> Floats:
        """Positions of the edges' first ends on the undeformed line, and of its end, m from its start, shape (k + 1,)."""
        return np.append(0.0, np.cumsum(self.lengths))

    def compute_positions(self, displacements: Floats) -> Floats:
        """Return the coefficients of the deformed edges, m, from the elements' displacements.

        Parameters
        ----------
        displacements
            Values of the n elements on corners and edges, m, shape (n, 8 p).

        Returns
        -------
        Floats
            Coefficients of the edges' functions for r and z, shape (k, 2, p + 1) for k edges.
        """
        return np.asarray(self.place + self.signs[:, None] * displacements[self.element[:, None, None], self.values])


def find_lines(mesh: Topology, corners: Floats, order: int) -> dict[str, BoundaryLine]:
    """Return the lines that may touch, by name: walls run upwards, lines along the surface run outwards.

    Walls are "inner wall", "hole wall" and "tube wall". On the surface, the blocks have "inner face" and "tube face"; the tissue
    has "under inner", "strip", "under tube" and "top". Where edges are round, "inner lip", "hole lip" and "tube lip" are the ends
    of the faces, and "open strip" and "open top" are the tissue that no face touches at rest. With sharp edges these two equal
    "strip" and "top".

    Parameters
    ----------
    mesh
        The elements.
    corners
        Corners of the elements in the undeformed section, m, shape (n, 4, 2).
    order
        Polynomial order of the elements.
    """
    corner_labels = compute_labels(mesh)
    column = {name: label_line(number) for name, number in mesh.layout.column.items()}
    (_, inner_edge), (hole_edge, tube_edge) = (tuple(map(label_line, ends)) for ends in mesh.layout.faces)
    surface = label_line(mesh.layout.row["surface"])
    tissue = np.isin(mesh.body, TISSUES)
    inner, outer = (mesh.body == body for body in (Body.INNER, Body.OUTER))

    def find_vertical(selection: Bools, name: str) -> BoundaryLine:
        """Return the edges of selected elements on a named column of the mesh."""
        return _find_line(corner_labels, corners, selection, order, axis=0, line=column[name], start=-np.inf, end=np.inf)

    def find_horizontal(selection: Bools, start: float, end: float) -> BoundaryLine:
        """Return the edges of selected elements on the tissue's surface between two radii, as labels."""
        return _find_line(corner_labels, corners, selection, order, axis=1, line=surface, start=start, end=end)

    axis, inner_wall, hole, tube, side = (column[name] for name in ("axis", "inner", "hole", "tube", "side"))
    lips = {
        "inner lip": (inner, inner_edge, inner_wall),
        "hole lip": (outer, hole, hole_edge),
        "tube lip": (outer, tube_edge, tube),
    }
    return {name: find_horizontal(*arguments) for name, arguments in lips.items() if "inner edge" in mesh.layout.column} | {
        "inner wall": find_vertical(inner, "inner"),
        "hole wall": find_vertical(outer, "hole"),
        "tube wall": find_vertical(outer, "tube"),
        "inner face": find_horizontal(inner, axis, inner_wall),
        "tube face": find_horizontal(outer, hole, tube),
        "under inner": find_horizontal(tissue, axis, inner_wall),
        "strip": find_horizontal(tissue, inner_wall, hole),
        "under tube": find_horizontal(tissue, hole, tube),
        "top": find_horizontal(tissue, tube, side),
        "open strip": find_horizontal(tissue, inner_edge, hole_edge),
        "open top": find_horizontal(tissue, tube_edge, side),
    }


def _find_line(
    corner_labels: Floats, corners: Floats, selection: Bools, order: int, *, axis: int, line: float, start: float, end: float
) -> BoundaryLine:
    """Return the edges of selected elements on one line of the mesh, in rising order along it.

    Parameters
    ----------
    corner_labels
        Labels of the elements' corners, (r, z): numbers of the mesh lines through them, shape (n, 4, 2).
    corners
        Positions of the corners, m, shape (n, 4, 2).
    selection
        Mask of the elements whose edges may belong to the line.
    order
        Polynomial order p of the elements.
    axis, line
        0 for a vertical line, 1 for a horizontal one, and its label.
    start, end
        Labels, along the line, of the range that the edges lie in.
    """
    m = 4 * order  # values of u_r come first, those of u_z m places later
    elements, sides = np.flatnonzero(selection & (np.sum(corner_labels[..., axis] == line, axis=1) > 1)), np.array(ELEMENT_SIDES)
    ends = corner_labels[elements[:, None, None], sides]  # shape (elements, 4 sides, 2 ends, 2)
    along = ends[..., 1 - axis]
    is_between = (along.min(axis=2) >= start) & (along.max(axis=2) <= end)
    row, k = np.nonzero(np.all(ends[..., axis] == line, axis=2) & is_between)
    element, along = elements[row], along[row, k]
    # the functions of side k: its two corners, then p - 1 of its own, which follow the four corners' side by side
    inner = 4 + (order - 1) * k[:, None] + np.arange(order - 1)
    functions, place, signs = np.hstack([sides[k], inner]), np.zeros((len(k), 2, order + 1)), np.ones((len(k), order + 1))
    place[..., :2] = corners[element[:, None], sides[k]].swapaxes(1, 2)
    against = along[:, 0] > along[:, 1]  # the edge runs against the line's direction
    functions[against, :2], place[against, :, :2] = functions[against, 1::-1], place[against, :, 1::-1]
    signs[against, 3::2] = -1.0  # functions of odd degree from 3 on are odd about the edge's middle
    order_along = np.argsort(along.min(axis=1))
    values = np.stack([functions, m + functions], axis=1)
    return BoundaryLine(element[order_along], values[order_along], signs[order_along], place[order_along])


@keep_table
def tabulate_gauss(order: int, count: int) -> tuple[Floats, Floats]:
    """Return the weights, (g,), and an edge's functions of order p, (g, p + 1), at its g = ``count`` Gauss points."""
    x, w = legendre.leggauss(count)
    x, w = np.asarray((x + 1) / 2), np.asarray(w / 2)
    return w, evaluate_functions(x, order)[0]


def evaluate_functions(x: Floats, order: int) -> tuple[Floats, Floats, Floats]:
    """Return the values of an edge's functions of order p, and their first and second derivatives, shape (..., p + 1) each.

    ``x`` are positions on the edge, from 0 to 1, of any shape.
    """
    value, derivative, bend = _tabulate_powers(order)
    powers = np.ones((*np.shape(x), order + 1))
    for k in range(order):
        powers[..., k + 1] = powers[..., k] * x
    return powers @ value, powers @ derivative, powers @ bend


@keep_table
def tabulate_slopes(order: int) -> Floats:
    """Return the derivatives of an edge's functions of order p at its two ends, shape (2, p + 1)."""
    return evaluate_functions(np.array([0.0, 1.0]), order)[1]


@keep_table
def _tabulate_powers(order: int) -> tuple[Floats, Floats, Floats]:
    """Return the coefficients, in powers of x, of an edge's functions and of their first and second derivatives.

    Three arrays of shape (p + 1, p + 1): row i holds the coefficients of x^i, column j belongs to function j.
    """
    places = np.linspace(0, 1, order + 1)  # p + 1 points determine a polynomial of degree p
    values = evaluate_edge_functions(places, evaluate_legendre(places, order))[0]
    value = np.asarray(np.linalg.solve(np.vander(places, order + 1, increasing=True), values), dtype=float)
    rise = np.diag(np.arange(1.0, order + 1), 1)  # differentiates powers: d(x^i) / dx = i x^(i - 1)
    return value, rise @ value, rise @ rise @ value


@dataclass(frozen=True)
class LinePoints:
    """Points of a line at given heights t (the coordinate along which the line is a graph).

    Attributes
    ----------
    edge
        Number of each point's edge on the line, shape (j,).
    value, derivative, bend
        The edge's functions and their first and second derivatives there, shape (j, p + 1) each.
    """

    edge: Ints
    value: Floats
    derivative: Floats
    bend: Floats


def find_points(heights: Floats, wanted: Floats) -> tuple[LinePoints, Bools]:
    """Find the points at which a line has wanted heights.

    Parameters
    ----------
    heights
        The line's height t (the coordinate along which it is a graph), m, by coefficients of its edges' functions, (k, p + 1).
    wanted
        Wanted heights, m, shape (j,).

    Returns
    -------
    tuple[LinePoints, Bools]
        The points for those heights that the line reaches, and the mask of these heights, shape (j,).

    Raises
    ------
    SolveError
        The line turns back, so that it has a height twice.
    """
    order, knots = heights.shape[-1] - 1, np.append(heights[:, 0], heights[-1, 1])
    highest = np.maximum.accumulate(knots)  # where a line sags, the first point that reaches a height counts
    inside = (wanted >= knots[0]) & (wanted < highest[-1])
    t = wanted[inside]
    edge = highest.searchsorted(t, side="right") - 1
    rises = np.diff(knots)[edge]
    coefficients = (heights @ _tabulate_powers(order)[0].T)[edge].T
    x = _solve_polynomials(
        coefficients, t, np.clip((t - knots[edge]) / rises, 0.0, 1.0), HEIGHT_TOLERANCE_RELATIVE * np.abs(rises)
    )
    value, derivative, bend = evaluate_functions(x, order)
    if not np.all((derivative * heights[edge]).sum(axis=1) > 0):
        raise SolveError("a wall folds over")
    return LinePoints(edge, value, derivative, bend), inside


def _solve_polynomials(coefficients: Floats, wanted: Floats, x: Floats, close: Floats) -> Floats:
    """Return the positions from 0 to 1 at which j polynomials have wanted values, by Newton's method with bisection.

    Parameters
    ----------
    coefficients
        Coefficients of the polynomials, powers rising, shape (p + 1, j).
    wanted
        Wanted values, shape (j,).
    x
        Positions at which the search starts, shape (j,).
    close
        Differences from the wanted values that are small enough, shape (j,).
    """
    low, high = np.zeros_like(x), np.ones_like(x)  # bracket of each root, as the polynomials rise
    for _ in range(MAX_NEWTON_PASSES):
        residual, rise = coefficients[-1], np.zeros_like(x)
        for c in coefficients[-2::-1]:  # Horner's scheme, for the value and the derivative
            rise, residual = rise * x + residual, residual * x + c
        residual = residual - wanted
        if np.all(np.abs(residual) <= close):
            break
        low, high = np.where(residual <= 0, x, low), np.where(residual >= 0, x, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = x - residual / rise
        x = np.where((step > low) & (step < high), step, (low + high) / 2)  # a step out of the bracket is replaced by bisection
    return x


def multiply_outer(a: Floats, b: Floats) -> Floats:
    """Return the outer products of vectors: (j, n) and (j, m) give (j, n, m)."""
    return np.asarray(a[:, :, None] * b[:, None, :])


def multiply_symmetric(a: Floats, b: Floats) -> Floats:
    """Return a b' + b a' of vectors, (j, n) both, shape (j, n, n)."""
    product = multiply_outer(a, b)
    return np.asarray(product + product.transpose(0, 2, 1))


def join_edges(*edges: Floats) -> Floats:
    """Join derivatives with respect to the values of edges, (j, 2, p + 1) each, to one row for each point."""
    return np.concatenate([edge.reshape(len(edge), -1) for edge in edges], axis=1)
