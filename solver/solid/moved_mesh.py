"""Move an existing mesh with tumours, layer planes and tissue walls that moved or changed size a little.

Nodes move; elements keep their nodes. Nodes of tumours move affinely with them, those of blocks and of the reference cylinder
stay. Nodes on the tissue's top, bottom, side and layer planes move to the new surfaces. All other corners x of the tissue move
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
from geometry.tetra.body_layout import BodyLayout, Ellipsoid
from geometry.tetra.layers import find_body_faces
from geometry.tetra.mesh_check import check_mesh
from geometry.tetra.sizing import TetraFineness, choose_space, compute_sizes
from geometry.tetra.snapping import build_exact_surfaces, curve_mesh, find_memberships, snap
from geometry.tetra.tet_mesh import MeshBody, TetMesh, compute_scaled_jacobians, compute_volumes

MIN_CURVED_QUALITY = 0.2  # of an element's quality, when its edges are curved; as in ``geometry.tetra.regular_mesh``
MAX_OVERSIZE_GROWTH = 1.2  # maximum growth of large tetrahedra relative to the wanted size
MIN_QUALITY_SHARE = 0.4  # of an element's scaled Jacobian before, or of the mesh's tenth worst
LARGE_QUANTILE = 0.98  # quantile of sizes above which tetrahedra count as large
MAX_MOVE_RELATIVE = 1.0  # of a tumour's shortest semi-axis: its maximum displacement
MAX_THICKNESS_FACTOR = 1.3  # maximum change of a layer's thickness or the tissue's size
MOVABLE_FIELDS = "inclusions", "tissue_radius", "depth", "interfaces"  # fields of a layout that may change
MAX_STRETCH_RATIO = 3.0  # maximum over minimum principal stretch of all elements
TOP_SURFACE, FLOOR_SURFACE, GROOVE_SURFACES = 5, 6, 3  # indices in ``build_exact_surfaces``; number of groove surfaces
PER_EDGE = 6 * 2**0.5  # cube of a regular tetrahedron's edge over its volume


def remove_movable_sizes(layout: BodyLayout) -> BodyLayout:
    """Return the layout without all that a moved mesh may change: layouts with equal results differ only in this."""
    sides = None if layout.tissue_radius is None else 0.0  # 0 only marks that there are sides
    return replace(layout, inclusions=(), tissue_radius=sides, depth=0.0, interfaces=(0.0,) * len(layout.interfaces))


def may_move(old_layout: BodyLayout, new_layout: BodyLayout) -> bool:
    """Return whether two layouts differ only a little, and only in ellipsoidal tumours and the tissue's sizes."""
    is_same = all(
        getattr(old_layout, f.name) == getattr(new_layout, f.name) for f in fields(BodyLayout) if f.name not in MOVABLE_FIELDS
    )
    if (
        not is_same
        or len(old_layout.inclusions) != len(new_layout.inclusions)
        or len(old_layout.interfaces) != len(new_layout.interfaces)
    ):
        return False
    is_near = all(
        _is_near(item, moved_item) for item, moved_item in zip(old_layout.inclusions, new_layout.inclusions, strict=True)
    )
    sizes = [
        np.array([item.tissue_radius or 1.0, *np.diff([0.0, *item.interfaces, item.depth])]) for item in (old_layout, new_layout)
    ]
    return is_near and bool(np.all(np.abs(np.log(sizes[1] / sizes[0])) <= np.log(MAX_THICKNESS_FACTOR)))


def _is_near(old: object, new: object) -> bool:
    """Return whether two inclusions are ellipsoids whose centres and axes differ only a little."""
    if not (isinstance(old, Ellipsoid) and isinstance(new, Ellipsoid)):
        return False
    return bool(
        np.linalg.norm(new.centre - old.centre) + np.linalg.norm(new.axes - old.axes, 2) <= MAX_MOVE_RELATIVE * old.min_semi_axis
    )


