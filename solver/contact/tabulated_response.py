"""Tabulate the densities of first-order effects, so that those of thousands of tumours cost little.

The densities d_v and d_s of eq. CT.9 are functions of r and z alone, and smooth but for jumps at the interfaces of layers, which
tumours do not cross. They are computed on a grid in each layer and interpolated by cubic splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from geometry.common.arrays import Floats
from solver.contact.tumour_effects import BALL_POINTS, TumourResponse
from solver.equivalent_inclusion.first_order import build_half_ball
from solver.inclusions.tumours import Tumours

SPACING_RELATIVE = 1 / 32  # of the outer radius: effects differ from those without a table by less than their meshes do
EXTRA_CELLS = 4  # of the grid beyond the tumours: a spline's end conditions fade within that many
SPHERES_AT_ONCE = 256  # which limits the memory
EDGE_CLEARANCE_RELATIVE = 1e-9  # of the outer radius: distance of the grid from interfaces and the tissue's boundary


@dataclass(frozen=True)
class DensityTable:
    """The densities in one layer.

    Attributes
    ----------
    low, high
        Smallest and largest z of the grid, m.
    spacing
        Of the grid's points in r and z, m.
    coefficients
        Of the splines, shape (2 k, points in r, points in z).
    """

    low: float
    high: float
    spacing: tuple[float, float]
    coefficients: Floats

    @classmethod
    def from_response(cls, response: TumourResponse, widest: float, low: float, high: float) -> DensityTable:
        """Compute the densities of a response from r = 0 to ``widest`` and z from ``low`` to ``high``, m."""
        step = SPACING_RELATIVE * response.model.section.tube_radius
        counts = [max(2 * EXTRA_CELLS, int(np.ceil(size / step)) + 1) for size in (widest, high - low)]
        r, z = np.linspace(0.0, widest, counts[0]), np.linspace(low, high, counts[1])
        grid = np.meshgrid(r, z, indexing="ij")
        values = response.evaluate(grid[0].ravel(), grid[1].ravel()).reshape(-1, *counts)
        coefficients = np.stack([spline_filter(field, mode="mirror") for field in values])
        return cls(low, high, (float(r[1]), float(z[1] - z[0])), coefficients)

    def evaluate(self, r: Floats, z: Floats) -> Floats:
        """Return the densities at points, shape (2 k, *r.shape)."""
        places = np.stack([r / self.spacing[0], (z - self.low) / self.spacing[1]])
        # mirrored at r = 0: the densities are even there
        return np.stack([map_coordinates(part, places, prefilter=False, mode="mirror") for part in self.coefficients])


@dataclass(frozen=True)
class TabulatedResponse:
    """A ``TumourResponse`` whose densities are tabulated for tumours within some distance and depths.

    Attributes
    ----------
    response
        The response.
    widest
        Largest distance of a tumour's points from the axis, m.
    shallowest, deepest
        Depths of the points nearest to and farthest from the surface, m.
    interfaces
        Depths of the interfaces of layers, m.
    """

    response: TumourResponse
    widest: float
    shallowest: float
    deepest: float
    interfaces: tuple[float, ...]

    @cached_property
    def _tables(self) -> dict[int, DensityTable]:
        """The tables computed so far, by the number of the layer."""
        return {}

    def integrate(self, tumours: Tumours) -> Floats:
        """See ``TumourResponse.integrate``; the spheres lie within the tabulated distance and depths, each in one layer."""
        layers = np.searchsorted(self.interfaces, tumours.depth, side="right")
        results = np.empty((2, len(self.response.outputs), len(tumours.depth)))
        ball, weights = build_half_ball(*BALL_POINTS)
        for layer in np.unique(layers).tolist():
            table, members = self._get_table(layer), np.flatnonzero(layers == layer)
            for low in range(0, len(members), SPHERES_AT_ONCE):
                chunk = members[low : low + SPHERES_AT_ONCE]
                radius = tumours.diameter[chunk] / 2
                x, y, height = (radius[:, None] * ball[:, k] for k in range(3))
                r, z = np.hypot(tumours.offset[chunk, None] + x, y), height - tumours.depth[chunk, None]
                sums = table.evaluate(r, np.clip(z, table.low, table.high)) @ weights[:, 0]
                results[:, :, chunk] = (sums * (4 / 3 * np.pi * radius**3)).reshape(2, -1, len(chunk))
        return results

    def convert_to_constant_force(self, changes: Floats) -> Floats:
        """See ``TumourResponse.convert_to_constant_force``."""
        return self.response.convert_to_constant_force(changes)

    def _get_table(self, layer: int) -> DensityTable:
        """Return the table of a layer, which is computed once."""
        if layer not in self._tables:
            section = self.response.model.section
            step, clearance = SPACING_RELATIVE * section.tube_radius, EDGE_CLEARANCE_RELATIVE * section.tube_radius
            faces = (0.0, *self.interfaces, section.tissue_depth)
            upper = max(faces[layer] + clearance, self.shallowest - EXTRA_CELLS * step)
            lower = min(faces[layer + 1] - clearance, self.deepest + EXTRA_CELLS * step)
            widest = min(self.widest + EXTRA_CELLS * step, section.tissue_radius - clearance)
            self._tables[layer] = DensityTable.from_response(self.response, widest, -lower, -upper)
        return self._tables[layer]
