"""Closed outlines of the parts, in mm: what a section cuts and what is seen from above, with arcs as arcs."""

from __future__ import annotations

import math

from geometry.cad import solids
from geometry.scenes.base_sizes import base_sizes
from geometry.scenes.probe import Probe
from geometry.workshop.sheet import Loop

QUARTER_BULGE = math.tan(math.pi / 8)  # bulge of a quarter of a circle, to the left


def build_box(left: float, right: float, bottom: float, top: float) -> Loop:
    """Return a rectangle."""
    return [(left, bottom, 0.0), (right, bottom, 0.0), (right, top, 0.0), (left, top, 0.0)]


def build_block(left: float, right: float, top: float, edge: float) -> Loop:
    """Return a rectangle on z = 0 whose lower corners are quarters of circles of radius ``edge``."""
    if edge == 0:
        return build_box(left, right, 0.0, top)
    low = [(left, edge, QUARTER_BULGE), (left + edge, 0.0, 0.0), (right - edge, 0.0, QUARTER_BULGE), (right, edge, 0.0)]
    return [*low, (right, top, 0.0), (left, top, 0.0)]


def build_base_section(probe: Probe) -> Loop:
    """Return the section of the base; see ``geometry.cad.solids.build_base``."""
    sizes, mm = base_sizes(probe), solids.MM_PER_M
    low, side = (height * mm for height in solids.find_film_tops(probe))
    ro, rf, rm = probe.tube_radius * mm, sizes.flange_radius * mm, (probe.inner_radius + probe.gap / 2) * mm
    flange_bottom = max(low, side) + sizes.step_height * mm
    top = flange_bottom + sizes.thickness * mm
    half = [(rm, low), (rm, side)] if low != side else []
    half += [(ro, side), *([(ro, flange_bottom), (rf, flange_bottom)] if rf > ro else []), (rf, top)]
    return [(x, z, 0.0) for x, z in half] + [(-x, z, 0.0) for x, z in reversed(half)]


def build_disc(radius: float) -> Loop:
    """Return a circle about the origin as two arcs."""
    return [(-radius, 0.0, 1.0), (radius, 0.0, 1.0)]


def build_open_ring(inner: float, outer: float, half_width: float) -> Loop:
    """Return a ring about the origin, open where |y| < ``half_width`` on the side of +x."""
    x_inner, x_outer = (math.sqrt((radius - half_width) * (radius + half_width)) for radius in (inner, outer))
    outer_bulge = math.tan((math.pi - math.asin(half_width / outer)) / 2)
    inner_bulge = -math.tan((math.pi - math.asin(half_width / inner)) / 2)
    corners = [(x_outer, half_width), (x_outer, -half_width), (x_inner, -half_width), (x_inner, half_width)]
    return [(*corner, bulge) for corner, bulge in zip(corners, (outer_bulge, 0.0, inner_bulge, 0.0), strict=True)]


def compute_area(loop: Loop) -> float:
    """Return the area that an outline encloses, in mm^2: its polygon's and its arcs' segments."""
    total = 0.0
    for (x, y, bulge), (next_x, next_y, _) in zip(loop, [*loop[1:], loop[0]], strict=True):
        total += (x * next_y - next_x * y) / 2
        if bulge:
            angle = 4 * math.atan(bulge)
            radius = math.hypot(next_x - x, next_y - y) / (2 * math.sin(angle / 2))
            total += radius**2 * (angle - math.sin(angle)) / 2
    return abs(total)
