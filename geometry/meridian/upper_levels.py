"""Place the levels of films, bonds and an elastic base above the blocks, and the radii of the base across the gap."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Numeric
from geometry.meridian.breaks import join_intervals
from geometry.meridian.grading import grade_nodes, smooth_min
from geometry.meridian.section import Body, Section
from geometry.meridian.sphere_box import Breaks


def place_bridge(s: Section, sign: int | None, half: int) -> Numeric:
    """Return the radii of an elastic base across the gap, graded to its ends and to the step in its middle.

    ``sign`` is ``Kind.base``, ``half`` the number of columns of either half.
    """
    # the step is as high as the blocks' heights differ, and needs cells no larger than that
    middle = (s.inner_radius + s.hole_radius) / 2
    inner_top, outer_top = s.top_heights
    step = s.corner_size if not sign else smooth_min(s.corner_size, sign * (inner_top - outer_top))
    breaks = Breaks([s.inner_radius, middle, s.hole_radius], [s.corner_size, step, s.corner_size], [1, 1])
    return join_intervals(breaks, (half, half))[..., 1:-1]


def place_stack_levels(s: Section, height: Numeric, stack: tuple[Body, ...], rows: tuple[int, ...]) -> list[Numeric]:
    """Return the levels of the layers of a stack on a block whose top is at ``height``; ``rows`` of cells for each layer."""
    levels, top = [], height
    for body, count in zip(stack, rows, strict=True):
        thickness = getattr(s, body.name.lower())
        end = top + thickness
        if count == 1:  # no lines to place; 0 * corner size: arrays of its shape
            levels.append(np.asarray(end + 0 * s.corner_size)[..., None])
        else:
            levels.append(grade_nodes(top, end, count, s.corner_size, s.corner_size)[..., 1:])
        top = end
    return levels


def place_base_levels(s: Section, sign: int | None, step_rows: int, thick_rows: int) -> list[Numeric]:
    """Return the levels of an elastic base from below: its boss on the lower block, the step, and the flange.

    The boss, absent where both films are level, fills the height by which one block is lower than the other.
    ``sign`` is ``Kind.base``; the other numbers are the rows of boss or step and those of the flange.
    """
    low, step = s.top_heights[::-1] if sign == 1 else s.top_heights
    corner = s.corner_size
    boss = [] if sign == 0 else [grade_nodes(low, step, step_rows, corner, corner)[..., 1:-1]]
    flange = step + s.step_height
    top = grade_nodes(flange, flange + s.flange_thickness, thick_rows, smooth_min(s.step_height, corner))
    return [*boss, grade_nodes(step, flange, step_rows, corner, corner)[..., 1:], top[..., 1:]]
