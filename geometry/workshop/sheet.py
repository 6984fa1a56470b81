"""Define a drawing sheet: one DXF document in true millimetres, with frame, text and arrows enlarged or reduced by its scale.

The part is drawn 1:1 in model space, so that distances measured there are the part's; printed at the scale it fills the sheet.
``geometry.workshop.pdf`` prints the same document.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from geometry.cad.stamp import Stamp
from geometry.provenance.texts import split_block

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.layouts.layout import Modelspace


Point = tuple[float, float]
Loop = Sequence[tuple[float, float, float]]
"""Corners (x, y) in mm of a closed outline, each with the bulge of the arc to the next: tan(angle/4), 0 for a line."""

PAPER_SIZES_MM = {"A4": (210.0, 297.0), "A3": (297.0, 420.0)}  # upright, mm: ISO 216
CENTRE_LINE_OVERHANG_MM = 3.0  # mm of paper beyond the outline
MARGIN_MM, LEFT_MARGIN_MM = 10.0, 20.0  # mm of paper between sheet and frame, and on the left: ISO 5457
TEXT_HEIGHT_MM, DIMENSION_SPACING_MM, ARROW_LENGTH_MM = (
    2.5,
    8.0,
    2.5,
)  # mm of paper: height of figures, between two dimension lines, an arrow's length
WIDTH_PER_LETTER = 0.9  # width of a letter over the height of figures; 0.87 for figures of DejaVu Sans, less for a narrow font
LINE_STYLES = {  # layer: colour index, line width in 1/100 mm, line type; ISO 128-2
    "OUTLINE": (7, 50, "CONTINUOUS"),
    "HIDDEN": (8, 25, "DASHED"),
    "AXIS": (1, 18, "CENTER"),
    "SECTION": (8, 13, "CONTINUOUS"),
    "DIMENSION": (5, 18, "CONTINUOUS"),
    "TEXT": (7, 25, "CONTINUOUS"),
    "FRAME": (7, 50, "CONTINUOUS"),
}
DIMENSION_STYLE = "WORKSHOP"
MAX_PROPERTY_CHARACTERS = 2000  # characters: a string of a DXF file holds 2049
DIAMETER_SIGN = "\N{LATIN CAPITAL LETTER O WITH STROKE}"


@dataclass(frozen=True)
class DrawingSheet:
    """A sheet of a standard size at a scale.

    Attributes
    ----------
    size
        "A4" or "A3", upright.
    scale
        Millimetres of paper per millimetre of the part.
    """

    size: str
    scale: float

    @property
    def mm_per_paper_mm(self) -> float:
        """Millimetres of the part per millimetre of paper."""
        return 1 / self.scale

    @property
    def frame(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top of the frame in mm of paper."""
        width, height = PAPER_SIZES_MM[self.size]
        return LEFT_MARGIN_MM, MARGIN_MM, width - MARGIN_MM, height - MARGIN_MM

    @cached_property
    def document(self) -> Drawing:
        """The DXF document, in millimetres."""
        from ezdxf.filemanagement import new

        document = new("R2010", setup=["linetypes"], units=4)
        width, height = (length * self.mm_per_paper_mm for length in PAPER_SIZES_MM[self.size])
        settings = {
            "$MEASUREMENT": 1,
            "$LTSCALE": self.mm_per_paper_mm * 6,
            "$DIMSCALE": self.mm_per_paper_mm,
            "$LWDISPLAY": 1,
            "$LIMMAX": (width, height),
        }
        for name, value in {**settings, "$EXTMIN": (0, 0, 0), "$EXTMAX": (width, height, 0)}.items():
            document.header[name] = value
        for name, (colour, weight, kind) in LINE_STYLES.items():
            document.layers.add(name, color=colour, lineweight=weight, linetype=kind)
        document.dimstyles.new(DIMENSION_STYLE, dxfattribs=_build_style(self.mm_per_paper_mm))
        return document

    @cached_property
    def model(self) -> Modelspace:
        """The model space of the document."""
        return self.document.modelspace()

    def create_view(self, x: float, y: float) -> View:
        """Return a view whose origin lies at (x, y) in mm of paper."""
        return View(self, x * self.mm_per_paper_mm, y * self.mm_per_paper_mm)

    def write_text(self, x: float, y: float, text: str, height: float = TEXT_HEIGHT_MM, align: str = "LEFT") -> None:
        """Write a line of text at (x, y) in mm of paper, in letters ``height`` mm high."""
        from ezdxf.enums import TextEntityAlignment

        line = self.model.add_text(text, height=height * self.mm_per_paper_mm, dxfattribs={"layer": "TEXT"})
        line.set_placement((x * self.mm_per_paper_mm, y * self.mm_per_paper_mm), align=TextEntityAlignment[align])

    def draw_line(self, *points: Point, layer: str = "FRAME") -> None:
        """Draw lines from point to point in mm of paper."""
        self.model.add_lwpolyline(
            [(x * self.mm_per_paper_mm, y * self.mm_per_paper_mm) for x, y in points], dxfattribs={"layer": layer}
        )


