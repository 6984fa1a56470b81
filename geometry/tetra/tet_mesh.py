"""A mesh of quadratic tetrahedra, each labelled by the body it lies in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points

Indices = NDArray[np.int64]

INNER_BODY, OUTER_BODY, GROOVE_BODY, TISSUE_BODY, BEYOND_BODY, FIRST_INCLUSION_BODY = range(6)
AIR_LABEL, MIRROR_LABEL = -1, -2  # outside all bodies; behind the plane of symmetry
EDGE_CORNERS = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])  # with a node at the middle, in VTK's order
FACE_CORNERS = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])  # opposite each corner, their normals pointing out


@dataclass(frozen=True)
class TetMesh:
    """Quadratic tetrahedra in the probe's axes: origin on its axis in the tissue's top plane, z out of the tissue.

    Attributes
    ----------
    nodes
        (n, 3) in m.
    elements
        (t, 10) indices of nodes in VTK's order: four corners, then the middles of ``EDGE_CORNERS``.
    body
        (t,) ``INNER_BODY``, ``OUTER_BODY``, ``GROOVE_BODY`` (the groove), ``TISSUE_BODY``, ``BEYOND_BODY`` (tissue outside the
        reference cylinder) or ``FIRST_INCLUSION_BODY`` + the inclusion's index in the scene.
    beyond
        (t,) whether the element lies outside the reference cylinder: all of ``BEYOND_BODY``, and inclusions there.
    layer
        (t,) the layer of tissue that the element lies in, or whose place an inclusion takes: 1 for the first below the surface
        and so on, 0 for the tissue's own material and the blocks.
    half
        Whether only the half y >= 0 of a mirror-symmetric scene is meshed.
    """

    nodes: Points
    elements: Indices
    body: Indices
    beyond: NDArray[np.bool_]
    layer: Indices
    half: bool

    @property
    def quality(self) -> Points:
        """The minimum scaled Jacobian of each element, (t,): 1 for a regular one, 0 or less for one that folds."""
        return compute_scaled_jacobians(self.nodes, self.elements)

    def boundary(self, *labels: int) -> Indices:
        """Return the outer faces of the bodies with these labels, taken together, (f, 6).

        Each has three corners, in the order that makes its normal point out, then the middles of its edges.
        """
        chosen = self.elements[np.isin(self.body, labels)]
        faces = np.concatenate(
            [chosen[:, [*corners, *middles]] for corners, middles in zip(FACE_CORNERS, FACE_MIDDLES, strict=True)]
        )
        _, index, count = np.unique(np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True)
        result: Indices = faces[np.sort(index[count == 1])]
        return result


def find_boundary(cells: Indices) -> Indices:
    """Return the faces (f, 3) that belong to one of the tetrahedra (t, 4) only, their normals pointing out."""
    faces = cells[:, FACE_CORNERS].reshape(-1, 3)
    _, index, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(faces[np.sort(index[count == 1])])


def _number_face_middles() -> Indices:
    """Return for each of the faces ``FACE_CORNERS`` which of an element's ten nodes are the middles of its edges, (4, 3)."""
    number = {frozenset(edge): 4 + k for k, edge in enumerate(EDGE_CORNERS.tolist())}
    return np.array(
        [[number[frozenset((a, b))] for a, b in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))] for f in FACE_CORNERS.tolist()]
    )


FACE_MIDDLES = _number_face_middles()


def compute_shape_gradients(points: Points) -> Points:
    """Return the derivatives of the ten shape functions at barycentric points (q, 3) of the reference element: (q, 10, 3)."""
    # barycentric coordinates and their derivatives; a corner's function is b (2 b - 1), an edge's 4 b_i b_j
    b = np.column_stack([1 - points.sum(axis=1), points])
    d = np.vstack([-np.ones(3), np.eye(3)])
    corners = (4 * b[:, :, None] - 1) * d
    middles = [4 * (b[:, i, None] * d[j] + b[:, j, None] * d[i]) for i, j in EDGE_CORNERS]
    result: Points = np.concatenate([corners, np.stack(middles, axis=1)], axis=1)
    return result


_REFERENCE_CORNERS = np.vstack([np.zeros(3), np.eye(3)])
_GRADIENTS_AT_NODES = compute_shape_gradients(
    np.vstack([_REFERENCE_CORNERS, [(_REFERENCE_CORNERS[i] + _REFERENCE_CORNERS[j]) / 2 for i, j in EDGE_CORNERS]])
)
# the four Gauss points of degree 2 in a tetrahedron
_A, _B = 0.25 * (1 - 5**-0.5), 0.25 * (1 + 3 * 5**-0.5)
_GRADIENTS_AT_GAUSS_POINTS = compute_shape_gradients(np.array([(_A, _A, _A), (_B, _A, _A), (_A, _B, _A), (_A, _A, _B)]))


def compute_volumes(nodes: Points, elements: Indices) -> Points:
    """Return the volume of each quadratic element in m^3, (t,), by a rule of degree 2 (3 where the edges are straight)."""
    jacobians = np.einsum("qka,tkb->tqab", _GRADIENTS_AT_GAUSS_POINTS, nodes[elements])
    result: Points = np.linalg.det(jacobians).mean(axis=1) / 6
    return result


def compute_scaled_jacobians(nodes: Points, elements: Indices) -> Points:
    """Return the scaled Jacobian of each quadratic element, (t,): 1 for a regular one, 0 or less for one that folds.

    It is the minimum over the ten nodes of sqrt(2) times the Jacobian over the largest product of three edges at a corner.
    """
    element_nodes = nodes[elements]
    result = np.full(len(elements), np.inf)
    for gradients in _GRADIENTS_AT_NODES:
        a, b, c = (np.einsum("k,tkb->tb", gradients[:, axis], element_nodes) for axis in range(3))
        result = np.minimum(result, np.sqrt(2) * np.einsum("tb,tb->t", a, np.cross(b, c)) / _find_largest_product(a, b, c))
    return result


def _find_largest_product(a: Points, b: Points, c: Points) -> Points:
    """Return the largest product of the lengths of three edges that meet in a corner, (t,).

    a, b and c (t, 3) are the edges of each tetrahedron from its first corner.
    """
    la, lb, lc, ab, ac, bc = (np.sqrt(np.einsum("tb,tb->t", v, v)) for v in (a, b, c, a - b, a - c, b - c))
    result: Points = np.maximum(np.maximum(la * lb * lc, la * ab * ac), np.maximum(lb * ab * bc, lc * ac * bc))
    return result


def build_quadratic(corners: Points, tetrahedra: Indices) -> tuple[Points, Indices, Indices]:
    """Return nodes (n, 3) and elements (t, 10) with straight edges, and the edges' ends (m, 2).

    The corners come first among the nodes, then the middle of each edge, in the order of the ends.
    """
    edges = np.sort(tetrahedra[:, EDGE_CORNERS].reshape(-1, 2), axis=1)
    pairs, number = np.unique(edges, axis=0, return_inverse=True)
    nodes = np.vstack([corners, corners[pairs].mean(axis=1)])
    return nodes, np.hstack([tetrahedra, len(corners) + number.reshape(-1, 6)]), pairs
