"""Draw dimensioned drawings at a standard scale: a section, below it the view from above (first angle), and a title block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from geometry.cad.stamp import Stamp
from geometry.workshop.parts import DRAWING_TITLES, SEAT_ROUGHNESS, Measure, PartView
from geometry.workshop.sheet import (
    ARROW_LENGTH_MM,
    DIMENSION_SPACING_MM,
    PAPER_SIZES_MM,
    DrawingSheet,
    Point,
    View,
    find_bounds,
    find_text_width,
    format_number,
)
from geometry.workshop.title_block import BLOCK_HEIGHT_MM, NOTE_SPACING_MM, Title, draw_frame, draw_notes, draw_title_block
from geometry.workshop.tolerance import MACHINING_PROCESS, Budget, Tolerance, find_process, find_tolerance, format_deviation

FIRST_LINE_OFFSET_MM = 11.0  # mm of paper from a view to its first dimension line: space for roughness symbols
ITEM_SPACING_MM = 7.0  # between the numbers of two items
ITEM_COLUMN_MM = 14.0  # of item numbers, to the right of the section and left of the dimensions there
RADIUS_MARGIN_MM = 26.0  # next to the section, for the radius of its edge
VIEW_SPACING_MM = 10.0  # from the last dimension line to the next view
STANDARD_SCALES = [
    mantissa * 10.0**exponent for exponent in range(6, -7, -1) for mantissa in (5, 2, 1)
]  # ISO 5455, from the largest


def draw_part(part: PartView, stamp: Stamp, budget: Budget, extra: tuple[str, ...] = ()) -> DrawingSheet:
    """Draw a part on a sheet of suitable size at a suitable scale.

    Parameters
    ----------
    part
        The part to be drawn.
    stamp
        Stamp of the design.
    budget
        See ``geometry.workshop.tolerance.Budget``.
    extra
        Notes in addition to those on assumed sizes.
    """
    note_lines = [*extra, *_list_assumptions(part)]
    material = stamp.materials.get(part.name)
    process = MACHINING_PROCESS if material is None else material.process
    texts = {measure: format_dimension(measure, part.name, process, budget) for measure in part.measures}
    sheet = _choose_sheet(part, list(texts.values()), len(note_lines))
    draw_frame(sheet)
    material_text = "see the parts list" if material is None else material.text
    made = None if material is None else find_process(process)
    draw_title_block(sheet, Title(DRAWING_TITLES[part.name], part.name, material_text, stamp, made))
    draw_notes(sheet, note_lines, sheet.frame[1] + BLOCK_HEIGHT_MM + 3)
    _draw_views(sheet, part, texts, process)
    return sheet


def format_dimension(measure: Measure, part: str, process: str, budget: Budget) -> str:
    """Format a dimension: its number, its deviation where the drawing must state it, and a star where it is assumed.

    An auxiliary dimension, which follows from others, stands in parentheses.
    """
    text = f"{measure.prefix}{format_number(measure.size)}{'*' if measure.assumed else ''}"
    if measure.auxiliary:
        return f"({text})"
    held = measure.find_tolerance(part, process, budget)
    return text + _format_stated(held)


def _format_stated(tolerance: Tolerance) -> str:
    """Return the deviation as the drawing states it, with ±; empty where it need not be stated."""
    return f" \N{PLUS-MINUS SIGN}{format_deviation(tolerance.deviation)}" if tolerance.is_stated else ""


def _list_assumptions(part: PartView) -> Iterator[str]:
    """Yield the note on sizes with a star, if there are any."""
    if any(measure.assumed for measure in part.measures):
        yield "* assumed: the scene does not give this size"


def _choose_sheet(part: PartView, texts: list[str], count: int) -> DrawingSheet:
    """Choose the largest scale at which views and dimensions fit; a larger sheet if the scale on A4 would be below 1:1."""
    best = []
    for size in PAPER_SIZES_MM:
        left, bottom, right, top = DrawingSheet(size, 1.0).frame
        wide = right - left - 2 * _find_side_margin(part)
        tall = (
            top
            - bottom
            - BLOCK_HEIGHT_MM
            - NOTE_SPACING_MM * count
            - _reserve_above(texts)
            - _reserve_below(part)
            - 3 * VIEW_SPACING_MM
        )
        low_x, low, high_x, high = find_bounds(loop for loop, _ in part.cut)
        fit = min(wide / max(high_x - low_x, 2 * part.reach), tall / (high - low + 2 * part.reach))
        best.append(DrawingSheet(size, next((scale for scale in STANDARD_SCALES if scale <= fit), STANDARD_SCALES[-1])))
    return best[0] if best[0].scale >= 1 else max(best, key=lambda sheet: sheet.scale)


def _count_measures(part: PartView, place: str) -> int:
    """Return how many dimensions stand at a place of the drawing."""
    return sum(measure.place == place for measure in part.measures)


def _find_side_margin(part: PartView) -> float:
    """Return the width that dimensions, item numbers and an edge's radius need at each side of the views, mm of paper."""
    levels = max(_count_measures(part, place) for place in ("left", "right", "plan"))
    return FIRST_LINE_OFFSET_MM + max(
        DIMENSION_SPACING_MM * levels + 4 + (ITEM_COLUMN_MM if part.items else 0.0),
        14.0 if part.items else 0.0,
        RADIUS_MARGIN_MM if part.edge else 0.0,
    )


