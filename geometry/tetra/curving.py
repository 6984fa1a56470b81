"""The middles of edges put on the exact curved surfaces, but where that would spoil an element."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.snapping import Surface, snap
from geometry.tetra.tet_mesh import quadratic, scaled_jacobians

Indices = NDArray[np.int64]
_FLOOR = 0.03  # scaled Jacobian below which no element falls that was above it
_SHARES = (0.8, 0.7, 0.6, 0.5, 0.0, 0.0, 0.0)  # of its bend that an edge of a bad element keeps, step by step


def curved_mesh(
    corners: Points, tetrahedra: Indices, surfaces: list[Surface], *, faces: Indices, chosen: Indices, keep: float
) -> tuple[Points, Indices]:
    """Nodes and elements of the quadratic mesh whose interface edges follow the surfaces ``chosen`` (f,) of ``faces`` (f, 3).

    Edges of elements whose scaled Jacobian would fall below ``keep`` times the straight element's are straightened, step by step.
    """
    nodes, elements, pairs = quadratic(corners, tetrahedra)
    straight, count = nodes.copy(), len(corners)
    member = _edge_members(pairs, faces, chosen, len(surfaces), count)
    nodes[count:] = snap(surfaces, nodes[count:], member)
    bent = elements[np.flatnonzero(member[elements[:, 4:] - count].any(axis=(1, 2)))]
    before = scaled_jacobians(straight, bent)
    least = np.maximum(keep * before, np.minimum(0.9 * before, _FLOOR))
    for share in _SHARES:
        bad = scaled_jacobians(nodes, bent) < least
        if not bad.any():
            break
        middles = np.unique(bent[bad, 4:])
        nodes[middles] = straight[middles] + share * (nodes[middles] - straight[middles])
    return nodes, elements


def _edge_members(pairs: Indices, faces: Indices, chosen: Indices, surfaces: int, count: int) -> NDArray[np.bool_]:
    """Which surfaces each edge (m, 2) lies on, (m, surfaces): those of the faces beside it."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    keys = pairs[:, 0] * count + pairs[:, 1]  # the pairs are in order, so their keys are
    edge_keys = edges[:, 0] * count + edges[:, 1]
    index = np.clip(np.searchsorted(keys, edge_keys), 0, len(keys) - 1)
    hit = keys[index] == edge_keys
    member = np.zeros((len(pairs), surfaces), dtype=bool)
    member[index[hit], np.repeat(chosen, 3)[hit]] = True
    return member
