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
        """Interpolate the products of ``evaluate`` from the table: within about 1e-3, relative, where ``covers`` is true."""
        from scipy.ndimage import map_coordinates

        scale, _, depth, _ = self._range
        coordinates = np.stack([np.arcsinh(r / scale), np.arcsinh(-z / scale) - np.arcsinh(depth / scale)]) / TABLE_STEP
        coordinates[1] += SPARE_TABLE_LINES  # the table begins so many lines above the minimum depth
        out = np.empty((2 * len(self.pairs), len(r)))
        for values, row in zip(self._table, out, strict=True):
            map_coordinates(values, coordinates, output=row, order=SPLINE_ORDER, prefilter=False, mode="mirror")
        return out

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
    def _table(self) -> list[Floats]:
        """Spline coefficients of the 2 p products on a grid of r (even about the axis) and depth."""
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

        return [spline_filter(values_of_product, order=SPLINE_ORDER, mode="mirror") for values_of_product in values]
