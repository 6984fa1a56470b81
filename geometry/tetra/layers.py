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
from geometry.common.errors import SolveError
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.smoothing import compute_mean_ratios, smooth, undo_inversions
from geometry.tetra.snapping import Surface, find_interfaces, find_memberships, find_surfaces, snap
from geometry.tetra.tet_mesh import AIR_LABEL, EDGE_CORNERS, MIRROR_LABEL

Indices = NDArray[np.int64]
_MAX_MOVE_TO_PLANE = 0.3  # of the shortest edge that crosses a plane: how far its corners move onto the plane
_MIN_KEPT_QUALITY = 0.2  # of its quality a tetrahedron keeps when its corners move so, or they do not
_MEND_BELOW_RATIO = 0.15  # mean ratio below which tetrahedra are mended
_MIN_MENDED_RATIO = 0.05  # those that stay below this are put back to where they were cut
_QUALITY_FACTOR = 0.5  # but for those that were not this many times better there
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
        Of each the tetrahedron that it was cut from, (t,).
    layer
        Of each, as in ``TetMesh``, (t,).
    faces
        Between bodies, between layers and outside, (f, 3).
    chosen
        The surface that each face stands for, (f,).
    """

    points: Points
    cells: Indices
    parent: Indices
    layer: Indices
    faces: Indices
    chosen: Indices


def find_layers(layout: BodyLayout, heights: Points) -> Indices:
    """Return layers of tissue at heights (n,): 1 for the first below the surface and so on, 0 for the tissue's own material."""
    number = 1 + np.searchsorted(np.array(layout.interfaces), -heights)
    return np.where(number > len(layout.interfaces), 0, number)


def cut_by_planes(
    layout: BodyLayout, surfaces: list[Surface], points: Points, cells: Indices, *, body: Indices, member: NDArray[np.bool_]
) -> LayeredCells:
    """Cut straight tetrahedra (t, 4) of bodies (t,) by all planes between layers.

    Parameters
    ----------
    layout
        The bodies.
    surfaces
        All exact ones, the planes between layers last.
    points
        Corners, (n, 3).
    cells
        (t, 4).
    body
        Of each tetrahedron.
    member
        Which surfaces each corner lies on, (n, surfaces).

    Raises
    ------
    SolveError
        Bodies touch that do not in the scene.
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
    """Cut tetrahedra by plane z = height; return points (n, 3), tetrahedra (t, 4) and of each the one it was cut from (t,)."""
    offset = points[:, 2] - height
    side, parent = (
        np.where(np.abs(offset) <= _RELATIVE_TOLERANCE * np.abs(points).max(), 0.0, np.sign(offset)),
        np.arange(len(cells)),
    )
    pairs = np.sort(cells[:, EDGE_CORNERS], axis=2)
    pairs = np.unique(pairs[side[pairs].prod(axis=2) < 0], axis=0)
    if len(pairs) == 0:
        return points, cells, parent
    pairs = pairs[np.argsort(-np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1), kind="stable")]
    share = np.abs(points[pairs, 2] - height)
    share /= share.sum(axis=1, keepdims=True)
    new = share[:, 1:] * points[pairs[:, 0]] + share[:, :1] * points[pairs[:, 1]]
    new[:, 2] = height
    keys = pairs[:, 0] * len(points) + pairs[:, 1]
    order = np.argsort(keys)
    while True:
        ends = np.sort(cells[:, EDGE_CORNERS], axis=2)
        crossing = np.append(side, np.zeros(len(new)))[ends].prod(axis=2) < 0
        rows = np.flatnonzero(crossing.any(axis=1))
        if len(rows) == 0:
            return np.vstack([points, new]), cells, parent
        rank = np.full((len(rows), len(EDGE_CORNERS)), len(keys))
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
    """Move points (n, 3) near a plane (its index) onto it, along their surfaces, where that spoils no tetrahedron."""
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
    """Return for each point (n, 3) the length of the shortest of its edges (m, 2), 0 if it has none."""
    result = np.full(len(points), np.inf)
    np.minimum.at(result, ends, np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)[:, None])
    result[np.isinf(result)] = 0.0
    return result


def find_body_faces(
    layout: BodyLayout, surfaces: list[Surface], points: Points, cells: Indices, *, body: Indices, layer: Indices
) -> tuple[Indices, Indices]:
    """Find the faces (f, 3) between bodies and between layers, and their surfaces (f,)."""
    faces, first_body, second_body = find_interfaces(cells, body)
    flat = (np.abs(points[faces, 1]) <= 1e-9 * np.abs(points).max()).all(axis=1)
    second_body = np.where(flat & (second_body == AIR_LABEL) & layout.half, MIRROR_LABEL, second_body)
    chosen = find_surfaces(surfaces, points, faces, first_body, second_body)
    if (chosen < 0).any():
        a, b = first_body[chosen < 0][0], second_body[chosen < 0][0]
        raise SolveError(f"volume mesh: bodies {a} and {b} touch, which they do not in the scene")
    if not layout.interfaces:
        return faces, chosen
    layer_faces, upper_layer, lower_layer = find_interfaces(cells, np.where(body >= 0, layer, AIR_LABEL))
    layer_faces = layer_faces[(upper_layer >= 0) & (lower_layer >= 0) & (points[layer_faces, 2].max(axis=1) < 0)]
    first = len(surfaces) - len(layout.interfaces)
    planes = first + np.abs(points[layer_faces, 2].mean(axis=1)[:, None] + np.array(layout.interfaces)).argmin(axis=1)
    return np.vstack([faces, layer_faces]), np.concatenate([chosen, planes])


def _mend(surfaces: list[Surface], points: Points, cells: Indices, member: NDArray[np.bool_]) -> Points:
    """Move points (n, 3) onto their surfaces and smooth bad tetrahedra, except where that would spoil others."""
    exact = snap(surfaces, points, member)
    is_near = np.linalg.norm(exact - points, axis=1) < _MAX_MOVE_RELATIVE * _find_shortest_edges(
        points, cells[:, EDGE_CORNERS].reshape(-1, 2)
    )
    quality = compute_mean_ratios(points, cells)
    better = smooth(np.where(is_near[:, None], exact, points), cells, surfaces, member, min_ratio=_MEND_BELOW_RATIO, rounds=6)
    return undo_inversions(better, points, cells, np.minimum(_MIN_MENDED_RATIO, _QUALITY_FACTOR * quality))
