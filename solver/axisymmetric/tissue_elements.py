"""Locate points of the tissue in the elements of a mesh without inclusions.

Without a sphere every element of the tissue is a quadrilateral with straight sides, whose map is inverted by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints, Numeric
from geometry.common.errors import InputError
from geometry.common.limits import format_maximum
from geometry.meridian.mesh import Topology, compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.mesh_lines import place_lines
from geometry.meridian.section import TISSUES, Section

MAX_NEWTON_STEPS, NEWTON_TOLERANCE = 12, 1e-13  # tolerance: last step in the unit square


@dataclass(frozen=True)
class TissueElements:
    """The tissue's elements of a section, which has no inclusion, on a mesh."""

    section: Section
    mesh: Topology

    def check_points(self, points: Floats) -> None:
        """Raise ``InputError`` if there is an inclusion, or a point (r, z) of (m, 2) lies outside the tissue."""
        if np.all(self.section.sphere_radius != 0):  # 0: no inclusion
            raise InputError("inclusion", "one", "no inclusion: the field is that of the base states without tumours")
        s = self.section
        r, z = points.T
        inside = (r >= 0) & (r <= s.tissue_radius) & (z <= 0) & (z >= -s.tissue_depth)
        if not np.all(inside):
            far = points[np.flatnonzero(~inside)[0]]
            allowed = f"0 <= r <= {format_maximum(s.tissue_radius)}, -{format_maximum(s.tissue_depth)} <= z <= 0, m"
            raise InputError("points", f"r = {far[0]:g}, z = {far[1]:g}", allowed)

    def locate(self, points: Floats) -> tuple[Ints, Floats, Floats]:
        """Return for each of m points (r, z) its element, the place (u, v) in its unit square and d(r, z) / d(u, v).

        The shapes are (m,), (m, 2) and (m, 2, 2). Grid lines give a few candidates; the element is that in which the point lies
        deepest, measured from its nearest side.
        """
        radii, levels, table, tissue, corners, planes = self._lookup_table
        r, z = points.T
        column = np.searchsorted(radii[1:-1], r, side="right")
        row = np.searchsorted(levels[1:-1], z, side="right")
        candidates = table[row, column]
        a, b, c = planes[:, candidates]
        inside = (a * r[:, None, None] + b * z[:, None, None] + c).min(axis=2)
        chosen = candidates[np.arange(len(points)), np.argmax(inside, axis=1)]
        return tissue[chosen], *_invert_maps(corners[chosen], points)

    @cached_property
    def _lookup_table(self) -> tuple[Any, ...]:
        """Data to locate points: grid lines, candidate elements between them, and these elements' corners and sides.

        In order: radii and levels of the tissue's grid lines; candidates for each row and column between the lines, as positions
        in the next array, repeated to one length, shape (rows, columns, candidates); numbers of the tissue's elements in the
        mesh; their corners, shape (t, 4, 2); coefficients of their sides, see ``_compute_planes``.
        """
        layout = self.mesh.layout
        lines = place_lines(self.section, layout)
        radii, levels = lines.radii[: layout.column["side"] + 1], lines.levels[: layout.row["surface"] + 1]
        tissue = np.flatnonzero(np.isin(self.mesh.body, TISSUES))
        corners = compute_nodes(self.section, self.mesh, UNIT_SQUARE, tissue)
        low, high = corners.min(axis=1), corners.max(axis=1)
        middles = [(line[1:] + line[:-1]) / 2 for line in (radii, levels)]
        halves = [(line[1:] - line[:-1]) / 2 for line in (radii, levels)]
        in_column, in_row = (
            (low[:, k] < (middles[k] + halves[k] * (1 - 1e-9))[:, None])
            & (high[:, k] > (middles[k] - halves[k] * (1 - 1e-9))[:, None])
            for k in (0, 1)
        )  # (columns or rows, elements)
        candidates = [[np.flatnonzero(row & column) for column in in_column] for row in in_row]
        max_count = max(len(elements) for row in candidates for elements in row)
        table = np.array([[np.resize(elements, max_count) for elements in row] for row in candidates])
        return radii, levels, table, tissue, corners, _compute_planes(corners)


def _compute_planes(corners: Floats) -> Floats:
    """Return coefficients a, b, c of a r + b z + c, positive inside, for each side of n quadrilaterals, shape (3, n, 4).

    The values are distances from the side times its length, relative to the square of the quadrilateral's size.
    """
    sides = np.roll(corners, -1, axis=1) - corners
    size = np.abs(sides).sum(axis=(1, 2))[:, None] ** 2
    a, b = -sides[..., 1] / size, sides[..., 0] / size
    return np.stack([a, b, -a * corners[..., 0] - b * corners[..., 1]])


def _invert_maps(corners: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the places (u, v) in quadrilaterals' unit squares that map to points, (m, 2), and the Jacobians there.

    The map from (u, v) to (r, z) is a + u edge_u + v edge_v + u v twist, a the first corner; Newton's method inverts it.
    """
    a, b, c, d = corners.transpose(1, 2, 0)
    edge_u, edge_v, twist = b - a, d - a, (a - d) - (b - c)
    u = v = np.full(len(points), 0.5)
    for _ in range(MAX_NEWTON_STEPS):
        d_u, d_v = edge_u + v * twist, edge_v + u * twist
        residual = points.T - a - u * d_u - v * edge_v
        determinant = d_u[0] * d_v[1] - d_u[1] * d_v[0]
        step = np.stack([residual[0] * d_v[1] - residual[1] * d_v[0], d_u[0] * residual[1] - d_u[1] * residual[0]]) / determinant
        u, v = u + step[0], v + step[1]
        # without a twist the map is linear: one step is exact
        if not twist.any() or np.abs(step).max(initial=0.0) <= NEWTON_TOLERANCE:
            break
    u, v = np.clip(u, 0.0, 1.0), np.clip(v, 0.0, 1.0)
    return np.stack([u, v], axis=1), np.stack([edge_u + v * twist, edge_v + u * twist], axis=-1).transpose(1, 0, 2)


def compute_jacobian(corners: Numeric, places: Numeric) -> Numeric:
    """Return the Jacobians d(r, z) / d(u, v), shape (m, 2, 2), of m quadrilaterals at places in their unit squares.

    ``corners`` are the quadrilaterals' corners, m, shape (m, 4, 2), in order around each; ``places`` are (u, v), shape (m, 2).
    """
    u, v = places[:, :1], places[:, 1:]
    a, b, c, d = np.moveaxis(corners, 1, 0)
    return np.stack([(1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)], axis=-1)
