"""Halve triangles of the tissue's top, sides and floor until they are close to these relative to adjacent tetrahedra.

In the mesher's space far planes are bent, and round sides are polygons: pytetwild's nodes lie where the triangles are, and not
where the surface is. Where the two are further apart than tetrahedra are large, as at a small inclusion near the floor, those
between them are taken for air, or for tissue, and fold when their nodes go to the surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.labels import AIR_LABEL
from geometry.tetra.sizing import TetraFineness, compute_sizes
from geometry.tetra.snapping import Surface, build_exact_surfaces, snap
from geometry.tetra.stretched_space import MeshSpace
from geometry.tetra.tet_mesh import TISSUE_BODY

Triangles = NDArray[np.int64]
_MAX_RELATIVE_DEVIATION = (
    0.1  # of the tetrahedra's size, or of what is left to an inclusion: how far an edge's middle may lie beside its image
)
_RELATIVE_TOLERANCE = 1e-9  # of the tissue's size: how far points of a surface may be from it
_MAX_ROUNDS = 8  # each makes an edge's distance from its image a quarter: the last of these never came
_TRIANGLE_SIDES = np.array([(0, 1), (1, 2), (2, 0)])


def halve_triangles(
    points: Points, triangles: Triangles, layout: BodyLayout, fineness: TetraFineness, space: MeshSpace
) -> tuple[Points, Triangles]:
    """Cut triangles on the tissue's surfaces through the middles of their edges, which go to these surfaces.

    An edge is cut while its middle lies, in the mesher's space, beside its surface's image by more than a tenth of the size of
    the tetrahedra wanted there, or of the distance to an inclusion. What is closed stays so: all triangles of an edge are cut.

    Parameters
    ----------
    points
        (n, 3) of the scene, in m.
    triangles
        (t, 3) of all surfaces.
    layout
        The bodies.
    fineness
        Of the tetrahedra.
    space
        The mesher's.

    Returns
    -------
    tuple[Points, Triangles]
        The points, with those added behind them, and the triangles.
    """
    outer = [
        surface
        for surface in build_exact_surfaces(layout)
        if surface.separates(np.array([TISSUE_BODY]), np.array([AIR_LABEL]))[0]
    ]
    for _ in range(_MAX_ROUNDS):
        edges, middles, chords = _find_edge_middles(points, triangles, outer, space)
        deviation = np.linalg.norm(space.to_mesh(middles) - chords, axis=1) / _find_local_size(layout, fineness, space, middles)
        worst = np.argsort(-deviation)[: np.count_nonzero(deviation > _MAX_RELATIVE_DEVIATION)]
        if len(worst) == 0:
            break
        triangles = cut_triangles(triangles, edges[worst], len(points))
        points = np.vstack([points, middles[worst]])
    return points, triangles


def cut_triangles(triangles: Triangles, edges: NDArray[np.int64], count: int) -> Triangles:
    """Cut triangles through the middles of ``edges`` (k, 2), in their order; the middles are the points from ``count`` on.

    The lower index of each edge comes first; of a triangle with three such edges four are made.
    """
    base = np.array([count + len(edges), 1])
    keys = edges @ base
    order = np.argsort(keys)
    for _ in range(2):  # no half has two edges left of those of its triangle
        triangle_keys = np.sort(triangles[:, _TRIANGLE_SIDES], axis=2) @ base
        place = order[np.minimum(np.searchsorted(keys, triangle_keys, sorter=order), len(keys) - 1)]
        rank = np.where(keys[place] == triangle_keys, place, len(keys))
        is_cut = rank.min(axis=1) < len(keys)
        turned = (rank[is_cut].argmin(axis=1)[:, None] + np.arange(3)) % 3
        (a, b, c), middle = np.take_along_axis(triangles[is_cut], turned, axis=1).T, count + rank[is_cut].min(axis=1)
        triangles = np.vstack([triangles[~is_cut], np.column_stack([a, middle, c]), np.column_stack([middle, b, c])])
    return triangles


def _find_edge_middles(
    points: Points, triangles: Triangles, surfaces: list[Surface], space: MeshSpace
) -> tuple[NDArray[np.int64], Points, Points]:
    """Return edges on surfaces, (k, 2); their middles on these, (k, 3); and where straight edges have them in mesher's space."""
    tolerance, sides = (
        _RELATIVE_TOLERANCE * float(np.abs(points).max()),
        np.sort(triangles[:, _TRIANGLE_SIDES], axis=2).reshape(-1, 2),
    )
    member = np.stack([np.abs(surface.level(points)[0]) <= tolerance for surface in surfaces], axis=1)
    edges = np.unique(sides[(member[sides[:, 0]] & member[sides[:, 1]]).any(axis=1)], axis=0)
    chords = space.to_mesh(points)[edges].mean(axis=1)
    edge_member = member[edges[:, 0]] & member[edges[:, 1]]
    return edges, snap(surfaces, space.to_scene(chords), edge_member), chords


def _find_local_size(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace, points: Points) -> Points:
    """Return size of tetrahedra at points (n, 3) of the scene, or the distance to an inclusion if less; in the mesher's space."""
    distances = [np.abs(body.estimate_distance(points)) for body in layout.inclusions]
    result: Points = np.min([compute_sizes(layout, fineness, space, points), *distances], axis=0) * space.compute_scale(points)
    return result
