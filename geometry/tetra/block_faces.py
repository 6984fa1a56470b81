"""The faces of a block of tissue as triangles that grow with their distance from the probe.

In the mesher's space far planes are bent: a triangle as long as a share of its distance lies by about the square of that share
beside its image, and tetrahedra between the two would be taken for air, or for tissue.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from geometry.common.arrays import Points
from geometry.tetra.layout import BodyLayout

Soup = tuple[Points, NDArray[np.int64]]
_BESIDE = 0.012  # of the mesher's near distance: how far the middle of an edge may lie beside its image
_LARGEST = 0.5  # of their distance from the probe: edges of triangles
_BODY = 0.5  # of their distance from an inclusion's centre
_APART = 0.6  # of an edge: how far points inside a face stay from its boundary


@dataclass(frozen=True)
class Spacing:
    """How long edges of triangles may be.

    Attributes:
        near: distance from the probe beyond which lengths shrink in the mesher's space.
        bodies: centres of inclusions, (b, 3).
    """

    near: float
    bodies: Points

    def at(self, points: Points) -> Points:
        """Lengths at points (n, 3): a plane at a distance r is bent in the mesher's space as ln(r / near) over r."""
        far = np.maximum(np.linalg.norm(points, axis=1), self.near / 2)
        share = np.minimum(np.sqrt(8 * _BESIDE / np.maximum(np.log(far / self.near), 1e-9)), _LARGEST)
        apart = np.linalg.norm(points[:, None] - self.bodies, axis=2).min(axis=1, initial=np.inf)
        return np.asarray(np.minimum(share * far, _BODY * apart))

    def between(self, low: Points, high: Points) -> Points:
        """Shares from 0 to 1 of the way from one point (3,) to another, so far apart."""
        ends = np.linspace(0, 1, 2000)
        way = low + ends[:, None] * (high - low)
        density = float(np.linalg.norm(high - low)) / self.at(way)
        count = np.concatenate([[0.0], np.cumsum(np.diff(ends) * (density[1:] + density[:-1]) / 2)])
        return np.asarray(np.interp(np.linspace(0, count[-1], max(1, math.ceil(count[-1])) + 1), count, ends))


def block_faces(layout: BodyLayout, near: float, ring: Points) -> list[Soup]:
    """Sides, and top and floor outside the reference cylinder, whose corners (n, 2) are ``ring``; y >= 0 of a half."""
    (x, y), (a, b) = layout.centre, layout.sides
    low = 0.0 if layout.half else y - b
    spacing = Spacing(near, np.array([body.centre for body in layout.inclusions]).reshape(-1, 3))
    box = Box(np.array([[x - a, x + a], [low, y + b], [-layout.depth, 0.0]]), spacing, ring)
    planes = [(0, 0), (0, 1), (1, 1), (2, 0), (2, 1), *([] if layout.half else [(1, 0)])]
    return [box.face(axis, end) for axis, end in planes]


@dataclass(frozen=True)
class Box:
    """A block: its ends along each axis (3, 2), its triangles' sizes, and the ring (n, 2) that top and floor leave out."""

    ends: Points
    spacing: Spacing
    ring: Points

    def face(self, axis: int, end: int) -> Soup:
        """The triangles of the face where a coordinate is at one of its ends."""
        at, (p, q) = self.ends[axis, end], [k for k in range(3) if k != axis]
        bound = [_row(self.edge(p, {axis: at, q: value}), value) for value in self.ends[q]]
        bound += [_row(self.edge(q, {axis: at, p: value})[1:-1], value)[:, ::-1] for value in self.ends[p]]
        hole = self.ring if axis == 2 else np.zeros((0, 2))
        flat = np.vstack([*bound, hole])
        flat = np.vstack([flat, self._inside(axis, at, flat, hole)])
        triangles = Delaunay(flat).simplices.astype(np.int64)
        corners = flat[triangles]
        kept = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) > 1e-9 * np.ptp(flat, axis=0).prod()
        if len(hole):
            kept &= ~_within(corners.mean(axis=1), hole)
        points = np.empty((len(flat), 3))
        points[:, [p, q]], points[:, axis] = flat, at
        return points, triangles[kept]

    def edge(self, axis: int, fixed: dict[int, float]) -> Points:
        """Points of an edge, the same for both its faces: none in the ring, beside it those opposite its corners."""
        size = float(np.linalg.norm(self.ring, axis=1).max())
        low, high = (np.array([{axis: end, **fixed}[k] for k in range(3)]) for end in self.ends[axis])
        points: Points = self.ends[axis, 0] + np.ptp(self.ends[axis]) * self.spacing.between(low, high)
        points[-1] = self.ends[axis, 1]
        if axis == 2:
            return points
        aside = fixed[1 - axis]
        chord = float(np.linalg.norm(np.diff(self.ring, axis=0), axis=1).max())
        if abs(aside) < size:  # the plane of symmetry
            clear = np.abs(points) > size + chord / 2
            clear[[0, -1]] = True
            return points[clear]
        opposite = self.ring[np.abs(self.ring[:, 1 - axis] - aside) < 1.5 * chord, axis]
        inside = (opposite > self.ends[axis, 0] + chord / 2) & (opposite < self.ends[axis, 1] - chord / 2)
        apart = np.abs(points[:, None] - opposite[inside]).min(axis=1, initial=np.inf) > chord / 2
        apart[[0, -1]] = True
        return np.unique(np.concatenate([points[apart], opposite[inside]]))

    def _inside(self, axis: int, at: float, bound: Points, hole: Points) -> Points:
        """Points inside a face on rings about the feet of inclusions and probe, clear of its boundary and of each other."""
        others = [k for k in range(3) if k != axis]
        ends, found = self.ends[others], bound
        for centre in (*self.spacing.bodies, np.zeros(3)):
            foot = centre.copy()
            foot[axis] = at
            for radius in self._radii(foot, others[0]):
                apart = self._apart(foot + radius * np.eye(3)[others[0]])
                count = max(1, round(2 * np.pi * radius / apart))
                angles = np.arange(count) * 2 * np.pi / count
                points = foot[others] + radius * np.column_stack([np.cos(angles), np.sin(angles)])
                points = points[np.min([points - ends[:, 0], ends[:, 1] - points], axis=(0, 2)) > _APART * apart]
                if len(points):
                    found = np.vstack([found, points[cKDTree(found).query(points)[0] > _APART * apart]])
        points = found[len(bound) :]
        return points[~_within(points, hole)] if len(hole) else points

    def _radii(self, foot: Points, along: int) -> list[float]:
        """Radii of rings about a foot."""
        radii, reach = [0.0], float(np.linalg.norm(np.ptp(self.ends, axis=1)))
        while radii[-1] < reach:
            radii.append(radii[-1] + self._apart(foot + radii[-1] * np.eye(3)[along]))
        return radii

    def _apart(self, point: Points) -> float:
        return float(self.spacing.at(point[None, :])[0])


def _row(along: Points, value: float) -> Points:
    return np.column_stack([along, np.full(len(along), value)])


def _within(points: Points, ring: Points) -> NDArray[np.bool_]:
    """Which points (n, 2) lie within the polygon of a ring about the origin, or within its half of y >= 0."""
    angles = np.arctan2(ring[:, 1], ring[:, 0])
    order = np.argsort(angles)
    low = np.searchsorted(angles[order], np.arctan2(points[:, 1], points[:, 0])) - 1
    a, b = ring[order][low], ring[order][(low + 1) % len(ring)]
    across = (b - a)[:, 0] * (points - a)[:, 1] - (b - a)[:, 1] * (points - a)[:, 0]
    return np.asarray(across > 0)
