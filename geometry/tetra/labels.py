"""Which body tetrahedra lie in, by their centres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.layout import BodyLayout
from geometry.tetra.stretched_space import MeshSpace
from geometry.tetra.surface_files import Sheet
from geometry.tetra.surfaces import Corners
from geometry.tetra.tet_mesh import BEYOND, GROOVE, INCLUSION, INNER, OUTER, TISSUE

Labels = NDArray[np.int64]
AIR, MIRROR = -1, -2  # outside all bodies; behind the plane of symmetry


def labels(found: BodyLayout, turns: Corners, space: MeshSpace, points: Points) -> tuple[Labels, NDArray[np.bool_]]:
    """The bodies that points (n, 3) of the scene lie in, or ``AIR`` or ``MIRROR``, and whether beyond the reference cylinder."""
    x, y, z = points.T
    body = np.full(len(points), AIR)
    radius, angle, wide = np.hypot(x, y), np.arctan2(y, x), space.to_mesh(points)
    seen = np.abs(angle) if found.half else angle
    inner, hole, tube = (np.hypot(*wide[:, :2].T) * factor < size for size, factor in _blown(found, turns, space, seen, z))
    body[(z > 0) & (z < found.inner_height) & inner] = INNER
    outer = (z > 0) & (z < found.outer_height) & ~hole & tube
    body[outer] = OUTER
    if found.groove is not None:
        width, depth = found.groove
        body[outer & (z > found.outer_height - depth) & (x > 0) & (np.abs(y) < width)] = GROOVE
    tissue = (z < 0) & (z > -found.depth) & (radius < found.side_distance(angle))
    body[tissue] = TISSUE
    beyond = tissue & (radius > (np.inf if found.wall is None else found.wall))
    body[beyond] = BEYOND
    for index, inclusion in enumerate(found.inclusions):
        inside = inclusion.inside(points) if isinstance(inclusion, Sheet) else inclusion.level(points) < 1
        body[tissue & inside] = INCLUSION + index
    if found.half:
        body[y < 0] = MIRROR
    return body, beyond


def _blown(found: BodyLayout, turns: Corners, space: MeshSpace, angle: Points, z: Points) -> list[tuple[Points, Points]]:
    """Radii in the mesher's space at each point's height, and how much larger the circle is than its polygon in its direction."""
    result = []
    for size, corners in ((found.inner, turns.hole), (turns.hole_radius, turns.hole), (found.tube, turns.tube)):
        index = np.clip(np.searchsorted(corners, angle) - 1, 0, len(corners) - 2)
        low, high = corners[index], corners[index + 1]
        mapped = space.to_mesh(np.column_stack([np.full(len(z), size), np.zeros(len(z)), z]))[:, 0]
        result.append((mapped, np.cos(angle - (low + high) / 2) / np.cos((high - low) / 2)))
    return result
