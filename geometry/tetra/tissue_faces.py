"""The faces of tissue as triangles that grow with their distance from the probe.

In the mesher's space far planes are bent: a triangle as long as a share of its distance lies by about the square of that share
beside its image, and tetrahedra between the two would be taken for air, or for tissue. Thin triangles do as much harm as large
ones, as tetrahedra on them become as small as these are thin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from geometry.common.arrays import Points
from geometry.tetra.layout import BodyLayout, Ellipsoid
from geometry.tetra.stretched_space import Spacing
from geometry.tetra.surface_files import Sheet

Soup = tuple[Points, NDArray[np.int64]]
_ROUND = 0.3  # of round tissue's radius: the middle of an edge is as near to the circle as with a polygon of 21 corners
_APART, _BETWEEN = 0.5, 0.8  # of an edge: how far points inside a face stay from its boundary, and from each other


@dataclass(frozen=True)
class Face:
    """A part of the tissue's surface, rolled out into a plane.

    Attributes:
        lift: points (n, 2) of the plane to the scene (n, 3).
        bound: (n, 2) on its convex boundary.
        clear: how far points (n, 2) are inside the boundary.
        feet: (f, 2) nearest to inclusions and probe; seen from these, the first direction stands for all.
        hole: (n, 2) corners of a ring about the origin that it leaves out, or none.
    """

    lift: Callable[[Points], Points]
    bound: Points
    clear: Callable[[Points], Points]
    feet: Points
    hole: Points

    def filled(self, spacing: Spacing) -> Soup:
        """Its points in the scene, (n, 3), and triangles."""
        flat = np.vstack([self.bound, self.hole])
        flat = np.vstack([flat, self._inside(flat, spacing)])
        triangles = Delaunay(flat).simplices.astype(np.int64)
        corners = flat[triangles]
        kept = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) > 1e-9 * np.ptp(flat, axis=0).prod()
        if len(self.hole):
            kept &= ~_within(corners.mean(axis=1), self.hole)
        return self.lift(flat), triangles[kept]

    def _inside(self, bound: Points, spacing: Spacing) -> Points:
        """Points inside on rings about the feet of inclusions and probe, clear of the boundary and of those before them."""
        points = np.vstack([ring for foot in self.feet for ring in self._rings(foot, spacing)])
        sizes = spacing.at(self.lift(points))
        kept = np.minimum(self.clear(points), cKDTree(bound).query(points)[0]) > _APART * sizes
        if len(self.hole):
            kept &= ~_within(points, self.hole)
        points, sizes = points[kept], sizes[kept]
        tree, free = cKDTree(points), np.ones(len(points), dtype=bool)
        for index, point in enumerate(points):
            if free[index]:
                near = np.array(tree.query_ball_point(point, _BETWEEN * sizes[index]))
                free[near[near > index]] = False
        return np.asarray(points[free])

    def _rings(self, foot: Points, spacing: Spacing) -> list[Points]:
        """Rings of points (n, 2) about a foot."""
        radius, reach, rings = 0.0, float(np.linalg.norm(np.ptp(self.bound, axis=0))), []
        while radius < reach:
            apart = float(spacing.at(self.lift((foot + np.array([radius, 0.0]))[None, :]))[0])
            angles = np.linspace(0, 2 * np.pi, max(1, round(2 * np.pi * radius / apart)), endpoint=False)
            rings.append(foot + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
            radius += apart
        return rings


def tissue_faces(layout: BodyLayout, near: float, ring: Points) -> list[Soup]:
    """Sides, and top and floor outside the reference cylinder, whose corners (n, 2) are ``ring``; y >= 0 of a half."""
    bodies, radius = np.array([_middle(body) for body in layout.inclusions]).reshape(-1, 3), layout.tissue_radius
    spacing = Spacing(near, bodies, math.inf if radius is None else _ROUND * radius)
    faces = _block(layout, spacing, ring) if radius is None else Can(layout, radius, spacing, ring).faces()
    return [face.filled(spacing) for face in faces]


def _middle(body: Ellipsoid | Sheet) -> Points:
    """A point inside the tissue: what a file's coordinates are relative to may lie on its faces, or anywhere."""
    return np.asarray((body.points.min(axis=0) + body.points.max(axis=0)) / 2) if isinstance(body, Sheet) else body.centre


