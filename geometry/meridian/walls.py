"""Find the walls of both blocks that face each other across the gap, as sides of elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.meridian.mesh import ELEMENT_SIDES, Topology, compute_labels, compute_nodes, label_line
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.section import Body, Section


@dataclass(frozen=True, eq=False)
class GapWalls:
    """Sides of elements on the walls at the gap, from their lower ends upwards; the same for all sections of a kind.

    Attributes
    ----------
    elements
        One for each side, the inner block's, then those of the tube's hole, shape (m,).
    sides
        Which of the element's it is, by ``ELEMENT_SIDES``, shape (m,).
    inner
        How many are the inner block's.
    """

    elements: Ints
    sides: Ints
    inner: int

    @classmethod
    def from_mesh(cls, mesh: Topology) -> GapWalls:
        """Find the sides of a mesh on the gap's walls."""
        (elements, sides), hole_walls = (
            _find_rising_sides(mesh, Body.INNER, "inner"),
            _find_rising_sides(mesh, Body.OUTER, "hole"),
        )
        return cls(np.concatenate([elements, hole_walls[0]]), np.concatenate([sides, hole_walls[1]]), len(elements))

    @property
    def wall_slices(self) -> tuple[slice, slice]:
        """The sides of the inner block's wall, and of the hole's."""
        return slice(self.inner), slice(self.inner, None)

    def list_functions(self, order: int) -> Ints:
        """Return the numbers of the elements' shape functions that are not zero on the sides, shape (m, order + 1).

        The functions of the side's two ends come first, then those of the side by degree from 2 to ``order``.
        """
        # an element's functions: its 4 corners, then order - 1 for each side
        first = 4 + (order - 1) * self.sides[:, None]
        return np.hstack([np.array(ELEMENT_SIDES)[self.sides], first + np.arange(order - 1)])

    def compute_ends(self, section: Section, mesh: Topology) -> Floats:
        """Return the heights z of the sides' ends as their functions run, upwards or downwards, m, shape (m, 2)."""
        corners = compute_nodes(section, mesh, UNIT_SQUARE, self.elements)[..., 1]
        return np.take_along_axis(corners, np.array(ELEMENT_SIDES)[self.sides], axis=1)


def _find_rising_sides(mesh: Topology, body: Body, column: str) -> tuple[Ints, Ints]:
    """Return elements and sides (each (m,)) of a body that lie on a column of the mesh, from the lowest up.

    ``column`` is a name in ``MeshTopology.column``.
    """
    points, sides = compute_labels(mesh), np.array(ELEMENT_SIDES)
    is_on_column = (points[..., 0] == label_line(mesh.layout.column[column])) & (mesh.body == body)[:, None]
    elements, side = np.nonzero(is_on_column[:, sides].all(axis=2))
    rising = np.argsort(points[elements[:, None], sides[side], 1].min(axis=1))
    return elements[rising], side[rising]
