"""Hold a scene's bodies as numbers in the probe's axes, and check that they fit the tissue and do not overlap."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.errors import Refusal, Words
from geometry.common.limits import format_minimum_mm
from geometry.scenes.probe import format_mm
from geometry.tetra.surface_files import Sheet

_OUTLINE_ANGLES = np.linspace(0, 2 * np.pi, 721)  # every half degree


@dataclass(frozen=True)
class Ellipsoid:
    """The points ``centre`` + ``axes`` u with |u| <= 1, in m; ``axes`` (3, 3) has the semi-axes as columns."""

    centre: Points
    axes: Points

    def level(self, points: Points) -> Points:
        """Return |u| of points (n, 3), (n,), with u as in the class: less than 1 inside, 1 on the surface, more outside."""
        result: Points = np.linalg.norm((points - self.centre) @ self._inverse.T, axis=1)
        return result

    def find_level(self, points: Points) -> tuple[Points, Points]:
        """Return approximate distances of points (n, 3) from the surface, (n,), negative inside, and unit gradients (n, 3).

        They are (|u| - 1) over the gradient of |u|, which is exact for a sphere.
        """
        # both lower limits avoid a division by zero at the centre, where the gradient of |u| is undefined
        inverse, level = self._inverse, np.maximum(self.level(points), 1e-9)
        derivative = (points - self.centre) @ (inverse.T @ inverse) / level[:, None]
        steep = np.maximum(np.linalg.norm(derivative, axis=1), 1e-9 / self.min_semi_axis)
        return (level - 1) / steep, derivative / steep[:, None]

    def estimate_distance(self, points: Points) -> Points:
        """Estimate the distance in m from points (n, 3) to the surface, negative inside; see ``find_level``."""
        return self.find_level(points)[0]

    @property
    def min_semi_axis(self) -> float:
        """The smallest semi-axis."""
        return float(np.linalg.norm(self.axes, axis=0).min())

    @property
    def reach(self) -> Points:
        """Half the sides of the bounding box, along the probe's axes, (3,)."""
        result: Points = np.linalg.norm(self.axes, axis=1)
        return result

    @property
    def volume(self) -> float:
        """Volume in m^3."""
        return 4 / 3 * math.pi * abs(float(np.linalg.det(self.axes)))

    @cached_property
    def _inverse(self) -> Points:
        return np.asarray(np.linalg.inv(self.axes), dtype=np.float64)


@dataclass(frozen=True)
class BodyLayout:
    """Lengths in m, in the probe's axes: origin on its axis in the tissue's top plane, z out of the tissue.

    Attributes
    ----------
    inner, hole, tube
        Radii of the solid cylinder, the hole and the tube.
    inner_height, outer_height
        Of the blocks.
    groove
        Half its width and its depth, or None.
    centre
        The tissue's axis, (2,).
    tissue_radius
        Of round tissue, or None for a block.
    sides
        Half the length and half the breadth of a block.
    depth
        Of the tissue.
    interfaces
        Depths of the planes between its layers, from the surface downwards.
    wall
        Radius of the reference cylinder where it is not the tissue's own side, or None.
    inclusions
        In the scene's order.
    half
        Whether only y >= 0 is meshed.
    """

    inner: float
    hole: float
    tube: float
    inner_height: float
    outer_height: float
    groove: tuple[float, float] | None
    centre: tuple[float, float]
    tissue_radius: float | None
    sides: tuple[float, float]
    depth: float
    interfaces: tuple[float, ...]
    wall: float | None
    inclusions: tuple[Ellipsoid | Sheet, ...]
    half: bool

    @property
    def gap(self) -> float:
        """Width of the gap."""
        return self.hole - self.inner

    def compute_side_distance(self, angles: Points) -> Points:
        """Return the distances from the probe's axis to the tissue's side in the directions ``angles`` (n,)."""
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        centre = np.array(self.centre)
        if self.tissue_radius is not None:
            projection = directions @ centre
            # the root of |t direction - centre| = tissue_radius that is positive for an origin inside the tissue
            result: Points = projection + np.sqrt(projection**2 + self.tissue_radius**2 - centre @ centre)
            return result
        distances = np.where(directions > 0, np.array(self.sides) + centre, np.array(self.sides) - centre)
        # along each axis the ray meets the nearer of two planes; 1e-300: a ray parallel to a plane never meets it
        return np.asarray((distances / np.maximum(np.abs(directions), 1e-300)).min(axis=1))

    def contains(self, points: Points) -> NDArray[np.bool_]:
        """Return which points (n, 3) lie in tissue or blocks, (n,), gap and groove counted as blocks.

        In a half mesh only with y >= 0.
        """
        radius, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        tissue = (z <= 0) & (z >= -self.depth) & (radius <= self.compute_side_distance(np.arctan2(points[:, 1], points[:, 0])))
        blocks = (z > 0) & (z <= max(self.inner_height, self.outer_height)) & (radius <= self.tube)
        return np.asarray((tissue | blocks) & ((points[:, 1] >= 0) | (not self.half)))


