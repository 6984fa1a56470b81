"""Build both halves of each block's mould as solids and STEP files; read each file back and compare its volume with formulas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad import solids, step_check, step_writer
from geometry.cad.stamp import Stamp
from geometry.workshop.mould_sizes import (
    FLOOR_THICKNESS_MM,
    LID_THICKNESS_MM,
    MOULD_MATERIAL,
    PIN_HEIGHT_MM,
    PIN_PLAY_MM,
    PIN_RADII_MM,
    WALL_THICKNESS_MM,
    MouldSizes,
    compute_half_volumes,
)
from geometry.workshop.sheet import Point

if TYPE_CHECKING:
    import cadquery


MOULD_HALVES = ("lower", "upper")


def format_file_name(mould: MouldSizes, half: str) -> str:
    """Return the file name of a mould's half."""
    return f"mould-{mould.name}-{half}.step"


def write_half(mould: MouldSizes, half: str, stamp: Stamp, path: Path) -> None:
    """Build a half, write it as STEP and check the file.

    Raises
    ------
    ExportError
        The modeller fails, or the file's volume differs from the formulas.
    MissingLibrary
        See ``geometry.cad.solids.load_cadquery``.
    OSError
        The file cannot be written.
    """
    name = f"mould-{mould.name}-{half}"
    solids.load_cadquery()
    shape = solids.call_modeller(name, partial({"lower": build_lower, "upper": build_upper}[half], mould))
    with step_writer.silence_messages():
        step_writer.write_step({name: shape}, path, replace(stamp, materials={name: MOULD_MATERIAL}))
        step_check.check_volume(path, name, compute_half_volumes(mould)[half])


def build_lower(mould: MouldSizes) -> cadquery.Solid:
    """Build the half with the cavity; its upper face is the parting plane, and the cavity's floor is z = 0."""
    top, outside, e, (inner, outer) = mould.height, mould.outside, mould.edge, mould.compute_radii(mould.edge)
    # from the rim of the cavity inwards, and up the pin that forms the tube's hole
    cavity: list[solids.Corner] = [(outer, e, -solids.QUARTER_BULGE), (outer - e, 0.0)] if e else [(outer, 0.0)]
    foot: list[solids.Corner] = [(inner + e, 0.0, -solids.QUARTER_BULGE), (inner, e)] if e else [(inner, 0.0)]
    pin = [*foot, (mould.inner[1], top), (0.0, top)] if inner else [(0.0, 0.0)]
    corners = [(0.0, -FLOOR_THICKNESS_MM), (outside, -FLOOR_THICKNESS_MM), (outside, top), (mould.outer[1], top)]
    body: cadquery.Shape = _revolve([*corners, *cavity, *pin])
    for radius, place in zip(PIN_RADII_MM, _list_pin_places(mould), strict=True):
        # rooted 1 mm below the parting plane, so that pin and body do not merely touch
        body = body.fuse(_build_cylinder(radius, PIN_HEIGHT_MM + 1.0, place, top - 1.0))
    return _get_single_solid(body)


def build_upper(mould: MouldSizes) -> cadquery.Solid:
    """Build the lid, in place on the lower half."""
    body: cadquery.Shape = _build_cylinder(mould.outside, LID_THICKNESS_MM, (0.0, 0.0), mould.height)
    for radius, place in zip(PIN_RADII_MM, _list_pin_places(mould), strict=True):
        body = body.cut(_build_cylinder(radius + PIN_PLAY_MM, PIN_HEIGHT_MM + 0.5, place, mould.height))
    for radius, place in list_holes(mould):
        body = body.cut(_build_cylinder(radius, LID_THICKNESS_MM + mould.depth, place, mould.height))
    return _get_single_solid(body.fuse(_build_rib(mould)) if mould.depth else body)


def list_holes(mould: MouldSizes) -> list[tuple[float, Point]]:
    """Return radius and centre of the pouring hole and of two vents; none of them is above the rib, which lies at +x."""
    if not mould.hole_circle_radius:
        offset = 0.8 * mould.outer[1]
        return [(mould.pour, (0.0, 0.0)), (mould.vent, (0.0, offset)), (mould.vent, (0.0, -offset))]
    places = [
        (mould.hole_circle_radius * math.cos(angle), mould.hole_circle_radius * math.sin(angle)) for angle in (math.pi, 2.1, -2.1)
    ]
    return list(zip((mould.pour, mould.vent, mould.vent), places, strict=True))


def _list_pin_places(mould: MouldSizes) -> tuple[Point, Point]:
    """Return the centres of the two pins that align the halves, in the middle of the wall round the cavity."""
    offset = mould.outer[1] + WALL_THICKNESS_MM / 2
    return (0.0, offset), (0.0, -offset)


def _build_cylinder(radius: float, height: float, place: Point, z: float) -> cadquery.Solid:
    """Build a vertical cylinder that stands at the height ``z``, mm."""
    cq = solids.load_cadquery()
    return cq.Solid.makeCylinder(radius, height, cq.Vector(*place, z))


def _build_rib(mould: MouldSizes) -> cadquery.Solid:
    """Build the rib: the part of the cavity's ring within the groove's width and depth, on the side x > 0."""
    cq, low = solids.load_cadquery(), mould.height - mould.depth
    (inner, outer), a = mould.compute_radii(low), mould.half_width
    ring = _revolve([(inner, low), (outer, low), (mould.outer[1], mould.height), (mould.inner[1], mould.height)])
    slab = cq.Solid.makeBox(2 * mould.outside, 2 * a, 3 * mould.depth, cq.Vector(0.0, -a, low - mould.depth))
    return _get_single_solid(ring.intersect(slab))


def _revolve(profile: Sequence[solids.Corner]) -> cadquery.Solid:
    """Build the solid of revolution about z of a closed profile in mm, its seam at -x, away from the rib."""
    return solids.revolve(profile, 1.0, side=-1)


def _get_single_solid(shape: cadquery.Shape) -> cadquery.Solid:
    """Return the only solid of a shape; raise ``ValueError`` if it has more or none."""
    (solid,) = shape.Solids()
    return solid
