"""Whether what only a layout knows fits: surfaces from files and bodies in shortened tissue, inside it and apart."""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from geometry.common.arrays import Points
from geometry.common.errors import Refusal, Words
from geometry.common.limits import format_minimum_mm
from geometry.scenes.probe import format_mm
from geometry.tetra.surface_files import Sheet

if TYPE_CHECKING:
    from geometry.tetra.layout import BodyLayout, Ellipsoid

_OUTLINE_ANGLES = np.linspace(0, 2 * np.pi, 721)


def check_fit(layout: BodyLayout, names: tuple[str, ...], extent: float) -> None:
    """Refuse bodies that leave the tissue or overlap; ``names`` of their files, "" without; ``extent`` of the tissue in m.

    Raises:
        Refusal: of ``inclusion[k].surface``, or of ``tissue_extent`` where shortened tissue has no room for a body.
    """
    for index, (body, name) in enumerate(zip(layout.inclusions, names, strict=True)):
        left = _describe_excess(layout, body)
        if left and isinstance(body, Sheet):
            raise Refusal(f"inclusion[{index}].surface", Words(f"{name}, which leaves {left}"), "a body inside the tissue")
        if left:
            raise Refusal("tissue_extent", format_mm(extent), f"tissue with room for inclusion[{index}], which leaves {left}")
    for (i, first), (j, second) in combinations(enumerate(layout.inclusions), 2):
        if (isinstance(first, Sheet) or isinstance(second, Sheet)) and do_overlap(first, second):
            index, other_index = (j, i) if isinstance(second, Sheet) else (i, j)
            value = Words(f"{names[index]}, which overlaps or touches inclusion[{other_index}]")
            raise Refusal(f"inclusion[{index}].surface", value, "inclusions apart")


def _describe_excess(layout: BodyLayout, body: Ellipsoid | Sheet) -> str:
    """Return which face of the tissue a body reaches beyond and by how much, "" if it is inside."""
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
    """Return the outline of the ellipsoid's projection on the plane z = 0, about its centre, (n, 2)."""
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
    corners = np.asarray(np.linalg.solve(second.axes, (first.points - second.centre).T).T[first.triangles], dtype=np.float64)
    return float(compute_distances(corners).min()) <= 1.0 or bool(first.is_inside(second.centre[None, :])[0])


def compute_distances(corners: Points) -> Points:
    """Return the distances (t,) from the origin to the triangles with ``corners`` (t, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    result = np.minimum(_distance_to_edge(a, b), np.minimum(_distance_to_edge(b, c), _distance_to_edge(c, a)))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    sides = [np.einsum("ij,ij->i", np.cross(q - p, -p), normal) for p, q in ((a, b), (b, c), (c, a))]
    is_foot_inside = np.logical_and.reduce([side >= 0 for side in sides]) & (size > 0)  # the foot of the perpendicular is within
    height = np.abs(np.einsum("ij,ij->i", a, normal)) / np.maximum(size, 1e-300)
    return np.where(is_foot_inside, height, result)


def _distance_to_edge(a: Points, b: Points) -> Points:
    edge = b - a
    share = np.clip(-np.einsum("ij,ij->i", a, edge) / np.maximum(np.einsum("ij,ij->i", edge, edge), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + share[:, None] * edge, axis=1))


def check_extent(tube: float, extent: float) -> None:
    """Refuse shortened tissue that does not reach beyond the probe, or has no end."""
    if not tube * 1.05 < extent < math.inf:
        raise Refusal(
            "tissue_extent",
            format_mm(extent),
            f"a length above {format_minimum_mm(1.05 * tube)}: tissue reaches beyond the probe",
        )
