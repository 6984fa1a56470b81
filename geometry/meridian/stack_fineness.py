"""Say how finely films and bonds, and the blocks' ends below them, are meshed."""

from __future__ import annotations

from dataclasses import dataclass

from geometry.meridian.section import FILMS, Body

LAYER_RATIO = 0.15  # ratio of sizes from one layer at a corner to the next


@dataclass(frozen=True)
class StackFineness:
    """The cells of films and bonds, whose corners need other cells than the blocks' lower ends.

    Attributes
    ----------
    layers
        Geometric layers at the upper ends of the blocks' walls, and at the walls of the layers on them; 1 or more.
    rows
        Rows of cells in a bond to the block, in a film that has a bond to the base, and in the layer at the base.
    strips
        Into how many strips all rows are cut at the walls, ever thinner ones. Where ``layers`` are more, the last strip of rows
        at a layer's upper or lower end is cut towards its corner.
    ratio
        Ratio of sizes from one layer or strip to the next.
    """

    layers: int
    rows: tuple[int, int, int]
    strips: int
    ratio: float = LAYER_RATIO

    def count_rows(self, stack: tuple[Body, ...]) -> tuple[int, ...]:
        """Return the number of rows in each layer of a stack, from the block upwards."""
        to_block, floating, at_base = self.rows
        return tuple(at_base if body == stack[-1] else floating if body in FILMS else to_block for body in stack)
