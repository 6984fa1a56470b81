"""Film patterns: outline, electrodes on both faces, leads and tabs, as DXF in true millimetres, seen from above.

The electrodes keep away from the cut edge, where they would short; the leads of the two faces lie beside each other, so that no
film between them gives charge; the inner film's leave through the groove, the outer one's on the other side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geometry.cad.drawing import number
from geometry.cad.stamp import Stamp
from geometry.scenes.probe import Probe
from geometry.workshop.dxf_properties import signed
from geometry.workshop.outlines import area, box, disc, open_ring
from geometry.workshop.parts import TITLES, Millimetres, millimetres
from geometry.workshop.sheet import Loop, bounds

INSET, OF_WIDTH = 0.5, 0.1  # mm between an electrode and the edge, at most this part of the film's width
TAB = 5.0  # mm: length of the tabs, on which a connector or a conductive adhesive finds hold
STRIP = 2.0  # mm: half the widest strip of leads
LAYERS = {  # colour index
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

    Attributes:
        name: of the film.
        layers: what is drawn.
        inset: between the electrodes and the edge, mm.
        active: area where both electrodes face each other, over the area of the block's end that the film covers.
        exit: where its leads leave: "groove", "gap", "outside" or "" where there is no way.
    """

    name: str
    layers: Pattern
    inset: float
    active: float
    exit: str


def film_patterns(probe: Probe) -> tuple[FilmPattern, ...]:
    """Return the patterns of the films, the inner one first; none where the probe has none."""
    one = millimetres(probe)
    return () if probe.film is None else (_inner(one), _outer(one))


def way_out(one: Millimetres) -> str:
    """Return by where the inner film's leads can leave: the groove, or the gap where the folded film fits into it."""
    return "groove" if one.depth > one.t else "gap" if one.ri - one.r2 > one.t else ""


def _inner(one: Millimetres) -> FilmPattern:
    way = way_out(one)
    inset = min(INSET, OF_WIDTH * one.r2)
    half = min(STRIP, 0.8 * one.half_width if way == "groove" else one.r2 / 3, 0.8 * (one.r2 - inset))
    reach = {"groove": one.ro, "gap": one.ri + one.h1}.get(way, 0.0)
    electrode = disc(one.r2 - inset)
    face = (disc(one.r2),)
    outline = face if not way else (_with_strip(one.r2, half, reach + TAB),)
    leads = _leads(one.r2 - inset, half, reach, 1.0) if way else {}
    layers = {"FILM_OUTLINE": outline, "ELECTRODE_TOP": (electrode,), "ELECTRODE_BOTTOM": (electrode,), **leads, "ADHESIVE": face}
    return FilmPattern("film-inner", layers, inset, area(electrode) / area(face[0]), way)


def _outer(one: Millimetres) -> FilmPattern:
    inset = min(INSET, OF_WIDTH * (one.ro - one.ri))
    half = min(STRIP, one.ro / 3)
    strip = _with_strip(one.ro, half, one.ro + TAB, -1.0)
    face: tuple[Loop, ...] = (disc(one.ro), disc(one.ri))
    electrode: tuple[Loop, ...] = (disc(one.ro - inset), disc(one.ri + inset))
    outline: tuple[Loop, ...] = (strip, disc(one.ri))
    if one.depth:
        face = (open_ring(one.ri, one.ro, one.half_width),)
        electrode = (open_ring(one.ri + inset, one.ro - inset, one.half_width + inset),)
        outline = (_open_with_strip(one, half),)
    leads = _leads(one.ro - inset, half, one.ro, -1.0)
    layers = {"FILM_OUTLINE": outline, "ELECTRODE_TOP": electrode, "ELECTRODE_BOTTOM": electrode, **leads, "ADHESIVE": face}
    return FilmPattern("film-outer", layers, inset, _net(electrode) / _net(face), "outside")


def _net(loops: tuple[Loop, ...]) -> float:
    first, *holes = (area(loop) for loop in loops)
    return first - sum(holes)


def _with_strip(radius: float, half: float, end: float, side: float = 1.0) -> Loop:
    """Return a disc with a strip of that half width to x = ``end``, or to -x where ``side`` is -1."""
    x = math.sqrt((radius - half) * (radius + half))
    there = math.tan((math.pi - math.asin(half / radius)) / 2)
    corners = [(x, half, there), (x, -half, 0.0), (end, -half, 0.0), (end, half, 0.0)]
    return [(side * x, side * y, bulge) for x, y, bulge in corners]  # turned by 180 degrees, which keeps the bulges


def _open_with_strip(one: Millimetres, half: float) -> Loop:
    """Return the open ring with a strip towards -x."""
    first, *rest = open_ring(one.ri, one.ro, one.half_width)
    x = -math.sqrt((one.ro - half) * (one.ro + half))
    turn = math.pi - math.asin(one.half_width / one.ro) - math.asin(half / one.ro)
    arc, end = math.tan(turn / 4), -one.ro - TAB
    return [(*first[:2], arc), (x, half, 0.0), (end, half, 0.0), (end, -half, 0.0), (x, -half, arc), *rest]


def _leads(radius: float, half: float, reach: float, side: float) -> Pattern:
    """Return leads, from inside an electrode of that radius to ``reach``, and tabs beyond it; those of the bottom below y = 0."""
    start = math.sqrt(radius**2 - (0.8 * min(half, radius)) ** 2)
    found: Pattern = {}
    for face, sign in (("TOP", 1.0), ("BOTTOM", -1.0)):
        low, high = sorted((sign * 0.2 * half, sign * 0.8 * half))
        for layer, left, right in (("LEAD", start, reach), ("TAB", reach, reach + TAB - 0.2 * half)):
            loop = box(left, right, low, high)
            found[f"{layer}_{face}"] = ([(side * x, y, bulge) for x, y, bulge in (loop if side > 0 else loop[::-1])],)
    return found


def document(pattern: FilmPattern, stamp: Stamp, thickness: float) -> Any:
    """Return the DXF document of a pattern; ``thickness`` of the film in mm."""
    from ezdxf.filemanagement import new

    drawing = new("R2010", units=4)
    drawing.header["$MEASUREMENT"] = 1
    for name, colour in LAYERS.items():
        drawing.layers.add(name, color=colour)
    model = drawing.modelspace()
    for name, loops in pattern.layers.items():
        for loop in loops:
            model.add_lwpolyline(loop, format="xyb", close=True, dxfattribs={"layer": name})
    left, low, right, _ = bounds(pattern.layers["FILM_OUTLINE"])
    reach = max(math.hypot(x, y) for loop in pattern.layers["ADHESIVE"] for x, y, _ in loop)
    height = (right - left + reach) / 60
    for line, text in enumerate(_said(pattern, stamp, thickness)):
        place = (min(left, -reach), min(low, -reach) - height * (3 + 2 * line))
        model.add_text(text, height=height, dxfattribs={"layer": "TEXT", "insert": place})
    return drawing


def _said(pattern: FilmPattern, stamp: Stamp, thickness: float) -> list[str]:
    first = f"{TITLES[pattern.name]}, {number(thickness)} thick, mm 1:1, from above; electrodes {number(pattern.inset)} inside"
    return [
        first,
        f"Electrodes face each other on {100 * pattern.active:.1f} % of the end.",
        f"design {stamp.design}",
        stamp.program,
    ]


def write(pattern: FilmPattern, stamp: Stamp, thickness: float, path: Path) -> None:
    """Write a pattern as DXF; ``thickness`` of the film in mm. Raises ``OSError``."""
    signed(document(pattern, stamp, thickness), stamp).saveas(path)
