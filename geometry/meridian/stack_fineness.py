"""Say how finely films and bonds, and the blocks' ends below them, are meshed."""

from __future__ import annotations

from dataclasses import dataclass

from geometry.meridian.section import FILMS, Body


@dataclass(frozen=True)
class StackFineness:
    """The cells of films and bonds, whose corners need other cells than the blocks' lower ends.

    Attributes
    ----------
    layers
        Geometric layers at the upper ends of the blocks' walls, and at the walls of the layers on them; 1 or more.
    rows
        Rows of cells in a bond to the block, in a film that has a bond to the base, and in the layer at the base.
    corners
        Whether rows at a layer's upper and lower end are cut towards its corners; else all are cut into strips.
    """

    layers: int
    rows: tuple[int, int, int]
    corners: bool = False

    def count_rows(self, stack: tuple[Body, ...]) -> tuple[int, ...]:
        """Return the number of rows in each layer of a stack, from the block upwards."""
        to_block, floating, at_base = self.rows
        return tuple(at_base if body == stack[-1] else floating if body in FILMS else to_block for body in stack)
