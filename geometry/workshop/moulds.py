"""The two halves of the mould of each block as solids and STEP files, each read back and its volume compared with formulas."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from geometry.cad import solids, step_writer
from geometry.cad.stamp import Stamp
from geometry.cad.step_check import TOLERANCE
from geometry.cad.step_reader import read
from geometry.common.errors import ExportError
from geometry.workshop.mould_sizes import FLOOR, LID, PIN_HEIGHT, PIN_PLAY, PINS, TOOL, WALL, MouldSizes, volumes
from geometry.workshop.sheet import Point

HALVES = ("lower", "upper")


def file_name(mould: MouldSizes, half: str) -> str:
    """Return the name of a half's file."""
    return f"mould-{mould.name}-{half}.step"


def write(mould: MouldSizes, half: str, stamp: Stamp, path: Path) -> None:
    """Build a half, write it and read it back.

    Raises:
        ExportError: the modeller fails, or the file does not hold what the formulas say.
        MissingLibrary: see ``geometry.cad.solids.load_cadquery``.
        OSError: the file cannot be written.
    """
    name = f"mould-{mould.name}-{half}"
    solids.cadquery()
    shape = solids.built(name, partial({"lower": lower, "upper": upper}[half], mould))
    with step_writer.quiet():
        step_writer.write({name: shape}, path, replace(stamp, materials={name: TOOL}))
        check(path, name, volumes(mould)[half])


def check(path: Path, name: str, volume: float) -> None:
    """Raise ``ExportError`` unless a file holds one valid closed solid of that name and volume in mm^3."""
    (found, shape, _), *others = read(path)
    if others or found != name or shape.ShapeType() != "Solid" or not shape.isValid():
        raise ExportError(f"{path.name}: shape = {found} {shape.ShapeType()}, expected one valid Solid {name}")
    if not abs(shape.Volume() - volume) <= TOLERANCE * volume:
        raise ExportError(f"{path.name}: volume = {shape.Volume():.9g}, expected {volume:.9g} within {TOLERANCE:g} of it")


def lower(mould: MouldSizes) -> Any:
    """Build the half with the cavity; the parting plane is its upper face, z = 0 the cavity's floor."""
    top, outside = mould.height, mould.outside
    corners = [(0.0, -FLOOR), (outside, -FLOOR), (outside, top), (mould.outer[1], top)]
    body = _revolved([*(_lines(corners)), *_cavity(mould, 0.0), *_middle(mould), ((0.0, _axis(mould)), (0.0, -FLOOR))])
    for radius, place in zip(PINS, _pin_places(mould), strict=True):
        body = body.fuse(_cylinder(radius, PIN_HEIGHT + 1.0, place, top - 1.0))
    return _one(body)


def upper(mould: MouldSizes) -> Any:
    """Build the lid, as it lies on the lower half."""
    body = _cylinder(mould.outside, LID, (0.0, 0.0), mould.height)
    for radius, place in zip(PINS, _pin_places(mould), strict=True):
        body = body.cut(_cylinder(radius + PIN_PLAY, PIN_HEIGHT + 0.5, place, mould.height))
    for radius, place in hole_places(mould):
        body = body.cut(_cylinder(radius, LID + mould.depth, place, mould.height))
    return _one(body.fuse(_rib(mould)) if mould.depth else body)


def hole_places(mould: MouldSizes) -> list[tuple[float, Point]]:
    """Return the radius and place of the hole to pour through and of two vents; none of them above the rib, which lies at +x."""
    if not mould.middle:
        at = 0.8 * mould.outer[1]
        return [(mould.pour, (0.0, 0.0)), (mould.vent, (0.0, at)), (mould.vent, (0.0, -at))]
    places = [(mould.middle * math.cos(angle), mould.middle * math.sin(angle)) for angle in (math.pi, 2.1, -2.1)]
    return list(zip((mould.pour, mould.vent, mould.vent), places, strict=True))


def _pin_places(mould: MouldSizes) -> tuple[Point, Point]:
    at = mould.outer[1] + WALL / 2
    return (0.0, at), (0.0, -at)


def _cylinder(radius: float, height: float, place: Point, z: float) -> Any:
    cq = solids.cadquery()
    return cq.Solid.makeCylinder(radius, height, cq.Vector(*place, z))


def _lines(corners: list[Point]) -> list[tuple[Point, ...]]:
    return [tuple(pair) for pair in pairwise(corners)]


def _cavity(mould: MouldSizes, floor: float) -> list[tuple[Point, ...]]:
    """Return the cavity's wall and floor as lines of two and arcs of three points (r, z), from the rim inwards."""
    e, (inner, outer) = mould.edge, mould.radii(mould.edge)
    cut = e * (1 - math.sqrt(0.5))
    sides: list[tuple[Point, ...]] = [((mould.outer[1], mould.height), (outer, floor + e))]
    if e:
        sides.append(((outer, e), (outer - cut, cut), (outer - e, 0.0)))
    hole = e if inner else 0.0
    sides.append(((outer - e, 0.0), (inner + hole, 0.0)))
    if inner and e:
        sides.append(((inner + e, 0.0), (inner + cut, cut), (inner, e)))
    return sides


def _middle(mould: MouldSizes) -> list[tuple[Point, ...]]:
    """Return the pin that leaves the tube's hole."""
    inner, _ = mould.radii(mould.edge)
    if not inner:
        return []
    return _lines([(inner, mould.edge), (mould.inner[1], mould.height), (0.0, mould.height)])


def _axis(mould: MouldSizes) -> float:
    return mould.height if mould.inner[1] else 0.0


def _rib(mould: MouldSizes) -> Any:
    """What of the cavity's ring lies in |y| < half the groove's width, x > 0, within its depth below the parting plane."""
    cq, low = solids.cadquery(), mould.height - mould.depth
    (inner, outer), a = mould.radii(low), mould.half_width
    ring = _revolved(
        _lines([(inner, low), (outer, low), (mould.outer[1], mould.height), (mould.inner[1], mould.height), (inner, low)])
    )
    slab = cq.Solid.makeBox(2 * mould.outside, 2 * a, 3 * mould.depth, cq.Vector(0.0, -a, low - mould.depth))
    return _one(ring.intersect(slab))


def _revolved(sides: list[tuple[Point, ...]]) -> Any:
    cq = solids.cadquery()
    edges = []
    for side in sides:
        points = [cq.Vector(-radius, 0.0, z) for radius, z in side]  # the seam on the side of -x, away from the rib
        edges.append(cq.Edge.makeLine(*points) if len(points) == 2 else cq.Edge.makeThreePointArc(*points))
    face = cq.Face.makeFromWires(cq.Wire.assembleEdges(edges))
    return cq.Solid.revolve(face, 360.0, cq.Vector(0, 0, 0), cq.Vector(0, 0, 1))


def _one(shape: Any) -> Any:
    (solid,) = shape.Solids()
    return solid
