r"""Round the kinks of a master line between two elements, past which points of the other line slide.

Elements join at a node with one position but two slopes k = ds/dt. A point that presses on a soft wall turns its element, and the
force on it would jump as it passes the node: no load step over the jump converges. Within a width w of the node, in t, the height
of the line is therefore that of a parabola that joins both slopes:

    height added = (k_right - k_left) y^2 / (4 w),   y = w - |t - t_node| >= 0                        (CT.13)

The corner of a block within a line is rounded by ``RoundEdge`` alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from solver.contact.boundary_lines import join_edges, multiply_symmetric, tabulate_slopes
from solver.contact.pairs import Pair

# w, of the shorter element: forces change by less than 1e-5 up to 0.37 and by 1.3e-4 at 0.45 outer radii, half of what two meshes
# differ by; on 0.1 of it no step converged beyond 0.64
KINK_WIDTH_RELATIVE = 0.25


@dataclass(frozen=True)
class Kinks:
    """The nodes of a pair's master line that are next to points.

    Attributes
    ----------
    pair
        The two lines.
    neighbours
        Number of the edge beyond the node, shape (j,); the point's own where there is none.
    sides
        1 where the point's edge begins at the node, -1 where it ends there, shape (j,).
    depths, widths
        y, 0 beyond the width or at a line's end, and w of eq. CT.13, m, shape (j,) each.
    slopes, runs
        ds/dt and dt/dx at the node, on the point's edge and on its neighbour, shape (2, j) each.
    """

    pair: Pair
    neighbours: Ints
    sides: Ints
    depths: Floats
    widths: Floats
    slopes: Floats
    runs: Floats

    @classmethod
    def from_points(cls, pair: Pair, heights: tuple[Floats, Floats], edges: Ints, t: Floats) -> Kinks:
        """Find the nodes next to j points.

        Parameters
        ----------
        pair
            The two lines.
        heights
            Coefficients of the master's edges for t and for s, m, shape (k, p + 1) each.
        edges, t
            Edges of the points and their coordinates t, m, shape (j,) each.
        """
        (mt, ms), line = heights, pair.master
        below, above = t - mt[edges, 0], mt[edges, 1] - t
        sides = np.where(below <= above, 1, -1)
        neighbours, nodes = edges - sides, np.where(sides > 0, edges, edges + 1)
        is_corner = np.abs(line.starts[nodes] - pair.master_edge.place) <= 1e-9 * line.starts[-1]
        # faces that slide or open touch everywhere at rest: their lines stay as they are
        rounded = (neighbours >= 0) & (neighbours < len(mt)) & ~is_corner & (not pair.loose)
        neighbours = np.where(rounded, neighbours, edges)
        widths = KINK_WIDTH_RELATIVE * np.minimum(line.lengths[edges], line.lengths[neighbours])
        depths = np.where(rounded, np.maximum(widths - np.minimum(below, above), 0.0), 0.0)
        derivatives, first_end = tabulate_slopes(line.order), np.where(sides > 0, 0, 1)
        ends = ((edges, first_end), (neighbours, 1 - first_end))
        runs, rises = (np.stack([np.einsum("jp,jp->j", derivatives[end], m[edge]) for edge, end in ends]) for m in (mt, ms))
        return cls(pair, neighbours, sides, depths, widths, rises / runs, runs)

    @property
    def any_near(self) -> bool:
        """Whether any point lies within the width of a node."""
        return bool(np.any(self.depths > 0))

    @property
    def changes(self) -> Floats:
        """Slope beyond the node minus that before it, shape (j,)."""
        return np.asarray(self.sides * (self.slopes[0] - self.slopes[1]))

    @property
    def heights(self) -> Floats:
        """Height added to the line at the points, m, shape (j,)."""
        return np.asarray(self.changes * self.depths**2 / (4 * self.widths))

    def select_points(self, selection: Bools) -> Kinks:
        """Return the nodes next to selected points; ``selection`` is a mask, shape (j,)."""
        neighbours, sides = self.neighbours[selection], self.sides[selection]
        depths, widths, slopes, runs = (x[..., selection] for x in (self.depths, self.widths, self.slopes, self.runs))
        return Kinks(self.pair, neighbours, sides, depths, widths, slopes, runs)

    def differentiate(self, on_slave: Floats) -> tuple[Floats, Floats]:
        """Return the first and second derivatives of the added heights, (j, 6 (p + 1)) and (j, 6 (p + 1), 6 (p + 1)).

        They are taken with respect to the values of the slave's edge, of the point's edge on the master, and of its neighbour.
        ``on_slave`` are the slave's edge functions at the points, shape (j, p + 1).
        """
        T, S = self.pair.axes
        order = self.pair.master.order
        end_derivatives, first_end = tabulate_slopes(order), np.where(self.sides > 0, 0, 1)
        zeros, end_functions = np.zeros((len(on_slave), 2, order + 1)), np.eye(2, order + 1)  # functions 0 and 1: the two ends
        sides, depths, widths, changes = (x[:, None] for x in (self.sides, self.depths, self.widths, self.changes))
        deeper = sides * join_edges(-_spread(T, on_slave), _spread(T, end_functions[first_end]), zeros)  # of y
        turns, stretches = list[Floats](), list[Floats]()  # of k and of ln dt/dx, on the point's edge and on its neighbour
        for number, end in enumerate((first_end, 1 - first_end)):
            functions = end_derivatives[end] / self.runs[number][:, None]
            for derivatives, direction in ((turns, S - self.slopes[number][:, None] * T), (stretches, T)):
                along = _spread(direction, functions)
                derivatives.append(join_edges(zeros, along, zeros) if number == 0 else join_edges(zeros, zeros, along))
        turn = sides * (turns[0] - turns[1])
        first = turn * depths**2 / (4 * widths) + changes * depths / (2 * widths) * deeper
        second = -(sides * depths**2 / (4 * widths))[..., None] * (
            multiply_symmetric(turns[0], stretches[0]) - multiply_symmetric(turns[1], stretches[1])
        )
        second += (depths / (2 * widths))[..., None] * multiply_symmetric(turn, deeper)
        second += (changes / (4 * widths) * (depths > 0))[..., None] * multiply_symmetric(deeper, deeper)
        return first, second


def _spread(direction: Floats, functions: Floats) -> Floats:
    """Return edge functions, (j, p + 1), along a direction, (2,) or (j, 2): derivatives with respect to values, (j, 2, p + 1)."""
    return np.asarray(np.broadcast_to(direction, (len(functions), 2))[:, :, None] * functions[:, None])
