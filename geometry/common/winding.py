"""Compute winding numbers of triangulated surfaces with many triangles about many points.

A group of triangles that is far away counts by the sum of their areas' vectors at its centre (G. Barill et al., Fast winding
numbers for soups and clouds, ACM Trans. Graph. 37(4), 2018, section 3); near ones exactly, one by one (A. Van Oosterom,
J. Strackee, IEEE Trans. Biomed. Eng. 30, 1983, eq. 8). All points go down the tree of triangles together.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points

Indices = NDArray[np.int64]
_FAR_DISTANCE_RADII = (
    3.0  # radii of a group: beyond, a flat one is off by at most 3/4 (radius / distance)^2 of its own solid angle, 8 %
)
_MAX_LEAF_TRIANGLES = 32  # triangles in a group that is not divided
_MAX_PAIRS = 1_000_000  # of points and groups, or points and triangles, that are held at a time


@dataclass(frozen=True)
class WindingTree:
    """Groups of triangles, each of two groups down to the smallest: group k's are 2 k + 1 and 2 k + 2.

    Attributes
    ----------
    corners
        Of the triangles, in the groups' order, (t, 3, 3).
    starts
        Where each of the smallest groups begins, and the last one ends, (leaves + 1,).
    centre
        Of the groups, weighted by area, (groups, 3).
    radius
        Of the ball about the centre that holds a group, (groups,).
    dipole
        The sum of n, a triangle's normal as long as its area, (groups, 3).
    """

    corners: Points
    starts: Indices
    centre: Points
    radius: Points
    dipole: Points

    @classmethod
    def from_triangles(cls, corners: Points) -> WindingTree:
        """Divide triangles (t, 3, 3), in halves along the longer side of the box around each group."""
        order, ends = np.arange(len(corners)), [0, len(corners)]
        middle = corners.mean(axis=1)
        while max(np.diff(ends)) > _MAX_LEAF_TRIANGLES:
            parts = [_split_in_halves(order[a:b], middle) for a, b in pairwise(ends)]
            order = np.concatenate([half for pair in parts for half in pair])
            ends = np.cumsum([0, *(len(half) for pair in parts for half in pair)]).tolist()
        ordered, starts = corners[order], np.array(ends)
        levels = [starts[:: 2**k] for k in reversed(range((len(starts) - 1).bit_length()))]
        groups = [np.concatenate(parts) for parts in zip(*(_summarise_groups(ordered, level) for level in levels), strict=True)]
        return cls(ordered, starts, *groups)

    def compute_winding(self, points: Points) -> Points:
        """Return the winding numbers of the surface about points (m, 3): (m,)."""
        step = max(1, _MAX_PAIRS // 256)  # points at a time: 256 pairs are allowed for each
        parts = [self._sum_solid_angles(points[k : k + step]) for k in range(0, len(points), step)]
        return np.concatenate([np.zeros(0), *parts]) / (4 * np.pi)

    def _sum_solid_angles(self, points: Points) -> Points:
        """Return the sums of the solid angles of all triangles, from the largest groups to the smallest."""
        result = np.zeros(len(points))
        leaves = len(self.radius) // 2  # the first of the smallest groups
        point, group = np.arange(len(points)), np.zeros(len(points), dtype=np.int64)
        while len(point):
            offset = self.centre[group] - points[point]
            distance = np.sqrt(np.einsum("ij,ij->i", offset, offset))
            far = distance > _FAR_DISTANCE_RADII * self.radius[group]
            angles = np.einsum("ij,ij->i", offset[far], self.dipole[group[far]]) / distance[far] ** 3
            result += np.bincount(point[far], angles, len(points))
            point, group = point[~far], group[~far]
            is_leaf = group >= leaves
            self._add_exactly(result, points, point[is_leaf], group[is_leaf] - leaves)
            point, group = np.tile(point[~is_leaf], 2), np.concatenate([2 * group[~is_leaf] + 1, 2 * group[~is_leaf] + 2])
        return result

    def _add_exactly(self, result: Points, points: Points, point: Indices, leaf: Indices) -> None:
        """Add to ``result`` the solid angles of all triangles of some of the smallest groups, about one point each.

        ``point`` and ``leaf`` (p,) are pairs: the row of a point, and the number of a smallest group.
        """
        step = _MAX_PAIRS // _MAX_LEAF_TRIANGLES
        for k in range(0, len(point), step):
            size = np.diff(self.starts)[leaf[k : k + step]]
            # numbers of the triangles: for each group its start, then consecutive numbers
            first = np.repeat(self.starts[leaf[k : k + step]] - np.cumsum(size) + size, size)
            owner = np.repeat(point[k : k + step], size)
            angles = compute_solid_angles(self.corners[first + np.arange(len(first))] - points[owner, None])
            result += np.bincount(owner, angles, len(points))


def compute_solid_angles(corners: Points) -> Points:
    """Return the signed solid angles of triangles (t, 3, 3) about the origin: (t,)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.sqrt(np.einsum("ij,ij->i", v, v)) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    triple_product = np.einsum("ij,ij->i", a, np.cross(b, c))
    return np.asarray(2 * np.arctan2(triple_product, la * lb * lc + ab * lc + bc * la + ca * lb))


def _split_in_halves(rows: Indices, middle: Points) -> tuple[Indices, Indices]:
    """Split triangles into two equal groups along the longest axis of their centres."""
    axis = int(np.ptp(middle[rows], axis=0).argmax())
    half = len(rows) // 2
    parted = rows[np.argpartition(middle[rows, axis], half)]
    return parted[:half], parted[half:]


def _summarise_groups(corners: Points, starts: Indices) -> tuple[Points, Points, Points]:
    """Return centre, radius and dipole of groups of triangles (t, 3, 3) that begin at ``starts``, whose last one is the end."""
    first = starts[:-1]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    area = np.linalg.norm(normal, axis=1) + 1e-300  # never zero: a group may consist of degenerate triangles
    weighed = np.add.reduceat(corners.mean(axis=1) * area[:, None], first)
    centre = weighed / np.add.reduceat(area, first)[:, None]
    owner = np.repeat(np.arange(len(first)), np.diff(starts))
    reach = np.linalg.norm(corners - centre[owner, None], axis=2).max(axis=1)
    return centre, np.maximum.reduceat(reach, first), np.add.reduceat(normal, first)