def _block(layout: BodyLayout, spacing: Spacing, ring: Points) -> list[Face]:
    (x, y), (a, b) = layout.centre, layout.sides
    low = 0.0 if layout.half else y - b
    box = Box(np.array([[x - a, x + a], [low, y + b], [-layout.depth, 0.0]]), spacing, ring)
    planes = [(0, 0), (0, 1), (1, 1), (2, 0), (2, 1), *([] if layout.half else [(1, 0)])]
    return [box.face(axis, end) for axis, end in planes]


@dataclass(frozen=True)
class Box:
    """A block: its ends along each axis (3, 2), its triangles' sizes, and the ring (n, 2) that top and floor leave out."""

    ends: Points
    spacing: Spacing
    ring: Points

    def face(self, axis: int, end: int) -> Face:
        """The face where a coordinate is at one of its ends."""
        at, others = self.ends[axis, end], [k for k in range(3) if k != axis]
        (p, q), ends = others, self.ends[others]
        bound = [_row(self.edge(p, {axis: at, q: value}), value) for value in self.ends[q]]
        bound += [_row(self.edge(q, {axis: at, p: value})[1:-1], value)[:, ::-1] for value in self.ends[p]]

        def lift(points: Points) -> Points:
            result = np.full((len(points), 3), at)
            result[:, others] = points
            return result

        def clear(points: Points) -> Points:
            return np.asarray(np.min([points - ends[:, 0], ends[:, 1] - points], axis=(0, 2)))

        feet = np.vstack([self.spacing.bodies, np.zeros(3)])[:, others]
        return Face(lift, np.vstack(bound), clear, feet, self.ring if axis == 2 else np.zeros((0, 2)))

    def edge(self, axis: int, fixed: dict[int, float]) -> Points:
        """Points of an edge, the same for both its faces: none in the ring, beside it those opposite its corners."""
        low, high = (np.array([{axis: end, **fixed}[k] for k in range(3)]) for end in self.ends[axis])
        points: Points = self.ends[axis, 0] + np.ptp(self.ends[axis]) * self.spacing.between(low, high)
        points[-1] = self.ends[axis, 1]
        if axis == 2:
            return points
        aside, chord = fixed[1 - axis], _chord(self.ring)
        if abs(aside) < float(np.linalg.norm(self.ring, axis=1).max()):  # the plane of symmetry
            return _beside_ring(points, self.ring)
        return _opposite(points, self.ring[np.abs(self.ring[:, 1 - axis] - aside) < 1.5 * chord, axis], chord)


