"""Move an existing mesh with tumours, layer planes and tissue walls that moved or changed size a little.

Nodes move; elements keep their nodes. Nodes of tumours move affinely with them, those of blocks and of the reference cylinder
stay. Nodes on the tissue's top, floor, side and layer planes move to the new surfaces. All other corners x of the tissue move
by u, from a diffusion equation for each coordinate, with a higher conductivity for small elements so that they deform least:

    sum_e (1 / V_e) Int grad w_a . grad u dV = 0 at free corners a,  u = A' A^-1 (x - c) + c' - x in tumours     (SO.9)

with elements e of volume V_e, hat functions w_a, and tumours' centres c, c' and axes A, A' before and after. Corners and mid-edge
nodes are then projected on the exact surfaces. The result must pass the checks of every mesh, and no tetrahedron may be much
larger than wanted or much flatter than before; else a new mesh is made.
"""

from __future__ import annotations

from dataclasses import fields, replace

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
from geometry.tetra.snapping import curved_mesh, exact_surfaces, memberships, snap
from geometry.tetra.tet_mesh import BEYOND, INCLUSION, TISSUE, TetMesh, element_volumes, scaled_jacobians

KEEP = 0.2  # of an element's quality, when its edges are curved; as in ``geometry.tetra.regular_mesh``
LARGER = 1.2  # maximum growth of large tetrahedra relative to the wanted size
FLATTER = 0.4  # of an element's scaled Jacobian before, or of the mesh's tenth worst
LARGE = 0.98  # quantile of sizes above which tetrahedra count as large
FAR = 1.0  # of a tumour's shortest semi-axis: its maximum displacement
THICKER = 1.3  # maximum change of a layer's thickness or the tissue's size
MOVABLE = "inclusions", "tissue_radius", "depth", "interfaces"  # fields of a layout that may change
STRETCHED = 3.0  # maximum over minimum principal stretch of all elements
TOP, FLOOR, GROOVES = 5, 6, 3  # indices in ``exact_surfaces``; number of groove surfaces
PER_EDGE = 6 * 2**0.5  # cube of a regular tetrahedron's edge over its volume


def unmoved(layout: BodyLayout) -> BodyLayout:
    """Return the layout without all that a moved mesh may change."""
    sides = None if layout.tissue_radius is None else 0.0
    return replace(layout, inclusions=(), tissue_radius=sides, depth=0.0, interfaces=(0.0,) * len(layout.interfaces))


def may_move(before: BodyLayout, after: BodyLayout) -> bool:
    """Return whether two layouts differ only a little, and only in ellipsoidal tumours and the tissue's sizes."""
    alike = all(getattr(before, f.name) == getattr(after, f.name) for f in fields(BodyLayout) if f.name not in MOVABLE)
    if not alike or len(before.inclusions) != len(after.inclusions) or len(before.interfaces) != len(after.interfaces):
        return False
    near = all(_near(one, other) for one, other in zip(before.inclusions, after.inclusions, strict=True))
    sizes = [np.array([one.tissue_radius or 1.0, *np.diff([0.0, *one.interfaces, one.depth])]) for one in (before, after)]
    return near and bool(np.all(np.abs(np.log(sizes[1] / sizes[0])) <= np.log(THICKER)))


def _near(one: object, other: object) -> bool:
    """Return whether two inclusions are ellipsoids that differ only a little."""
    if not (isinstance(one, Ellipsoid) and isinstance(other, Ellipsoid)):
        return False
    return bool(np.linalg.norm(other.centre - one.centre) + np.linalg.norm(other.axes - one.axes, 2) <= FAR * one.smallest)


def moved_mesh(mesh: TetMesh, before: BodyLayout, after: BodyLayout, fineness: TetraFineness) -> TetMesh | None:
    """Move the mesh of a layout to another layout, see ``may_move``; return None if the result is not good enough."""
    count = int(mesh.elements[:, :4].max()) + 1
    points, cells, surfaces = mesh.nodes[:count], mesh.elements[:, :4], exact_surfaces(before)
    faces, chosen = body_faces(before, surfaces, points, cells, body=mesh.body, layer=mesh.layer)
    member = memberships(count, faces, chosen, len(surfaces))
    moved = snap(exact_surfaces(after), points + _displacement(mesh, points, member, before, after), member)
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
    """Return the principal stretches, (t, 3), of elements (t, 4 or more) whose corner nodes move; nodes are (n, 3)."""
    edges = [nodes[elements[:, 1:4]] - nodes[elements[:, :1]] for nodes in (before, after)]
    return np.asarray(np.linalg.svd(np.linalg.solve(edges[0], edges[1]), compute_uv=False))


