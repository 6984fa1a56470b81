r"""Block-structured quadrilateral meshes of the meridian half-plane r >= 0, z <= 0 in the tissue.

Tissue is cut into a strip under the surface, a box around the sphere and the rest. All
lines in the box are rays from the sphere's centre, so no cell can turn inside out:

    z = 0    +-----------------------------+      strip: as thick as the cover allows
             +---------+-------------------+
             |\  top  /|                   |
             | (sphere) side   right       |      box: three ring blocks outside the
             |/ bottom\|                   |      sphere, three inside, a core in the middle
             +---------+-------------------+
             |           bottom            |
    z = -H   +-----------------------------+
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from geometry.grading import Feature, Floats, graded, with_midpoints

SPHERE_CELL = 0.4  # cells near the sphere per unit growth, in its radii


class Body(IntEnum):
    """The bodies of the meridian plane."""

    TISSUE = 0
    INNER = 1
    OUTER = 2
    INCLUSION = 3


@dataclass(frozen=True)
class Fineness:
    """How fine a mesh is: cells grow by ``growth`` per distance, the first at a corner is ``corner`` of its scale.

    ``order`` is the polynomial order that is meant to go with it.
    """

    growth: float
    corner: float
    order: int = 3


@dataclass(frozen=True)
class Sphere:
    """A sphere on the axis: radius and depth of the centre, m."""

    radius: float
    depth: float


@dataclass(frozen=True)
class Section:
    """The meridian section of a rotationally symmetric scene; lengths in m.

    ``inner_radius`` < ``hole_radius`` < ``tube_radius`` < ``tissue_radius``.
    """

    inner_radius: float
    hole_radius: float
    tube_radius: float
    inner_height: float
    outer_height: float
    tissue_radius: float
    tissue_depth: float
    sphere: Sphere | None = None

    @property
    def corner_scales(self) -> tuple[float, float, float]:
        """The length on which each block corner's stress singularity lives, at r2, Ri and Ro."""
        gap, wall = self.hole_radius - self.inner_radius, self.tube_radius - self.hole_radius
        return (
            min(self.inner_radius, self.inner_height, gap, self.tissue_depth),
            min(wall, self.outer_height, gap, self.tissue_depth),
            min(wall, self.outer_height, self.tissue_radius - self.tube_radius, self.tissue_depth),
        )

    @property
    def floor_scale(self) -> float:
        """The length on which the singularity lives where the tissue's side meets the table."""
        return min(self.tissue_radius - self.tube_radius, self.tissue_depth)


@dataclass(frozen=True)
class MeridianMesh:
    """Nine-node quadrilaterals.

    Attributes:
        cells: node coordinates (r, z) in m, shape (n, 9, 2); nodes in the order of the corners
            counter-clockwise, the edges' middles (bottom, right, top, left), the centre.
        body: the body of each cell, shape (n,), values of ``Body``.
    """

    cells: Floats
    body: np.ndarray[tuple[int], np.dtype[np.int64]]


def mesh(section: Section, fineness: Fineness) -> MeridianMesh:
    """Mesh a section; cells of blocks and tissue meet node to node on z = 0."""
    columns = _columns(section, fineness)
    parts = _tissue(section, fineness, columns) + _blocks(section, fineness, columns)
    body = np.concatenate([np.full(len(cells), int(body)) for body, cells in parts])
    return MeridianMesh(np.concatenate([cells for _, cells in parts]) + 0.0, body)  # + 0.0: no negative zeros


Part = tuple[Body, Floats]


def _columns(section: Section, fineness: Fineness) -> Floats:
    radii = (section.inner_radius, section.hole_radius, section.tube_radius)
    scales = zip(radii, section.corner_scales, strict=True)
    features = [Feature.point(r, fineness.corner * scale) for r, scale in scales]
    features.append(Feature.point(section.tissue_radius, fineness.corner * section.floor_scale))
    breaks = {0.0, *radii, section.tissue_radius}
    if section.sphere is not None:
        box = _Box.around(section.sphere, section)
        breaks.add(box.right)
        features.append(Feature(0.0, box.right, SPHERE_CELL * section.sphere.radius))
        # between a sphere and a plane near it the field varies over sqrt(clearance * radius), and
        # the parabolas that stand for arcs have to follow the sphere to a small part of the clearance
        features += [Feature.point(0.0, 0.5 * np.sqrt(gap * section.sphere.radius), 0.5) for gap in (box.cover, box.clearance)]
    return graded(sorted(breaks), features, fineness.growth)


def _rows(low: float, high: float, section: Section, fineness: Fineness) -> Floats:
    """Levels z of the tissue, graded to its surface, its bottom and the sphere."""
    features = [
        Feature.point(0.0, fineness.corner * min(section.corner_scales)),
        Feature.point(-section.tissue_depth, fineness.corner * section.floor_scale),
    ]
    if section.sphere is not None:
        box = _Box.around(section.sphere, section)
        features.append(Feature(box.low, box.high, SPHERE_CELL * section.sphere.radius))
    return graded([low, high], features, fineness.growth)