def check_fit(layout: BodyLayout, names: tuple[str, ...], extent: float) -> None:
    """Refuse inclusions that reach beyond the tissue, and surfaces from files that overlap other inclusions.

    Two overlapping ellipsoids were refused before, when the scene was read.

    Parameters
    ----------
    layout
        The bodies, the tissue shortened to ``extent``.
    names
        Of each inclusion's surface file, "" where it has none.
    extent
        Radius and depth of the shortened tissue in m, for the message.

    Raises
    ------
    Refusal
        For ``inclusion[k].surface``, or for ``tissue_extent`` where shortened tissue is too small for a body.
    """
    for index, (body, name) in enumerate(zip(layout.inclusions, names, strict=True)):
        protrusion = _describe_excess(layout, body)
        if protrusion and isinstance(body, Sheet):
            raise Refusal(f"inclusion[{index}].surface", Words(f"{name}, which leaves {protrusion}"), "a body inside the tissue")
        if protrusion:
            raise Refusal(
                "tissue_extent", format_mm(extent), f"tissue with room for inclusion[{index}], which leaves {protrusion}"
            )
    for (i, first), (j, second) in combinations(enumerate(layout.inclusions), 2):
        if (isinstance(first, Sheet) or isinstance(second, Sheet)) and do_overlap(first, second):
            # the message is for the one with a file; of two with files for the second
            index, other_index = (j, i) if isinstance(second, Sheet) else (i, j)
            value = Words(f"{names[index]}, which overlaps or touches inclusion[{other_index}]")
            raise Refusal(f"inclusion[{index}].surface", value, "inclusions apart")


def _describe_excess(layout: BodyLayout, body: Ellipsoid | Sheet) -> str:
    """Return which face of the tissue a body reaches beyond and by how much ("its top by 2 mm"), "" if it is inside."""
    if isinstance(body, Sheet):
        low, high = float(body.points[:, 2].min()), float(body.points[:, 2].max())
        reach, angles = np.hypot(*body.points[:, :2].T), np.arctan2(body.points[:, 1], body.points[:, 0])
    else:
        low, high = float(body.centre[2] - body.reach[2]), float(body.centre[2] + body.reach[2])
        outline = body.centre[:2] + _compute_outline(body)
        reach, angles = np.hypot(*outline.T), np.arctan2(outline[:, 1], outline[:, 0])
    if high >= 0:
        return f"its top by {format_mm(high)}"
    if low <= -layout.depth:
        return f"its bottom by {format_mm(-layout.depth - low)}"
    excess = float((reach - layout.compute_side_distance(angles)).max())
    return f"its side by {format_mm(excess)}" if excess >= 0 else ""


def _compute_outline(body: Ellipsoid) -> Points:
    """Return points on the outline of the ellipsoid's projection on the plane z = 0, relative to its centre, (n, 2).

    With B the first two rows of ``axes`` and F = B B^T, the point farthest in the direction d is F d / sqrt(d F d).
    """
    directions = np.column_stack([np.cos(_OUTLINE_ANGLES), np.sin(_OUTLINE_ANGLES)])
    form = body.axes[:2] @ body.axes[:2].T
    result: Points = directions @ form / np.sqrt(np.einsum("ni,ij,nj->n", directions, form, directions))[:, None]
    return result


def do_overlap(first: Ellipsoid | Sheet, second: Ellipsoid | Sheet) -> bool:
    """Return whether two bodies, at least one of them a surface from a file, overlap or touch; False for two ellipsoids."""
    if not isinstance(first, Sheet):
        return do_overlap(second, first) if isinstance(second, Sheet) else False
    if isinstance(second, Sheet):
        return first.crosses(second) or bool(first.is_inside(second.points).any() or second.is_inside(first.points).any())
    # in coordinates u (see ``Ellipsoid``) the ellipsoid is the unit ball about the origin
    scaled = replace(first, points=(first.points - second.centre) @ np.asarray(np.linalg.inv(second.axes.T), dtype=np.float64))
    nearest = scaled.find_nearest(np.zeros((1, 3)))
    return float(np.linalg.norm(nearest)) <= 1.0 or bool(first.is_inside(second.centre[None, :])[0])


def check_extent(tube: float, extent: float) -> None:
    """Refuse an ``extent`` of shortened tissue in m that is infinite or not 5 % above the tube's radius ``tube``."""
    if not tube * 1.05 < extent < math.inf:
        raise Refusal(
            "tissue_extent",
            format_mm(extent),
            f"a length above {format_minimum_mm(1.05 * tube)}: tissue reaches beyond the probe",
        )