@dataclass(frozen=True)
class Can:
    """Round tissue, its radius, its triangles' sizes, and the ring (n, 2) that top and floor leave out."""

    layout: BodyLayout
    radius: float
    spacing: Spacing
    ring: Points

    @property
    def ends(self) -> tuple[float, float]:
        """Angles at the tissue's axis between which its side lies: where it is whole it is cut open opposite the probe."""
        x, y = self.layout.centre
        first = 0.0 if self.layout.half else math.atan2(y, x)
        return first, first + (math.pi if self.layout.half else 2 * math.pi)

    def faces(self) -> list[Face]:
        """Top, floor and side."""
        heights = 0.0, -self.layout.depth
        rims = [self.rim(height) for height in heights]
        return [*(self.flat(rim, height) for rim, height in zip(rims, heights, strict=True)), self.side(*rims)]

    def around(self, angles: Points, height: float | Points) -> Points:
        """Points (n, 3) of the side."""
        (x, y), level = self.layout.centre, np.broadcast_to(height, angles.shape)
        return np.column_stack([x + self.radius * np.cos(angles), y + self.radius * np.sin(angles), level])

    def rim(self, height: float) -> Points:
        """Angles of an edge's points, both ends among them: beside the ring those opposite its corners."""
        low, high = self.ends
        even = self.spacing.along(self.around(np.linspace(low, high, 20000), height))
        away, chord = self.ring - self.layout.centre, _chord(self.ring)
        beside = away[self.radius - np.linalg.norm(away, axis=1) < 1.5 * chord]
        angles = low + np.mod(np.arctan2(beside[:, 1], beside[:, 0]) - low, 2 * np.pi)
        return _opposite(low + (high - low) * even, angles, chord / self.radius)

    def flat(self, rim: Points, height: float) -> Face:
        """Top or floor."""
        centre, half, bound = np.array(self.layout.centre), self.layout.half, self.around(rim, height)[:, :2]
        if half:
            ends = self.around(np.array([np.pi, 0.0]), height)
            ends[:, 1] = 0.0
            between = ends[0, 0] + np.ptp(ends[:, 0]) * self.spacing.between(*ends)
            bound = np.vstack([bound, _row(_beside_ring(between, self.ring)[1:-1], 0.0)])

        def clear(points: Points) -> Points:
            inside = self.radius - np.linalg.norm(points - centre, axis=1)
            return np.minimum(inside, points[:, 1]) if half else np.asarray(inside)

        def lift(points: Points) -> Points:
            return np.column_stack([points, np.full(len(points), height)])

        feet = np.vstack([self.spacing.bodies, np.zeros(3)])[:, :2]
        return Face(lift, bound if half else bound[:-1], clear, feet, self.ring)

    def side(self, top: Points, floor: Points) -> Face:
        """The side rolled out: depths, and angles from one end to the other times the radius."""
        depth, turn = self.layout.depth, self.radius * 2 * np.pi
        edges = np.array(self.ends) * self.radius
        bound = [_row(rim * self.radius, value)[:, ::-1] for rim, value in ((top, 0.0), (floor, depth))]
        for edge, angle in zip(edges, self.ends, strict=True):
            low, high = self.around(np.full(2, angle), np.array([0.0, -depth]))
            bound.append(_row(depth * self.spacing.between(low, high)[1:-1], edge))

        def lift(points: Points) -> Points:
            return self.around(points[:, 1] / self.radius, -points[:, 0])

        def clear(points: Points) -> Points:
            return np.asarray(np.min([points - [0, edges[0]], [depth, edges[1]] - points], axis=(0, 2)))

        away = np.vstack([self.spacing.bodies, np.zeros(3)]) - [*self.layout.centre, 0.0]
        feet = np.column_stack([-away[:, 2], np.arctan2(away[:, 1], away[:, 0]) * self.radius])
        turned = [feet + np.array([0, k * turn]) for k in ((0,) if self.layout.half else (-1, 0, 1, 2))]
        return Face(lift, np.vstack(bound), clear, np.vstack(turned), np.zeros((0, 2)))


def _row(along: Points, value: float) -> Points:
    return np.column_stack([along, np.full(len(along), value)])


def _chord(ring: Points) -> float:
    return float(np.linalg.norm(np.diff(ring, axis=0), axis=1).max())


def _beside_ring(points: Points, ring: Points) -> Points:
    """Points (n,) of a line through the ring's middle, those in it or close to it left out, but the ends."""
    clear = np.abs(points) > float(np.linalg.norm(ring, axis=1).max()) + _chord(ring) / 2
    clear[[0, -1]] = True
    return points[clear]


def _opposite(points: Points, others: Points, chord: float) -> Points:
    """Points (n,) of an edge with ``replacements`` in place of those close to them; the ends stay."""
    inside = (others > points[0] + chord / 2) & (others < points[-1] - chord / 2)
    apart = np.abs(points[:, None] - others[inside]).min(axis=1, initial=np.inf) > chord / 2
    apart[[0, -1]] = True
    return np.unique(np.concatenate([points[apart], others[inside]]))


def _within(points: Points, ring: Points) -> NDArray[np.bool_]:
    """Which points (n, 2) lie within the polygon of a ring about the origin, or within its half of y >= 0."""
    angles = np.arctan2(ring[:, 1], ring[:, 0])
    order = np.argsort(angles)
    low = np.searchsorted(angles[order], np.arctan2(points[:, 1], points[:, 0])) - 1
    a, b = ring[order][low], ring[order][(low + 1) % len(ring)]
    across = (b - a)[:, 0] * (points - a)[:, 1] - (b - a)[:, 1] * (points - a)[:, 0]
    return np.asarray(across > 0)
