"""Draw the title block of a sheet: part, material, scale, general tolerance and design; ISO 7200, without a date."""

from __future__ import annotations

from dataclasses import dataclass

from geometry.cad.stamp import Stamp
from geometry.workshop.sheet import WIDTH_PER_LETTER, DrawingSheet, View, find_text_width
from geometry.workshop.tolerance import Process

BLOCK_WIDTH_MM, ROW_HEIGHT_MM, ROW_COUNT = 180.0, 6.5, 6  # mm of paper
BLOCK_HEIGHT_MM = ROW_HEIGHT_MM * ROW_COUNT + 3.5  # the first row is higher
LABEL_HEIGHT_MM, MAX_LETTER_HEIGHT_MM = 1.8, 2.2  # heights of letters
PARTS_REFERENCE = "see the parts' drawings"
NOTE_SPACING_MM = 4.0  # between two lines of notes


@dataclass(frozen=True)
class Title:
    """The entries of a title block.

    Attributes
    ----------
    name
        Name of the part.
    file
        Name of the drawing's files without suffix.
    material
        Material of the part.
    stamp
        Stamp of the design.
    process
        Manufacturing process; None for an assembly, whose parts have one each.
    """

    name: str
    file: str
    material: str
    stamp: Stamp
    process: Process | None


def format_scale(scale: float) -> str:
    """Format a scale as drawings state it: ``5:1`` or ``1:2``."""
    return f"{scale:g}:1" if scale >= 1 else f"1:{1 / scale:g}"


def draw_frame(sheet: DrawingSheet) -> None:
    """Draw the frame of a sheet."""
    left, bottom, right, top = sheet.frame
    sheet.draw_line((left, bottom), (right, bottom), (right, top), (left, top), (left, bottom))


def draw_title_block(sheet: DrawingSheet, title: Title) -> None:
    """Draw the title block at the lower right corner of the frame."""
    _, bottom, right, _ = sheet.frame
    left, top = right - BLOCK_WIDTH_MM, bottom + BLOCK_HEIGHT_MM
    process = title.process
    general, roughness, bonded = (
        (process.general, process.roughness, process.bonded) if process else (PARTS_REFERENCE, PARTS_REFERENCE, PARTS_REFERENCE)
    )
    sheet.draw_line((left, bottom), (left, top), (right, top))
    sheet.write_text(left + 3, top - 7.2, title.name, 4.5)
    sheet.write_text(right - 3, top - 7.2, title.file, 3.0, "RIGHT")
    rows: list[list[tuple[str, str, float]]] = [
        [("Material", title.material, BLOCK_WIDTH_MM)],
        [("Scale", format_scale(sheet.scale), 45), ("Sheet", sheet.size, 45), ("Units", "mm", 45), ("Projection", "", 45)],
        [("General tolerances", general, 90), ("Roughness, unless indicated", roughness, 90)],
        [("Design", title.stamp.design, BLOCK_WIDTH_MM)],
        [("Program", title.stamp.program, 90), ("Bonded faces", bonded, 90)],
    ]
    for number, row in enumerate(rows):
        high = top - 10.0 - number * ROW_HEIGHT_MM
        sheet.draw_line((left, high), (right, high))
        _draw_cells(sheet, left, high, row)
    _draw_first_angle_symbol(sheet, left + 160, top - 10.0 - 1.5 * ROW_HEIGHT_MM)


def _draw_cells(sheet: DrawingSheet, left: float, high: float, row: list[tuple[str, str, float]]) -> None:
    """Draw the cells of a row, whose upper left corner is given: each a label, a text and its width, mm of paper."""
    for label, text, width in row:
        if left > sheet.frame[2] - BLOCK_WIDTH_MM:
            sheet.draw_line((left, high), (left, high - ROW_HEIGHT_MM))
        sheet.write_text(left + 2, high - 4.2, label, LABEL_HEIGHT_MM)
        start = 3 + find_text_width(label, LABEL_HEIGHT_MM)
        sheet.write_text(left + start, high - 4.4, text, fit_letter_height(text, width - start - 1))
        left += width


def fit_letter_height(text: str, width: float) -> float:
    """Return the height of letters at which a text is no wider than ``width``, ``MAX_LETTER_HEIGHT_MM`` at most; mm of paper."""
    return min(MAX_LETTER_HEIGHT_MM, width / (WIDTH_PER_LETTER * max(1, len(text))))


def draw_notes(sheet: DrawingSheet, lines: list[str], bottom: float) -> None:
    """Write lines of notes one below the other, the last one at ``bottom``, mm of paper."""
    left, _, right, _ = sheet.frame
    for number, line in enumerate(reversed(lines)):
        sheet.write_text(left + 4, bottom + NOTE_SPACING_MM * number, line, fit_letter_height(line, right - left - 8))


def _draw_first_angle_symbol(sheet: DrawingSheet, x: float, y: float) -> None:
    """Draw the symbol of first-angle projection, ISO 5456-2: a cone, and to its right its view from the left."""
    sheet.draw_line((x - 9, y - 1), (x - 3, y - 2), (x - 3, y + 2), (x - 9, y + 1), (x - 9, y - 1), layer="TEXT")
    view: View = sheet.create_view(x + 4, y)
    for radius in (1.0, 2.0):
        view.draw_circle(radius * sheet.mm_per_paper_mm, "TEXT")
    sheet.draw_line((x - 10, y), (x + 7, y), layer="AXIS")
    sheet.draw_line((x + 4, y - 2.8), (x + 4, y + 2.8), layer="AXIS")
