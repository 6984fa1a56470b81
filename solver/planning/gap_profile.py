"""Approach of the two walls at the gap along their heights, both blocks pressed by the same indentation.

Walls bulge between the elements' corners, by a third more than at any of them, so that the finite elements' polynomials are
followed all along. Between the ends of either wall's sides the gap is one polynomial: it is looked at in even places, and at the
top of the parabola through the largest of them and both beside it, which moves smoothly with every length and modulus.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.walls import GapWalls
from solver.axisymmetric.base_states import BaseStates
from solver.elements.shape_functions import evaluate_edge_functions, evaluate_legendre
from solver.linalg.workspace import keep_result

POINTS_PER_POLYNOMIAL = 65  # per polynomial: the maximum by parabolas is within 1e-5 of that with 1025 points
_walls = keep_result(GapWalls.from_mesh)


@dataclass(frozen=True)
class GapProfile:
    """The walls where they face each other.

    Attributes
    ----------
    heights
        At the gap, m, rising; each row is one polynomial's, shape (k, PLACES).
    nearing
        By how much the walls near each other there per unit indentation, likewise.
    """

    heights: Floats
    nearing: Floats

    @classmethod
    def from_states(cls, states: BaseStates, places: int = POINTS_PER_POLYNOMIAL) -> GapProfile:
        """Compute the approach of both walls, from the tissue up to where the lower block ends."""
        model, walls = states.model, _walls(states.model.mesh)
        section, sides = model.section, walls.compute_ends(model.section, model.mesh)
        moved = states.edge[walls.elements].reshape(len(sides), 2, -1, 2)[:, 0].sum(axis=-1)
        moved = np.take_along_axis(moved, walls.list_functions(model.shapes.order), axis=1)
        ends = np.unique(np.minimum(sides, min(section.inner_height, section.outer_height)))
        heights = ends[:-1, None] + np.linspace(0.0, 1.0, places) * np.diff(ends)[:, None]
        inner, outer = (_compute_outward_motion(sides[wall], moved[wall], heights) for wall in walls.wall_slices)
        return cls(heights, inner - outer)

    @cached_property
    def max_nearing(self) -> float:
        """Maximum approach of the walls per unit indentation; 0 where they approach nowhere."""
        lower, middle, upper = (self.nearing[:, k : k - 2 or None] for k in range(3))
        bend, lean = 2 * middle - lower - upper, upper - lower
        top = (bend > 0) & (np.abs(lean) <= bend)
        rise = np.divide(lean**2, 8 * bend, out=np.zeros_like(middle), where=top)
        return float(max(np.max(self.nearing, initial=0.0), np.max(middle + rise, initial=0.0)))


def _compute_outward_motion(ends: Floats, moved: Floats, heights: Floats) -> Floats:
    """Return how far a wall moves outwards at ``heights``, from its sides' ends (m, 2) and shape functions' values (m, p + 1)."""
    side = np.searchsorted(ends.max(axis=1), heights.mean(axis=1))
    start, end = ends[side].T[..., None]
    fraction = (heights - start) / (end - start)
    values = evaluate_edge_functions(fraction, evaluate_legendre(fraction, moved.shape[1] - 1))[0]
    return np.asarray((values @ moved[side, :, None])[..., 0])
