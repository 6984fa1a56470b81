"""Evaluate displacements and strains of base states anywhere in tissue without inclusions.

Without a sphere every element of the tissue is a quadrilateral with straight sides, whose map is inverted by Newton's
method; the polynomials are then evaluated directly, so that strains are as accurate as the elements.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.common.errors import InputError
from geometry.common.limits import format_maximum
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.mesh_lines import place_lines
from geometry.meridian.section import TISSUES
from solver.axisymmetric.base_states import BaseStates
from solver.elements.quadrilateral import compute_dilations
from solver.elements.shape_functions import evaluate_functions, evaluate_legendre, evaluate_pressures

POINTS_PER_CHUNK = 20_000  # evaluated at once, which limits the memory
MAX_NEWTON_STEPS, NEWTON_TOLERANCE = 12, 1e-13  # tolerance: last step in the unit square


@dataclass(frozen=True)
class Strains:
    """Displacements and strains of the s states at m points, per unit of each (see ``BaseStates``); last axis: the state.

    Attributes
    ----------
    displacement
        u_r, u_z, m per unit, shape (m, 2, s).
    strain
        eps_rr, eps_zz, eps_hoop and eps_rz (half the engineering shear) per unit, shape (m, 4, s).
    dilation
        Their sum as the elements project it, shape (m, s): near incompressibility the sum itself oscillates.
    """

    displacement: Floats
    strain: Floats
    dilation: Floats


@dataclass(frozen=True)
class TissueField:
    """The s states, without an inclusion, as functions of position."""

    states: BaseStates

    @property
    def count(self) -> int:
        """The number of states s: two base states and, with films, two film states."""
        return len(self.states.products)

    def evaluate(self, r: Floats, z: Floats) -> Strains:
        """Evaluate at points 0 <= r <= tissue radius, -tissue depth <= z <= 0 (z out of the tissue), arrays of one shape (m,).

        Raises
        ------
        InputError
            A point lies outside the tissue, or there is an inclusion.
        """
        if np.all(self.states.model.section.sphere_radius != 0):  # 0: no inclusion
            raise InputError("inclusion", "one", "no inclusion: the field is that of the base states without tumours")
        points = np.stack(np.broadcast_arrays(np.atleast_1d(r), np.atleast_1d(z)), axis=-1).astype(float)
        self._check_points(points)
        parts = [self._evaluate_chunk(points[low : low + POINTS_PER_CHUNK]) for low in range(0, len(points), POINTS_PER_CHUNK)]
        if not parts:
            return Strains(*(np.zeros((0, *shape, self.count)) for shape in ((2,), (4,), ())))
        return Strains(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def _check_points(self, points: Floats) -> None:
        """Raise ``InputError`` where a point (r, z) lies outside the tissue."""
        s = self.states.model.section
        r, z = points.T
        inside = (r >= 0) & (r <= s.tissue_radius) & (z <= 0) & (z >= -s.tissue_depth)
        if not np.all(inside):
            far = points[np.flatnonzero(~inside)[0]]
            allowed = f"0 <= r <= {format_maximum(s.tissue_radius)}, -{format_maximum(s.tissue_depth)} <= z <= 0, m"
            raise InputError("points", f"r = {far[0]:g}, z = {far[1]:g}", allowed)

    def _evaluate_chunk(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return displacements, strains and projected dilations, as in ``Strains``, at points (m, 2)."""
        element, places, jacobian = self.locate(points)
        model, legendre = self.states.model, evaluate_legendre(places, self.states.model.shapes.order)
        value, (by_u, by_v) = evaluate_functions(places, model.shapes.degrees, legendre)
        # the Jacobian dr/du, dr/dv; dz/du, dz/dv, and from it derivatives of the s functions by r and z
        (ru, rv), (zu, zv) = jacobian.transpose(1, 2, 0)[..., None]
        determinant = ru * zv - rv * zu
        derivatives = np.stack([value, (zv * by_u - zu * by_v) / determinant, (ru * by_v - rv * by_u) / determinant], axis=1)
        u, by_r, by_z = (derivatives @ self._values[element]).reshape(-1, 3, 2, self.count).transpose(1, 0, 2, 3)
        radius = points[:, :1]
        hoop = np.where(radius > 0, u[:, 0] / np.where(radius > 0, radius, 1.0), by_r[:, 0])  # u_r / r -> u_r,r on the axis
        strain = np.stack([by_r[:, 0], by_z[:, 1], hoop, (by_z[:, 0] + by_r[:, 1]) / 2], axis=1)
        pressed = evaluate_pressures(places, model.shapes.order, legendre)
        dilation = (pressed[:, None] @ self._find_dilation_coefficients(element))[:, 0]
        return u + self.states.shift[element][:, None] * [[0.0], [1.0]], strain, dilation

    @cached_property
    def _values(self) -> Floats:
        """The elements' values by function, u_r and u_z of all s states, shape (n, functions, 2 s)."""
        values = self.states.values.reshape(len(self.states.values), 2, -1, self.count)
        return np.ascontiguousarray(values.transpose(0, 2, 1, 3)).reshape(len(values), -1, 2 * self.count)

    def _find_dilation_coefficients(self, element: Ints) -> Floats:
        """Return the coefficients of the states' projected dilations on the k pressure functions of m elements, (m, k, s).

        Those of an element are computed when first needed: few tumours lie in few elements.
        """
        model, (coefficients, is_known) = self.states.model, self._dilation_coefficients
        new = np.unique(element[~is_known[element]])
        if len(new):
            values = self.states.values[new].reshape(len(new), 2, -1, self.count)
            table = compute_dilations(model.geometry.select(new), model.shapes)[:, :, ::2]
            coefficients[new] = np.einsum("nkcs,ncsi->nki", table, values, optimize=True)
            is_known[new] = True
        return coefficients[element]

    @cached_property
    def _dilation_coefficients(self) -> tuple[Floats, Bools]:
        """Coefficients of all n elements, shape (n, k, s), and which are computed already, shape (n,)."""
        n, pressures = len(self.states.values), self.states.model.shapes.pressure.shape[1]
        return np.zeros((n, pressures, self.count)), np.zeros(n, dtype=bool)

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
        model = self.states.model
        layout = model.mesh.layout
        lines = place_lines(model.section, layout)
        radii, levels = lines.radii[: layout.column["side"] + 1], lines.levels[: layout.row["surface"] + 1]
        tissue = np.flatnonzero(np.isin(model.mesh.body, TISSUES))
        corners = compute_nodes(model.section, model.mesh, UNIT_SQUARE, tissue)
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


def compute_jacobian(corners: Any, places: Any) -> Any:
    """Return the Jacobians d(r, z) / d(u, v), shape (m, 2, 2), of m quadrilaterals at places in their unit squares.

    ``corners`` are the quadrilaterals' corners, m, shape (m, 4, 2), in order around each; ``places`` are (u, v), shape (m, 2).
    """
    u, v = places[:, :1], places[:, 1:]
    a, b, c, d = np.moveaxis(corners, 1, 0)
    return np.stack([(1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)], axis=-1)
