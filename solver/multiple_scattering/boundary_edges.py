"""Find the element edges on surface, side, bottom and interfaces of the tissue's layers and on the blocks' ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.meridian.mesh import ELEMENT_SIDES, compute_labels, label_line
from geometry.meridian.section import LAYERS, Body, Section
from solver.axisymmetric.base_states import MeridianModel
from solver.elements.shape_functions import evaluate_functions

EXTRA_POINTS = 3  # Gauss-Lobatto points of an edge beyond those that its polynomials need


@dataclass(frozen=True)
class Edges:
    """Edges of elements with their functions and integration points.

    Attributes
    ----------
    element
        Element of each edge, shape (e,).
    local
        Indices of the edge's functions among the element's, shape (e, p + 1).
    r, z
        Coordinates of the edge's points, m, shape (e, q).
    weight
        Weights for integrals along the edge times r, shape (e, q).
    values
        Values of the edge's functions at its points, shape (q, p + 1).
    """

    element: Ints
    local: Ints
    r: Floats
    z: Floats
    weight: Floats
    values: Floats

    @property
    def coefficients(self) -> Floats:
        """Matrix from values at the points to coefficients of functions, (p + 1, q): exact at the ends, least squares between."""
        ends, bubbles = self.values[:, :2], self.values[:, 2:]
        corner = np.zeros((2, len(self.values)))
        corner[0, 0] = corner[1, -1] = 1.0
        return np.concatenate([corner, np.linalg.pinv(bubbles) @ (np.eye(len(self.values)) - ends @ corner)])


@dataclass(frozen=True)
class Boundary:
    """Edges of one layer's boundary in the base states' mesh without a sphere; lines that it does not have are empty.

    Attributes
    ----------
    surface, side, floor
        Edges of the layer's elements on the tissue's surface, side and bottom.
    ends
        Edges of the blocks' elements on their ends, for the uppermost layer.
    above, below
        Edges of the layer's elements on the interfaces with the layers above and below it.
    """

    surface: Edges
    side: Edges
    floor: Edges
    ends: Edges
    above: Edges
    below: Edges

    @classmethod
    def from_model(cls, model: MeridianModel, layer: int = 0) -> Boundary:
        """Find the edges of a layer by its number from the surface downwards; the tissue below all layers has the last number."""
        layout, body = model.mesh.layout, model.mesh.body
        surface, faces = label_line(layout.row["surface"]), [label_line(row) for row in layout.interfaces]
        is_first, is_last = layer == 0, layer == len(faces)
        in_layer, in_probe = body == find_tissue_body(model.section, layer), (body == Body.INNER) | (body == Body.OUTER)

        def find_edges(axis: int, line: float, which: Bools, exists: bool = True) -> Edges:
            """Find the edges of the elements ``which`` on a line; none unless the line ``exists`` in the layer."""
            return _find_edges(model, axis, line, which if exists else np.zeros_like(which))

        return cls(
            surface=find_edges(1, surface, in_layer, is_first),
            side=find_edges(0, label_line(layout.column["side"]), in_layer),
            floor=find_edges(1, label_line(0), in_layer, is_last),
            ends=find_edges(1, surface, in_probe, is_first),
            above=find_edges(1, surface if is_first else faces[layer - 1], in_layer, not is_first),
            below=find_edges(1, surface if is_last else faces[layer], in_layer, not is_last),
        )

    @property
    def elements(self) -> Ints:
        """All elements with an edge on the boundary, shape (e,)."""
        return np.unique(np.concatenate([edges.element for edges in vars(self).values()]))


def find_tissue_body(section: Section, layer: int) -> Body:
    """Return the meridian body of a layer, by its number, or that of the tissue below all layers."""
    return LAYERS[layer] if layer < len(section.interfaces) else Body.TISSUE


def _find_edges(model: MeridianModel, axis: int, line: float, which: Bools) -> Edges:
    """Find the edges of the elements ``which`` on a line of constant label: of r for axis 0, of z for axis 1.

    Labels are dimensionless coordinates of corners, equal along a line of the mesh. ``which`` is true for elements that count,
    shape (elements,).
    """
    label, order = compute_labels(model.mesh), model.shapes.order
    x, weight = _compute_lobatto_rule(order + EXTRA_POINTS)
    elements, locals_, starts = [], [], []
    for number, (a, b) in enumerate(ELEMENT_SIDES):
        matching = np.flatnonzero(which & (label[:, a, axis] == line) & (label[:, b, axis] == line))
        elements.append(matching)
        # an element's functions are first those of its four corners, then p - 1 for each side in turn
        local = np.array([a, b, *range(4 + number * (order - 1), 4 + (number + 1) * (order - 1))])
        locals_.append(np.broadcast_to(local, (len(matching), order + 1)))
        starts.append(np.broadcast_to([a, b], (len(matching), 2)))
    element, start = np.concatenate(elements), np.concatenate(starts)
    corners = model.corners[element]
    first, last = (corners[np.arange(len(element)), start[:, k]] for k in (0, 1))
    r, z = ((1 - x) * first[:, k, None] + x * last[:, k, None] for k in (0, 1))
    length = np.hypot(*(last - first).T)
    edge_functions = evaluate_functions(
        np.stack([x, np.zeros_like(x)], axis=1), np.array([(0, 0), (1, 0), *((k, 0) for k in range(2, order + 1))])
    )
    return Edges(element, np.concatenate(locals_), r=r, z=z, weight=weight * length[:, None] * r, values=edge_functions[0])


def _compute_lobatto_rule(count: int) -> tuple[Floats, Floats]:
    """Compute Gauss-Lobatto points and weights on the unit interval."""
    legendre = np.polynomial.legendre.Legendre.basis(count - 1)
    inner = legendre.deriv().roots().real
    x = np.concatenate([[-1.0], np.sort(inner), [1.0]])
    return (x + 1) / 2, 1 / (count * (count - 1) * legendre(x) ** 2)
