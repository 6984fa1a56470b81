"""Triangulate the surfaces between a scene's bodies, without gaps, as input of the volume mesher.

Each surface appears once, however many bodies share it. All round ones are polygons with corners at the same directions
from the probe's axis, so that the gap between two of them stays as wide as it is; the mesh's nodes are moved to the exact
surfaces later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.body_layout import BodyLayout, Ellipsoid
from geometry.tetra.stretched_space import Spacing
from geometry.tetra.surface_files import Sheet
from geometry.tetra.tissue_faces import triangulate_faces

Triangles = NDArray[np.int64]
Soup = tuple[Points, Triangles]
_OCTAHEDRON_FACES = ((0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5))


@dataclass(frozen=True)
class Corners:
    """Directions, seen from the probe's axis, of the corners of the polygons that stand for circles.

    Attributes
    ----------
    hole
        At the solid cylinder and the hole, (n,), rising from -pi to pi or, for half a scene, from 0 to pi.
    tube
        At the tube's outside.
    side
        At the reference cylinder and the tissue's side.
    hole_radius
        Of the hole's polygon, drawn round the circle and not into it: nodes that go from it to the circle stretch the tube's
        tetrahedra there, which they would flatten otherwise.
    across
        Index of the middle (+x) and how many corners from it the groove's sides lie, 0 without a groove.
    """

    hole: Points
    tube: Points
    side: Points
    hole_radius: float
    across: tuple[int, int]


def choose_corners(layout: BodyLayout, count: int) -> Corners:
    """Choose ``count`` directions, a multiple of 4, all round; with corners where the groove has its own."""
    first = 0 if layout.half else -count // 2
    even_angles: Points = np.arange(first, count // 2 + 1, dtype=np.float64) * (2 * np.pi / count)
    hole_radius = layout.hole / math.cos(math.pi / count)
    if layout.groove is None:
        return Corners(even_angles, even_angles, even_angles, hole_radius, (-first, 0))
    at_hole, at_tube = (math.asin(layout.groove[0] / radius) for radius in (hole_radius, layout.tube))
    steps = int(np.clip(round((at_hole + at_tube) / 2 / (2 * np.pi / count)), 1, count // 2 - 2))
    knots = np.array([-np.pi, -steps * 2 * np.pi / count, 0, steps * 2 * np.pi / count, np.pi])
    hole, tube = (np.interp(even_angles, knots, [-np.pi, -a, 0, a, np.pi]) for a in (at_hole, at_tube))
    return Corners(hole, tube, even_angles, hole_radius, (-first, steps))


def build_surfaces(layout: BodyLayout, turns: Corners, linear_radius: float, rows: int, sphere: int) -> Soup:
    """Build all surfaces but the plane of symmetry.

    Parameters
    ----------
    layout
        The bodies.
    turns
        Directions of the polygons' corners.
    linear_radius
        Distance beyond which lengths shrink in the mesher's space.
    rows
        Of quadrilaterals down round tissue.
    sphere
        Triangles to a right angle of an ellipsoid.
    """
    soups = [*_build_blocks(layout, turns), *_build_tissue(layout, turns, linear_radius, rows)]
    for body in layout.inclusions:
        soups.append((body.points, body.triangles) if isinstance(body, Sheet) else build_ellipsoid(body, sphere, layout.half))
    return join_soups(soups)


def join_soups(soups: Sequence[Soup]) -> Soup:
    """Join surfaces into one set of points, without duplicates, and the triangles that remain."""
    starts = np.cumsum([0, *(len(points) for points, _ in soups)])
    points = np.vstack([points for points, _ in soups])
    triangles = np.vstack([triangles + start for (_, triangles), start in zip(soups, starts, strict=False)])
    grid = np.round(points / (1e-10 * np.abs(points).max()))
    _, index, number = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    triangles = number.reshape(-1)[triangles]
    whole = (triangles[:, 0] != triangles[:, 1]) & (triangles[:, 1] != triangles[:, 2]) & (triangles[:, 0] != triangles[:, 2])
    return points[index], triangles[whole]


def build_ring(radius: float | Points, angles: Points, height: float) -> Points:
    """Return points at a radius, or one for each angle, and a height: (n, 3)."""
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), height)])


def build_band(*rows: Points) -> Soup:
    """Build the triangles between rows of equally many points."""
    n = len(rows[0])
    quads = [(k * n + i, k * n + i + 1, (k + 1) * n + i + 1, (k + 1) * n + i) for k in range(len(rows) - 1) for i in range(n - 1)]
    parts = [part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))]
    return np.vstack(rows), np.array(parts, dtype=np.int64)


def fill_polygon(row: Points) -> Soup:
    """Fill a convex polygon with triangles by repeated halving, so that none is much longer than necessary."""
    parts: list[tuple[int, int, int]] = []

    def add_triangles(low: int, high: int) -> None:
        if high - low > 1:
            middle = (low + high) // 2
            parts.append((low, middle, high))
            add_triangles(low, middle)
            add_triangles(middle, high)

    add_triangles(0, len(row) - 1)
    return row, np.array(parts, dtype=np.int64)


def _build_blocks(layout: BodyLayout, turns: Corners) -> list[Soup]:
    top, height = layout.inner_height, layout.outer_height
    core = [build_ring(layout.inner, turns.hole, z) for z in (0.0, top)]
    levels = [0.0, height] if layout.groove is None else [0.0, height - layout.groove[1], height]
    hole = [build_ring(turns.hole_radius, turns.hole, z) for z in levels]
    tube = [build_ring(layout.tube, turns.tube, z) for z in levels]
    soups = [
        fill_polygon(core[0]),
        fill_polygon(core[1]),
        build_band(*core),
        build_band(core[0], hole[0]),
        build_band(hole[0], tube[0]),
    ]
    soups += [build_band(*hole), build_band(*tube), build_band(hole[-1], tube[-1])]
    if layout.groove is not None:
        middle, steps = turns.across
        across = slice(max(middle - steps, 0), middle + steps + 1)
        soups.append(build_band(hole[1][across], tube[1][across]))
        for index in (middle + steps,) if layout.half else (middle - steps, middle + steps):
            soups.append(build_band(*(np.array([h[index], t[index]]) for h, t in zip(hole[1:], tube[1:], strict=True))))
    return soups


def _build_tissue(layout: BodyLayout, turns: Corners, linear_radius: float, rows: int) -> list[Soup]:
    tube, far = build_ring(layout.tube, turns.tube, 0.0), build_ring(layout.compute_side_distance(turns.side), turns.side, 0.0)
    if layout.wall is None:
        return [build_band(tube, far), *_build_can(layout, far, np.linspace(0, -layout.depth, rows + 1), rows)]
    wall = build_ring(layout.wall, turns.side, 0.0)
    edge = np.array([layout.wall, 0.0, 0.0])
    side_heights = -layout.depth * Spacing(linear_radius, np.zeros((0, 3))).divide_line(edge, edge - [0, 0, layout.depth])
    soups = [build_band(tube, wall), *_build_can(layout, wall, side_heights, rows)]
    return [*soups, *triangulate_faces(layout, linear_radius, wall[:, :2] if layout.half else wall[:-1, :2])]


def _build_can(layout: BodyLayout, top: Points, side_heights: Points, rows: int) -> list[Soup]:
    """Build the side below a ring, with rows at the heights ``inverted``, and the floor inside it."""
    floor = [top * share - [0, 0, layout.depth] for share in np.linspace(0, 1, rows + 1)[1:]]
    return [build_band(*(top + np.array([0, 0, z]) for z in side_heights)), fill_polygon(floor[0]), build_band(*floor)]


def build_ellipsoid(body: Ellipsoid, parts: int, half: bool) -> Soup:
    """Build an ellipsoid's triangles, ``parts`` to a right angle; only y >= 0, with corners on y = 0, if ``half``."""
    points, triangles = _build_sphere(parts, half)
    pole = body.axes[1] / np.linalg.norm(body.axes[1])  # the unit sphere's points with y = 0 are normal to it
    normal = np.linalg.svd(pole[None, :])[2][1]
    turn = np.array([normal, pole, np.cross(normal, pole)])  # rows: the images of x, y, z
    return body.centre + points @ turn @ body.axes.T, triangles


def _build_sphere(parts: int, half: bool) -> Soup:
    corner = np.vstack([np.eye(3), -np.eye(3)])[[0, 3, 1, 4, 2, 5]]
    soups = []
    for face in _OCTAHEDRON_FACES:
        if half and corner[list(face), 1].min() < 0:
            continue
        a, b, c = corner[list(face)]
        steps = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
        number = {step: k for k, step in enumerate(steps)}
        points = np.array([a + (b - a) * i / parts + (c - a) * j / parts for i, j in steps])
        upright = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in steps if i + j < parts]
        inverted = [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in steps if i + j < parts - 1]
        soups.append((_spread_evenly(points), np.array(upright + inverted, dtype=np.int64)))
    return join_soups(soups)


def _spread_evenly(points: Points) -> Points:
    """Place points of an octahedron's face on the sphere, more evenly than by their own directions."""
    bent = np.sign(points) * np.sin(np.pi / 2 * np.abs(points))
    result: Points = bent / np.linalg.norm(bent, axis=1)[:, None]
    return result
