"""A drawing sheet: one DXF document in true millimetres, whose frame, text and arrows are as large as its scale wants.

What is drawn measures 1:1 in model space, so that a reader's distances are the part's; printed at the scale it gives the sheet.
``geometry.workshop.pdf`` prints the same document.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

Point = tuple[float, float]
Loop = Sequence[tuple[float, float, float]]
"""Corners (x, y) in mm of a closed outline, each with the bulge of the arc to the next: tan(angle/4), 0 for a line."""

SIZES = {"A4": (210.0, 297.0), "A3": (297.0, 420.0)}  # upright, mm: ISO 216
MARGIN, FEED = 10.0, 20.0  # mm of paper between sheet and frame, and on the left: ISO 5457
TEXT, LEVEL, ARROW = 2.5, 8.0, 2.5  # mm of paper: height of figures, between two dimension lines, an arrow's length
PER_LETTER = 0.9  # width of a letter over the height of figures; DejaVu Sans has 0.87 for figures, a drawing's narrow font less
LINES = {  # layer: colour index, line width in 1/100 mm, line type; ISO 128-2
    "OUTLINE": (7, 50, "CONTINUOUS"),
    "HIDDEN": (8, 25, "DASHED"),
    "AXIS": (1, 18, "CENTER"),
    "SECTION": (8, 13, "CONTINUOUS"),
    "DIMENSION": (5, 18, "CONTINUOUS"),
    "TEXT": (7, 25, "CONTINUOUS"),
    "FRAME": (7, 50, "CONTINUOUS"),
}
STYLE = "WORKSHOP"


@dataclass(frozen=True)
class DrawingSheet:
    """A sheet of a standard size at a scale.

    Attributes:
        size: "A4" or "A3", upright.
        scale: millimetres of paper for one of the part.
    """

    size: str
    scale: float

    @property
    def unit(self) -> float:
        """Millimetres of the part in one of paper."""
        return 1 / self.scale

    @property
    def frame(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top of the frame in mm of paper."""
        width, height = SIZES[self.size]
        return FEED, MARGIN, width - MARGIN, height - MARGIN

    @cached_property
    def document(self) -> Any:
        """The DXF document, millimetres."""
        from ezdxf.filemanagement import new

        document = new("R2010", setup=["linetypes"], units=4)
        width, height = (length * self.unit for length in SIZES[self.size])
        settings = {
            "$MEASUREMENT": 1,
            "$LTSCALE": self.unit * 6,
            "$DIMSCALE": self.unit,
            "$LWDISPLAY": 1,
            "$LIMMAX": (width, height),
        }
        for name, value in {**settings, "$EXTMIN": (0, 0, 0), "$EXTMAX": (width, height, 0)}.items():
            document.header[name] = value
        for name, (colour, weight, kind) in LINES.items():
            document.layers.add(name, color=colour, lineweight=weight, linetype=kind)
        document.dimstyles.new(STYLE, dxfattribs=_style(self.unit))
        return document

    @cached_property
    def model(self) -> Any:
        """Its model space."""
        return self.document.modelspace()

    def view(self, x: float, y: float) -> View:
        """Return a view whose origin lies at (x, y) in mm of paper."""
        return View(self, x * self.unit, y * self.unit)

    def text(self, x: float, y: float, text: str, height: float = TEXT, align: str = "LEFT") -> None:
        """Write a line at (x, y) in mm of paper, its letters ``height`` mm high."""
        from ezdxf.enums import TextEntityAlignment

        line = self.model.add_text(text, height=height * self.unit, dxfattribs={"layer": "TEXT"})
        line.set_placement((x * self.unit, y * self.unit), align=TextEntityAlignment[align])

    def line(self, *points: Point, layer: str = "FRAME") -> None:
        """Draw lines from point to point in mm of paper."""
        self.model.add_lwpolyline([(x * self.unit, y * self.unit) for x, y in points], dxfattribs={"layer": layer})


