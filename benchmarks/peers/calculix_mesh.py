"""Structured quadrilaterals of second order in the meridian plane of probe and tissue, graded to the blocks' corners.

All patches are ruled: straight lines join two curves point by point. Round the sphere lies a box, wider than the probe, its
upper face in the middle of the cover; inside it an O-grid: a ring outside the sphere, one inside, and a square core.
Lengths are in inner radii, tissue lies below z = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geometry import Scene
from geometry.common.arrays import Floats, Ints

RESOLUTION = 1e-7  # nodes nearer than this are one
FREE_SIZE = 10.0  # an element's size that restricts nothing


@dataclass(frozen=True)
class Fineness:
    """One mesh.

    Attributes
    ----------
    corner
        Size of the elements at the blocks' corners, over the narrowest of gap, wall and blocks.
    growth
        By how much of their distance from the corner elements grow.
    size
        Of the largest elements, over the size of the body or layer they are in.
    """

    corner: float
    growth: float
    size: float


@dataclass(frozen=True)
class Mesh:
    """Nodes (n, 2); for each body its elements (m, 8), counter-clockwise, corners first; named sets of nodes."""

    nodes: Floats
    elements: dict[str, Ints]
    sets: dict[str, Ints]


def divide_interval(ends: tuple[float, float], sizes: tuple[float, float], fineness: Fineness) -> Floats:
    """Divide an interval: elements of the given sizes at its ends, growing from there; with their middles."""
    a, b = ends
    half = np.concatenate([[0.0], np.geomspace(1e-9, 0.5, 400)])
    x = a + (b - a) * np.concatenate([half, 1 - half[-2::-1]])
    left, right = (size + fineness.growth * np.abs(x - end) for size, end in zip(sizes, ends, strict=True))
    density = 1 / np.minimum(np.minimum(left, right), fineness.size * abs(b - a))
    count = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.abs(np.diff(x)))])
    return insert_middles(np.interp(np.linspace(0, count[-1], math.ceil(count[-1]) + 1), count, x))


def insert_middles(x: Floats) -> Floats:
    """Insert the middles."""
    return np.interp(np.arange(2 * len(x) - 1) / 2, np.arange(len(x)), x)


def divide_evenly(count: int) -> Floats:
    """Divide 0 to 1 evenly, with middles."""
    return np.linspace(0, 1, 2 * count + 1)


def level(r: Floats, z: float) -> Floats:
    """Return a horizontal line, shape (n, 2)."""
    return np.stack([r, np.full_like(r, z)], axis=1)


def upright(r: float, z: Floats) -> Floats:
    """Return a vertical line, shape (n, 2)."""
    return np.stack([np.full_like(z, r), z], axis=1)


class Meridian:
    """The curves of one scene at one fineness, and the patches between them.

    Raises
    ------
    ValueError
        The tissue is no cylinder, or holds no sphere on the axis.
    """

    def __init__(self, scene: Scene, fineness: Fineness) -> None:
        tissue, probe, unit = scene.tissue, scene.probe, scene.probe.inner_radius
        if tissue.shape != "cylinder" or len(scene.inclusion) != 1 or scene.inclusion[0].diameter is None:
            raise ValueError("this mesh takes tissue in a cylinder and one sphere")
        self.fineness = fineness
        self.hole, self.tube, self.side = (x / unit for x in (probe.hole_radius, probe.tube_radius, tissue.radius))
        self.heights, self.floor = (probe.core_height / unit, probe.tube_height / unit), -tissue.depth / unit
        self.sphere, self.centre = scene.inclusion[0].diameter / 2 / unit, -scene.inclusion[0].depth / unit
        self.wide, self.lid = max(1.5 * self.sphere, 1.3 * self.tube), (self.centre + self.sphere) / 2
        self.low = max(self.centre - 1.5 * self.sphere, (self.centre - self.sphere + self.floor) / 2)
        self.corner_size = fineness.corner * min(self.hole - 1, self.tube - self.hole, *self.heights, 1.0)
        self.patches: dict[str, list[tuple[Floats, Floats, Floats]]] = {}

    def rule(self, body: str, first: Floats, last: Floats, weights: Floats) -> None:
        """Add a patch between two curves (n, 2); weights run from 0 on the first to 1 on the last."""
        self.patches.setdefault(body, []).append((first, last, weights))

    def build(self) -> Mesh:
        """Return the mesh."""
        parts = self._across()
        for body, part, height in zip(("inner", "outer"), (parts[0], parts[2]), self.heights, strict=True):
            upwards = divide_interval((0, 1), (self.corner_size / height, self.corner_size / height), self.fineness)
            self.rule(body, level(part, 0), level(part, height), upwards)
        across = np.concatenate([parts[0], *(part[1:] for part in parts[1:])])
        lid = divide_interval((0, 1), (self.corner_size / -self.lid, FREE_SIZE), self.fineness)
        self.rule("tissue", level(across, 0), level(across, self.lid), lid)
        self._box(across / self.wide)
        self._outside(lid, (len(across) - 1) // 2)
        nodes, elements = join_patches(self.patches)
        return Mesh(nodes, elements, self._sets(nodes))

    def _across(self) -> list[Floats]:
        """Divide the radius under the inner block, the gap, under the outer block, and from there to the box's side."""
        ends = [0.0, 1.0, self.hole, self.tube, self.wide]
        sizes = [FREE_SIZE, *[self.corner_size] * 3, FREE_SIZE]
        return [divide_interval((ends[k], ends[k + 1]), (sizes[k], sizes[k + 1]), self.fineness) for k in range(4)]

    def _box(self, t: Floats) -> None:
        """Add O-grid and core; t: where the lines from above meet the box's upper face, 0 to 1."""
        steps = math.ceil(1 / self.fineness.size)
        uniform, ring, side_steps = divide_evenly((len(t) - 1) // 2), divide_evenly(steps // 2), divide_evenly(2 * steps)
        mixed, core, quarter = (t + uniform) / 2, self.sphere / 2, math.pi / 4
        upper, lower = self.centre + core, self.centre - core
        curves = [
            (level(self.wide * t, self.lid), self._arc(quarter * mixed), level(core * uniform, upper)),
            (upright(self.wide, self.lid + (self.low - self.lid) * side_steps), self._arc(quarter * (1 + 2 * side_steps)),
             upright(core, upper + (lower - upper) * side_steps)),
            (level(self.wide * uniform, self.low), self._arc(math.pi - quarter * uniform), level(core * uniform, lower)),
        ]  # fmt: skip
        for box, arc, square in curves:
            self.rule("tissue", box, arc, ring)
            self.rule("inclusion", arc, square, ring)
        self.rule("inclusion", curves[0][2], curves[2][2], side_steps)

    def _arc(self, angle: Floats) -> Floats:
        """Return points of the sphere, the angle from the upper pole."""
        return np.stack([self.sphere * np.sin(angle), self.centre + self.sphere * np.cos(angle)], axis=1)

    def _outside(self, lid: Floats, columns: int) -> None:
        """Add the tissue below the box and outside it."""
        fine, steps = self.fineness, math.ceil(1 / self.fineness.size)
        downwards = divide_interval((0.0, 1.0), ((self.lid - self.low) / (2 * steps) / (self.low - self.floor), FREE_SIZE), fine)
        self.rule(
            "tissue",
            level(self.wide * divide_evenly(columns), self.low),
            level(self.wide * divide_evenly(columns), self.floor),
            downwards,
        )
        outwards = divide_interval((0.0, 1.0), (fine.size * (self.wide - self.tube) / (self.side - self.wide), FREE_SIZE), fine)
        for top, bottom, weights in (
            (0.0, self.lid, lid),
            (self.lid, self.low, divide_evenly(2 * steps)),
            (self.low, self.floor, downwards),
        ):
            z = top + (bottom - top) * weights
            self.rule("tissue", upright(self.wide, z), upright(self.side, z), outwards)

    def _sets(self, nodes: Floats) -> dict[str, Ints]:
        """Return the nodes that are held or moved."""
        r, z = nodes.T
        conditions = {
            "axis": r < RESOLUTION,
            "bottom": z < self.floor + RESOLUTION,
            "end_inner": (r < 1 + RESOLUTION) & (z > self.heights[0] - RESOLUTION),
            "end_outer": (r > 1 + RESOLUTION) & (z > self.heights[1] - RESOLUTION),
        }
        return {name: np.flatnonzero(mask) for name, mask in conditions.items()}


def join_patches(patches: dict[str, list[tuple[Floats, Floats, Floats]]]) -> tuple[Floats, dict[str, Ints]]:
    """Assign numbers to the nodes of all patches, those in the same place once; return them and the elements of each body."""
    grids = {body: [_grid(*patch) for patch in several] for body, several in patches.items()}
    points = np.concatenate([grid.reshape(-1, 2) for several in grids.values() for grid in several])
    _, kept, place = np.unique(np.round(points / RESOLUTION), axis=0, return_index=True, return_inverse=True)
    start, numbers = 0, {}
    for body, several in grids.items():
        elements = []
        for grid in several:
            elements.append(start + _quadrilaterals(grid))
            start += grid.size // 2
        numbers[body] = place.ravel()[np.concatenate(elements)]
    used, number = np.unique(np.concatenate(list(numbers.values())), return_inverse=True)  # not the elements' midpoints
    shares = np.split(number.reshape(-1, 8), np.cumsum([len(elements) for elements in numbers.values()])[:-1])
    return points[kept[used]], dict(zip(numbers, shares, strict=True))


def _grid(first: Floats, last: Floats, weights: Floats) -> Floats:
    """Return the points of a patch, shape (weights, points of a curve, 2)."""
    return first * (1 - weights)[:, None, None] + last * weights[:, None, None]


def _quadrilaterals(grid: Floats) -> Ints:
    """Return the elements of a patch of points (2 m + 1, 2 n + 1, 2) by their points' numbers, counter-clockwise."""
    number = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2])
    corners = [number[:-1:2, :-1:2], number[:-1:2, 2::2], number[2::2, 2::2], number[2::2, :-1:2]]
    middles = [number[:-1:2, 1::2], number[1::2, 2::2], number[2::2, 1::2], number[1::2, :-1:2]]
    (a, b), (c, d) = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    if a * d - b * c < 0:
        corners, middles = corners[::-1], [*middles[2::-1], middles[3]]
    return np.stack([each.ravel() for each in corners + middles], axis=1)
