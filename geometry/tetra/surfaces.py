"""The surfaces between a scene's bodies as triangles that fit together: what the volume mesher is given.

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
from geometry.tetra.layout import BodyLayout, Ellipsoid
from geometry.tetra.stretched_space import MeshSpace
from geometry.tetra.surface_files import Sheet

Triangles = NDArray[np.int64]
Soup = tuple[Points, Triangles]
_BESIDE = 0.01  # of the mesher's near distance
_HALVINGS = 6
_OCTAHEDRON = ((0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5))


@dataclass(frozen=True)
class Corners:
    """Directions, seen from the probe's axis, of the corners of the polygons that stand for circles.

    Attributes:
        hole: at the solid cylinder and the hole, (n,), rising from -pi to pi or, for half a scene, from 0 to pi.
        tube: at the tube's outside.
        side: at the reference cylinder and the tissue's side.
        hole_radius: of the hole's polygon, drawn round the circle and not into it: nodes that go from it to the circle stretch
            the tube's tetrahedra there, which they would flatten otherwise.
        across: index of the middle (+x) and how many corners from it the groove's sides lie, 0 without a groove.
    """

    hole: Points
    tube: Points
    side: Points
    hole_radius: float
    across: tuple[int, int]


def corners(layout: BodyLayout, count: int) -> Corners:
    """Choose ``count`` directions, a multiple of 4, all round; with corners where groove and block have theirs."""
    first = 0 if layout.half else -count // 2
    even: Points = np.arange(first, count // 2 + 1, dtype=np.float64) * (2 * np.pi / count)
    side = even.copy()
    for angle in layout.corner_angles():
        turned = (angle + np.pi) % (2 * np.pi) - np.pi
        if turned >= even[0]:
            side[np.abs(even - turned).argmin()] = turned
    hole_radius = layout.hole / math.cos(math.pi / count)
    if layout.groove is None:
        return Corners(even, even, side, hole_radius, (-first, 0))
    at_hole, at_tube = (math.asin(layout.groove[0] / radius) for radius in (hole_radius, layout.tube))
    steps = int(np.clip(round((at_hole + at_tube) / 2 / (2 * np.pi / count)), 1, count // 2 - 2))
    knots = np.array([-np.pi, -steps * 2 * np.pi / count, 0, steps * 2 * np.pi / count, np.pi])
    hole, tube = (np.interp(even, knots, [-np.pi, -a, 0, a, np.pi]) for a in (at_hole, at_tube))
    return Corners(hole, tube, side, hole_radius, (-first, steps))


def surfaces(layout: BodyLayout, turns: Corners, space: MeshSpace, rows: int, sphere: int) -> Soup:
    """All surfaces but the plane of symmetry; ``rows`` of quadrilaterals down the tissue's side, ``sphere`` to a right angle.

    Far planes are bent in the mesher's space: there they have as many triangles as follow them.
    """
    soups = [*_blocks(layout, turns), followed(join(_tissue(layout, turns, rows)), space)]
    for body in layout.inclusions:
        soups.append((body.points, body.triangles) if isinstance(body, Sheet) else ellipsoid(body, sphere, layout.half))
    return join(soups)


def join(soups: Sequence[Soup]) -> Soup:
    """One set of points, those that coincide once, and all triangles that are left."""
    starts = np.cumsum([0, *(len(points) for points, _ in soups)])
    points = np.vstack([points for points, _ in soups])
    triangles = np.vstack([triangles + start for (_, triangles), start in zip(soups, starts, strict=False)])
    grid = np.round(points / (1e-10 * np.abs(points).max()))
    _, index, number = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    triangles = number.reshape(-1)[triangles]
    whole = (triangles[:, 0] != triangles[:, 1]) & (triangles[:, 1] != triangles[:, 2]) & (triangles[:, 0] != triangles[:, 2])
    return points[index], triangles[whole]


def followed(soup: Soup, space: MeshSpace) -> Soup:
    """Triangles halved along edges until none lies further beside its own image in the mesher's space than ``_BESIDE``.

    Tetrahedra between a triangle and its image would be taken for tissue outside, or for air inside.
    """
    points, triangles = soup
    for _ in range(_HALVINGS):
        edges, number = _edges(triangles)
        ends = points[edges]
        middles = ends.mean(axis=1)
        images = space.to_mesh(points)
        a, b, c = (images[triangles[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        beside = (space.to_mesh(middles) - images[edges].mean(axis=1))[number]
        bent = np.abs(np.einsum("tkj,tj->tk", beside, normal)) > _BESIDE * space.near
        split = np.zeros(len(edges), dtype=bool)
        split[number[bent]] = True
        if not split.any():
            break
        new = np.where(split, len(points) + np.cumsum(split) - 1, -1)
        points, triangles = np.vstack([points, middles[split]]), _halved(triangles, new[number])
    return points, triangles


def _edges(triangles: Triangles) -> tuple[Triangles, Triangles]:
    """The edges (e, 2), each once, and of each triangle the numbers of those from its first, second and third corner (t, 3)."""
    every = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    edges, number = np.unique(every.reshape(-1, 2), axis=0, return_inverse=True)
    return edges, number.reshape(-1, 3)


def _halved(triangles: Triangles, middles: Triangles) -> Triangles:
    """Triangles cut along the middles (t, 3) of their edges, -1 where an edge is whole."""
    parts: list[tuple[int, ...]] = []
    for corners, cuts in zip(triangles.tolist(), middles.tolist(), strict=True):
        first = next((k for k in range(3) if cuts[k] >= 0 and cuts[k - 1] < 0), 0)  # turned so that cut edges come first
        (a, b, c), (ab, bc, ca) = (one[first:] + one[:first] for one in (corners, cuts))
        if ca >= 0:
            parts += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        elif bc >= 0:
            parts += [(ab, b, bc), (a, ab, bc), (a, bc, c)]
        elif ab >= 0:
            parts += [(a, ab, c), (ab, b, c)]
        else:
            parts.append((a, b, c))
    return np.array(parts, dtype=np.int64)


def ring(radius: float | Points, angles: Points, height: float) -> Points:
    """Points at a radius, or one for each angle, and a height: (n, 3)."""
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), height)])


def band(*rows: Points) -> Soup:
    """Triangles between rows of as many points each."""
    n = len(rows[0])
    quads = [(k * n + i, k * n + i + 1, (k + 1) * n + i + 1, (k + 1) * n + i) for k in range(len(rows) - 1) for i in range(n - 1)]
    parts = [part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))]
    return np.vstack(rows), np.array(parts, dtype=np.int64)


def disc(row: Points) -> Soup:
    """Triangles that fill a convex polygon, halving it again and again: none much longer than need be."""
    parts: list[tuple[int, int, int]] = []

    def fill(low: int, high: int) -> None:
        if high - low > 1:
            middle = (low + high) // 2
            parts.append((low, middle, high))
            fill(low, middle)
            fill(middle, high)

    fill(0, len(row) - 1)
    return row, np.array(parts, dtype=np.int64)


def _blocks(layout: BodyLayout, turns: Corners) -> list[Soup]:
    top, height = layout.inner_height, layout.outer_height
    core = [ring(layout.inner, turns.hole, z) for z in (0.0, top)]
    levels = [0.0, height] if layout.groove is None else [0.0, height - layout.groove[1], height]
    hole = [ring(turns.hole_radius, turns.hole, z) for z in levels]
    tube = [ring(layout.tube, turns.tube, z) for z in levels]
    soups = [disc(core[0]), disc(core[1]), band(*core), band(core[0], hole[0]), band(hole[0], tube[0])]
    soups += [band(*hole), band(*tube), band(hole[-1], tube[-1])]
    if layout.groove is not None:
        middle, steps = turns.across
        across = slice(max(middle - steps, 0), middle + steps + 1)
        soups.append(band(hole[1][across], tube[1][across]))
        for index in (middle + steps,) if layout.half else (middle - steps, middle + steps):
            soups.append(band(*(np.array([h[index], t[index]]) for h, t in zip(hole[1:], tube[1:], strict=True))))
    return soups


def _tissue(layout: BodyLayout, turns: Corners, rows: int) -> list[Soup]:
    tube, far = ring(layout.tube, turns.tube, 0.0), ring(layout.side_distance(turns.side), turns.side, 0.0)
    down = -layout.depth * np.linspace(0, 1, rows + 1)
    soups = [band(*(far + np.array([0, 0, z]) for z in down))]
    stops = [far] if layout.wall is None else [ring(layout.wall, turns.side, 0.0), far]
    soups.append(band(tube, *stops))
    if layout.wall is not None:
        soups.append(band(*(stops[0] + np.array([0, 0, z]) for z in down)))
    shares = [(stops[0], share) for share in np.linspace(0, 1, rows + 1)[1:]]
    floor = [row * [share, share, 0] - [0, 0, layout.depth] for row, share in shares]
    if len(stops) > 1:
        floor += [stops[0] * (1 - s) + far * s - [0, 0, layout.depth] for s in (0.5, 1.0)]
    return [*soups, disc(floor[0]), band(*floor)]


def ellipsoid(body: Ellipsoid, parts: int, half: bool) -> Soup:
    """An ellipsoid's triangles, ``parts`` to a right angle; with corners on the plane y = 0, and only y >= 0, if ``half``."""
    points, triangles = _sphere(parts, half)
    pole = body.axes[1] / np.linalg.norm(body.axes[1])  # the unit sphere's points with y = 0 are normal to it
    other = np.linalg.svd(pole[None, :])[2][1]
    turn = np.array([other, pole, np.cross(other, pole)])  # rows: the images of x, y, z
    return body.centre + points @ turn @ body.axes.T, triangles


def _sphere(parts: int, half: bool) -> Soup:
    corner = np.vstack([np.eye(3), -np.eye(3)])[[0, 3, 1, 4, 2, 5]]
    soups = []
    for face in _OCTAHEDRON:
        if half and corner[list(face), 1].min() < 0:
            continue
        a, b, c = corner[list(face)]
        steps = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
        number = {step: k for k, step in enumerate(steps)}
        points = np.array([a + (b - a) * i / parts + (c - a) * j / parts for i, j in steps])
        up = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in steps if i + j < parts]
        down = [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in steps if i + j < parts - 1]
        soups.append((_evened(points), np.array(up + down, dtype=np.int64)))
    return join(soups)


def _evened(points: Points) -> Points:
    """Points of an octahedron's face on the sphere, more evenly than by their own directions."""
    bent = np.sign(points) * np.sin(np.pi / 2 * np.abs(points))
    result: Points = bent / np.linalg.norm(bent, axis=1)[:, None]
    return result
