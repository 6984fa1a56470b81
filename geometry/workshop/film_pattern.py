"""Draw film patterns: outline, electrodes on both faces, leads and tabs, as DXF in true millimetres, seen from above.

The electrodes keep a distance from the cut edge, where they would short: the scene's ``electrode_inset``, or where that is 0 a
usual one. The leads of the two faces do not overlap, so that the
film under them yields no charge. The inner film's leads leave through the groove, the outer film's on the other side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.cad.stamp import Stamp
from geometry.scenes.probe import Probe
from geometry.workshop.outlines import Millimetres, build_box, build_disc, build_open_ring, compute_area, convert_to_mm
from geometry.workshop.parts import DRAWING_TITLES
from geometry.workshop.sheet import Loop, add_properties, find_bounds, format_number

if TYPE_CHECKING:
    from ezdxf.document import Drawing


MAX_INSET_MM, MAX_INSET_FRACTION = 0.5, 0.1  # mm between an electrode and the edge, at most this fraction of the film's width
TAB_LENGTH_MM = 5.0  # mm: length of the tabs, for a connector or a conductive adhesive
LEAD_EDGES_RELATIVE = (0.2, 0.8)  # of half the strip's width: a lead runs between them, on either side of the middle
MAX_STRIP_HALF_WIDTH_MM = 2.0  # mm: half the widest strip of leads
LAYER_COLOURS = {  # colour index
    "FILM_OUTLINE": 7,
    "ELECTRODE_TOP": 1,
    "ELECTRODE_BOTTOM": 5,
    "LEAD_TOP": 1,
    "LEAD_BOTTOM": 5,
    "TAB_TOP": 1,
    "TAB_BOTTOM": 5,
    "ADHESIVE": 3,
    "TEXT": 8,
}
Pattern = dict[str, tuple[Loop, ...]]
"""Closed outlines by layer, mm; of two in one layer the smaller is a hole."""


@dataclass(frozen=True)
class FilmPattern:
    """The pattern of a film.

    Attributes
    ----------
    name
        Name of the film.
    layers
        Outlines by layer.
    thickness
        Thickness of the film, mm.
    inset
        Distance between the electrodes and the edge, mm.
    assumed
        Whether the scene has electrodes that reach the edge, so that the distance is a usual one.
    active
        Area where both electrodes face each other, over the area of the block's end that the film covers.
    exit
        Where its leads leave: "groove", "gap", "outside", or "" where they cannot.
    """

    name: str
    layers: Pattern
    thickness: float
    inset: float
    assumed: bool
    active: float
    exit: str


def build_film_patterns(probe: Probe) -> tuple[FilmPattern, ...]:
    """Return the patterns of the films, the inner one first; empty for a probe without films."""
    sizes = convert_to_mm(probe)
    return () if probe.film is None else (_build_inner(sizes), _build_outer(sizes))


def find_exit(sizes: Millimetres) -> str:
    """Return where the inner film's leads can leave: through the groove, or through the gap if the folded film fits."""
    return "groove" if sizes.depth > sizes.t2 else "gap" if sizes.ri - sizes.r2 > sizes.t2 else ""


def _find_inset(given: float, width: float) -> float:
    """Return the distance between electrode and edge, mm: the scene's, or where that is 0 one that suits the film's width."""
    return given or min(MAX_INSET_MM, MAX_INSET_FRACTION * width)


def _build_inner(sizes: Millimetres) -> FilmPattern:
    """Return the pattern of the inner film, a disc with a strip of leads towards +x if they can leave."""
    exit_name = find_exit(sizes)
    inset = _find_inset(sizes.inset2, sizes.r2)
    half = min(
        MAX_STRIP_HALF_WIDTH_MM, 0.8 * sizes.half_width if exit_name == "groove" else sizes.r2 / 3, 0.8 * (sizes.r2 - inset)
    )
    # where the tabs begin: outside the tube; through the gap the strip is folded and runs down the outer block's height
    reach = {"groove": sizes.ro, "gap": sizes.ri + sizes.h1}.get(exit_name, 0.0)
    electrode = build_disc(sizes.r2 - inset)
    face = (build_disc(sizes.r2),)
    outline = face if not exit_name else (_add_strip(sizes.r2, half, reach + TAB_LENGTH_MM),)
    leads = _build_leads(sizes.r2 - inset, half, reach, 1.0) if exit_name else {}
    layers = {"FILM_OUTLINE": outline, "ELECTRODE_TOP": (electrode,), "ELECTRODE_BOTTOM": (electrode,), **leads, "ADHESIVE": face}
    active = compute_area(electrode) / compute_area(face[0])
    return FilmPattern("film-inner", layers, sizes.t2, inset, not sizes.inset2, active, exit_name)


