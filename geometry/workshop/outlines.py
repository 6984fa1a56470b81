"""Convert a probe's dimensions to mm, and build closed outlines of its parts for sections and views from above.

The dimensions are named by the letters of the section. Arcs are kept as arcs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from geometry.cad.solids import QUARTER_BULGE
from geometry.scenes.base_sizes import find_base_faces, find_base_sizes, find_film_levels
from geometry.scenes.probe import Probe
from geometry.scenes.units import MM_PER_M
from geometry.workshop.sheet import Loop, Point

CHORDS_PER_QUARTER = 32  # chords for a quarter of a circle where arcs have to be polygons


@dataclass(frozen=True)
class Millimetres:
    """A probe's dimensions in mm; 0 for a groove, films or round edges that it does not have.

    Attributes
    ----------
    r2, ri, ro
        Radii of the inner block, the hole and the tube.
    h2, h1
        Heights of the inner and the outer block.
    z2, z1
        Heights of the lower face of the inner and of the outer film.
    t2, t1
        Thicknesses of the inner and of the outer film.
    inset2, inset1
        How far the scene has the inner and the outer film's electrodes end within the film's edges.
    half_width, depth
        Half the groove's width, and its depth.
    edge
        Radius of the blocks' lower edges.
    low, side
        Heights of the base's lower faces over the inner and the outer block.
    rf
        Radius of the flange; that of the tube without a flange.
    flange_bottom, top
        Heights of the flange's lower and upper face.
    """

    r2: float
    ri: float
    ro: float
    h2: float
    h1: float
    z2: float
    z1: float
    t2: float
    t1: float
    inset2: float
    inset1: float
    half_width: float
    depth: float
    edge: float
    low: float
    side: float
    rf: float
    flange_bottom: float
    top: float

    @property
    def middle(self) -> float:
        """Radius of the middle of the gap, where the base's lower face steps."""
        return (self.r2 + self.ri) / 2

    @property
    def groove_ends(self) -> tuple[float, float]:
        """Where the groove's sides meet the hole's and the tube's wall: x."""
        inner, outer = (math.sqrt((radius - self.half_width) * (radius + self.half_width)) for radius in (self.ri, self.ro))
        return inner, outer


def convert_to_mm(probe: Probe, edge_radius: float = 0.0) -> Millimetres:
    """Return a probe's dimensions in mm; ``edge_radius`` is that of the blocks' lower edges, m.

    Raises
    ------
    InputError
        See ``geometry.scenes.base_sizes.find_base_sizes``.
    """
    sizes, (low, side), mm = find_base_sizes(probe), find_base_faces(probe), MM_PER_M
    films = (None, None) if probe.film is None else probe.film.by_block
    levels = (probe.core_height,) * 2, (probe.tube_height,) * 2  # of the films' lower and upper faces
    (bottom2, top2), (bottom1, top1) = levels if probe.film is None else find_film_levels(probe)
    inset2, inset1 = (0.0 if film is None else film.electrode_inset * mm for film in films)
    flange_bottom = max(low, side) * mm + sizes.step_height * mm
    return Millimetres(
        r2=probe.inner_radius * mm,
        ri=probe.hole_radius * mm,
        ro=probe.tube_radius * mm,
        h2=probe.core_height * mm,
        h1=probe.tube_height * mm,
        z2=bottom2 * mm,
        z1=bottom1 * mm,
        t2=(top2 - bottom2) * mm,
        t1=(top1 - bottom1) * mm,
        inset2=inset2,
        inset1=inset1,
        half_width=0.0 if probe.groove is None else probe.groove.width / 2 * mm,
        depth=0.0 if probe.groove is None else probe.groove.depth * mm,
        edge=edge_radius * mm,
        low=low * mm,
        side=side * mm,
        rf=sizes.flange_radius * mm,
        flange_bottom=flange_bottom,
        top=flange_bottom + sizes.thickness * mm,
    )


def build_box(left: float, right: float, bottom: float, top: float) -> Loop:
    """Return a rectangle."""
    return [(left, bottom, 0.0), (right, bottom, 0.0), (right, top, 0.0), (left, top, 0.0)]


def build_block(left: float, right: float, top: float, edge: float) -> Loop:
    """Return a rectangle on z = 0 whose lower corners are rounded with radius ``edge``."""
    if edge == 0:
        return build_box(left, right, 0.0, top)
    low = [(left, edge, QUARTER_BULGE), (left + edge, 0.0, 0.0), (right - edge, 0.0, QUARTER_BULGE), (right, edge, 0.0)]
    return [*low, (right, top, 0.0), (left, top, 0.0)]


def build_base_section(lengths: Millimetres) -> Loop:
    """Return the section of the base; see ``geometry.cad.solids.build_base``."""
    low, side, rm, ro, rf = lengths.low, lengths.side, lengths.middle, lengths.ro, lengths.rf
    half = [(rm, low), (rm, side)] if low != side else []  # the right half's corners, from below; the left one mirrors them
    half += [(ro, side), *([(ro, lengths.flange_bottom), (rf, lengths.flange_bottom)] if rf > ro else []), (rf, lengths.top)]
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
    """Return the area that an outline encloses, mm^2: that of its polygon plus the segments of its arcs."""
    total = 0.0
    for (x, y, bulge), (next_x, next_y, _) in zip(loop, [*loop[1:], loop[0]], strict=True):
        total += (x * next_y - next_x * y) / 2
        if bulge:
            angle = 4 * math.atan(bulge)
            radius = math.hypot(next_x - x, next_y - y) / (2 * math.sin(angle / 2))
            total += radius**2 * (angle - math.sin(angle)) / 2
    return abs(total)


def convert_to_polygon(loop: Loop) -> list[Point]:
    """Return the corners of an outline, its arcs as chords, ``CHORDS_PER_QUARTER`` for a quarter of a circle."""
    corners: list[Point] = []
    for (x, y, bulge), (next_x, next_y, _) in zip(loop, [*loop[1:], loop[0]], strict=True):
        corners.append((x, y))
        angle = 4 * math.atan(bulge)
        count = round(CHORDS_PER_QUARTER * abs(angle) / (math.pi / 2))
        for k in range(1, count):  # points on the arc, by the chord from its start
            turn = angle * k / count / 2
            length, lean = math.sin(turn) / math.sin(angle / 2), turn - angle / 2
            dx, dy = length * (next_x - x), length * (next_y - y)
            corners.append((x + dx * math.cos(lean) - dy * math.sin(lean), y + dx * math.sin(lean) + dy * math.cos(lean)))
    return corners
