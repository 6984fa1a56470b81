"""Layers of tissue in a mesh that knows nothing of them: its tetrahedra cut by the planes between layers.

Corners near a plane move onto it, along the surfaces that they lie on; edges that still cross it get a corner where they do.
So a layer costs what its planes cut, and far from the probe, where fields change slowly, tetrahedra may be flat: ``sizing.py``
makes them no longer than five thicknesses, or they would be needles. A cut edge is halved in all tetrahedra round it, in one
order for all, so that faces stay common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.errors import SolveError
from geometry.tetra.labels import AIR, MIRROR
from geometry.tetra.layout import BodyLayout
from geometry.tetra.smoothing import mean_ratios, smooth, undo_inversions
from geometry.tetra.snapping import Surface, interfaces, memberships, snap, surfaces_of
from geometry.tetra.tet_mesh import EDGES

Indices = NDArray[np.int64]
_NEAR = 0.3  # of the shortest edge that crosses a plane: how far its corners move onto the plane
_KEPT = 0.2  # of its quality a tetrahedron keeps when its corners move so, or they do not
_MENDED = 0.15  # mean ratio below which tetrahedra are mended
_LEAST = 0.05  # those that stay below this are put back to where they were cut
_FLATTER = 0.5  # but for those that were not this many times better there
_ON = 1e-10  # of the largest coordinate: corners so near a plane are on it
_FAR = 0.5  # of its shortest edge: how far a corner moves to where a plane cuts its surfaces


@dataclass(frozen=True)
class LayeredCells:
    """Straight tetrahedra that no plane between layers crosses.

    Attributes:
        points: (n, 3) in m.
        cells: (t, 4).
        parent: of each the tetrahedron that it was cut from, (t,).
        layer: of each, as in ``TetMesh``, (t,).
        faces: between bodies, between layers and outside, (f, 3).
        chosen: the surface that each face stands for, (f,).
    """

    points: Points
    cells: Indices
    parent: Indices
    layer: Indices
    faces: Indices
    chosen: Indices


def layers_at(layout: BodyLayout, heights: Points) -> Indices:
    """Return layers of tissue at heights (n,): 1 for the first below the surface and so on, 0 for the tissue's own material."""
    number = 1 + np.searchsorted(np.array(layout.interfaces), -heights)
    return np.where(number > len(layout.interfaces), 0, number)


def layered(
    layout: BodyLayout, surfaces: list[Surface], points: Points, cells: Indices, *, body: Indices, member: NDArray[np.bool_]
) -> LayeredCells:
    """Cut straight tetrahedra (t, 4) of bodies (t,) by all planes between layers.

    Args:
        layout: the bodies.
        surfaces: all exact ones, the planes between layers last.
        points: corners, (n, 3).
        cells: (t, 4).
        body: of each tetrahedron.
        member: which surfaces each corner lies on, (n, surfaces).

    Raises:
        SolveError: bodies touch that do not in the scene.
    """
    parent, first = np.arange(len(cells)), len(surfaces) - len(layout.interfaces)
    for plane, depth in enumerate(layout.interfaces, first):
        points = _moved(surfaces, points, cells, member, plane)
        points, cells, of = split(points, cells, -depth)
        parent, new = parent[of], np.zeros((len(points) - len(member), len(surfaces)), dtype=bool)
        new[:, plane] = True
        member = np.vstack([member, new])
    layer = layers_at(layout, points[cells, 2].mean(axis=1))
    faces, chosen = body_faces(layout, surfaces, points, cells, body=body[parent], layer=layer)
    member = memberships(len(points), faces, chosen, len(surfaces))
    return LayeredCells(_mended(surfaces, points, cells, member), cells, parent, layer, faces, chosen)


def split(points: Points, cells: Indices, height: float) -> tuple[Points, Indices, Indices]:
    """Cut tetrahedra by plane z = height; return points (n, 3), tetrahedra (t, 4) and of each the one it was cut from (t,)."""
    away = points[:, 2] - height
    side, parent = np.where(np.abs(away) <= _ON * np.abs(points).max(), 0.0, np.sign(away)), np.arange(len(cells))
    pairs = np.sort(cells[:, EDGES], axis=2)
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
        ends = np.sort(cells[:, EDGES], axis=2)
        crossing = np.append(side, np.zeros(len(new)))[ends].prod(axis=2) < 0
        rows = np.flatnonzero(crossing.any(axis=1))
        if len(rows) == 0:
            return np.vstack([points, new]), cells, parent
        rank = np.full((len(rows), len(EDGES)), len(keys))
        found = ends[rows][crossing[rows]]
        rank[crossing[rows]] = order[np.searchsorted(keys, found[:, 0] * len(points) + found[:, 1], sorter=order)]
        first = rank.argmin(axis=1)
        middle, one, other = len(points) + rank.min(axis=1), cells[rows].copy(), cells[rows].copy()
        each = np.arange(len(rows))
        one[each, EDGES[first, 1]], other[each, EDGES[first, 0]] = middle, middle
        cells, parent = np.vstack([cells, other]), np.concatenate([parent, parent[rows]])
        cells[rows] = one