def _blocks(section: Section, fineness: Fineness, columns: Floats) -> list[Part]:
    inner = columns[columns <= section.inner_radius]
    outer = columns[(columns >= section.hole_radius) & (columns <= section.tube_radius)]
    at_core, at_hole, at_edge = section.corner_scales
    sides = ((Body.INNER, inner, section.inner_height, at_core), (Body.OUTER, outer, section.outer_height, min(at_hole, at_edge)))
    parts = []
    for body, across, height, scale in sides:
        ends = [Feature.point(z, fineness.corner * scale) for z in (0.0, height)]
        parts.append((body, _tensor(across, graded([0.0, height], ends, fineness.growth))))
    return parts


def _tissue(section: Section, fineness: Fineness, columns: Floats) -> list[Part]:
    if section.sphere is None:
        return [(Body.TISSUE, _tensor(columns, _rows(-section.tissue_depth, 0.0, section, fineness)))]
    box = _Box.around(section.sphere, section)
    rooms = ((box.high, 0.0), (box.low, box.high), (-section.tissue_depth, box.low))
    strip, middle, bottom = (_rows(low, high, section, fineness) for low, high in rooms)
    beside = columns[columns >= box.right]
    tissue = [_tensor(columns, strip), _tensor(beside, middle), _tensor(columns, bottom)]
    within = with_midpoints(columns[columns <= box.right])
    return [(Body.TISSUE, cells) for cells in tissue] + _box_parts(box, fineness, within, with_midpoints(middle))


@dataclass(frozen=True)
class _Box:
    """The box 0 <= r <= right, low <= z <= high round a sphere, between one and two radii from its centre."""

    sphere: Sphere
    right: float
    high: float
    low: float
    cover: float
    clearance: float

    @classmethod
    def around(cls, sphere: Sphere, section: Section) -> _Box:
        s, d = sphere.radius, sphere.depth
        cover, clearance, beside = d - s, section.tissue_depth - d - s, section.tissue_radius - s
        above, below, right = (s + min(room / 2, s) for room in (cover, clearance, beside))
        return cls(sphere, right, above - d, -d - below, cover, clearance)

    @property
    def core_scale(self) -> float:
        """The core is the box shrunk about the sphere's centre until its corners lie at 0.6 radii."""
        far = max(abs(self.high + self.sphere.depth), abs(self.low + self.sphere.depth))
        return float(0.6 * self.sphere.radius / np.hypot(self.right, far))


def _box_parts(box: _Box, fineness: Fineness, across: Floats, levels: Floats) -> list[Part]:
    """The blocks of the box; ``across`` and ``levels`` contain the cells' middles."""
    centre = np.array([0.0, -box.sphere.depth])
    grid = np.stack(np.meshgrid(across, levels, indexing="ij"), axis=-1)
    sides = (grid[::-1, -1], grid[-1, ::-1], grid[:, 0])  # top, right and bottom, each counted clockwise backwards
    outside, inside = (with_midpoints(fractions) for fractions in _ring_fractions(box, fineness))
    parts = [(Body.INCLUSION, _quadrilaterals(centre + box.core_scale * (grid - centre)))]
    for side in (sides[0], sides[1], sides[2]):
        ray = side - centre
        arc = centre + box.sphere.radius * ray / np.hypot(ray[:, :1], ray[:, 1:])
        parts.append((Body.TISSUE, _ruled(arc, side, outside)))
        parts.append((Body.INCLUSION, _ruled(centre + box.core_scale * ray, arc, inside)))
    return parts


def _ring_fractions(box: _Box, fineness: Fineness) -> tuple[Floats, Floats]:
    """Where circles cut the rays between sphere and box and between core and sphere, as fractions 0 .. 1.

    Under a thin cover the strip is thin too, and block corners may lie beside the pole, where the
    rays are long: cells then shrink towards the strip.
    """
    longest = np.hypot(box.right, max(box.high + box.sphere.depth, -box.low - box.sphere.depth)) - box.sphere.radius
    strip = Feature.point(1.0, -box.high / longest)
    outside = graded([0.0, 1.0], [strip, Feature(0.0, 1.0, 0.6)], fineness.growth)
    return outside, graded([0.0, 1.0], [Feature(0.0, 1.0, 0.9)], fineness.growth)


def _ruled(start: Floats, end: Floats, fractions: Floats) -> Floats:
    """Cells between two curves of corresponding points; the curves themselves are met exactly."""
    v = fractions[None, :, None]
    points = np.where(v == 1.0, end[:, None], start[:, None] + v * (end - start)[:, None])
    return _quadrilaterals(points)


def _tensor(across: Floats, levels: Floats) -> Floats:
    return _quadrilaterals(np.stack(np.meshgrid(with_midpoints(across), with_midpoints(levels), indexing="ij"), axis=-1))


def _quadrilaterals(points: Floats) -> Floats:
    """Cut a (2m+1, 2n+1, 2) array of points into m n nine-node cells, counter-clockwise."""
    corners = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1))
    m, n = (size - 2 for size in points.shape[:2])
    cells = np.stack([points[i : i + m : 2, j : j + n : 2] for i, j in corners], axis=2).reshape(-1, 9, 2)
    return cells if _turns_left(cells[0]) else cells[:, [0, 3, 2, 1, 7, 6, 5, 4, 8]]


def _turns_left(cell: Floats) -> bool:
    (a, b), (c, d) = cell[1] - cell[0], cell[3] - cell[0]
    return bool(a * d - b * c > 0)