@dataclass(frozen=True)
class View:
    """A view of a part: its coordinates are the part's in mm, its origin lies at (x, y) in mm of the sheet's model space."""

    sheet: DrawingSheet
    x: float
    y: float

    def at(self, point: Point) -> Point:
        """Return where a point of the part lies in model space."""
        return self.x + point[0], self.y + point[1]

    def loop(self, loop: Loop, layer: str = "OUTLINE") -> None:
        """Draw a closed outline."""
        points = [(*self.at((x, y)), bulge) for x, y, bulge in loop]
        self.sheet.model.add_lwpolyline(points, format="xyb", close=True, dxfattribs={"layer": layer})

    def section(self, loop: Loop, angle: float = 0.0) -> None:
        """Draw a closed outline that is cut, hatched at 45 degrees + ``angle``; what is thin on paper is filled."""
        self.loop(loop)
        points = [(*self.at((x, y)), bulge) for x, y, bulge in loop]
        hatch = self.sheet.model.add_hatch(dxfattribs={"layer": "SECTION", "color": 256})
        spans = (max(values) - min(values) for values in list(zip(*points, strict=True))[:2])
        if min(spans) > 1.5 * self.sheet.unit:
            hatch.set_pattern_fill("ANSI31", scale=0.8 * self.sheet.unit, angle=angle)
        hatch.paths.add_polyline_path(points, is_closed=True)

    def line(self, start: Point, end: Point, layer: str = "OUTLINE") -> None:
        """Draw a line."""
        self.sheet.model.add_line(self.at(start), self.at(end), dxfattribs={"layer": layer})

    def circle(self, radius: float, layer: str = "OUTLINE") -> None:
        """Draw a circle about the origin."""
        self.sheet.model.add_circle(self.at((0.0, 0.0)), radius, dxfattribs={"layer": layer})

    def cross(self, width: float, height: float, over: float = 3.0) -> None:
        """Draw centre lines through the origin, ``overhang`` mm of paper longer than width and height."""
        reach = over * self.sheet.unit
        self.line((-width / 2 - reach, 0), (width / 2 + reach, 0), "AXIS")
        self.line((0, -height / 2 - reach), (0, height / 2 + reach), "AXIS")

    def dimension(
        self, start: Point, end: Point, text: str, *, at: float, upright: bool = False, clear: float = -math.inf
    ) -> None:
        """Dimension horizontal or upright distance of two points; line lies ``line_position`` that y, or x, of the part, in mm.

        The text stands on the line where it fits between the arrows, else on its continuation beyond its upper or right end
        and beyond ``clear``, where nothing else is.
        """
        along = 1 if upright else 0
        place = (lambda value: (at, value)) if upright else (lambda value: (value, at))
        low, high = sorted((start[along], end[along]))
        unit, width = self.sheet.unit, room(text) * self.sheet.unit
        made = self.sheet.model.add_linear_dim(
            base=self.at(place(start[along])),
            p1=self.at(start),
            p2=self.at(end),
            angle=90 if upright else 0,
            text=text,
            dimstyle=STYLE,
            dxfattribs={"layer": "DIMENSION"},
        )
        if high - low < width + 2 * ARROW * unit:
            beyond = max(high + 2.2 * ARROW * unit, clear + ARROW * unit)
            self.line(place(high), place(beyond), "DIMENSION")
            made.set_location(self.at(place(beyond + unit + width / 2)))
        made.render()
        made.dimension.dxf.actual_measurement = high - low

    def radius(self, centre: Point, radius: float, angle: float, text: str, place: Point) -> None:
        """Dimension an arc's radius from outside, at an angle in degrees; ``place`` is where the text's middle lies."""
        made = self.sheet.model.add_radius_dim(
            center=self.at(centre), radius=radius, angle=angle, text=text, dimstyle=STYLE, dxfattribs={"layer": "DIMENSION"},
            override={"dimtoh": 1, "dimtih": 1},
        )  # fmt: skip
        made.set_location(self.at(place))
        made.render()
        made.dimension.dxf.actual_measurement = radius

    def item(self, tip: Point, place: Point, text: str) -> None:
        """Point from the right of ``place`` at ``tip`` and write there which item of a list it is."""
        unit = self.sheet.unit
        x, y = self.at(place)
        self.sheet.model.add_lwpolyline([self.at(tip), (x, y), (x + 4 * unit, y)], dxfattribs={"layer": "DIMENSION"})
        self.sheet.model.add_circle(self.at(tip), 0.4 * unit, dxfattribs={"layer": "DIMENSION"})
        self.sheet.text(x / unit + 5, y / unit - 1.5, text, 3.0)

    def roughness(self, point: Point, text: str, up: bool = True) -> None:
        """Set the symbol of a surface that is machined (ISO 21920-1) on a face that looks up, or down, with its value."""
        unit, sign = self.sheet.unit, 1 if up else -1
        x, y = (coordinate / unit for coordinate in self.at(point))
        high, wide = 5.0 * sign, 2.5
        self.sheet.line(
            (x - wide / 2, y + high / 2), (x, y), (x + wide, y + high), (x + wide + room(text), y + high), layer="TEXT"
        )
        self.sheet.line((x - wide / 2, y + high / 2), (x + wide / 2, y + high / 2), layer="TEXT")
        self.sheet.text(x + wide + 0.5, y + high - (3.2 if up else -0.7), text, height=2.2)


def room(text: str, height: float = TEXT) -> float:
    """Return the width of a line of text in mm of paper."""
    return PER_LETTER * height * len(text)


def _style(unit: float) -> dict[str, Any]:
    sizes = {"dimtxt": TEXT, "dimasz": ARROW, "dimexe": 1.5, "dimexo": 0.8, "dimgap": 0.7, "dimscale": unit}
    return {**sizes, "dimtad": 1, "dimtih": 0, "dimtoh": 0, "dimdec": 4, "dimclrd": 256, "dimclre": 256, "dimclrt": 256}


def bounds(loops: Iterable[Loop]) -> tuple[float, float, float, float]:
    """Return left, bottom, right and top of outlines in mm."""
    points = [point for loop in loops for point in loop]
    x, y = [point[0] for point in points], [point[1] for point in points]
    return min(x), min(y), max(x), max(y)
