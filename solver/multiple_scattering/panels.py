"""Place the points on top, side and bottom of a tissue layer at which scattered fields are sampled.

Scattered fields are smooth there, unlike the response, whose mesh is fine at the blocks' corners. Polynomials on panels that are
graded from the axis outwards represent them with far fewer points than the edges of elements have.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Section

MIN_PANEL_RELATIVE = 1.4  # minimum panel in outer radii, times the order of the elements
PANEL_GROWTH = 0.4  # of panels, per distance from the axis
MIN_SIDE_PANEL_RELATIVE, MIN_FLOOR_PANEL_RELATIVE = 0.4, 0.3  # minimum panels on side and floor, of the tissue's radius and depth
EXTRA_POINTS = 4  # points of a panel beyond the order of the elements


@dataclass(frozen=True)
class PanelLine:
    """Gauss points of panels along a line.

    Attributes
    ----------
    ends
        Ends of the panels, rising, m, shape (n + 1,).
    points
        Number of points of each panel.
    """

    ends: Floats
    points: int

    @classmethod
    def from_length(cls, length: float, step: float, points: int) -> PanelLine:
        """Build panels of at least ``step`` that grow with the distance from 0, up to ``length``, m."""
        ends = [0.0]
        while ends[-1] < length:
            ends.append(ends[-1] + max(step, PANEL_GROWTH * ends[-1]))
        return cls(np.array(ends) * length / ends[-1], points)

    @cached_property
    def places(self) -> Floats:
        """Positions of all points along the line, m."""
        middle, half = (self.ends[1:] + self.ends[:-1]) / 2, np.diff(self.ends) / 2
        return (middle[:, None] + half[:, None] * self._nodes).ravel()

    def build_interpolation(self, places: Floats) -> Floats:
        """Return the matrix that interpolates values at the points to other places, shape (*places, points)."""
        panel = np.clip(np.searchsorted(self.ends, places, side="right") - 1, 0, len(self.ends) - 2)
        low, high = self.ends[panel], self.ends[panel + 1]
        x, nodes = (2 * places - low - high) / (high - low), self._nodes
        weights = np.zeros((*places.shape, len(self.ends) - 1, self.points))
        for k, node in enumerate(nodes):
            other_nodes = np.delete(nodes, k)
            values = np.prod((x[..., None] - other_nodes) / (node - other_nodes), axis=-1)
            np.put_along_axis(weights[..., k], panel[..., None], values[..., None], axis=-1)
        return weights.reshape(*places.shape, len(self.places))

    @cached_property
    def _nodes(self) -> Floats:
        return np.asarray(np.polynomial.legendre.leggauss(self.points)[0])


@dataclass(frozen=True)
class Panels:
    """Points on a layer's boundary, in the order top, side, bottom (of tissue without layers surface, side, floor): n of them.

    Attributes
    ----------
    surface, floor
        Along r on top and bottom.
    side
        Along the depth below the top.
    section
        Section of the tissue.
    top, bottom
        Depths of the layer's faces, m.
    """

    surface: PanelLine
    side: PanelLine
    floor: PanelLine
    section: Section
    top: float
    bottom: float

    @classmethod
    def from_section(cls, section: Section, order: int, layer: int = 0) -> Panels:
        """Build panels for elements of an order, on a layer by its number or on the tissue below all layers."""
        top, bottom = [0.0, *section.interfaces, section.tissue_depth][layer : layer + 2]
        step, points = MIN_PANEL_RELATIVE / order * section.tube_radius, order + EXTRA_POINTS
        floor_step = max(step, MIN_FLOOR_PANEL_RELATIVE * section.tissue_depth) if layer == len(section.interfaces) else step
        steps = step, max(step, MIN_SIDE_PANEL_RELATIVE * section.tissue_radius), floor_step
        lengths = section.tissue_radius, bottom - top, section.tissue_radius
        surface, side, floor = (
            PanelLine.from_length(length, panel_step, points) for length, panel_step in zip(lengths, steps, strict=True)
        )
        return cls(surface, side, floor, section, top, bottom)

    @cached_property
    def parts(self) -> tuple[slice, slice, slice]:
        """Slices of the points of surface, side and floor."""
        a, b, c = (len(line.places) for line in (self.surface, self.side, self.floor))
        return slice(0, a), slice(a, a + b), slice(a + b, a + b + c)

    @cached_property
    def r(self) -> Floats:
        """Radii of the points, m, shape (n,)."""
        at_side = np.full_like(self.side.places, self.section.tissue_radius)
        return np.concatenate([self.surface.places, at_side, self.floor.places])

    @cached_property
    def z(self) -> Floats:
        """Heights of the points, m, shape (n,)."""
        at_top, at_floor = np.full_like(self.surface.places, -self.top), np.full_like(self.floor.places, -self.bottom)
        return np.concatenate([at_top, -(self.top + self.side.places), at_floor])
