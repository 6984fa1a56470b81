"""The walls of both blocks that face each other across the gap, as sides of elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.meridian.mesh import SQUARE, Topology, labels, line_label, nodes
from geometry.meridian.section import Body, Section

ENDS = np.array([(0, 1), (1, 2), (3, 2), (0, 3)])  # an element's corners at the ends of its sides: bottom, right, top, left


@dataclass(frozen=True, eq=False)
class GapWalls:
    """Sides of elements on the inner block's wall, then on that of the tube's hole.

    Attributes:
        elements: one for each side, shape (m,).
        sides: which of the element's it is, by ``ENDS``, shape (m,).
        inner: how many are the inner block's.
    """

    elements: Ints
    sides: Ints
    inner: int

    @classmethod
    def of(cls, mesh: Topology) -> GapWalls:
        """Find them; the same for all sections of a kind."""
        across, column = labels(mesh)[..., 0], mesh.layout.column
        found = []
        for body, name in ((Body.INNER, "inner"), (Body.OUTER, "hole")):
            on = (across == line_label(column[name])) & (mesh.body == body)[:, None]
            found.append(np.nonzero(on[:, ENDS].all(axis=2)))
        elements, sides = (np.concatenate(one) for one in zip(*found, strict=True))
        return cls(elements, sides, len(found[0][0]))

    def heights(self, section: Section, mesh: Topology, places: Floats) -> Floats:
        """Return heights z at ``places`` along the sides, 0 to 1, shape (m, places)."""
        corners = nodes(section, mesh, SQUARE, self.elements)[..., 1]
        start, end = np.take_along_axis(corners, ENDS[self.sides], axis=1).T
        return np.asarray(start[:, None] + places * (end - start)[:, None])


def on_sides(places: Floats) -> Floats:
    """Return the points of the unit square at ``places`` along its sides, shape (4, places, 2)."""
    start, end = SQUARE[ENDS].transpose(1, 0, 2)[:, :, None]
    return np.asarray(start + places[:, None] * (end - start))