def _reserve_below(part: PartView) -> float:
    """Return the height that dimensions need below the section, mm of paper."""
    return FIRST_LINE_OFFSET_MM + DIMENSION_SPACING_MM * _count_measures(part, "below")


def _reserve_above(texts: list[str]) -> float:
    """Return the height above the section, mm of paper, for the text of a short vertical dimension."""
    return max(find_text_width(text) for text in texts) + 3 * ARROW_LENGTH_MM + 2


def _draw_views(sheet: DrawingSheet, part: PartView, texts: dict[Measure, str], process: str) -> None:
    """Draw the section with its dimensions at the top of the sheet, and the view from above below it."""
    left, _, right, top = sheet.frame
    unit = sheet.mm_per_paper_mm
    _, low, _, high = find_bounds(loop for loop, _ in part.cut)
    middle = (left + right) / 2
    front = sheet.create_view(middle, top - _reserve_above(list(texts.values())) - high * sheet.scale)
    _draw_front(front, part, process)
    _draw_dimensions(front, part, texts, process)
    plan = sheet.create_view(middle, front.y / unit - _reserve_below(part) - VIEW_SPACING_MM + (low - part.reach) * sheet.scale)
    _draw_plan(plan, part)
    for level, measure in enumerate(candidate for candidate in part.measures if candidate.place == "plan"):
        line_position = part.reach + (FIRST_LINE_OFFSET_MM + DIMENSION_SPACING_MM * level) * unit
        plan.draw_dimension(measure.start, measure.end, texts[measure], line_position=line_position, upright=True)


def _draw_front(view: View, part: PartView, process: str) -> None:
    """Draw the section: cut faces, visible lines, the axis, roughness symbols and item numbers."""
    unit = view.sheet.mm_per_paper_mm
    _, low, _, high = find_bounds(loop for loop, _ in part.cut)
    for loop, angle in part.cut:
        view.draw_section(loop, angle)
    for start, end in part.seen:
        view.draw_line(start, end)
    view.draw_line((0, low - 3 * unit), (0, high + 3 * unit), "AXIS")
    for x, z, is_upward in (
        part.seats if process == MACHINING_PROCESS else ()
    ):  # the title block states the process of the other faces
        view.draw_roughness((x, z), SEAT_ROUGHNESS, is_upward)
    for item, (tip, z) in enumerate(
        zip(part.items, _spread_heights(part.items, low, ITEM_SPACING_MM * unit), strict=True), start=1
    ):
        view.draw_item(tip, (part.reach + FIRST_LINE_OFFSET_MM * unit, z), str(item))


def _spread_heights(tips: Sequence[Point], low: float, spacing: float) -> list[float]:
    """Return the heights of item numbers: level with their tips where the spacing allows it, and none below ``low``."""
    # downwards first, each at least ``spacing`` below the last; then upwards, which lifts those below the limit
    heights: list[float] = []
    for _, z in tips:
        heights.append(min(z, heights[-1] - spacing) if heights else z)
    height = low - spacing
    for index in reversed(range(len(heights))):
        height = heights[index] = max(heights[index], height + spacing)
    return heights


def _draw_plan(view: View, part: PartView) -> None:
    """Draw the view from above, without dimensions."""
    for loop in part.plan:
        view.draw_loop(loop)
    for radius in part.hidden:
        view.draw_circle(radius, "HIDDEN")
    for start, end in part.plan_lines:
        view.draw_line(start, end)
    view.draw_centre_lines(2 * part.reach, 2 * part.reach)


def _draw_dimensions(view: View, part: PartView, texts: dict[Measure, str], process: str) -> None:
    """Draw the dimensions of the section, each by its text, and the radius of its round edges."""
    unit = view.sheet.mm_per_paper_mm
    low_x, low, high_x, high = find_bounds(loop for loop, _ in part.cut)
    starts: dict[str, float] = {"below": low, "left": low_x, "right": high_x}
    for place, start in starts.items():
        sign = 1 if place == "right" else -1
        offset = FIRST_LINE_OFFSET_MM + (ITEM_COLUMN_MM if part.items and place == "right" else 0.0)
        for level, measure in enumerate(candidate for candidate in part.measures if candidate.place == place):
            line_position = start + sign * (offset + DIMENSION_SPACING_MM * level) * unit
            upright = place != "below"
            view.draw_dimension(
                measure.start,
                measure.end,
                texts[measure],
                line_position=line_position,
                upright=upright,
                clear=high if upright else high_x,
            )
    if part.edge is not None:
        radius, centre = part.edge
        held = find_tolerance(radius, radius=True, process=process)
        text = f"R{format_number(radius)}{_format_stated(held)}"
        view.draw_radius(centre, radius, -45, text, (high_x + (4 + find_text_width(text) / 2) * unit, low - 7.0 * unit))
