"""The box round a sphere in a meridian mesh: where it ends, how fine it is, and how its rays meet interfaces of the tissue."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from geometry.meridian.grading import smooth_max, smooth_min
from geometry.meridian.section import Section

CORE_REACH = 0.7  # radii of the sphere within which its core's corners lie
SPHERE_CELL = 0.4  # size of the cells beside a sphere, in its radii, to which its box's outer cells are graded


@dataclass(frozen=True)
class Breaks:
    """Places that lines must meet, the sizes of cells there (None: any), and least numbers of cells between them."""

    places: list[Any]
    sizes: list[Any]
    least: list[int]


@dataclass(frozen=True)
class SphereBox:
    """The box 0 <= r <= edge, low <= z <= high round a sphere, and sizes to grade to.

    Attributes:
        radius, depth: the sphere's.
        above, below: from the sphere's poles to the box.
        pole: size of cells at the poles.
    """

    radius: Any
    depth: Any
    above: Any
    below: Any
    pole: Any

    @classmethod
    def of(cls, section: Section) -> SphereBox | None:
        """Return that of a section; None without a sphere."""
        if "sphere_radius" not in section.lengths:
            return None
        s, gaps = section.sphere_radius, (section.cover, section.clearance)
        # between a sphere and a plane near it the field varies over sqrt(gap * radius)
        pole = smooth_min(SPHERE_CELL * s, *(0.5 * (gap * s) ** 0.5 for gap in gaps))
        above, below = (smooth_min(gap / 2, s) for gap in gaps)
        return cls(s, section.sphere_depth, above, below, pole)

    @property
    def high(self) -> Any:
        """Height of its upper side."""
        return self.above + self.radius - self.depth

    @property
    def low(self) -> Any:
        """Height of its lower side."""
        return -self.depth - self.radius - self.below

    def rings(self) -> tuple[Breaks, Breaks]:
        """Fractions of the rays between sphere and box and between core and sphere."""
        one = np.ones_like(np.asarray(self.radius))
        sizes = smooth_min(self.above, self.below), smooth_min(self.radius, 2 * self.pole)
        outside, inside = (Breaks([0 * one, one], [None, size / self.radius], [2]) for size in sizes)
        return outside, inside

    def core(self, edge: Any) -> Any:
        """Factor by which the box, which ends at ``edge``, is shrunk to become the core."""
        far = (edge**2 + (self.radius + self.above) ** 2 + (self.radius + self.below) ** 2) ** 0.5  # than the box's corners
        return CORE_REACH * self.radius / far

    def widest_place(self, s: Section) -> int:
        """Between which radii the box has the most room to end, on a logarithmic scale."""
        breaks = [0.0, *s.block_radii.values(), s.tissue_radius]
        low, high = s.box_limits()
        return int(np.argmax([min(b, high) / max(a, low) for a, b in pairwise(breaks)]))

    def edge(self, s: Section, box: int, breaks: list[Any]) -> Any:
        """Where the box ends: in the middle of the room between its limits and the radii beside it."""
        low, high = s.box_limits()
        blur = 0.2 * (high - low)
        least = low if box == 0 else smooth_max(low, breaks[box], blur)
        return (least - smooth_max(-high, -breaks[box + 1], blur)) / 2

    def turns(self, radii: Any, levels: Any, crossing: list[int]) -> Any:
        """Angles by which rays to points of the box's grid are turned, so that those to the interfaces are level on the sphere.

        With a the angle of a ray above the horizon and b that of where it meets the sphere, sin b = height / radius at an
        interface, b is linear in a between the interfaces, the box's corners and the poles (ME.3). A corner's b is its own a or,
        where an interface meets the sphere near it or beyond, half-way from that interface to the pole. Inside the box's
        sides the turn b - a is a Coons patch of theirs.

        Args:
            radii: of the box's columns, from the axis to its side, shape (..., columns).
            levels: heights of its rows, shape (..., rows).
            crossing: numbers of the rows on interfaces, from below.

        Returns:
            Shape (..., columns, rows).
        """
        heights, edge = levels + np.asarray(self.depth)[..., None], radii[..., -1:]
        breaks, along, half = [0, *crossing, levels.shape[-1] - 1], np.arctan(heights / edge), np.pi / 2
        a, b = along[..., breaks], np.arcsin(heights[..., crossing] / np.asarray(self.radius)[..., None])
        low, high = (s * (half - smooth_min(half - s * a[..., k], (half - s * b[..., k]) / 2)) for s, k in ((-1, 0), (1, -1)))
        b = np.concatenate([low[..., None], b, high[..., None]], axis=-1)
        spans = [slice(first, last + (last == breaks[-1])) for first, last in pairwise(breaks)]
        side = np.concatenate([_between(a, b, k, along[..., span]) for k, span in enumerate(spans)], axis=-1)
        across, up = radii / edge, (heights - heights[..., :1]) / (heights[..., -1:] - heights[..., :1])
        inside = across[..., :, None] * side[..., None, :]
        for k, pole, share in ((0, -half, 1 - up), (-1, half, up)):  # what bottom and top add
            flat = pole - np.arctan(radii / heights[..., [k]])
            flank = (b[..., [k]] - a[..., [k]]) * (pole - flat) / (pole - a[..., [k]])
            inside = inside + share[..., None, :] * (flank - across * side[..., [k]])[..., None]
        return inside


def _between(a: Any, b: Any, k: int, along: Any) -> Any:
    """By how much rays between the breaks k and k + 1 are turned: b - a, b linear in a."""
    share = (along - a[..., [k]]) / (a[..., [k + 1]] - a[..., [k]])
    return b[..., [k]] + share * (b[..., [k + 1]] - b[..., [k]]) - along