def _displacement(mesh: TetMesh, points: Floats, member: NDArray[np.bool_], before: BodyLayout, after: BodyLayout) -> Floats:
    """Compute the displacements of corners, (n, 3), by eq. SO.9."""
    cells, free = mesh.elements[:, :4], np.isin(mesh.body, [TISSUE, BEYOND])
    u, given = _tumours(mesh, points, before, after)
    _set_by_surfaces(u, given, points, member, (before, after))
    given[np.unique(cells[mesh.body < TISSUE])] = True
    given[np.setdiff1d(np.arange(len(points)), cells[free])] = True
    matrix = _conductance(points, cells[free])
    for k in range(3):
        inside, known = np.flatnonzero(~given[:, k]), np.flatnonzero(given[:, k])
        if len(inside) and u[known, k].any():
            loads = -(matrix[inside][:, known] @ u[known, k])
            u[inside, k] = splu(matrix[inside][:, inside].tocsc()).solve(loads)
    return u


def _tumours(mesh: TetMesh, points: Floats, before: BodyLayout, after: BodyLayout) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the displacements of tumours' corners, (n, 3), and the mask of these, (n, 3)."""
    u, given = np.zeros_like(points), np.zeros(points.shape, dtype=bool)
    for k, (one, other) in enumerate(zip(before.inclusions, after.inclusions, strict=True)):
        if isinstance(one, Ellipsoid) and isinstance(other, Ellipsoid):
            own = np.unique(mesh.elements[mesh.body == INCLUSION + k, :4])
            u[own] = other.centre + (points[own] - one.centre) @ np.linalg.solve(one.axes.T, other.axes.T) - points[own]
            given[own] = True
    return u, given


def _set_by_surfaces(
    u: Floats, given: NDArray[np.bool_], points: Floats, member: NDArray[np.bool_], layouts: tuple[BodyLayout, BodyLayout]
) -> None:
    """Set and mark the displacements (n, 3) prescribed by planes, the tissue's sides and the reference cylinder."""
    before, after = layouts
    mirror = member.shape[1] - len(before.interfaces) - 1  # behind the bodies' surfaces
    heights = {TOP: 0.0, FLOOR: before.depth - after.depth}
    heights |= {mirror + 1 + k: a - b for k, (a, b) in enumerate(zip(before.interfaces, after.interfaces, strict=True))}
    for plane, up in heights.items():
        on = member[:, plane]
        u[on, 2], given[on, 2] = up, True
    on = member[:, mirror]
    u[on, 1], given[on, 1] = 0.0, True
    first = FLOOR + 1 + (GROOVES if before.groove is not None else 0)
    for side in range(first, mirror - len(before.inclusions)):
        beside = np.flatnonzero(member[:, side])
        wider = (after.tissue_radius or 1.0) / (before.tissue_radius or 1.0) if side == first else 1.0
        u[beside, :2] = (wider - 1.0) * (points[beside, :2] - before.centre)
        given[beside, :2] = True


def _conductance(points: Floats, cells: Ints) -> sp.csr_array:
    """Assemble the matrix of eq. SO.9 on straight tetrahedra."""
    corners = points[cells]
    edges = corners[:, 1:] - corners[:, :1]
    slopes = np.swapaxes(np.linalg.inv(edges), 1, 2)
    gradients = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
    local = gradients @ np.swapaxes(gradients, 1, 2)  # the volume cancels
    rows, columns = np.repeat(cells, 4, axis=1).ravel(), np.tile(cells, (1, 4)).ravel()
    return sp.coo_array((local.ravel(), (rows, columns)), shape=(len(points),) * 2).tocsr()


def _good(mesh: TetMesh, found: TetMesh, before: BodyLayout, after: BodyLayout, fineness: TetraFineness) -> bool:
    """Return whether no tetrahedron is much larger than wanted or much flatter than before."""
    quality, was = (scaled_jacobians(one.nodes, one.elements) for one in (found, mesh))
    allowed = FLATTER * np.minimum(was, np.sort(was)[min(9, len(was) - 1)])
    large, large_before = (_oversize(*pair, fineness) for pair in ((found, after), (mesh, before)))
    return bool(np.all(quality >= allowed)) and large <= LARGER * large_before


def _oversize(mesh: TetMesh, layout: BodyLayout, fineness: TetraFineness) -> float:
    """Return the edge length of large tetrahedra in tissue and tumours relative to the wanted length."""
    inside = mesh.body >= TISSUE
    middles = mesh.nodes[mesh.elements[inside, :4]].mean(axis=1)
    edges = np.cbrt(PER_EDGE * element_volumes(mesh.nodes, mesh.elements[inside]))
    return float(np.quantile(edges / sizes(layout, fineness, space_of(layout, fineness), middles), LARGE))
