"""Find the nodal displacements of the blocks' upper ends on a mesh that stand for a film as an actuator.

The displacement w of ``solver/multiple_scattering/stack_motion.py`` has edge layers as thin as the film, much thinner than
elements. Nodal values w_b are those of its projection on the mesh's functions N_a, by which it does the same work on any
traction that the mesh resolves:

    Int N_a (sum_b N_b w_b - w) dA = 0 for each a                                                   (SO.13)

with the integral over the upper end of a block.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from geometry.common.arrays import Floats, Ints
from geometry.tetra.tet_mesh import EDGE_CORNERS, ELEMENT_FACES, MeshBody, evaluate_quadratic_functions
from solver.multiple_scattering.stack_motion import compute_stack_motion
from solver.solid.domain import Domain
from solver.solid.problem import PLANE_TOLERANCE_RELATIVE, Solid

ENDS = ((MeshBody.INNER,), (MeshBody.OUTER, MeshBody.GROOVE))  # bodies of the inner and of the outer block
POINTS_PER_SIDE = 12  # of the quadrature on a triangle, which must resolve the layers at the blocks' edges


def build_end_motion(domain: Domain, solid: Solid) -> Floats:
    """Return the displacements of nodes of the blocks' upper ends by both films, zero elsewhere, ``CHARGE_UNIT``/N; (3 n, 2)."""
    motion, nodes = compute_stack_motion(domain.scene), solid.nodes
    tolerance = PLANE_TOLERANCE_RELATIVE * float(np.ptp(nodes, axis=0).max())
    lift = np.zeros((len(nodes), 3, 2))
    for block, bodies in enumerate(ENDS):
        elements = solid.elements[np.isin(solid.body, bodies)]
        faces = _find_end_faces(nodes, elements, tolerance)
        used, index = np.unique(faces, return_inverse=True)
        evaluate = partial(motion.evaluate, block, turn=domain.turn, mirrored=solid.mesh.half)
        lift[used] = _project(evaluate, nodes[used, :2], index.reshape(faces.shape))
    if solid.mesh.half:
        lift[np.abs(nodes[:, 1]) < tolerance, 1] = 0.0  # nodes of the plane of symmetry stay in it
    return lift.reshape(-1, 2)


def _find_end_faces(nodes: Floats, elements: Ints, tolerance: float) -> Ints:
    """Return the nodes of the triangles at the upper end of a block's elements, corners first, shape (triangles, 6).

    Middles follow in the order of the edges 01, 12, 02. Nodes within ``tolerance`` of the end, m, lie on it.
    """
    top = nodes[elements[:, :4], 2].max() - tolerance
    faces = elements[:, ELEMENT_FACES].reshape(-1, 6)
    return np.asarray(faces[(nodes[faces[:, :3], 2] > top).all(axis=1)])


def _project(evaluate: Callable[[Floats], Floats], places: Floats, faces: Ints) -> Floats:
    """Return the nodal values of w by eq. SO.13, shape (n, 3, 2): node, axis, film.

    Parameters
    ----------
    evaluate
        Function that returns w at points x and y, m, shape (n, 2); see ``StackMotion.evaluate``.
    places
        x and y of the nodes, m, shape (n, 2).
    faces
        Nodes of the triangles, shape (t, 6).
    """
    values, derivatives, weights = _build_triangle_rule()
    x = places[faces]
    mapping = np.einsum("tai,qaj->tqij", x, derivatives)
    area = np.abs(np.linalg.det(mapping)) * weights
    points = np.einsum("tai,qa->tqi", x, values)
    w = evaluate(points.reshape(-1, 2)).reshape(*area.shape, -1)
    mass = np.einsum("tq,qa,qb->tab", area, values, values)
    moments = np.einsum("tq,qa,tqk->tak", area, values, w)
    rows, columns = (np.broadcast_to(index, mass.shape).ravel() for index in (faces[:, :, None], faces[:, None, :]))
    matrix = sp.csc_array(sp.coo_array((mass.ravel(), (rows, columns)), shape=(len(places),) * 2))
    loads = np.zeros((len(places), moments.shape[2]))
    np.add.at(loads, faces, moments)
    return np.asarray(splu(matrix).solve(loads)).reshape(len(places), 3, 2)


def _build_triangle_rule() -> tuple[Floats, Floats, Floats]:
    """Return values (q, 6) and derivatives (q, 6, 2) of a triangle's functions at points of a quadrature rule, and its weights.

    It is Gauss's rule on the square, of which one side is shrunk to a point.
    """
    x, weight = np.polynomial.legendre.leggauss(POINTS_PER_SIDE)
    x, weight = (x + 1) / 2, weight / 2
    u, v = (grid.ravel() for grid in np.meshgrid(x, x, indexing="ij"))
    values, derivatives = evaluate_quadratic_functions(np.stack([u * (1 - v), u * v], axis=1), EDGE_CORNERS[:3])
    return values, derivatives, np.outer(weight, weight).ravel() * u
