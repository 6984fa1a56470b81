"""Draw an overview page: a dimensioned axial section, a magnified detail, and a cutaway view of the assembly."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad import solids
from geometry.cad.materials import find_part_materials
from geometry.common.files import write_whole
from geometry.provenance.texts import build_picture_metadata
from geometry.scenes.base_sizes import assumed_sizes, has_flange
from geometry.scenes.probe import Probe
from geometry.scenes.units import MM_PER_M
from geometry.workshop import cutaway
from geometry.workshop.millimetres import convert_to_mm
from geometry.workshop.outlines import build_box, convert_to_polygon
from geometry.workshop.parts import build_part_views
from geometry.workshop.sheet import DIAMETER_SIGN, Point, format_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes


ASSUMED_MARK = "*"  # follows dimensions that the scene does not give
SHEET_SIZE_INCH = (16.0, 9.0)  # inches
SECTION_PANEL = (0.025, 0.05, 0.56, 0.86)  # position of the section on the sheet: left, bottom, width, height
DIMENSION_SPACING_INCH = 0.34  # inches between two dimension lines
HATCH_OF_PART = {"inner": "//", "outer": "\\\\", "film-inner": "xxxx", "film-outer": "xxxx", "base": "/"}


def draw_probe(probe: Probe, path: Path, edge_radius: float = 0.0) -> Path:
    """Write the overview of a probe as a PNG of 2400 x 1350 pixels, dimensions in mm; return ``path``.

    Parameters
    ----------
    probe
        The probe to be drawn.
    path
        Path of the PNG.
    edge_radius
        Radius of the blocks' lower edges, m; 0: sharp.

    Raises
    ------
    ExportError, InputError, MissingLibrary
        See ``solids.build_parts``.
    OSError
        The file cannot be written.
    """
    shapes = solids.build_parts(probe, edge_radius)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SHEET_SIZE_INCH, dpi=150, facecolor="white")
    FigureCanvasAgg(figure)
    plane = "its axis" if probe.groove is None else "the groove's plane"
    star = f"; {ASSUMED_MARK} assumed: not in the scene" if assumed_sizes(probe) else ""
    figure.text(0.03, 0.955, f"Tactile probe: section through {plane} (y = 0)", fontsize=15, weight="bold")
    figure.text(0.03, 0.93, f"dimensions in mm; tissue below, at z = 0{star}", fontsize=10)
    _draw_section(figure.add_axes(SECTION_PANEL), probe, edge_radius)
    _draw_detail(figure.add_axes((0.60, 0.07, 0.16, 0.31)), probe, edge_radius)
    for line, (text, colour) in enumerate(_build_notes(probe, edge_radius)):
        figure.text(0.785, 0.37 - 0.028 * line, "\N{BLACK SQUARE}", fontsize=13, va="center", color=colour or "none")
        figure.text(0.798, 0.37 - 0.028 * line, text, fontsize=9, va="center")
    cutaway.draw_cutaway(figure.add_axes((0.57, 0.40, 0.43, 0.58), projection="3d"), shapes, probe.hole_radius * MM_PER_M)
    with write_whole(Path(path)) as draft:
        figure.savefig(draft, format="png", metadata=build_picture_metadata("png"))
    return Path(path)


def build_section_outlines(probe: Probe, edge_radius: float = 0.0) -> dict[str, list[list[Point]]]:
    """Return the polygons (x, z), mm, in which the plane y = 0 cuts each part; round edges (radius in m) are chords."""
    views = build_part_views(probe, edge_radius)
    return {name: [convert_to_polygon(loop) for loop, _ in view.cut] for name, view in views.items()}


def _fill_section(axes: Axes, probe: Probe, edge_radius: float) -> None:
    if probe.groove is not None:  # visible behind the cut: the groove's side, and the film's edge above it
        lengths = convert_to_mm(probe)
        side = build_box(lengths.ri, lengths.ro, lengths.h1 - lengths.depth, lengths.h1)
        film = build_box(lengths.ri, lengths.ro, lengths.h1, lengths.h1 + lengths.t)
        for box, name, opacity, edge in ((side, "outer", 0.25, "0.4"), (film, "film-outer", 0.35, "none")):
            tint = (*solids.PART_COLOURS[name], opacity)
            axes.fill(*zip(*convert_to_polygon(box), strict=True), facecolor=tint, edgecolor=edge, lw=0.6)
    for name, polygons in build_section_outlines(probe, edge_radius).items():
        tint = (*solids.PART_COLOURS[name], 0.75)
        for polygon in polygons:
            axes.fill(*zip(*polygon, strict=True), facecolor=tint, edgecolor="0.15", hatch=HATCH_OF_PART[name], lw=0.9)


def _draw_section(axes: Axes, probe: Probe, edge_radius: float) -> None:
    lengths = convert_to_mm(probe, edge_radius)
    r2, ri, ro, h2, h1, edge = lengths.r2, lengths.ri, lengths.ro, lengths.h2, lengths.h1, lengths.edge
    rf, flange_bottom, top = lengths.rf, lengths.flange_bottom, lengths.top
    inch = _set_frame(axes, rf, top)  # mm of the probe in an inch of paper
    _fill_section(axes, probe, edge_radius)
    axes.axhline(0, color="0.55", lw=0.6, ls=(0, (6, 3)), zorder=0)
    axes.plot([0, 0], [-0.15 * inch, top + 0.15 * inch], color="0.2", lw=0.8, ls="-.")
    step = DIMENSION_SPACING_INCH * inch
    for level, radius in enumerate((r2, ri, ro), start=1):
        _draw_dimension(
            axes,
            (-radius, 0),
            (radius, 0),
            line_position=-level * step,
            text=DIAMETER_SIGN + format_number(2 * radius),
            inch=inch,
        )
    if has_flange(probe):
        text = DIAMETER_SIGN + _format_length(probe, "base.flange_radius", 2 * rf)
        _draw_dimension(axes, (-rf, top), (rf, top), line_position=top + step, text=text, inch=inch)
        low = max(lengths.low, lengths.side)
        text = _format_length(probe, "base.step_height", flange_bottom - low)
        _draw_dimension(axes, (ro, flange_bottom), (ro, low), line_position=rf + 2 * step, text=text, inch=inch, upright=True)
    whole = format_number(top) + ASSUMED_MARK * (assumed_sizes(probe).keys() - {"probe.base.flange_radius"} != set())
    lefts = [((-ro, h1), format_number(h1)), ((-r2, h2), format_number(h2)), ((-rf, top), whole)]
    for level, (corner, text) in enumerate(lefts if h1 != h2 else lefts[::2], start=1):
        _draw_dimension(axes, (-ro, 0), corner, line_position=-rf - level * step, text=text, inch=inch, upright=True)
    text = _format_length(probe, "base.thickness", top - flange_bottom)
    _draw_dimension(axes, (rf, flange_bottom), (rf, top), line_position=rf + step, text=text, inch=inch, upright=True)
    _draw_leader(axes, (-lengths.middle, edge), (-rf - step, -2.2 * step), f"gap {format_number(ri - r2)}")
    if edge > 0:
        cut = edge * (1 - 0.5**0.5)  # from the corner of the sharp block to the middle of the arc
        low = min(-0.35 * step, h1 - 0.25 * inch - 0.5 * step)  # below the arrows of the dimensions on the right
        _draw_leader(axes, (ro - cut, cut), (rf + 2.2 * step, low), f"R {format_number(edge)}")
    if probe.groove is not None:
        depth = lengths.depth
        _draw_dimension(
            axes, (ro, h1 - depth), (ro, h1), line_position=rf + 3 * step, text=format_number(depth), inch=inch, upright=True
        )
        text = f"groove {format_number(2 * lengths.half_width)} wide, {format_number(depth)} deep,\non this side only"
        _draw_leader(axes, ((ri + ro) / 2, h1 - depth / 2), (max(rf, ro + 0.6 * inch) + step, -3.8 * step), text)


def _set_frame(axes: Axes, radius: float, height: float) -> float:
    """Scale the axes so that the probe and its dimension lines fill them; return mm of the probe per inch."""
    width, tall = SECTION_PANEL[2] * SHEET_SIZE_INCH[0], SECTION_PANEL[3] * SHEET_SIZE_INCH[1]
    inch = max(2 * radius / (width - 8 * DIMENSION_SPACING_INCH - 0.4), height / (tall - 7 * DIMENSION_SPACING_INCH))
    axes.set_xlim(-width / 2 * inch, width / 2 * inch)
    middle = height / 2 - 1.5 * DIMENSION_SPACING_INCH * inch  # there are more dimension lines below than above
    axes.set_ylim(middle - tall / 2 * inch, middle + tall / 2 * inch)
    axes.set_axis_off()
    return inch


def _draw_dimension(
    axes: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    *,
    line_position: float,
    text: str,
    inch: float,
    upright: bool = False,
) -> None:
    """Draw a dimension line at ``line_position`` between two points; short ones get arrows from outside."""
    axis = 1 if upright else 0

    def place(along: float) -> Point:
        return (line_position, along) if upright else (along, line_position)

    low, high = sorted((start[axis], end[axis]))
    for point in (start, end):
        axes.plot(*zip(point, place(point[axis]), strict=True), color="0.45", lw=0.5)
    style = {"lw": 0.7, "color": "black", "shrinkA": 0, "shrinkB": 0}
    if high - low > 0.3 * inch:
        axes.annotate("", place(low), place(high), arrowprops={"arrowstyle": "<|-|>,head_width=0.12,head_length=0.35", **style})
    else:
        for tip, tail in ((low, low - 0.25 * inch), (high, high + 0.25 * inch)):
            axes.annotate("", place(tip), place(tail), arrowprops={"arrowstyle": "-|>,head_width=0.12,head_length=0.35", **style})
    text_position, room = (low + high) / 2, (0.1 + 0.085 * len(text)) * inch
    if high - low < room:  # the number does not fit between the arrows and is placed beyond them
        text_position = high + 0.3 * inch + room / 2
        axes.plot(*zip(place(high), place(text_position), strict=True), color="black", lw=0.7)
    white = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
    x, y = place(text_position)
    axes.text(x, y, text, rotation=90 * upright, ha="center", va="center", fontsize=10, bbox=white)


def _draw_leader(axes: Axes, tip: tuple[float, float], place: tuple[float, float], text: str) -> None:
    arrow = {"arrowstyle": "-|>,head_width=0.12,head_length=0.35", "lw": 0.7, "color": "black", "shrinkB": 0}
    box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    axes.annotate(text, tip, place, ha="center", va="center", fontsize=10, arrowprops=arrow, bbox=box, zorder=9)


def _draw_detail(axes: Axes, probe: Probe, edge_radius: float) -> None:
    """Magnify the gap's corner at the outer film."""
    lengths = convert_to_mm(probe)
    ri, ro, h1, t, gap = lengths.ri, lengths.ro, lengths.h1, lengths.t, lengths.ri - lengths.r2
    reach = 2.2 * max(gap, t)
    x, z = -lengths.middle, h1 + t / 2
    axes.set(xlim=(x - reach, x + reach), ylim=(z - reach, z + reach), xticks=[], yticks=[], aspect="equal")
    place = "film" if probe.film else "block's upper end"
    axes.set_title(f"detail at the outer {place}, -x side", fontsize=10)
    _fill_section(axes, probe, edge_radius)
    height = h1 - min(reach, h1) / 2
    boss = lengths.low < height  # the base reaches down into the hole and halves the gap
    tip, text = (x - gap / 4, f"clearance {format_number(gap / 2)}") if boss else (x, f"gap {format_number(gap)}")
    _draw_leader(axes, (tip, height), (x - 0.5 * reach, z - 0.85 * reach), text)
    if probe.film is not None:
        film = -ri - min(reach - gap / 2, ro - ri) / 2  # the middle of its visible part
        _draw_leader(axes, (film, z), (film, z + 0.7 * reach), f"film {_format_length(probe, 'film.thickness', t)}")


