"""Add layers of tissue to a mesh made without them: cut its tetrahedra by the planes between layers.

Corners near a plane move onto it, along the surfaces that they lie on; edges that still cross it get a corner where they do.
So a layer costs only the tetrahedra that its planes cut. Far from the probe, where fields change slowly, they may be flat:
``sizing.py`` makes them no longer than five thicknesses, or they would be needles. A cut edge is halved in all tetrahedra round
it, in one order for all, so that faces stay common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.smoothing import compute_mean_ratios, smooth, undo_inversions
from geometry.tetra.snapping import Surface, find_interfaces, find_memberships, find_surfaces, snap
from geometry.tetra.tet_mesh import EDGE_CORNERS, MeshBody

Indices = NDArray[np.int64]
_MAX_MOVE_TO_PLANE = 0.3  # of the shortest edge that crosses a plane: how far its corners move onto the plane
_MIN_KEPT_QUALITY = 0.2  # of its quality: a tetrahedron that would keep less when its corners move so stays as it is
_MEND_BELOW_RATIO = 0.15  # mean ratio below which tetrahedra are mended
_MIN_MENDED_RATIO = 0.05  # those that stay below this are put back to where they were cut
_QUALITY_FACTOR = 0.5  # unless they have kept this fraction of the mean ratio that they had there
_RELATIVE_TOLERANCE = 1e-10  # of the largest coordinate: corners so near a plane are on it
_MAX_MOVE_RELATIVE = 0.5  # of its shortest edge: how far a corner moves to where a plane cuts its surfaces


@dataclass(frozen=True)
class LayeredCells:
    """Straight tetrahedra that no plane between layers crosses.

    Attributes
    ----------
    points
        (n, 3) in m.
    cells
        (t, 4).
    parent
        For each, the row of the tetrahedron that it was cut from, (t,).
    layer
        Of each, as in ``TetMesh``, (t,).
    faces
        Between bodies, between layers and outside, (f, 3).
    chosen
        Index of the exact surface that each face represents, (f,).
    """

    points: Points
    cells: Indices
    parent: Indices
    layer: Indices
    faces: Indices
    chosen: Indices


def find_layers(layout: BodyLayout, heights: Points) -> Indices:
    """Return the numbers (n,) of the layers at heights z (n,): 1 for the first below the surface and so on.

    Below all layers it is 0, the tissue's own material.
    """
    number = 1 + np.searchsorted(np.array(layout.interfaces), -heights)
    return np.where(number > len(layout.interfaces), 0, number)


def cut_by_planes(
    layout: BodyLayout, surfaces: list[Surface], points: Points, cells: Indices, *, body: Indices, member: NDArray[np.bool_]
) -> LayeredCells:
    """Cut straight tetrahedra by all planes between layers, and move corners onto their surfaces.

    Parameters
    ----------
    layout
        The bodies.
    surfaces
        All exact surfaces of the scene, the planes between layers last.
    points
        Corners, (n, 3).
    cells
        Tetrahedra, (t, 4).
    body
        Label of each tetrahedron, as in ``TetMesh``, (t,).
    member
        Which surfaces each corner lies on, (n, surfaces).

    Raises
    ------
    SolveError
        Bodies share a face in the mesh that are apart in the scene.
    """
    parent, first = np.arange(len(cells)), len(surfaces) - len(layout.interfaces)
    for plane, depth in enumerate(layout.interfaces, first):
        points = _move_to_plane(surfaces, points, cells, member, plane)
        points, cells, source = split_at_height(points, cells, -depth)
        parent, new = parent[source], np.zeros((len(points) - len(member), len(surfaces)), dtype=bool)
        new[:, plane] = True
        member = np.vstack([member, new])
    layer = find_layers(layout, points[cells, 2].mean(axis=1))
    faces, chosen = find_body_faces(layout, surfaces, points, cells, body=body[parent], layer=layer)
    member = find_memberships(len(points), faces, chosen, len(surfaces))
    return LayeredCells(_mend(surfaces, points, cells, member), cells, parent, layer, faces, chosen)


def split_at_height(points: Points, cells: Indices, height: float) -> tuple[Points, Indices, Indices]:
    """Cut tetrahedra by the plane z = height.

    Every edge that crosses the plane gets a corner there, and all tetrahedra round it are halved; the longest edges come first.

    Returns
    -------
    tuple[Points, Indices, Indices]
        Points (n, 3), the new ones last; tetrahedra (t, 4); for each, the row of the one that it was cut from (t,).
    """
    offset = points[:, 2] - height
    side, parent = (
        np.where(np.abs(offset) <= _RELATIVE_TOLERANCE * np.abs(points).max(), 0.0, np.sign(offset)),
        np.arange(len(cells)),
    )
    pairs = np.sort(cells[:, EDGE_CORNERS], axis=2)  # edges by their two corners; those that cross the plane are kept
    pairs = np.unique(pairs[side[pairs].prod(axis=2) < 0], axis=0)
    if len(pairs) == 0:
        return points, cells, parent
    pairs = pairs[np.argsort(-np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1), kind="stable")]
    # each end's distance from the plane over the sum of both: the weight of the other end in the new corner
    fraction = np.abs(points[pairs, 2] - height)
    fraction /= fraction.sum(axis=1, keepdims=True)
    new = fraction[:, 1:] * points[pairs[:, 0]] + fraction[:, :1] * points[pairs[:, 1]]
    new[:, 2] = height  # exactly, without rounding errors
    keys = pairs[:, 0] * len(points) + pairs[:, 1]
    order = np.argsort(keys)
    while True:  # each round halves every crossing tetrahedron at the first of its crossing edges
        ends = np.sort(cells[:, EDGE_CORNERS], axis=2)
        crossing = np.append(side, np.zeros(len(new)))[ends].prod(axis=2) < 0
        rows = np.flatnonzero(crossing.any(axis=1))
        if len(rows) == 0:
            return np.vstack([points, new]), cells, parent
        rank = np.full((len(rows), len(EDGE_CORNERS)), len(keys))  # place of each edge in ``pairs``; last where it does not cross
        crossing_edges = ends[rows][crossing[rows]]
        rank[crossing[rows]] = order[
            np.searchsorted(keys, crossing_edges[:, 0] * len(points) + crossing_edges[:, 1], sorter=order)
        ]
        first = rank.argmin(axis=1)
        middle, first_half, second_half = len(points) + rank.min(axis=1), cells[rows].copy(), cells[rows].copy()
        indices = np.arange(len(rows))
        first_half[indices, EDGE_CORNERS[first, 1]], second_half[indices, EDGE_CORNERS[first, 0]] = middle, middle
        cells, parent = np.vstack([cells, second_half]), np.concatenate([parent, parent[rows]])
        cells[rows] = first_half


def _move_to_plane(surfaces: list[Surface], points: Points, cells: Indices, member: NDArray[np.bool_], plane: int) -> Points:
    """Move points (n, 3) near the surface ``plane`` (an index) onto it, along their other surfaces.

    A corner stays where the move would make a tetrahedron round it too bad, or would be too long.
    """
    height = surfaces[plane].level(points)[0]
    ends = cells[:, EDGE_CORNERS].reshape(-1, 2)
    shortest = _find_shortest_edges(points, ends[height[ends].prod(axis=1) < 0])
    near_corners = np.flatnonzero(np.abs(height) < _MAX_MOVE_TO_PLANE * shortest)
    target_member = member[near_corners]
    target_member[:, plane] = True
    target = points.copy()
    target[near_corners] = snap(surfaces, points[near_corners], target_member)
    distance_left = np.abs(surfaces[plane].level(target)[0])
    is_reached = (distance_left <= _RELATIVE_TOLERANCE * np.abs(points).max() / 2) & (
        np.linalg.norm(target - points, axis=1) < _MAX_MOVE_RELATIVE * shortest
    )
    chosen = np.zeros(len(points), dtype=bool)
    chosen[near_corners] = is_reached[near_corners]
    touched = cells[chosen[cells].any(axis=1)]
    min_ratio = _MIN_KEPT_QUALITY * compute_mean_ratios(points, touched)
    while True:
        result = np.where(chosen[:, None], target, points)
        spoilt = touched[(compute_mean_ratios(result, touched) < min_ratio) & chosen[touched].any(axis=1)]
        if len(spoilt) == 0:
            return result
        farthest = np.where(chosen[spoilt], np.abs(height[spoilt]), -1.0).argmax(axis=1)
        chosen[spoilt[np.arange(len(spoilt)), farthest]] = False


def _find_shortest_edges(points: Points, ends: Indices) -> Points:
    """Return the length (n,) of the shortest edge at each point (n, 3), 0 where there is none.

    ``ends`` (m, 2) are the edges' points.
    """
    result = np.full(len(points), np.inf)
    np.minimum.at(result, ends, np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)[:, None])
    result[np.isinf(result)] = 0.0
    return result


def find_body_faces(
    layout: BodyLayout, surfaces: list[Surface], points: Points, cells: Indices, *, body: Indices, layer: Indices
) -> tuple[Indices, Indices]:
    """Return the faces (f, 3) between bodies and between layers, and the indices (f,) of the surfaces that they represent.

    ``body`` and ``layer`` (t,) are the labels of the tetrahedra ``cells`` (t, 4), as in ``TetMesh``.

    Raises
    ------
    SolveError
        Two bodies share a face, and no surface of the scene lies between them.
    """
    faces, first_body, second_body = find_interfaces(cells, body)
    # outer faces of a half mesh in the plane of symmetry, y = 0, have the mirror image behind them, not air
    in_symmetry_plane = (np.abs(points[faces, 1]) <= 1e-9 * np.abs(points).max()).all(axis=1)
    second_body = np.where(in_symmetry_plane & (second_body == MeshBody.AIR) & layout.half, MeshBody.MIRROR, second_body)
    chosen = find_surfaces(surfaces, points, faces, first_body, second_body)
    if not layout.interfaces:
        return faces, chosen
    layer_faces, upper_layer, lower_layer = find_interfaces(cells, np.where(body >= 0, layer, MeshBody.AIR))
    # a face with a corner on the tissue's surface, z = 0, is none between layers
    layer_faces = layer_faces[(upper_layer >= 0) & (lower_layer >= 0) & (points[layer_faces, 2].max(axis=1) < 0)]
    first = len(surfaces) - len(layout.interfaces)  # the planes between layers are the last surfaces
    # interfaces are depths, positive downwards: the plane at z = -depth that is nearest to the face's middle
    planes = first + np.abs(points[layer_faces, 2].mean(axis=1)[:, None] + np.array(layout.interfaces)).argmin(axis=1)
    return np.vstack([faces, layer_faces]), np.concatenate([chosen, planes])


def _mend(surfaces: list[Surface], points: Points, cells: Indices, member: NDArray[np.bool_]) -> Points:
    """Move points (n, 3) onto their surfaces and smooth bad tetrahedra, except where others would become worse than allowed."""
    exact = snap(surfaces, points, member)
    is_near = np.linalg.norm(exact - points, axis=1) < _MAX_MOVE_RELATIVE * _find_shortest_edges(
        points, cells[:, EDGE_CORNERS].reshape(-1, 2)
    )
    quality = compute_mean_ratios(points, cells)
    better = smooth(np.where(is_near[:, None], exact, points), cells, surfaces, member, min_ratio=_MEND_BELOW_RATIO, rounds=6)
    return undo_inversions(better, points, cells, np.minimum(_MIN_MENDED_RATIO, _QUALITY_FACTOR * quality))
