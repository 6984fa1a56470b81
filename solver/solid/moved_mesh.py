"""A mesh carried along with tumours that moved or changed size a little: nodes move, elements hang together as before.

Tumours take their nodes along affinely. Corners in the tissue follow as heat would spread through it, small elements being the
better conductors, so that they are stretched least; blocks, the tissue's top, floor and sides, planes between layers and the
reference cylinder stay:

    sum_e (1 / V_e) Int grad w_a . grad u dV = 0 at free corners a,  u = A' A^-1 (x - c) + c' - x in tumours     (SO.9)

Middles of edges then go to the exact surfaces. What comes out passes the checks of every mesh, none of its tetrahedra is much
larger than wanted or much flatter than before; else there is none, and another mesh is made.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from geometry.tetra.check import check
from geometry.tetra.layers import body_faces
from geometry.tetra.layout import BodyLayout, Ellipsoid
from geometry.tetra.mesher import space_of
from geometry.tetra.sizing import TetraFineness, sizes
from geometry.tetra.snapping import curved_mesh, exact_surfaces, memberships
from geometry.tetra.tet_mesh import BEYOND, INCLUSION, TISSUE, TetMesh, element_volumes, scaled_jacobians

KEEP = 0.2  # of its quality an element keeps when its edges are curved, as in ``geometry.tetra.regular_mesh``
LARGER = 1.2  # times the size wanted, over what it was before: the most that large tetrahedra may grow
FLATTER = 0.4  # of its scaled Jacobian, or of the mesh's tenth worst: the least that an element keeps
LARGE = 0.98  # share of tetrahedra below which the others count as large
FAR = 1.0  # of its least semi-axis: the farthest that a tumour moves
STRETCHED = 3.0  # principal stretches of an element, the largest in the mesh over the least: the most that is allowed
PER_EDGE = 6 * 2**0.5  # volumes of a regular tetrahedron in the cube of its edge


def may_move(before: BodyLayout, after: BodyLayout) -> bool:
    """Whether two layouts differ by the places and forms of their tumours alone, all ellipsoids, and by little."""
    if any(getattr(before, f.name) != getattr(after, f.name) for f in fields(BodyLayout) if f.name != "inclusions"):
        return False
    if len(before.inclusions) != len(after.inclusions):
        return False
    return all(_near(one, other) for one, other in zip(before.inclusions, after.inclusions, strict=True))


def _near(one: object, other: object) -> bool:
    if not (isinstance(one, Ellipsoid) and isinstance(other, Ellipsoid)):
        return False
    return bool(np.linalg.norm(other.centre - one.centre) + np.linalg.norm(other.axes - one.axes, 2) <= FAR * one.smallest)


def moved_mesh(mesh: TetMesh, before: BodyLayout, after: BodyLayout, fineness: TetraFineness) -> TetMesh | None:
    """Carry the mesh of a layout to another one that it may move to, see ``may_move``; None where it would be no good mesh."""
    count = int(mesh.elements[:, :4].max()) + 1
    points, cells, surfaces = mesh.nodes[:count], mesh.elements[:, :4], exact_surfaces(before)
    faces, chosen = body_faces(before, surfaces, points, cells, body=mesh.body, layer=mesh.layer)
    member = memberships(count, faces, chosen, len(surfaces))
    moved = points + _displacement(mesh, points, member, before, after)
    nodes, elements = curved_mesh(moved, cells, exact_surfaces(after), faces=faces, chosen=chosen, keep=KEEP)
    found = TetMesh(nodes, elements, mesh.body, mesh.beyond, mesh.layer, mesh.half)
    try:
        check(found, after)
    except SolveError:
        return None
    lengths = stretches(cells, mesh.nodes, nodes)
    straight = lengths.max() <= STRETCHED * lengths.min()
    return found if straight and _good(mesh, found, before, after, fineness) else None


def stretches(elements: Ints, before: Floats, after: Floats) -> Floats:
    """Principal stretches of elements (t, 4 or more) by their corners, for nodes (n, 3) before and after; (t, 3)."""
    edges = [nodes[elements[:, 1:4]] - nodes[elements[:, :1]] for nodes in (before, after)]
    return np.asarray(np.linalg.svd(np.linalg.solve(edges[0], edges[1]), compute_uv=False))


def _displacement(mesh: TetMesh, points: Floats, member: NDArray[np.bool_], before: BodyLayout, after: BodyLayout) -> Floats:
    """How far corners (n, 3) move, eq. SO.9."""
    u, cells, given = np.zeros_like(points), mesh.elements[:, :4], np.ones(len(points), dtype=bool)
    free = np.isin(mesh.body, [TISSUE, BEYOND])
    given[cells[free]] = False
    plane = member.shape[1] - len(before.interfaces) - 1  # of symmetry: behind those of the bodies
    first = plane - len(before.inclusions)
    held = np.asarray(member[:, :first].any(axis=1) | member[:, plane + 1 :].any(axis=1))
    given |= held
    for k, (one, other) in enumerate(zip(before.inclusions, after.inclusions, strict=True)):
        if not (isinstance(one, Ellipsoid) and isinstance(other, Ellipsoid)):
            continue
        own = np.unique(cells[mesh.body == INCLUSION + k])
        u[own] = other.centre + (points[own] - one.centre) @ np.linalg.solve(one.axes.T, other.axes.T) - points[own]
        given[own] = True
        u[own[held[own]]] = 0.0  # where a tumour is cut by what stays: the checks say whether that will do
    matrix = _conductance(points, cells[free])
    for given_here, columns in ((given, slice(0, 3, 2)), (given | member[:, plane], slice(1, 2))):
        inside = np.flatnonzero(~given_here)
        loads = -(matrix[inside][:, given_here] @ u[given_here][:, columns])
        u[inside, columns] = splu(matrix[inside][:, inside].tocsc()).solve(loads)
    return u


def _conductance(points: Floats, cells: Ints) -> sp.csr_array:
    """The matrix of eq. SO.9 on straight tetrahedra."""
    corners = points[cells]
    edges = corners[:, 1:] - corners[:, :1]
    slopes = np.swapaxes(np.linalg.inv(edges), 1, 2)
    gradients = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
    local = gradients @ np.swapaxes(gradients, 1, 2)  # the volume cancels
    rows, columns = np.repeat(cells, 4, axis=1).ravel(), np.tile(cells, (1, 4)).ravel()
    return sp.coo_array((local.ravel(), (rows, columns)), shape=(len(points),) * 2).tocsr()


def _good(mesh: TetMesh, found: TetMesh, before: BodyLayout, after: BodyLayout, fineness: TetraFineness) -> bool:
    """Whether tetrahedra are not much larger than wanted, nor much flatter than they were."""
    quality, was = (scaled_jacobians(one.nodes, one.elements) for one in (found, mesh))
    allowed = FLATTER * np.minimum(was, np.sort(was)[min(9, len(was) - 1)])
    large, large_before = (_oversize(*pair, fineness) for pair in ((found, after), (mesh, before)))
    return bool(np.all(quality >= allowed)) and large <= LARGER * large_before


def _oversize(mesh: TetMesh, layout: BodyLayout, fineness: TetraFineness) -> float:
    """Edges of large tetrahedra in the tissue and its tumours over those wanted there."""
    inside = mesh.body >= TISSUE
    middles = mesh.nodes[mesh.elements[inside, :4]].mean(axis=1)
    edges = np.cbrt(PER_EDGE * element_volumes(mesh.nodes, mesh.elements[inside]))
    return float(np.quantile(edges / sizes(layout, fineness, space_of(layout, fineness), middles), LARGE))