def _build_notes(probe: Probe, edge_radius: float) -> list[tuple[str, tuple[float, float, float] | None]]:
    """Return the lines of the legend, each with its colour."""
    thick = f"{_format_length(probe, 'film.thickness', solids.film_thickness(probe) * MM_PER_M)} thick"
    cut, step = probe.groove_footprint, DIAMETER_SIGN + format_number(2 * probe.tube_radius * MM_PER_M)
    materials = find_part_materials(probe)
    texts = {
        "inner": f"inner block: {materials['inner'].text}",
        "outer": f"outer block: {materials['outer'].text}",
        "film-inner": f"inner film, {thick}",
        "film-outer": f"outer film, {thick}" + (", open above the groove" if cut else ""),
        "base": ("base" if probe.base.material is None else f"base of {probe.base.material}")
        + (f", step {step}" if has_flange(probe) else f", {step}"),
    }
    lines: list[tuple[str, tuple[float, float, float] | None]] = [
        (text, solids.PART_COLOURS[name]) for name, text in texts.items() if probe.film or "film" not in name
    ]
    lines += [] if probe.film else [("no films: the scene has none", None)]
    areas = {"inner end A2": probe.inner_area, "outer end A1": probe.outer_area}
    if cut:
        end = "film" if probe.film else "base"
        areas |= {f"outer end at the {end}": probe.outer_area - cut, "groove's footprint": cut}
    lines += [(f"{what} = {area * MM_PER_M**2:.6g} mm\u00b2", None) for what, area in areas.items()]
    lines += [(f"A2/A1 = {probe.inner_area / probe.outer_area:.6g}", None)]
    round_edges = f"lower edges R {format_number(edge_radius * MM_PER_M)}; A1, A2 as if sharp"
    lines += [(round_edges, None)] if edge_radius else []
    return lines


def _format_length(probe: Probe, key: str, length: float) -> str:
    """Return a length in mm as text, with a mark if it is assumed because the scene does not give ``key`` of the probe."""
    return format_number(length) + (ASSUMED_MARK if f"probe.{key}" in assumed_sizes(probe) else "")
