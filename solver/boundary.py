"""The tissue's surface, side and floor as edges of elements, and what a field given on them does to the finite elements.

A field u_s that balances in the tissue leaves forces on its boundary. What must come on top of it (its reflection) solves the
base problem, eq. (B1): in the tissue the unknown is the rest w, in the blocks the whole, which on the ends is w + u_s:

    forces -Int t_s . v on the tissue's surface and side; the blocks strained by u_s on their ends; w = -u_s on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geometry.grading import Floats
from geometry.meridian import SQUARE, labels, line_label, nodes
from geometry.section import Body
from solver.azimuthal import Harmonic
from solver.base_states import Model
from solver.shapes import Ints, functions

ENDS = ((0, 1), (1, 2), (3, 2), (0, 3))  # corners of an element's sides, as its functions run along them
EXTRA = 3  # Gauss-Lobatto points of an edge beyond those that its polynomials need


@dataclass(frozen=True)
class Edges:
    """Some sides of elements.

    Attributes:
        element: of each edge, shape (e,).
        local: numbers of the functions that live on it among the element's, shape (e, p + 1).
        r, z: of its points, shape (e, q).
        weight: for integrals along it times r, shape (e, q).
        values: of its functions at its points, shape (q, p + 1).
    """

    element: Ints
    local: Ints
    r: Floats
    z: Floats
    weight: Floats
    values: Floats

    @property
    def coefficients(self) -> Floats:
        """From values at the points to coefficients of the functions: ends met exactly, least squares between; (p + 1, q)."""
        ends, bubbles = self.values[:, :2], self.values[:, 2:]
        corner = np.zeros((2, len(self.values)))
        corner[0, 0] = corner[1, -1] = 1.0
        return np.concatenate([corner, np.linalg.pinv(bubbles) @ (np.eye(len(self.values)) - ends @ corner)])


@dataclass(frozen=True)
class Boundary:
    """The edges of a base states' mesh without a sphere: the tissue's surface, side and floor and the blocks' ends."""

    surface: Edges
    side: Edges
    floor: Edges
    ends: Edges

    @classmethod
    def of(cls, model: Model) -> Boundary:
        """Find the edges."""
        layout, body = model.mesh.layout, model.mesh.body
        surface, side = line_label(layout.row["surface"]), line_label(layout.column["side"])
        tissue, probe = body == Body.TISSUE, (body == Body.INNER) | (body == Body.OUTER)
        wanted = ((1, surface, tissue), (0, side, tissue), (1, line_label(0), tissue), (1, surface, probe))
        return cls(*(_edges(model, axis, line, which) for axis, line, which in wanted))


def _edges(model: Model, axis: int, line: float, which: Floats) -> Edges:
    """Sides of some bodies' elements on a line of constant label: of r for axis 0, of z for axis 1."""
    label, order = labels(model.mesh), model.shapes.order
    x, weight = _lobatto(order + EXTRA)
    elements, locals_, starts = [], [], []
    for number, (a, b) in enumerate(ENDS):
        found = np.flatnonzero(which & (label[:, a, axis] == line) & (label[:, b, axis] == line))
        elements.append(found)
        own = np.array([a, b, *range(4 + number * (order - 1), 4 + (number + 1) * (order - 1))])
        locals_.append(np.broadcast_to(own, (len(found), order + 1)))
        starts.append(np.broadcast_to([a, b], (len(found), 2)))
    element, start = np.concatenate(elements), np.concatenate(starts)
    corners = nodes(model.section, model.mesh, SQUARE, element)
    first, last = (corners[np.arange(len(element)), start[:, k]] for k in (0, 1))
    r, z = ((1 - x) * first[:, k, None] + x * last[:, k, None] for k in (0, 1))
    length = np.hypot(*(last - first).T)
    along = functions(np.stack([x, np.zeros_like(x)], axis=1), np.array([(0, 0), (1, 0), *((k, 0) for k in range(2, order + 1))]))
    return Edges(element, np.concatenate(locals_), r, z, weight * length[:, None] * r, along[0])


def _lobatto(count: int) -> tuple[Floats, Floats]:
    """Gauss-Lobatto points and weights on the unit interval."""
    legendre = np.polynomial.legendre.Legendre.basis(count - 1)
    inner = legendre.deriv().roots().real
    x = np.concatenate([[-1.0], np.sort(inner), [1.0]])
    return (x + 1) / 2, 1 / (count * (count - 1) * legendre(x) ** 2)


