"""Dimensioned drawings: a section above, the view from above below it (first angle), a title block, at a standard scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from geometry.cad.drawing import number
from geometry.cad.stamp import Stamp
from geometry.workshop.parts import SEAT, TITLES, Measure, PartView
from geometry.workshop.processes import find_process
from geometry.workshop.sheet import ARROW, LEVEL, SIZES, DrawingSheet, Point, View, bounds, room
from geometry.workshop.title_block import HEIGHT, NOTE, Title, frame, notes, title_block
from geometry.workshop.tolerance import MACHINING, Budget, tolerance, written

FIRST = 11.0  # mm of paper from a view to its first dimension line: symbols of roughness stand there
ITEM = 7.0  # between the numbers of two items
RADIUS = 26.0  # beside the section, for the radius of its edge
BETWEEN = 10.0  # from the last dimension line to the next view
SCALES = [mantissa * 10.0**exponent for exponent in range(6, -7, -1) for mantissa in (5, 2, 1)]  # ISO 5455, from the largest


def draw(part: PartView, stamp: Stamp, budget: Budget, extra: tuple[str, ...] = ()) -> DrawingSheet:
    """Draw a part on the sheet and at the scale that suit it.

    Args:
        part: what is shown.
        stamp: the design's.
        budget: see ``geometry.workshop.tolerance.Budget``.
        extra: notes beside those on assumed sizes.
    """
    said = [*extra, *_assumptions(part)]
    material = stamp.materials.get(part.name)
    process = MACHINING if material is None else material.process
    texts = {measure: label(measure, part.name, process, budget) for measure in part.measures}
    sheet = _sheet(part, list(texts.values()), len(said))
    frame(sheet)
    told = "see the parts list" if material is None else material.text
    made = None if material is None else find_process(process)
    title_block(sheet, Title(TITLES[part.name], part.name, told, stamp, made))
    notes(sheet, said, sheet.frame[1] + HEIGHT + 3)
    _views(sheet, part, texts, process)
    return sheet


def label(measure: Measure, part: str, process: str, budget: Budget) -> str:
    """Write a dimension: its number, its deviation where the drawing has to tell it, a star where it is assumed.

    One that others give stands in parentheses.
    """
    if measure.auxiliary:
        return f"({measure.prefix}{number(measure.size)})"
    held = measure.held(part, process, budget)
    star = "*" if measure.assumed else ""
    return f"{measure.prefix}{number(measure.size)}{star}" + (
        f" \N{PLUS-MINUS SIGN}{written(held.deviation)}" if held.told else ""
    )


def _assumptions(part: PartView) -> Iterator[str]:
    if any(measure.assumed for measure in part.measures):
        yield "* assumed: the scene does not give this size"


def _sheet(part: PartView, texts: list[str], count: int) -> DrawingSheet:
    """Choose the largest scale that leaves room for views and dimensions; a larger sheet where an A4 would have to reduce."""
    best = []
    for size in SIZES:
        left, bottom, right, top = DrawingSheet(size, 1.0).frame
        wide = right - left - 2 * _side(part)
        tall = top - bottom - HEIGHT - NOTE * count - _overhead(texts) - _below(part) - 3 * BETWEEN
        low_x, low, high_x, high = bounds(loop for loop, _ in part.cut)
        fit = min(wide / max(high_x - low_x, 2 * part.reach), tall / (high - low + 2 * part.reach))
        best.append(DrawingSheet(size, next((scale for scale in SCALES if scale <= fit), SCALES[-1])))
    return best[0] if best[0].scale >= 1 else max(best, key=lambda sheet: sheet.scale)


def _count(part: PartView, place: str) -> int:
    return sum(measure.place == place for measure in part.measures)


def _side(part: PartView) -> float:
    levels = max(_count(part, place) for place in ("left", "right", "plan"))
    return FIRST + max(LEVEL * levels + 4, 14.0 if part.items else 0.0, RADIUS if part.edge else 0.0)


def _below(part: PartView) -> float:
    return FIRST + LEVEL * _count(part, "below")


def _overhead(texts: list[str]) -> float:
    """Room above the section, where the text of a short upright dimension stands."""
    return max(room(text) for text in texts) + 3 * ARROW + 2


def _views(sheet: DrawingSheet, part: PartView, texts: dict[Measure, str], process: str) -> None:
    left, _, right, top = sheet.frame
    unit = sheet.unit
    _, low, _, high = bounds(loop for loop, _ in part.cut)
    middle = (left + right) / 2
    front = sheet.view(middle, top - _overhead(list(texts.values())) - high * sheet.scale)
    _front(front, part, process)
    _dimensions(front, part, texts, process)
    plan = sheet.view(middle, front.y / unit - _below(part) - BETWEEN + (low - part.reach) * sheet.scale)
    _plan(plan, part)
    for level, measure in enumerate(one for one in part.measures if one.place == "plan"):
        at = part.reach + (FIRST + LEVEL * level) * unit
        plan.dimension(measure.start, measure.end, texts[measure], at=at, upright=True)


def _front(view: View, part: PartView, process: str) -> None:
    unit = view.sheet.unit
    _, low, _, high = bounds(loop for loop, _ in part.cut)
    for loop, angle in part.cut:
        view.section(loop, angle)
    for start, end in part.seen:
        view.line(start, end)
    view.line((0, low - 3 * unit), (0, high + 3 * unit), "AXIS")
    for x, z, up in part.seats if process == MACHINING else ():  # of others the title block says how their faces are made
        view.roughness((x, z), SEAT, up)
    for item, (tip, z) in enumerate(zip(part.items, _beside(part.items, low, ITEM * unit), strict=True), start=1):
        view.item(tip, (part.reach + FIRST * unit, z), str(item))


def _beside(tips: Sequence[Point], low: float, apart: float) -> list[float]:
    """Return the heights for the numbers of items: beside their tips as far as they stay apart, and none below ``low``."""
    heights: list[float] = []
    for _, z in tips:
        heights.append(min(z, heights[-1] - apart) if heights else z)
    up = low - apart
    for index in reversed(range(len(heights))):
        up = heights[index] = max(heights[index], up + apart)
    return heights


def _plan(view: View, part: PartView) -> None:
    for loop in part.plan:
        view.loop(loop)
    for radius in part.hidden:
        view.circle(radius, "HIDDEN")
    for start, end in part.plan_lines:
        view.line(start, end)
    view.cross(2 * part.reach, 2 * part.reach)


def _dimensions(view: View, part: PartView, texts: dict[Measure, str], process: str) -> None:
    unit = view.sheet.unit
    low_x, low, high_x, high = bounds(loop for loop, _ in part.cut)
    starts: dict[str, float] = {"below": low, "left": low_x, "right": high_x}
    for place, start in starts.items():
        sign = 1 if place == "right" else -1
        for level, measure in enumerate(one for one in part.measures if one.place == place):
            at = start + sign * (FIRST + LEVEL * level) * unit
            upright = place != "below"
            view.dimension(measure.start, measure.end, texts[measure], at=at, upright=upright, clear=high if upright else high_x)
    if part.edge is not None:
        radius, centre = part.edge
        held = tolerance(radius, radius=True, process=process)
        text = f"R{number(radius)}" + (f" \N{PLUS-MINUS SIGN}{written(held.deviation)}" if held.told else "")
        view.radius(centre, radius, -45, text, (high_x + (4 + room(text) / 2) * unit, low - 7.0 * unit))
