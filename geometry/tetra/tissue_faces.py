"""The faces of tissue as triangles that grow with their distance from the probe.

In the mesher's space far planes are bent: a triangle as long as a fraction of its distance lies about the square of that fraction
off its image, and tetrahedra between the two would be taken for air, or for tissue. Thin triangles do as much harm as large
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
from geometry.tetra.body_layout import BodyLayout, Ellipsoid
from geometry.tetra.stretched_space import Spacing
from geometry.tetra.surface_files import Sheet

Soup = tuple[Points, NDArray[np.int64]]
_MAX_EDGE_PER_RADIUS = (
    0.3  # of round tissue's radius: the middle of an edge is as near to the circle as with a polygon of 21 corners
)
_MIN_BOUNDARY_DISTANCE, _MIN_POINT_DISTANCE = (
    0.5,
    0.8,
)  # of an edge: how far points inside a face stay from its boundary, and from each other


@dataclass(frozen=True)
class Face:
    """A part of the tissue's surface, rolled out into a plane.

    Attributes
    ----------
    lift
        Points (n, 2) of the plane to the scene (n, 3).
    bound
        (n, 2) on its convex boundary.
    clear
        How far points (n, 2) are inside the boundary.
    feet
        (f, 2) nearest to inclusions and probe; seen from these, the first direction stands for all.
    hole
        (n, 2) corners of a ring about the origin that it leaves out, or none.
    """

    lift: Callable[[Points], Points]
    bound: Points
    clear: Callable[[Points], Points]
    feet: Points
    hole: Points

    def triangulate(self, spacing: Spacing) -> Soup:
        """Return the face's points in the scene, (n, 3), and its triangles."""
        flat = np.vstack([self.bound, self.hole])
        flat = np.vstack([flat, self._place_inner_points(flat, spacing)])
        triangles = Delaunay(flat).simplices.astype(np.int64)
        corners = flat[triangles]
        is_kept = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) > 1e-9 * np.ptp(flat, axis=0).prod()
        if len(self.hole):
            is_kept &= ~_is_in_ring(corners.mean(axis=1), self.hole)
        return self.lift(flat), triangles[is_kept]

    def _place_inner_points(self, bound: Points, spacing: Spacing) -> Points:
        """Place points on rings about the feet of inclusions and probe, away from the boundary and from earlier points."""
        points = np.vstack([ring for foot in self.feet for ring in self._place_rings(foot, spacing)])
        sizes = spacing.compute_lengths(self.lift(points))
        is_kept = np.minimum(self.clear(points), cKDTree(bound).query(points)[0]) > _MIN_BOUNDARY_DISTANCE * sizes
        if len(self.hole):
            is_kept &= ~_is_in_ring(points, self.hole)
        points, sizes = points[is_kept], sizes[is_kept]
        tree, free = cKDTree(points), np.ones(len(points), dtype=bool)
        for index, point in enumerate(points):
            if free[index]:
                neighbours = np.array(tree.query_ball_point(point, _MIN_POINT_DISTANCE * sizes[index]))
                free[neighbours[neighbours > index]] = False
        return np.asarray(points[free])

    def _place_rings(self, foot: Points, spacing: Spacing) -> list[Points]:
        """Place rings of points (n, 2) about a foot."""
        radius, reach, rings = 0.0, float(np.linalg.norm(np.ptp(self.bound, axis=0))), []
        while radius < reach:
            spacing_here = float(spacing.compute_lengths(self.lift((foot + np.array([radius, 0.0]))[None, :]))[0])
            angles = np.linspace(0, 2 * np.pi, max(1, round(2 * np.pi * radius / spacing_here)), endpoint=False)
            rings.append(foot + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
            radius += spacing_here
        return rings


def triangulate_faces(layout: BodyLayout, linear_radius: float, ring: Points) -> list[Soup]:
    """Triangulate sides, top and floor outside the reference cylinder, whose corners (n, 2) are ``ring``; of a half, y >= 0."""
    bodies, radius = np.array([_find_middle(body) for body in layout.inclusions]).reshape(-1, 3), layout.tissue_radius
    spacing = Spacing(linear_radius, bodies, math.inf if radius is None else _MAX_EDGE_PER_RADIUS * radius)
    faces = _build_block_faces(layout, spacing, ring) if radius is None else Can(layout, radius, spacing, ring).build_faces()
    return [face.triangulate(spacing) for face in faces]


def _find_middle(body: Ellipsoid | Sheet) -> Points:
    """Return a point inside the tissue; the origin of a file's coordinates may lie on its faces, or anywhere."""
    return np.asarray((body.points.min(axis=0) + body.points.max(axis=0)) / 2) if isinstance(body, Sheet) else body.centre


def _build_block_faces(layout: BodyLayout, spacing: Spacing, ring: Points) -> list[Face]:
    (x, y), (a, b) = layout.centre, layout.sides
    low = 0.0 if layout.half else y - b
    box = Box(np.array([[x - a, x + a], [low, y + b], [-layout.depth, 0.0]]), spacing, ring)
    planes = [(0, 0), (0, 1), (1, 1), (2, 0), (2, 1), *([] if layout.half else [(1, 0)])]
    return [box.build_face(axis, end) for axis, end in planes]


@dataclass(frozen=True)
class Box:
    """A block: its ends along each axis (3, 2), its triangles' sizes, and the ring (n, 2) that top and floor leave out."""

    ends: Points
    spacing: Spacing
    ring: Points

    def build_face(self, axis: int, end: int) -> Face:
        """Build the face on which a coordinate is at one of its ends."""
        position, other_axes = self.ends[axis, end], [k for k in range(3) if k != axis]
        (p, q), ends = other_axes, self.ends[other_axes]
        bound = [_build_row(self.divide_edge(p, {axis: position, q: value}), value) for value in self.ends[q]]
        bound += [_build_row(self.divide_edge(q, {axis: position, p: value})[1:-1], value)[:, ::-1] for value in self.ends[p]]

        def lift(points: Points) -> Points:
            result = np.full((len(points), 3), position)
            result[:, other_axes] = points
            return result

        def clear(points: Points) -> Points:
            return np.asarray(np.min([points - ends[:, 0], ends[:, 1] - points], axis=(0, 2)))

        feet = np.vstack([self.spacing.bodies, np.zeros(3)])[:, other_axes]
        return Face(lift, np.vstack(bound), clear, feet, self.ring if axis == 2 else np.zeros((0, 2)))

    def divide_edge(self, axis: int, fixed: dict[int, float]) -> Points:
        """Return points of an edge, the same for both its faces: none in the ring, next to it those opposite its corners."""
        low, high = (np.array([{axis: end, **fixed}[k] for k in range(3)]) for end in self.ends[axis])
        points: Points = self.ends[axis, 0] + np.ptp(self.ends[axis]) * self.spacing.divide_line(low, high)
        points[-1] = self.ends[axis, 1]
        if axis == 2:
            return points
        side_position, chord = fixed[1 - axis], _max_chord(self.ring)
        if abs(side_position) < float(np.linalg.norm(self.ring, axis=1).max()):  # the plane of symmetry
            return _remove_points_in_ring(points, self.ring)
        return _replace_close_points(points, self.ring[np.abs(self.ring[:, 1 - axis] - side_position) < 1.5 * chord, axis], chord)


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

    def build_faces(self) -> list[Face]:
        """Build top, floor and side."""
        heights = 0.0, -self.layout.depth
        rims = [self.divide_rim(height) for height in heights]
        return [*(self.build_flat_face(rim, height) for rim, height in zip(rims, heights, strict=True)), self.build_side(*rims)]

    def place_on_side(self, angles: Points, height: float | Points) -> Points:
        """Map points of the rolled-out side to the scene, (n, 3)."""
        (x, y), level = self.layout.centre, np.broadcast_to(height, angles.shape)
        return np.column_stack([x + self.radius * np.cos(angles), y + self.radius * np.sin(angles), level])

    def divide_rim(self, height: float) -> Points:
        """Return the angles of an edge's points, both ends included: next to the ring those opposite its corners."""
        low, high = self.ends
        fractions = self.spacing.divide_path(self.place_on_side(np.linspace(low, high, 20000), height))
        offset, chord = self.ring - self.layout.centre, _max_chord(self.ring)
        close_corners = offset[self.radius - np.linalg.norm(offset, axis=1) < 1.5 * chord]
        angles = low + np.mod(np.arctan2(close_corners[:, 1], close_corners[:, 0]) - low, 2 * np.pi)
        return _replace_close_points(low + (high - low) * fractions, angles, chord / self.radius)

    def build_flat_face(self, rim: Points, height: float) -> Face:
        """Build top or floor."""
        centre, half, bound = np.array(self.layout.centre), self.layout.half, self.place_on_side(rim, height)[:, :2]
        if half:
            ends = self.place_on_side(np.array([np.pi, 0.0]), height)
            ends[:, 1] = 0.0
            edge_points = ends[0, 0] + np.ptp(ends[:, 0]) * self.spacing.divide_line(*ends)
            bound = np.vstack([bound, _build_row(_remove_points_in_ring(edge_points, self.ring)[1:-1], 0.0)])

        def clear(points: Points) -> Points:
            inside = self.radius - np.linalg.norm(points - centre, axis=1)
            return np.minimum(inside, points[:, 1]) if half else np.asarray(inside)

        def lift(points: Points) -> Points:
            return np.column_stack([points, np.full(len(points), height)])

        feet = np.vstack([self.spacing.bodies, np.zeros(3)])[:, :2]
        return Face(lift, bound if half else bound[:-1], clear, feet, self.ring)

    def build_side(self, top: Points, floor: Points) -> Face:
        """Build the side rolled out: depths, and angles from one end to the other times the radius."""
        depth, turn = self.layout.depth, self.radius * 2 * np.pi
        edges = np.array(self.ends) * self.radius
        bound = [_build_row(rim * self.radius, value)[:, ::-1] for rim, value in ((top, 0.0), (floor, depth))]
        for edge, angle in zip(edges, self.ends, strict=True):
            low, high = self.place_on_side(np.full(2, angle), np.array([0.0, -depth]))
            bound.append(_build_row(depth * self.spacing.divide_line(low, high)[1:-1], edge))

        def lift(points: Points) -> Points:
            return self.place_on_side(points[:, 1] / self.radius, -points[:, 0])

        def clear(points: Points) -> Points:
            return np.asarray(np.min([points - [0, edges[0]], [depth, edges[1]] - points], axis=(0, 2)))

        offset = np.vstack([self.spacing.bodies, np.zeros(3)]) - [*self.layout.centre, 0.0]
        feet = np.column_stack([-offset[:, 2], np.arctan2(offset[:, 1], offset[:, 0]) * self.radius])
        turned = [feet + np.array([0, k * turn]) for k in ((0,) if self.layout.half else (-1, 0, 1, 2))]
        return Face(lift, np.vstack(bound), clear, np.vstack(turned), np.zeros((0, 2)))


def _build_row(coordinates: Points, value: float) -> Points:
    return np.column_stack([coordinates, np.full(len(coordinates), value)])


def _max_chord(ring: Points) -> float:
    return float(np.linalg.norm(np.diff(ring, axis=0), axis=1).max())


def _remove_points_in_ring(points: Points, ring: Points) -> Points:
    """Return points (n,) of a line through the ring's middle, without those in or close to the ring, but with the ends."""
    clear = np.abs(points) > float(np.linalg.norm(ring, axis=1).max()) + _max_chord(ring) / 2
    clear[[0, -1]] = True
    return points[clear]


def _replace_close_points(points: Points, replacements: Points, chord: float) -> Points:
    """Return points (n,) of an edge with ``replacements`` in place of those close to them; the ends stay."""
    inside = (replacements > points[0] + chord / 2) & (replacements < points[-1] - chord / 2)
    is_clear = np.abs(points[:, None] - replacements[inside]).min(axis=1, initial=np.inf) > chord / 2
    is_clear[[0, -1]] = True
    return np.unique(np.concatenate([points[is_clear], replacements[inside]]))


def _is_in_ring(points: Points, ring: Points) -> NDArray[np.bool_]:
    """Return which points (n, 2) lie within the polygon of a ring about the origin, or within its half of y >= 0."""
    angles = np.arctan2(ring[:, 1], ring[:, 0])
    order = np.argsort(angles)
    low = np.searchsorted(angles[order], np.arctan2(points[:, 1], points[:, 0])) - 1
    a, b = ring[order][low], ring[order][(low + 1) % len(ring)]
    across = (b - a)[:, 0] * (points - a)[:, 1] - (b - a)[:, 1] * (points - a)[:, 0]
    return np.asarray(across > 0)