@dataclass(frozen=True)
class View:
    """A view of a part, in the part's coordinates, mm; its origin lies at (x, y) of the sheet's model space, mm."""

    sheet: DrawingSheet
    x: float
    y: float

    def to_model(self, point: Point) -> Point:
        """Convert a point of the part to model space."""
        return self.x + point[0], self.y + point[1]

    def draw_loop(self, loop: Loop) -> list[tuple[float, float, float]]:
        """Draw a closed outline; return its points in model space, with their bulges."""
        points = [(*self.to_model((x, y)), bulge) for x, y, bulge in loop]
        self.sheet.model.add_lwpolyline(points, format="xyb", close=True, dxfattribs={"layer": "OUTLINE"})
        return points

    def draw_section(self, loop: Loop, angle: float = 0.0) -> None:
        """Draw a section's closed outline, hatched at 45 degrees + ``angle``; a section that is thin on paper is filled."""
        points = self.draw_loop(loop)
        hatch = self.sheet.model.add_hatch(dxfattribs={"layer": "SECTION", "color": 256})
        spans = (max(values) - min(values) for values in list(zip(*points, strict=True))[:2])
        if min(spans) > 1.5 * self.sheet.mm_per_paper_mm:
            hatch.set_pattern_fill("ANSI31", scale=0.8 * self.sheet.mm_per_paper_mm, angle=angle)
        hatch.paths.add_polyline_path(points, is_closed=True)

    def draw_line(self, start: Point, end: Point, layer: str = "OUTLINE") -> None:
        """Draw a line."""
        self.sheet.model.add_line(self.to_model(start), self.to_model(end), dxfattribs={"layer": layer})

    def draw_circle(self, radius: float, layer: str = "OUTLINE") -> None:
        """Draw a circle about the origin."""
        self.sheet.model.add_circle(self.to_model((0.0, 0.0)), radius, dxfattribs={"layer": layer})

    def draw_centre_lines(self, width: float, height: float) -> None:
        """Draw centre lines through the origin, longer than width and height by ``CENTRE_LINE_OVERHANG_MM`` at each end."""
        reach = CENTRE_LINE_OVERHANG_MM * self.sheet.mm_per_paper_mm
        self.draw_line((-width / 2 - reach, 0), (width / 2 + reach, 0), "AXIS")
        self.draw_line((0, -height / 2 - reach), (0, height / 2 + reach), "AXIS")

    def draw_dimension(
        self, start: Point, end: Point, text: str, *, line_position: float, upright: bool = False, clear: float = -math.inf
    ) -> None:
        """Dimension the horizontal or vertical distance of two points, with the line at y or x = ``line_position``, mm.

        The text stands on the line if it fits between the arrows, else on the extended line beyond its upper or right end
        and beyond ``clear``.
        """
        axis = 1 if upright else 0
        place = (lambda value: (line_position, value)) if upright else (lambda value: (value, line_position))
        low, high = sorted((start[axis], end[axis]))
        unit, width = self.sheet.mm_per_paper_mm, find_text_width(text) * self.sheet.mm_per_paper_mm
        made = self.sheet.model.add_linear_dim(
            base=self.to_model(place(start[axis])),
            p1=self.to_model(start),
            p2=self.to_model(end),
            angle=90 if upright else 0,
            text=text,
            dimstyle=DIMENSION_STYLE,
            dxfattribs={"layer": "DIMENSION"},
        )
        if high - low < width + 2 * ARROW_LENGTH_MM * unit:  # the text does not fit between the arrows
            text_position = max(high + 2.2 * ARROW_LENGTH_MM * unit, clear + ARROW_LENGTH_MM * unit)
            self.draw_line(place(high), place(text_position), "DIMENSION")
            made.set_location(self.to_model(place(text_position + unit + width / 2)))
        made.render()
        made.dimension.dxf.actual_measurement = high - low

    def draw_radius(self, centre: Point, radius: float, angle: float, text: str, place: Point) -> None:
        """Dimension an arc's radius from outside, at an angle in degrees; ``place`` is the centre of the text."""
        made = self.sheet.model.add_radius_dim(
            center=self.to_model(centre), radius=radius, angle=angle, text=text, dimstyle=DIMENSION_STYLE,
            dxfattribs={"layer": "DIMENSION"},
            override={"dimtoh": 1, "dimtih": 1},
        )  # fmt: skip
        made.set_location(self.to_model(place))
        made.render()
        made.dimension.dxf.actual_measurement = radius

    def draw_item(self, tip: Point, place: Point, text: str) -> None:
        """Write the number of a list's item at ``place``, with a line to the right that points at ``tip``."""
        unit = self.sheet.mm_per_paper_mm
        x, y = self.to_model(place)
        self.sheet.model.add_lwpolyline([self.to_model(tip), (x, y), (x + 4 * unit, y)], dxfattribs={"layer": "DIMENSION"})
        self.sheet.model.add_circle(self.to_model(tip), 0.4 * unit, dxfattribs={"layer": "DIMENSION"})
        self.sheet.write_text(x / unit + 5, y / unit - 1.5, text, 3.0)

    def draw_roughness(self, point: Point, text: str, is_upward: bool = True) -> None:
        """Draw the symbol of surface roughness (ISO 21920-1) with its value on a face that points up, or down."""
        unit, sign = self.sheet.mm_per_paper_mm, 1 if is_upward else -1
        x, y = (coordinate / unit for coordinate in self.to_model(point))
        high, wide = 5.0 * sign, 2.5
        self.sheet.draw_line(
            (x - wide / 2, y + high / 2), (x, y), (x + wide, y + high), (x + wide + find_text_width(text), y + high), layer="TEXT"
        )
        self.sheet.draw_line((x - wide / 2, y + high / 2), (x + wide / 2, y + high / 2), layer="TEXT")
        self.sheet.write_text(x + wide + 0.5, y + high - (3.2 if is_upward else -0.7), text, height=2.2)