@dataclass(frozen=True)
class Data:
    """Amplitudes of one order on the boundary, U, V, W last but one: displacements on ends and floor, tractions elsewhere.

    Attributes:
        surface, side: tractions t_r, t_theta, t_z, outward normal, shapes (e, q, 3, k), Pa.
        ends, floor: displacements, shapes (e, q, 3, k).
    """

    surface: Floats
    side: Floats
    ends: Floats
    floor: Floats


@dataclass(frozen=True)
class Response:
    """What one azimuthal order answers to data on the boundary.

    Attributes:
        harmonic: the order's system.
        boundary: the edges.
    """

    harmonic: Harmonic
    boundary: Boundary

    @cached_property
    def _elements(self) -> Ints:
        """All elements with an edge on the boundary."""
        b = self.boundary
        return np.unique(np.concatenate([edges.element for edges in (b.surface, b.side, b.floor, b.ends)]))

    @cached_property
    def _add_up(self) -> Any:
        """Adds forces on the own values of those elements up, a sparse matrix (unknowns, 4 c p elements)."""
        return self.harmonic.gathered(self._elements).T.tocsr()

    @cached_property
    def _stiffness(self) -> Floats:
        return self.harmonic.system.stiffness[self._elements]

    @cached_property
    def _tables(self) -> dict[str, tuple[Ints, Ints, Floats]]:
        """For each set of edges: where its elements and their functions are, and what makes their own values of data."""
        round_axis, amplitudes, b = 2 * np.pi if self.harmonic.m == 0 else np.pi, self.harmonic.amplitudes, self.boundary
        loads = {"surface": b.surface, "side": b.side}
        tables = {
            name: np.einsum("eq,qs,ac->ecsqa", round_axis * edges.weight, edges.values, amplitudes)
            for name, edges in loads.items()
        }
        inverse = np.linalg.pinv(amplitudes)
        for name, edges in {"ends": b.ends, "floor": b.floor}.items():
            tables[name] = np.broadcast_to(
                np.einsum("sq,ca->csqa", edges.coefficients, inverse),
                (len(edges.element), len(inverse), *edges.coefficients.shape[:1], edges.coefficients.shape[1], 3),
            )
        return {name: self._table(getattr(b, name), table) for name, table in tables.items()}

    def _table(self, edges: Edges, table: Floats) -> tuple[Ints, Ints, Floats]:
        e, c, s = table.shape[:3]
        functions = np.arange(c)[:, None] * 4 * self.harmonic.model.shapes.order + edges.local[:, None]  # (e, c, p + 1)
        return np.searchsorted(self._elements, edges.element)[:, None], functions.reshape(e, c * s), table.reshape(e, c * s, -1)

    def _placed(self, name: str, data: Floats) -> Floats:
        """Data (e, q, 3, k) as own values of the boundary's elements, (elements, 4 c p, k)."""
        row, column, table = self._tables[name]
        out = np.zeros((len(self._elements), self._stiffness.shape[1], data.shape[-1]))
        out[row, column] = table @ data.reshape(len(data), -1, data.shape[-1])
        return out

    def to(self, data: Data, elements: Ints, rows: Any) -> Floats:
        """Solve eq. (B1); values U, V, W of w in some of the tissue's elements, (e, 3, s, k).

        Args:
            data: amplitudes of this order.
            elements: which.
            rows: ``self.harmonic.gathered(elements)``, alike for all orders above 1.

        Raises:
            SolveError: see ``Harmonic.solve``.
        """
        held = -self._placed("floor", data.floor)
        forces = self._placed("surface", data.surface) + self._placed("side", data.side)
        forces += self._stiffness @ (held + self._placed("ends", data.ends))
        k = forces.shape[-1]
        v = self.harmonic.solve(-(self._add_up @ forces.reshape(-1, k)))
        edge = (rows @ v).reshape(len(elements), -1, k)
        low = np.isin(elements, self.boundary.floor.element)
        edge[low] += held[np.searchsorted(self._elements, elements[low])]
        return self.harmonic.whole(edge, elements)
