"""Integrate over tetrahedra of ten nodes: shape functions, quadrature and the matrices of their stiffness.

With g_a the gradient of shape function a, the stiffness K of an element of any linear law C follows from one matrix G of nine
numbers for each pair of nodes:

    G_(ai)(bj) = Int g_ai g_bj dV                                                            (SO.1)
    K_(ai)(bj) = lambda G_(ai)(bj) + sum_kl (C_ikjl - lambda delta_ik delta_jl) G_(ak)(bl)   (SO.2)

where i to l are axes, a and b nodes, and delta is Kronecker's; lambda is any number. With that of an isotropic law, elements may
average the dilation in the first term.

Nodes are in VTK's order: corners 0 1 2 3, then the middles of edges 01 12 02 03 13 23. An element whose middles lie
elsewhere is curved; its mapping is quadratic, its Jacobian no longer constant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from geometry.tetra.tet_mesh import EDGE_CORNERS, evaluate_quadratic_functions

CHUNK_ELEMENTS = 8192  # elements at once: 60 MB of matrices
STRAIGHT_TOLERANCE_RELATIVE = 1e-6  # of the longest edge: smaller offsets of mid-edge nodes are neglected


@dataclass(frozen=True)
class Rule:
    """Quadrature on the tetrahedron x, y, z >= 0, x + y + z <= 1, with the functions at its points.

    Attributes
    ----------
    weights
        Weights of the q points, which sum to the volume 1/6, shape (q,).
    values
        Values of the ten functions, shape (q, 10).
    derivatives
        Derivatives of the functions with respect to x, y and z, shape (q, 10, 3).
    """

    weights: Floats
    values: Floats
    derivatives: Floats


@cache
def build_rule(curved: bool) -> Rule:
    """Return the quadrature rule: 4 points, degree 2, exact for straight elements; 14 points, degree 5, for curved ones.

    Source: Keast, Comput. Methods Appl. Mech. Eng. 55 (1986); Walkington's rule of 14 points with positive weights.
    """
    if not curved:  # a and b are the barycentric coordinates of each point: a near one corner, b three times
        a, b = 0.5854101966249685, 0.1381966011250105
        bary, weights = np.full((4, 4), b) + (a - b) * np.eye(4), np.full(4, 1 / 24)
    else:
        parts, weights_of = [], []
        for a, weight in ((0.31088591926330060980, 0.11268792571801585080), (0.092735250310891226402, 0.073493043116361949544)):
            parts.append(np.full((4, 4), a) + (1 - 4 * a) * np.eye(4))
            weights_of.append(np.full(4, weight / 6))
        a = 0.045503704125649649492
        middle = np.full((6, 4), a)
        np.put_along_axis(middle, EDGE_CORNERS, 0.5 - a, axis=1)
        parts.append(middle)
        weights_of.append(np.full(6, 0.042546020777081466438 / 6))
        bary, weights = np.vstack(parts), np.concatenate(weights_of)
    return Rule(weights, *evaluate_quadratic_functions(bary[:, 1:]))


def find_curved(corners_and_middles: Floats) -> NDArray[np.bool_]:
    """Return the mask of curved elements, nodes (t, 10, 3): mid-edge nodes are off the middles of the chords."""
    x = corners_and_middles
    ends = x[:, EDGE_CORNERS]
    max_offset = np.linalg.norm(x[:, 4:] - ends.mean(axis=2), axis=2).max(axis=1)
    longest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1)
    return np.asarray(max_offset > STRAIGHT_TOLERANCE_RELATIVE * longest)


def compute_gradients(x: Floats, derivatives: Floats) -> tuple[Floats, Floats]:
    """Compute the gradients of the shape functions in space, and the Jacobians, at quadrature points of elements.

    Parameters
    ----------
    x
        Nodes of the elements, m, shape (t, 10, 3).
    derivatives
        Derivatives of the functions on the unit tetrahedron at the points, shape (q, 10, 3).

    Returns
    -------
    tuple[Floats, Floats]
        Gradients g, 1/m, shape (t, q, 10, 3), and Jacobians, m^3, shape (t, q).

    Raises
    ------
    SolveError
        An element is turned inside out.
    """
    mapping = np.einsum("tai,qaj->tqij", x, derivatives, optimize=True)  # dx_i / dxi_j
    # the inverse of the mapping is its cofactors over its determinant
    cofactors = np.stack([np.cross(mapping[..., (k + 1) % 3], mapping[..., (k + 2) % 3]) for k in range(3)], axis=-2)
    jacobian = np.einsum("tqi,tqi->tq", cofactors[..., 0, :], mapping[..., 0])
    if not np.all(jacobian > 0):
        raise SolveError(f"{int(np.sum(np.any(jacobian <= 0, axis=1)))} elements of the mesh are turned inside out")
    return derivatives @ (cofactors / jacobian[..., None, None]), jacobian


def iterate_quadrature(x: Floats) -> Iterator[tuple[Ints, Floats, Floats, Floats]]:
    """Yield the quadrature of elements with nodes x, (t, 10, 3), in chunks that limit the memory.

    First come straight elements, then curved ones, which have another rule. Each chunk of n elements gives their indices, (n,),
    the functions at the q points, (q, 10), their gradients, 1/m, (n, q, 10, 3), and the weights, m^3, (n, q).
    """
    bent = find_curved(x)
    for kind in (False, True):
        number, points = np.flatnonzero(bent == kind), build_rule(kind)
        for start in range(0, len(number), CHUNK_ELEMENTS):
            selection = number[start : start + CHUNK_ELEMENTS]
            g, jacobian = compute_gradients(x[selection], points.derivatives)
            yield selection, points.values, g, jacobian * points.weights


def compute_grams(g: Floats, weight: Floats) -> Floats:
    """Return G of eq. SO.1, shape (n, 30, 30), from gradients g (n, q, 10, 3) and weights (n, q)."""
    n, q = weight.shape
    root = (g * np.sqrt(weight)[..., None, None]).reshape(n, q, 30)
    return np.asarray(root.transpose(0, 2, 1) @ root)


def compute_mean_dilation(g: Floats, weight: Floats) -> Floats:
    """Return the matrix that lambda multiplies if an element's dilation is its mean: Int g_ai dV Int g_bj dV / V, (n, 30, 30)."""
    total = np.einsum("nqai,nq->nai", g, weight).reshape(len(g), 30)
    return np.asarray(total[:, :, None] * (total / weight.sum(axis=1)[:, None])[:, None])
