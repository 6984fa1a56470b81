"""Evaluate products of the states' strains at any position, from the elements or from a table.

A sphere's effect on film forces and charges needs two scalars of each pair of states, tr(eps_i) tr(eps_j) and e_i:e_j with e
the deviator. The states are the two base states and, with films, two film states (``BaseStates``). Both scalars are the same all
round the probe's axis, so that they are functions of r and z alone wherever the sphere lies.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import csr_array

from geometry.common.arrays import Bools, Floats, Ints
from solver.axisymmetric.tissue_field import TissueField

TABLE_STEP = 0.035  # step of the table in asinh(length / scale)
TABLE_SCALE_OUTER_RADII = 0.3  # outer radii
MIN_TABLE_DEPTH_OUTER_RADII = 0.15  # outer radii: above this depth the blocks' corners matter and elements are evaluated
MAX_TABLE_REACH_OUTER_RADII = 12.0  # outer radii
SPLINE_ORDER: Final = 3  # of the splines
SPARE_TABLE_LINES = 4  # lines above the minimum depth, which keep the splines' end conditions away


@dataclass(frozen=True)
class Energies:
    """Strain products of the s states of one probe on one tissue, per unit of each of both states.

    For base states this is per unit displacement squared, 1/m^2.
    """

    field: TissueField

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """The p = s (s + 1) / 2 pairs of states i <= j: (0, 0), (0, 1), (1, 1), (0, 2), ..."""
        return tuple((i, j) for j in range(self.field.count) for i in range(j + 1))

    @cached_property
    def pair_index(self) -> Ints:
        """The index in ``pairs`` of each pair of states, shape (s, s)."""
        index = np.empty((self.field.count,) * 2, dtype=int)
        for k, (i, j) in enumerate(self.pairs):
            index[i, j] = index[j, i] = k
        return index

    def evaluate(self, r: Floats, z: Floats) -> Floats:
        """Return the strain products of the states at m points, shape (2 p, m).

        The first p rows are tr(eps_i) tr(eps_j), the others e_i:e_j, each for the pairs of ``pairs``. ``r`` and ``z``, in m,
        have shape (m,).

        Raises
        ------
        InputError
            A point lies outside the tissue.
        """
        strains = self.field.evaluate(r, z)
        rr, zz, hoop, rz = strains.strain.transpose(1, 0, 2)
        sums, trace = rr + zz + hoop, strains.dilation
        # eps_i:eps_j, from which the deviators' products follow
        product = [
            rr[:, i] * rr[:, j] + zz[:, i] * zz[:, j] + hoop[:, i] * hoop[:, j] + 2 * rz[:, i] * rz[:, j] for i, j in self.pairs
        ]
        dilation = [trace[:, i] * trace[:, j] for i, j in self.pairs]
        deviator = [full_product - sums[:, i] * sums[:, j] / 3 for full_product, (i, j) in zip(product, self.pairs, strict=True)]
        return np.array([*dilation, *deviator])

    def interpolate(self, r: Floats, z: Floats) -> Floats:
        """Interpolate the products of ``evaluate`` from the table: within about 1e-3, relative, where ``covers`` is true.

        Each value is a sum of 16 of the splines' coefficients: one sparse matrix gives those of all products.
        """
        scale, _, depth, _ = self._range
        table, rows_of_table, columns_of_table = self._table
        # the table begins ``SPARE_TABLE_LINES`` above the minimum depth
        rows, row_weights = _compute_spline_weights(np.arcsinh(r / scale) / TABLE_STEP, rows_of_table)
        columns, column_weights = _compute_spline_weights(
            (np.arcsinh(-z / scale) - np.arcsinh(depth / scale)) / TABLE_STEP + SPARE_TABLE_LINES, columns_of_table
        )
        indices = (rows[:, :, None] * columns_of_table + columns[:, None]).ravel()
        weights = (row_weights[:, :, None] * column_weights[:, None]).ravel()
        matrix = csr_array((weights, indices, np.arange(0, len(weights) + 1, 16)), shape=(len(r), len(table)))
        return np.asarray((matrix @ table).T)

    def covers(self, reach: Floats, highest: Floats, lowest: Floats) -> Bools:
        """Return whether the table covers radii up to ``reach`` and z from ``lowest`` to ``highest``, m.

        It covers nothing in layered tissue, as strains jump at interfaces.
        """
        if self.field.states.model.section.interfaces:
            return np.zeros(np.shape(reach), dtype=bool)
        _, widest, low, high = self._range
        return np.asarray((reach <= widest) & (-highest >= low) & (-lowest <= high))

    @property
    def _range(self) -> tuple[float, float, float, float]:
        """The scale, the maximum radius, the minimum and the maximum depth of the table, m."""
        s = self.field.states.model.section
        scale, far = TABLE_SCALE_OUTER_RADII * s.tube_radius, MAX_TABLE_REACH_OUTER_RADII * s.tube_radius
        return scale, min(s.tissue_radius, far), MIN_TABLE_DEPTH_OUTER_RADII * s.tube_radius, min(s.tissue_depth, far)

    @cached_property
    def _table(self) -> tuple[Floats, int, int]:
        """Spline coefficients of the 2 p products on a grid of r (even about the axis) and depth, shape (radii depths, 2 p).

        The numbers of radii and depths follow.
        """
        scale, widest, low, high = self._range
        s = self.field.states.model.section
        radius_count = int(np.ceil(np.arcsinh(widest / scale) / TABLE_STEP)) + 1
        depth_count = int(np.ceil((np.arcsinh(high / scale) - np.arcsinh(low / scale)) / TABLE_STEP)) + 1
        radii = np.minimum(scale * np.sinh(TABLE_STEP * np.arange(radius_count)), s.tissue_radius)
        depths = np.minimum(
            scale * np.sinh(np.arcsinh(low / scale) + TABLE_STEP * np.arange(-SPARE_TABLE_LINES, depth_count)), s.tissue_depth
        )
        r, z = (part.ravel() for part in np.meshgrid(radii, -depths, indexing="ij"))
        values = self.evaluate(r, z).reshape(-1, radius_count, depth_count + SPARE_TABLE_LINES)
        from scipy.ndimage import spline_filter

        table = np.array([spline_filter(values_of_product, order=SPLINE_ORDER, mode="mirror") for values_of_product in values])
        return np.ascontiguousarray(table.reshape(len(table), -1).T), *table.shape[1:]


def _compute_spline_weights(place: Floats, size: int) -> tuple[Ints, Floats]:
    """Return the indices and the weights of the four coefficients of a cubic spline at m places, shape (m, 4) both.

    ``place`` counts in lines of a table of ``size`` lines, which is mirrored at its first and last line.
    """
    line = np.floor(place)
    f = place - line  # the place between two lines
    g = 1 - f
    weights = np.stack([g**3 / 6, 2 / 3 - f**2 * (2 - f) / 2, 2 / 3 - g**2 * (2 - g) / 2, f**3 / 6], axis=1)
    index = np.abs(line.astype(int)[:, None] + np.arange(-1, 3))
    return np.where(index >= size, 2 * (size - 1) - index, index), weights
