"""Determine the body in which each tetrahedron lies, by its centre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.stretched_space import MeshSpace
from geometry.tetra.surface_files import Sheet
from geometry.tetra.surfaces import Corners
from geometry.tetra.tet_mesh import BEYOND_BODY, FIRST_INCLUSION_BODY, GROOVE_BODY, INNER_BODY, OUTER_BODY, TISSUE_BODY

Labels = NDArray[np.int64]
AIR_LABEL, MIRROR_LABEL = -1, -2  # outside all bodies; behind the plane of symmetry


def label_points(layout: BodyLayout, turns: Corners, space: MeshSpace, points: Points) -> tuple[Labels, NDArray[np.bool_]]:
    """Return the body (or ``AIR_LABEL``, ``MIRROR_LABEL``) of points (n, 3), and whether beyond the reference cylinder."""
    x, y, z = points.T
    body = np.full(len(points), AIR_LABEL)
    radius, angle, wide = np.hypot(x, y), np.arctan2(y, x), space.to_mesh(points)
    folded = np.abs(angle) if layout.half else angle
    inner, hole, tube = (np.hypot(*wide[:, :2].T) * factor < size for size, factor in _map_radii(layout, turns, space, folded, z))
    body[(z > 0) & (z < layout.inner_height) & inner] = INNER_BODY
    outer = (z > 0) & (z < layout.outer_height) & ~hole & tube
    body[outer] = OUTER_BODY
    if layout.groove is not None:
        width, depth = layout.groove
        body[outer & (z > layout.outer_height - depth) & (x > 0) & (np.abs(y) < width)] = GROOVE_BODY
    tissue = (z < 0) & (z > -layout.depth) & (radius < layout.compute_side_distance(angle))
    body[tissue] = TISSUE_BODY
    is_beyond = tissue & (radius > (np.inf if layout.wall is None else layout.wall))
    body[is_beyond] = BEYOND_BODY
    for index, inclusion in enumerate(layout.inclusions):
        inside = inclusion.is_inside(points) if isinstance(inclusion, Sheet) else inclusion.level(points) < 1
        body[tissue & inside] = FIRST_INCLUSION_BODY + index
    if layout.half:
        body[y < 0] = MIRROR_LABEL
    return body, is_beyond


def _map_radii(layout: BodyLayout, turns: Corners, space: MeshSpace, angle: Points, z: Points) -> list[tuple[Points, Points]]:
    """Return radii in mesher's space at each point's height, and the ratio of circle to polygon there."""
    result = []
    for size, corners in ((layout.inner, turns.hole), (turns.hole_radius, turns.hole), (layout.tube, turns.tube)):
        index = np.clip(np.searchsorted(corners, angle) - 1, 0, len(corners) - 2)
        low, high = corners[index], corners[index + 1]
        mapped = space.to_mesh(np.column_stack([np.full(len(z), size), np.zeros(len(z)), z]))[:, 0]
        result.append((mapped, np.cos(angle - (low + high) / 2) / np.cos((high - low) / 2)))
    return result
