"""A mesh of quadratic tetrahedra, each labelled by the body it lies in."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points

Indices = NDArray[np.int64]

EDGE_CORNERS = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])  # with a node at the middle, in VTK's order
FACE_CORNERS = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])  # opposite each corner, their normals pointing out


class MeshBody(IntEnum):
    """The bodies of a volume mesh; inclusions follow the first by their index in the scene."""

    MIRROR = -2  # behind the plane of symmetry
    AIR = -1  # outside all bodies
    INNER = 0
    OUTER = 1
    GROOVE = 2
    TISSUE = 3
    BEYOND = 4  # tissue outside the reference cylinder
    FIRST_INCLUSION = 5


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
        (t,) ``MeshBody``, from ``FIRST_INCLUSION`` on plus the inclusion's index in the scene.
    beyond
        (t,) whether the element lies outside the reference cylinder: all of ``MeshBody.BEYOND``, and inclusions there.
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
        return np.asarray(chosen[:, ELEMENT_FACES].reshape(-1, 6)[match_faces(chosen[:, :4])[2]])


def match_faces(cells: Indices) -> tuple[Indices, Indices, Indices]:
    """Match the faces of tetrahedra (t, 4).

    Returns
    -------
    tuple
        The corners of all faces, four for each tetrahedron in turn, (4 t, 3); the indices of the two that are the same face of
        neighbours, (2, m); and those of faces that belong to one tetrahedron only, (n,).
    """
    faces = cells[:, FACE_CORNERS].reshape(-1, 3)
    corners = np.sort(faces, axis=1)
    # sorted by their corners, the two copies of a face that two tetrahedra share follow each other
    order = np.lexsort(corners.T)
    pairs = np.flatnonzero((corners[order[1:]] == corners[order[:-1]]).all(axis=1))
    shared = np.stack([order[pairs], order[pairs + 1]])
    return faces, shared, np.setdiff1d(np.arange(len(faces)), shared)


def _number_element_faces() -> Indices:
    """Return which of an element's ten nodes lie on each of the faces ``FACE_CORNERS``, corners first, then middles, (4, 6)."""
    number = {frozenset(edge): 4 + k for k, edge in enumerate(EDGE_CORNERS.tolist())}
    return np.array(
        [[a, b, c, *(number[frozenset(edge)] for edge in ((a, b), (b, c), (c, a)))] for a, b, c in FACE_CORNERS.tolist()]
    )


ELEMENT_FACES = _number_element_faces()


def evaluate_quadratic_functions(points: Points, edge_corners: Indices = EDGE_CORNERS) -> tuple[Points, Points]:
    """Return values (q, s) and derivatives (q, s, d) of the quadratic functions of a triangle, d = 2, or tetrahedron, d = 3.

    The functions are those of the corners and then of the edges, whose corners ``edge_corners`` (e, 2) names; ``points`` are
    (q, d), in the simplex between the origin and the unit vectors.
    """
    bary = np.column_stack([1 - points.sum(axis=1), points])
    derivative = np.vstack([-np.ones(points.shape[1]), np.eye(points.shape[1])])  # of the barycentric coordinates
    a, b = edge_corners.T
    values = np.hstack([bary * (2 * bary - 1), 4 * bary[:, a] * bary[:, b]])
    corner = (4 * bary - 1)[:, :, None] * derivative
    edge = 4 * (bary[:, a, None] * derivative[b] + bary[:, b, None] * derivative[a])
    return values, np.concatenate([corner, edge], axis=1)


_REFERENCE_CORNERS = np.vstack([np.zeros(3), np.eye(3)])
_GRADIENTS_AT_NODES = evaluate_quadratic_functions(
    np.vstack([_REFERENCE_CORNERS, _REFERENCE_CORNERS[EDGE_CORNERS].mean(axis=1)])
)[1]
# the four Gauss points of degree 2 in a tetrahedron
_A, _B = 0.25 * (1 - 5**-0.5), 0.25 * (1 + 3 * 5**-0.5)
_GRADIENTS_AT_GAUSS_POINTS = evaluate_quadratic_functions(np.array([(_A, _A, _A), (_B, _A, _A), (_A, _B, _A), (_A, _A, _B)]))[1]


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