def _moved(surfaces: list[Surface], points: Points, cells: Indices, member: NDArray[np.bool_], plane: int) -> Points:
    """Move points (n, 3) near a plane (its index) onto it, along their surfaces, where that spoils no tetrahedron."""
    above = surfaces[plane].level(points)[0]
    ends = cells[:, EDGES].reshape(-1, 2)
    shortest = _shortest(points, ends[above[ends].prod(axis=1) < 0])
    near = np.flatnonzero(np.abs(above) < _NEAR * shortest)
    both = member[near]
    both[:, plane] = True
    target = points.copy()
    target[near] = snap(surfaces, points[near], both)
    left = np.abs(surfaces[plane].level(target)[0])
    there = (left <= _ON * np.abs(points).max() / 2) & (np.linalg.norm(target - points, axis=1) < _FAR * shortest)
    chosen = np.zeros(len(points), dtype=bool)
    chosen[near] = there[near]
    touched = cells[chosen[cells].any(axis=1)]
    least = _KEPT * mean_ratios(points, touched)
    while True:
        result = np.where(chosen[:, None], target, points)
        spoilt = touched[(mean_ratios(result, touched) < least) & chosen[touched].any(axis=1)]
        if len(spoilt) == 0:
            return result
        far = np.where(chosen[spoilt], np.abs(above[spoilt]), -1.0).argmax(axis=1)
        chosen[spoilt[np.arange(len(spoilt)), far]] = False


def _shortest(points: Points, ends: Indices) -> Points:
    """Return for each point (n, 3) the length of the shortest of its edges (m, 2), 0 if it has none."""
    result = np.full(len(points), np.inf)
    np.minimum.at(result, ends, np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)[:, None])
    result[np.isinf(result)] = 0.0
    return result


def body_faces(
    layout: BodyLayout, surfaces: list[Surface], points: Points, cells: Indices, *, body: Indices, layer: Indices
) -> tuple[Indices, Indices]:
    """Find the faces (f, 3) between bodies and between layers, and their surfaces (f,)."""
    faces, one, other = interfaces(cells, body)
    flat = (np.abs(points[faces, 1]) <= 1e-9 * np.abs(points).max()).all(axis=1)
    other = np.where(flat & (other == AIR) & layout.half, MIRROR, other)
    chosen = surfaces_of(surfaces, points, faces, one, other)
    if (chosen < 0).any():
        a, b = one[chosen < 0][0], other[chosen < 0][0]
        raise SolveError(f"volume mesh: bodies {a} and {b} touch, which they do not in the scene")
    if not layout.interfaces:
        return faces, chosen
    between, above, below = interfaces(cells, np.where(body >= 0, layer, AIR))
    between = between[(above >= 0) & (below >= 0) & (points[between, 2].max(axis=1) < 0)]
    first = len(surfaces) - len(layout.interfaces)
    planes = first + np.abs(points[between, 2].mean(axis=1)[:, None] + np.array(layout.interfaces)).argmin(axis=1)
    return np.vstack([faces, between]), np.concatenate([chosen, planes])


def _mended(surfaces: list[Surface], points: Points, cells: Indices, member: NDArray[np.bool_]) -> Points:
    """Move points (n, 3) onto their surfaces and smooth bad tetrahedra, except where that would spoil others."""
    exact = snap(surfaces, points, member)
    near = np.linalg.norm(exact - points, axis=1) < _FAR * _shortest(points, cells[:, EDGES].reshape(-1, 2))
    quality = mean_ratios(points, cells)
    better = smooth(np.where(near[:, None], exact, points), cells, surfaces, member, least=_MENDED, rounds=6)
    return undo_inversions(better, points, cells, np.minimum(_LEAST, _FLATTER * quality))