def move_mesh(mesh: TetMesh, old_layout: BodyLayout, new_layout: BodyLayout, fineness: TetraFineness) -> TetMesh | None:
    """Move the mesh of a layout to another layout, see ``may_move``; return None if the result is not good enough.

    Parameters
    ----------
    mesh, old_layout
        The mesh and its layout.
    new_layout
        The layout to move it to.
    fineness
        Fineness of the mesh, for the check of its sizes.
    """
    # corners have lower numbers than mid-edge nodes
    count = int(mesh.elements[:, :4].max()) + 1
    points, cells, surfaces = mesh.nodes[:count], mesh.elements[:, :4], build_exact_surfaces(old_layout)
    faces, chosen = find_body_faces(old_layout, surfaces, points, cells, body=mesh.body, layer=mesh.layer)
    member = find_memberships(count, faces, chosen, len(surfaces))
    moved = snap(
        build_exact_surfaces(new_layout), points + _compute_displacement(mesh, points, member, old_layout, new_layout), member
    )
    nodes, elements = curve_mesh(
        moved, cells, build_exact_surfaces(new_layout), faces=faces, chosen=chosen, keep=MIN_CURVED_QUALITY
    )
    result = TetMesh(nodes, elements, mesh.body, mesh.beyond, mesh.layer, mesh.half)
    try:
        check_mesh(result, new_layout)
    except SolveError:
        return None
    lengths = compute_stretches(cells, mesh.nodes, nodes)
    straight = lengths.max() <= MAX_STRETCH_RATIO * lengths.min()
    return result if straight and _is_good(mesh, result, old_layout, new_layout, fineness) else None


def compute_stretches(elements: Ints, old_nodes: Floats, new_nodes: Floats) -> Floats:
    """Return the principal stretches, (t, 3), of elements (t, 4 or more) whose corner nodes move; nodes are (n, 3)."""
    edges = [nodes[elements[:, 1:4]] - nodes[elements[:, :1]] for nodes in (old_nodes, new_nodes)]
    return np.asarray(np.linalg.svd(np.linalg.solve(edges[0], edges[1]), compute_uv=False))


def _compute_displacement(
    mesh: TetMesh, points: Floats, member: NDArray[np.bool_], old_layout: BodyLayout, new_layout: BodyLayout
) -> Floats:
    """Compute the displacements of the elements' corners by eq. SO.9.

    Parameters
    ----------
    mesh
        The mesh to move.
    points
        Its corners, m, shape (n, 3).
    member
        Mask of the exact surfaces that each corner lies on, shape (n, surfaces).
    old_layout, new_layout
        Layouts before and after.

    Returns
    -------
    Floats
        Displacements, m, shape (n, 3).
    """
    cells, free = mesh.elements[:, :4], np.isin(mesh.body, [MeshBody.TISSUE, MeshBody.BEYOND])
    u, given = _move_tumours(mesh, points, old_layout, new_layout)
    _set_surface_displacements(u, given, points, member, (old_layout, new_layout))
    given[np.unique(cells[mesh.body < MeshBody.TISSUE])] = True  # blocks stay
    given[np.setdiff1d(np.arange(len(points)), cells[free])] = True
    matrix = _assemble_conductance(points, cells[free])
    for k in range(3):
        inside, known = np.flatnonzero(~given[:, k]), np.flatnonzero(given[:, k])
        if len(inside) and u[known, k].any():
            loads = -(matrix[inside][:, known] @ u[known, k])
            u[inside, k] = splu(matrix[inside][:, inside].tocsc()).solve(loads)
    return u


