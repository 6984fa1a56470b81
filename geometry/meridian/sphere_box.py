"""Choose the size and the fineness of the box round a sphere in a meridian mesh."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Numeric
from geometry.meridian.grading import smooth_max, smooth_min
from geometry.meridian.section import Section

CORE_REACH = 0.7  # radii of the sphere within which its core's corners lie
SPHERE_CELL = 0.4  # size of the cells beside a sphere, in its radii, to which its box's outer cells are graded


@dataclass(frozen=True)
class Breaks:
    """Places that lines must meet, the sizes of cells there (None: any), and minimum numbers of cells between them."""

    places: list[Numeric]
    sizes: list[Numeric]
    min_cells: list[int]


@dataclass(frozen=True)
class SphereBox:
    """The box 0 <= r <= edge, low <= z <= high round a sphere, and sizes to grade to.

    Attributes
    ----------
    radius, depth
        The sphere's.
    above, below
        From the sphere's poles to the box.
    pole
        Size of cells at the poles.
    """

    radius: Numeric
    depth: Numeric
    above: Numeric
    below: Numeric
    pole: Numeric

    @classmethod
    def from_section(cls, section: Section) -> SphereBox | None:
        """Return the box of a section; None without a sphere."""
        if "sphere_radius" not in section.lengths:
            return None
        s, gaps = section.sphere_radius, (section.cover, section.clearance)
        # between a sphere and a plane near it the field varies over sqrt(gap * radius)
        pole = smooth_min(SPHERE_CELL * s, *(0.5 * (gap * s) ** 0.5 for gap in gaps))
        above, below = (smooth_min(gap / 2, s) for gap in gaps)
        return cls(s, section.sphere_depth, above, below, pole)

    @property
    def high(self) -> Numeric:
        """Height of its upper side."""
        return self.above + self.radius - self.depth

    @property
    def low(self) -> Numeric:
        """Height of its lower side."""
        return -self.depth - self.radius - self.below

    def build_rings(self) -> tuple[Breaks, Breaks]:
        """Return the breaks, fractions 0 to 1 of a ray, of the rays from sphere to box and of those from core to sphere."""
        unit = np.ones_like(np.asarray(self.radius))
        sizes = smooth_min(self.above, self.below), smooth_min(self.radius, 2 * self.pole)
        outside, inside = (Breaks([0 * unit, unit], [None, size / self.radius], [2]) for size in sizes)
        return outside, inside

    def find_widest_interval(self, s: Section) -> int:
        """Return in which interval between radii the box ends: the one in which it may end at the widest range of radii.

        0 is the interval from the axis to the first of the section's ``block_radii``. The range is measured by the ratio of its
        ends.
        """
        breaks = [0.0, *s.block_radii.values(), s.tissue_radius]
        low, high = s.compute_box_limits()
        return int(np.argmax([min(b, high) / max(a, low) for a, b in pairwise(breaks)]))

    def find_edge(self, s: Section, box: int, breaks: list[Numeric]) -> Numeric:
        """Return the radius where the box ends: the middle of what its limits leave of the interval ``box`` of ``breaks``."""
        low, high = s.compute_box_limits()
        blur = 0.2 * (high - low)
        lower = low if box == 0 else smooth_max(low, breaks[box], blur)
        # minus the maximum of the negatives is a minimum
        return (lower - smooth_max(-high, -breaks[box + 1], blur)) / 2

    def place_core(self, radii: Numeric, levels: Numeric) -> tuple[Numeric, Numeric]:
        """Return radii and heights above the centre of the core's grid, both of the shape (..., columns, rows).

        The core is the box, scaled down about the sphere's centre. ``radii`` and ``levels`` are those of the box's lines.
        """
        x, heights = radii[..., :, None], (levels + np.asarray(self.depth)[..., None])[..., None, :]
        edge = radii[..., -1]
        # above the distance of the box's farthest corner from the centre, so that the core's corners lie within ``CORE_REACH``
        # radii
        corner_distance = (edge**2 + (self.radius + self.above) ** 2 + (self.radius + self.below) ** 2) ** 0.5
        shrunk = np.asarray(CORE_REACH * self.radius / corner_distance)[..., None, None]
        return shrunk * x + 0 * heights, shrunk * heights + 0 * x  # + 0: both get the grid's shape