def find_text_width(text: str, height: float = TEXT_HEIGHT_MM) -> float:
    """Return the width of a line of text in mm of paper."""
    return WIDTH_PER_LETTER * height * len(text)


def _build_style(unit: float) -> dict[str, float]:
    """Return the settings of the dimension style by their DXF names; ``unit`` is ``DrawingSheet.mm_per_paper_mm``."""
    sizes = {"dimtxt": TEXT_HEIGHT_MM, "dimasz": ARROW_LENGTH_MM, "dimexe": 1.5, "dimexo": 0.8, "dimgap": 0.7, "dimscale": unit}
    return {**sizes, "dimtad": 1, "dimtih": 0, "dimtoh": 0, "dimdec": 4, "dimclrd": 256, "dimclre": 256, "dimclrt": 256}


def find_bounds(loops: Iterable[Loop]) -> tuple[float, float, float, float]:
    """Return left, bottom, right and top of outlines in mm."""
    points = [point for loop in loops for point in loop]
    x, y = [point[0] for point in points], [point[1] for point in points]
    return min(x), min(y), max(x), max(y)


def format_number(length: float) -> str:
    """Format a length in mm to 0.1 um; finer only where it would be rounded to zero."""
    return f"{length:.4f}".rstrip("0").rstrip(".") if length >= 5e-4 else f"{length:.3g}"


def add_properties(document: Drawing, stamp: Stamp) -> Drawing:
    """Return a DXF document with custom properties: design, program, and the provenance block as JSON, split if too long."""
    entries = {"design": stamp.design, "program": stamp.program}
    parts = split_block(stamp.provenance, MAX_PROPERTY_CHARACTERS)
    names = ["provenance"] if len(parts) == 1 else [f"provenance {number}" for number in range(1, len(parts) + 1)]
    for name, text in {**entries, **dict(zip(names, parts, strict=True))}.items():
        document.header.custom_vars.append(name, text)
    return document