def _build_outer(sizes: Millimetres) -> FilmPattern:
    """Return the pattern of the outer film, a ring with a strip of leads towards -x, open above a groove."""
    inset = _find_inset(sizes.inset1, sizes.ro - sizes.ri)
    half = min(MAX_STRIP_HALF_WIDTH_MM, sizes.ro / 3)
    strip = _add_strip(sizes.ro, half, sizes.ro + TAB_LENGTH_MM, -1.0)
    face: tuple[Loop, ...] = (build_disc(sizes.ro), build_disc(sizes.ri))
    electrode: tuple[Loop, ...] = (build_disc(sizes.ro - inset), build_disc(sizes.ri + inset))
    outline: tuple[Loop, ...] = (strip, build_disc(sizes.ri))
    if sizes.depth:
        face = (build_open_ring(sizes.ri, sizes.ro, sizes.half_width),)
        electrode = (build_open_ring(sizes.ri + inset, sizes.ro - inset, sizes.half_width + inset),)
        outline = (_add_strip_to_open_ring(sizes, half),)
    leads = _build_leads(sizes.ro - inset, half, sizes.ro, -1.0)
    layers = {"FILM_OUTLINE": outline, "ELECTRODE_TOP": electrode, "ELECTRODE_BOTTOM": electrode, **leads, "ADHESIVE": face}
    active = _compute_net_area(electrode) / _compute_net_area(face)
    return FilmPattern("film-outer", layers, sizes.t1, inset, not sizes.inset1, active, "outside")


def _compute_net_area(loops: tuple[Loop, ...]) -> float:
    """Return the area between the first outline and the others, which are its holes, mm^2."""
    first, *holes = (compute_area(loop) for loop in loops)
    return first - sum(holes)


def _add_strip(radius: float, half: float, end: float, side: float = 1.0) -> Loop:
    """Return a disc with a strip of half width ``half`` to x = ``end``, or to x = -``end`` if ``side`` is -1."""
    x = math.sqrt((radius - half) * (radius + half))  # where the strip's sides leave the circle
    bulge_outer = math.tan((math.pi - math.asin(half / radius)) / 2)
    corners = [(x, half, bulge_outer), (x, -half, 0.0), (end, -half, 0.0), (end, half, 0.0)]
    return [(side * x, side * y, bulge) for x, y, bulge in corners]  # turned by 180 degrees, which keeps the bulges


def _add_strip_to_open_ring(sizes: Millimetres, half: float) -> Loop:
    """Return the open ring with a strip towards -x."""
    first, *remaining = build_open_ring(sizes.ri, sizes.ro, sizes.half_width)
    x = -math.sqrt((sizes.ro - half) * (sizes.ro + half))
    turn = math.pi - math.asin(sizes.half_width / sizes.ro) - math.asin(half / sizes.ro)
    arc, end = math.tan(turn / 4), -sizes.ro - TAB_LENGTH_MM
    return [(*first[:2], arc), (x, half, 0.0), (end, half, 0.0), (end, -half, 0.0), (x, -half, arc), *remaining]


def _build_leads(radius: float, half: float, reach: float, side: float) -> Pattern:
    """Return leads from inside an electrode of a radius to ``reach``, and tabs beyond; the bottom ones lie below y = 0.

    ``half`` is half the width of the strip of film that carries them, and ``side`` is 1 towards +x, -1 towards -x; mm.
    """
    near_middle, far_edge = LEAD_EDGES_RELATIVE
    start = math.sqrt(radius**2 - (far_edge * min(half, radius)) ** 2)  # where the lead's far edge leaves the electrode
    pattern: Pattern = {}
    for face, sign in (("TOP", 1.0), ("BOTTOM", -1.0)):
        low, high = sorted((sign * near_middle * half, sign * far_edge * half))
        tab_end = reach + TAB_LENGTH_MM - near_middle * half  # as far from the strip's end as from its middle
        for layer, left, right in (("LEAD", start, reach), ("TAB", reach, tab_end)):
            loop = build_box(left, right, low, high)
            pattern[f"{layer}_{face}"] = ([(side * x, y, bulge) for x, y, bulge in (loop if side > 0 else loop[::-1])],)
    return pattern


def build_document(pattern: FilmPattern, stamp: Stamp) -> Drawing:
    """Return the DXF document of a pattern."""
    from ezdxf.filemanagement import new

    drawing = new("R2010", units=4)
    drawing.header["$MEASUREMENT"] = 1
    for name, colour in LAYER_COLOURS.items():
        drawing.layers.add(name, color=colour)
    model = drawing.modelspace()
    for name, loops in pattern.layers.items():
        for loop in loops:
            model.add_lwpolyline(loop, format="xyb", close=True, dxfattribs={"layer": name})
    left, low, right, _ = find_bounds(pattern.layers["FILM_OUTLINE"])
    reach = max(math.hypot(x, y) for loop in pattern.layers["ADHESIVE"] for x, y, _ in loop)
    height = (right - left + reach) / 60
    for line, text in enumerate(_list_texts(pattern, stamp)):
        place = (min(left, -reach), min(low, -reach) - height * (3 + 2 * line))
        model.add_text(text, height=height, dxfattribs={"layer": "TEXT", "insert": place})
    return drawing


def _list_texts(pattern: FilmPattern, stamp: Stamp) -> list[str]:
    """Return the lines of text below the pattern."""
    first = (
        f"{DRAWING_TITLES[pattern.name]}, {format_number(pattern.thickness)} thick, mm 1:1, from above; electrodes "
        f"{format_number(pattern.inset)} inside{' (assumed)' if pattern.assumed else ''}"
    )
    return [
        first,
        f"Electrodes face each other on {100 * pattern.active:.1f} % of the end.",
        f"design {stamp.design}",
        stamp.program,
    ]


def write_pattern(pattern: FilmPattern, stamp: Stamp, path: Path) -> None:
    """Write a pattern as DXF. Raises ``OSError``."""
    add_properties(build_document(pattern, stamp), stamp).saveas(path)