def _move_tumours(
    mesh: TetMesh, points: Floats, old_layout: BodyLayout, new_layout: BodyLayout
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return displacements of all corners, m, zero outside tumours, and the mask of those in tumours, shape (n, 3) both."""
    u, given = np.zeros_like(points), np.zeros(points.shape, dtype=bool)
    for k, (old, new) in enumerate(zip(old_layout.inclusions, new_layout.inclusions, strict=True)):
        if isinstance(old, Ellipsoid) and isinstance(new, Ellipsoid):
            corners = np.unique(mesh.elements[mesh.body == MeshBody.FIRST_INCLUSION + k, :4])
            u[corners] = new.centre + (points[corners] - old.centre) @ np.linalg.solve(old.axes.T, new.axes.T) - points[corners]
            given[corners] = True
    return u, given


def _set_surface_displacements(
    u: Floats, given: NDArray[np.bool_], points: Floats, member: NDArray[np.bool_], layouts: tuple[BodyLayout, BodyLayout]
) -> None:
    """Set and mark the displacements prescribed by planes, the tissue's sides and the reference cylinder, in place.

    Parameters
    ----------
    u, given
        Displacements, m, and the mask of those that are prescribed, shape (n, 3) each; changed.
    points
        The corners, m, shape (n, 3).
    member
        Mask of the exact surfaces that each corner lies on, shape (n, surfaces); see ``build_exact_surfaces`` for their order.
    layouts
        Layouts before and after.
    """
    old_layout, new_layout = layouts
    mirror = member.shape[1] - len(old_layout.interfaces) - 1  # behind the bodies' surfaces
    # rise of each horizontal plane: z is minus the depth
    heights = {TOP_SURFACE: 0.0, FLOOR_SURFACE: old_layout.depth - new_layout.depth}
    heights |= {mirror + 1 + k: a - b for k, (a, b) in enumerate(zip(old_layout.interfaces, new_layout.interfaces, strict=True))}
    for plane, height_change in heights.items():
        on_surface = member[:, plane]
        u[on_surface, 2], given[on_surface, 2] = height_change, True
    on_surface = member[:, mirror]
    u[on_surface, 1], given[on_surface, 1] = 0.0, True
    first = FLOOR_SURFACE + 1 + (GROOVE_SURFACES if old_layout.groove is not None else 0)
    for side in range(first, mirror - len(old_layout.inclusions)):
        side_nodes = np.flatnonzero(member[:, side])
        # the cylinder's side, the first, moves in proportion to its radius; flat sides and the reference cylinder stay
        wider = (new_layout.tissue_radius or 1.0) / (old_layout.tissue_radius or 1.0) if side == first else 1.0
        u[side_nodes, :2] = (wider - 1.0) * (points[side_nodes, :2] - old_layout.centre)
        given[side_nodes, :2] = True


def _assemble_conductance(points: Floats, cells: Ints) -> sp.csr_array:
    """Assemble the matrix of eq. SO.9 on straight tetrahedra: corners ``points``, (n, 3), of ``cells``, (t, 4); shape (n, n)."""
    corners = points[cells]
    edges = corners[:, 1:] - corners[:, :1]
    derivatives = np.swapaxes(np.linalg.inv(edges), 1, 2)
    gradients = np.concatenate([-derivatives.sum(axis=1, keepdims=True), derivatives], axis=1)
    local = gradients @ np.swapaxes(gradients, 1, 2)  # the volume cancels
    rows, columns = np.repeat(cells, 4, axis=1).ravel(), np.tile(cells, (1, 4)).ravel()
    return sp.coo_array((local.ravel(), (rows, columns)), shape=(len(points),) * 2).tocsr()


def _is_good(mesh: TetMesh, result: TetMesh, old_layout: BodyLayout, new_layout: BodyLayout, fineness: TetraFineness) -> bool:
    """Return whether no tetrahedron of the moved mesh, ``result``, is much larger than wanted or much flatter than before."""
    quality, old_quality = (compute_scaled_jacobians(item.nodes, item.elements) for item in (result, mesh))
    allowed = MIN_QUALITY_SHARE * np.minimum(old_quality, np.sort(old_quality)[min(9, len(old_quality) - 1)])
    large, large_before = (_compute_oversize(*pair, fineness) for pair in ((result, new_layout), (mesh, old_layout)))
    return bool(np.all(quality >= allowed)) and large <= MAX_OVERSIZE_GROWTH * large_before


def _compute_oversize(mesh: TetMesh, layout: BodyLayout, fineness: TetraFineness) -> float:
    """Return the edge length of large tetrahedra in tissue and tumours relative to the wanted length (``LARGE_QUANTILE``)."""
    inside = mesh.body >= MeshBody.TISSUE
    middles = mesh.nodes[mesh.elements[inside, :4]].mean(axis=1)
    edges = np.cbrt(PER_EDGE * compute_volumes(mesh.nodes, mesh.elements[inside]))
    return float(np.quantile(edges / compute_sizes(layout, fineness, choose_space(layout, fineness), middles), LARGE_QUANTILE))
